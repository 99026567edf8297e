"""What a run ends with: the accuracy, what was found and page one's verdict, as plain lines."""

from __future__ import annotations

import math

from calflow.diagnosis.findings.extended_model import DiagnosisSummary
from calflow.diagnosis.findings.finding import Finding
from calflow.effects.words import place_name
from calflow.estimation.accuracy import Accuracy
from calflow.files.results import Results
from calflow.files.tables import from_frame
from calflow.files.words import mm, number
from calflow.reporting.findings import findings
from calflow.reporting.material import gathered, latest, split_judged, steps
from calflow.reporting.section import advice, sections
from calflow.reporting.sections.verdict import SECTION, headline, judgement

WRONG = 2  # urgency of advice that is repeated; what could be better is left to the report


def last_lines(results: Results) -> list[str]:
    """Return accuracy, findings, verdict and what is wrong, as far as there are results of it."""
    return [*_accuracy(results), *_findings(results), *_verdict(results), *_wrong(results)]


def _accuracy(results: Results) -> list[str]:
    """The accuracy of every model on the way; of a model with one more cause, what it has more."""
    if "identify/accuracy.csv" not in results:
        return []
    own = set(results.tables["identify/accuracy.csv"]["model"])
    rows = from_frame(latest(results, "accuracy"), Accuracy)
    names = [row.model if row.model in own else f"+ {place_name(row.effect, row.joint, row.part)}" for row in rows]
    width = max(map(len, names))
    return [
        f"{'position error':{width}}  split      mean mm    max mm",
        *(
            f"{name:{width}}  {row.split:8} {row.mean_mm:9.3f} {row.max_mm:9.3f}"
            for name, row in zip(names, rows, strict=True)
        ),
    ]


def _findings(results: Results) -> list[str]:
    if "diagnose/findings.csv" not in results:
        return []
    told = [f"found: {_told(one)}" for one in findings(results)]
    unseen = results.document("diagnose/summary.json", DiagnosisSummary).unseen
    return told or [f"found: nothing that the model lacks{f'; {unseen}' if unseen else ''}"]


def _told(one: Finding) -> str:
    """A finding with its cause, joint, size and gain."""
    said, (gain, low, high) = one.in_short, one.gain
    if one.is_misfit or one.status == "data_fault":
        return said
    if math.isnan(gain):
        return said
    if math.isnan(low):
        return f"{said}; takes {mm(gain)} mm off the mean error"
    interval = f"({number(low, '.3f')} to {number(high, '.3f')}, 95 %)"
    if low > 0:
        return f"{said}; takes {mm(gain)} mm off the mean error {interval}"
    if high < 0:
        return f"{said}; makes the mean error {mm(-gain)} mm larger at poses that no fit has seen {interval}"
    return f"{said}; takes nothing off the mean error that poses that no fit has seen would show {interval}"


def _verdict(results: Results) -> list[str]:
    if not all(name in results for name in SECTION.needs):
        return []
    accuracy = latest(results, "accuracy")
    split = split_judged(accuracy)
    found = gathered(steps(accuracy, split), len(steps(results.tables["identify/accuracy.csv"], split)))
    return [judgement(results, found), headline(found, split)]


def _wrong(results: Results) -> list[str]:
    return [f"! {item.sentence}" for item in advice(sections(), results) if item.urgency <= WRONG]
