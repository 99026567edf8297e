"""The causes on the first page: what the study's model lacked, and what the data leave open of it."""

from __future__ import annotations

import math

from calflow.diagnosis.findings.diagnosis_summary import DiagnosisSummary
from calflow.diagnosis.findings.tables import UNEXPLAINED
from calflow.files.results import Results
from calflow.reporting.causes.gain import labels
from calflow.reporting.causes.unexplained import structure, unexplained_findings
from calflow.reporting.findings import Found, findings
from calflow.reporting.words import first_up, listed, mm, plural


def lacked(results: Results, most: int = 4) -> list[str | tuple[str, str]]:
    """Say for the first page in a line each what the model lacked."""
    causes = [one for one in findings(results) if one.told]
    if not causes:
        told = "No cause explains what is left" if unexplained_findings(results) else "Nothing was found"
        tested = results.document("diagnose/summary.json", DiagnosisSummary).causes_tested
        return [f"{told}: {tested} causes were tested."]
    names = labels(causes)
    said: list[str | tuple[str, str]] = [
        (f"{first_up(label)}:", _in_short(one)) for label, one in zip(names[:most], causes[:most], strict=True)
    ]
    if len(causes) > most:
        rest = listed(list(dict.fromkeys(one.name for one in causes[most:])))
        said.append((f"And {plural(len(causes) - most, 'more cause')}:", f"{rest}."))
    return said


def _in_short(one: Found) -> str:
    gain, low, _ = one.gain
    gained = f"; it takes {mm(gain)} mm off the mean error" if math.isfinite(gain) and low > 0 else ""
    unproven = "; the step that added it shows no gain at held-out poses" if math.isfinite(gain) and low <= 0 else ""
    return f"{one.amount}{gained}{unproven}."


def unsure(results: Results) -> list[str]:
    """Say for the first page which names and which structure the data leave open."""
    said = []
    for one in findings(results):
        if one.of_family:
            said.append(f"The order, or finer form, of the {one.name}.")
        if UNEXPLAINED in one.alike:
            said.append(f"Whether it is {one.name} at all, or a part of what stays unexplained.")
        elif one.status == "one_of" and one.others:
            said.append(f"Whether it is {' or '.join([one.name, *(rival.name for rival in one.others[:3])])}.")
    left = unexplained_findings(results)
    why = f"Why a part of the error depends on {structure(results)}: no cause of the catalogue explains it."
    gain = max((one.gain[0] for one in left if one.gain[1] > 0), default=0.0)
    worth = f" What depends on it is worth {mm(gain)} mm of the mean error, or more." if gain else ""
    return [*said, why + worth] if left else said
