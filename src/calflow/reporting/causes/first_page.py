"""The causes on the first page: what the study's model lacked, and what the data leave open of it."""

from __future__ import annotations

import math

from calflow.diagnosis.findings.extended_model import DiagnosisSummary
from calflow.diagnosis.findings.finding import Finding
from calflow.effects.words import UNEXPLAINED
from calflow.estimation.fit_summary import IdentifySummary
from calflow.files.results import Results
from calflow.files.words import first_up, listed, mm, plural
from calflow.reporting.causes.gain import labels
from calflow.reporting.causes.unexplained import lack_of_fit, structure, unexplained_findings
from calflow.reporting.findings import findings

CAPPED = (
    "As many causes were found as were allowed (stages.diagnose.causes): there may be more, and what they would explain is "
    "left over or put down to those."
)


def foremost(results: Results) -> list[str]:
    """Say what a reader must know before any cause: a contradicted noise, and that the model leaves more than its noise."""
    doubts = results.document("identify/summary.json", IdentifySummary).noise_doubts
    said = (*(doubt.statement for doubt in doubts), lack_of_fit(results))
    return [sentence for sentence in said if sentence]


def lacked(results: Results, most: int = 4) -> list[str | tuple[str, str]]:
    """Say for the first page in a line each what the model lacked: what gains most first, what gains nothing last, as such."""
    causes = [one for one in findings(results) if one.is_cause]
    summary = results.document("diagnose/summary.json", DiagnosisSummary)
    if not causes:
        more = unexplained_findings(results) or lack_of_fit(results)
        told = "No cause explains what is left" if more else "Nothing was found"
        unseen = f" {first_up(summary.unseen)}." if summary.unseen else ""
        return [f"{told}: {summary.causes_tested} causes were tested.{unseen}"]
    named = list(zip(causes, labels(causes), strict=True))
    worth = sorted((pair for pair in named if not _in_vain(pair[0])), key=lambda pair: -_gain(pair[0]))
    vain = [name for cause, name in named if _in_vain(cause)]
    said: list[str | tuple[str, str]] = [(f"{first_up(name)}:", _in_short(cause)) for cause, name in worth[:most]]
    if len(worth) > most:
        rest = listed(list(dict.fromkeys(cause.name for cause, _ in worth[most:])), len(worth))
        said.append((f"And {plural(len(worth) - most, 'more cause')}:", f"{rest}."))
    if vain:
        said.append(("In the model without measurable gain at held-out poses:", f"{listed(vain, len(vain))}."))
    if summary.capped:
        said.append(CAPPED)
    return said


def _in_vain(one: Finding) -> bool:
    """Whether the step that added a cause shows no gain at poses that no fit has seen."""
    return math.isfinite(one.gain[0]) and not one.gain[1] > 0


def _gain(one: Finding) -> float:
    """What a cause takes off the mean error; nothing where that is not known."""
    return one.gain[0] if math.isfinite(one.gain[0]) else 0.0


def _in_short(one: Finding) -> str:
    gained = f"; it takes {mm(one.gain[0])} mm off the mean error" if math.isfinite(one.gain[0]) else ""
    return f"{one.amount}{gained}."


def unsure(results: Results) -> list[str]:
    """Say for the first page which names and which structure the data leave open."""
    said = []
    for one in findings(results):
        if one.of_family:
            said.append(f"The order, or finer form, of the {one.name}.")
        if UNEXPLAINED in one.cannot_tell_from:
            said.append(f"Whether it is {one.name} at all, or a part of what stays unexplained.")
        elif one.status == "one_of" and one.others:
            said.append(f"Whether it is {' or '.join([one.name, *(rival.name for rival in one.others[:3])])}.")
    left = unexplained_findings(results)
    why = f"Why a part of the error depends on {structure(results)}: no cause of the catalogue explains it."
    gain = max((one.gain[0] for one in left if one.gain[1] > 0), default=0.0)
    worth = f" What depends on it is worth {mm(gain)} mm of the mean error, or more." if gain else ""
    return [*said, why + worth] if left else said
