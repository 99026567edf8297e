"""The section on acceptance: what was measured with what, whether it is good enough, and where to sign."""

from __future__ import annotations

from calflow.files.words import mm, plural
from calflow.reporting.blocks import Block, Paragraph, Signatures, Table
from calflow.reporting.material import Material, latest, split_judged, steps
from calflow.reporting.section import Section
from calflow.reporting.tolerance import Judged, judged
from calflow.study_file import Acceptance

KELVIN = 273.15
SIGN = ("Calibrated by: name, date, signature", "Accepted by: name, date, signature")
JUDGED = (
    "Judged is the distance from where the calibrated model predicts the tool to where the instrument saw it, the instrument's "
    "noise included, at poses that no fit has seen. The robot itself comes so near only where its controller has the model's "
    "figures, or its commands are corrected by them."
)


def write(material: Material) -> list[Block]:
    """State what the study gives, and the verdict."""
    asked = material.study.file.acceptance
    assert asked is not None
    accuracy = latest(material.results, "accuracy")
    verdict = judged(material, steps(accuracy, split_judged(accuracy)))
    return [
        *([Paragraph(verdict.verdict, 12, bold=True)] if verdict else []),
        Table(("what", "stated"), _stated(material, asked), "ll", wide=1),
        *_why(material, verdict),
        Signatures(SIGN),
    ]


def _stated(material: Material, asked: Acceptance) -> list[tuple[str, str]]:
    """What is stated, as it is signed; what the study leaves out is left out."""
    temperature = "" if asked.temperature is None else f"{asked.temperature - KELVIN:.1f} °C"
    facts = [
        ("robot", material.study.robot.name),
        ("serial number", asked.serial_number),
        ("instrument", asked.instrument),
        ("its certificate", asked.certificate),
        ("date of the measurement", asked.date.isoformat() if asked.date else ""),
        ("operator", asked.operator),
        ("temperature", temperature),
        ("tolerance", f"{mm(1e3 * asked.tolerance)} mm" if asked.tolerance else ""),
    ]
    return [(name, said) for name, said in facts if said]


def _why(material: Material, verdict: Judged | None) -> list[Block]:
    """Say what was judged, and what it says of other poses."""
    if verdict is None:
        return []
    splits = material.tables["identify/residuals.csv"]["split"]
    out = int((~splits.isin(["train", "holdout"])).sum())
    left_out = f" {plural(out, 'row')} of the measurement file were left out as faulty, and not judged." if out else ""
    return [Paragraph(f"{JUDGED} {verdict.share_words}{left_out}".replace("  ", " "))]


SECTION = Section(
    3,
    "Acceptance",
    ("identify/accuracy.csv", "identify/residuals.csv", "identify/summary.json"),
    write,
    asked=lambda study: study.file.acceptance is not None,
)
