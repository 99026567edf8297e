"""What no cause explains: what it depends on, and how much it matters."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.diagnosis.findings.extended_model import DiagnosisSummary
from calflow.diagnosis.findings.finding import Finding
from calflow.files.results import Results
from calflow.files.words import chance, first_up, listed, ratio
from calflow.reporting.blocks import Block, Bullets, Heading, Paragraph
from calflow.reporting.causes.gain import worth
from calflow.reporting.findings import findings
from calflow.reporting.section import Advice


def still_unexplained(left: Sequence[Finding]) -> list[Block]:
    """Tell what stays unexplained."""
    if not left:
        return []
    items = [
        ("The model as a whole:", f"{first_up(one.statement)}.") if one.is_misfit else
        (f"{first_up(one.inputs_in_words)}:", f"part of the error depends on it, and no cause of the catalogue explains it. The "
         f"chance that noise looks like this is {chance(one.p_family)}.{worth(one)}")
        for one in left
    ]  # fmt: skip
    return [
        Heading("What stays unexplained"),
        Bullets(items),
        Paragraph("It is not in the model. Where it acts, predictions are off by more than noise."),
    ]


def structure(results: Results) -> str:
    """Name what the unexplained part of the error depends on; empty where nothing is unexplained."""
    left = unexplained_findings(results)
    return listed([one.inputs_in_words for one in left], 3) if left else ""


def unexplained_findings(results: Results) -> list[Finding]:
    """Return what stays unexplained and depends on an input."""
    return [one for one in findings(results) if one.status == "unexplained" and not one.is_misfit]


def lack_of_fit(results: Results) -> str:
    """Say that the extended model leaves more than its noise, and where most; empty where it does not."""
    p = next((one.p_family for one in findings(results) if one.is_misfit), None)
    if p is None:
        return ""
    summary = results.document("diagnose/summary.json", DiagnosisSummary)
    where = summary.worst.words if summary.worst else "about alike everywhere"
    return f"The model leaves {ratio(summary.lack_of_fit)} times the noise (chance of so much: {chance(p)}), {where}."


def unexplained(results: Results) -> list[Advice]:
    """Structure without a cause is to be looked for at the robot."""
    if not unexplained_findings(results):
        return [_look_there(results)] if lack_of_fit(results) else []
    sentence = (
        f"Something depends on {structure(results)} that no cause of the catalogue explains. Look at the robot for what changes "
        "with it (hoses and cables, loose bolts, collisions, the device's support), and measure again."
    )
    return [Advice(2, sentence)]


def _look_there(results: Results) -> Advice:
    """What to do about a lack of fit that no input explains."""
    worst = results.document("diagnose/summary.json", DiagnosisSummary).worst
    where = f"where {worst.where}" if worst else "at the poses with the largest errors (diagnose/residuals.csv)"
    sentence = (
        f"More is left than noise, and nothing that was tested explains it. Measure again {where}, coming back to some poses from "
        "elsewhere: what repeats is the robot's, what does not is the device's or the set-up's."
    )
    return Advice(2, sentence)
