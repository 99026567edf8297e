"""The appendix: the facts of the run."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np

from calflow.diagnosis.findings.diagnosis_summary import DiagnosisSummary
from calflow.estimation.calibrated import DeviceNoise
from calflow.estimation.fit_summary import IdentifySummary
from calflow.reporting.blocks import Block, Columns, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.summaries import diagnosed, identified
from calflow.reporting.words import effect_words

LETTERS = 42  # of a value in a line
PACKAGES = ("calflow", "casadi", "emcee", "numpy", "scipy", "pandas")


def write(material: Material) -> list[Block]:
    """Tabulate what was asked, what was used and how it ended."""
    study = material.study
    facts: list[tuple[str, str] | str] = [
        "asked",
        ("study", study.name),
        ("robot", f"{study.robot.name}: {study.robot.n_joints} joints, {study.robot.kinematics}"),
        ("effects", ", ".join(effect_words(effect) for effect in study.file.effects)),
        ("measurements", ", ".join(source.file for source in study.file.sources) or "none"),
        ("workflow", f"{study.workflow.name}: {', '.join(study.stages)}"),
        ("seed", str(study.file.seed)),
        ("versions", ", ".join(f"{name} {version(name)}" for name in PACKAGES)),
        *(
            (f"settings of {stage}", _settings(study.settings(stage)))
            for stage in study.stages
            if study.settings(stage)
        ),
        *_identified(material),
        *_diagnosed(material),
    ]
    return [
        Paragraph("Hashes of all input files, durations and the state of each stage are in manifest.json; all tables named in "
                  "this report lie beside it as CSV, in SI units unless a column says otherwise."),
        Columns([[Table(("what", "value"), half, "ll", size=None, wide=1)] for half in _halves(facts)], [1, 1]),
    ]  # fmt: skip


def _halves(facts: list[tuple[str, str] | str]) -> tuple[list[tuple[str, str] | str], list[tuple[str, str] | str]]:
    """Part what stands in two columns where both take about as many lines; a heading stays with what it is for."""
    lines = np.cumsum([1 if isinstance(fact, str) else 1 + len(fact[1]) // LETTERS for fact in facts])
    middle = int((lines <= lines[-1] / 2).sum())
    if isinstance(facts[middle - 1], str):
        middle -= 1
    return facts[:middle], facts[middle:]


def _identified(material: Material) -> list[tuple[str, str] | str]:
    results, path = material.results, "identify/summary.json"
    if path not in results:
        return []
    noises = results.rows("identify/noise.csv", DeviceNoise)
    return ["found by identify", *identified(results.document(path, IdentifySummary), noises), *_placement(material)]


def _diagnosed(material: Material) -> list[tuple[str, str] | str]:
    path = "diagnose/summary.json"
    if path not in material.results:
        return []
    return ["found by diagnose", *diagnosed(material.results.document(path, DiagnosisSummary))]


def _settings(settings: dict[str, object]) -> str:
    return "; ".join(f"{name} = {_plainly(value)}" for name, value in settings.items())


def _plainly(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {_plainly(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plainly(inner) for inner in value) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _placement(material: Material) -> list[tuple[str, str]]:
    rows = material.tables["identify/placement.csv"].to_dict("records")
    return [
        ("nominal place",
         f"{row['what']}: "
         + ", ".join(f"{axis} {1e3 * row[f'{axis}_m']:.2f} mm" for axis in "xyz")
         + (", " + ", ".join(f"{a} {row[f'{a}_deg']:.3f} deg" for a in ("rx", "ry", "rz")) if row["what"] == "base" else "")
         + f" ({row['source']})")
        for row in rows
    ]  # fmt: skip


SECTION = Section(90, "Appendix: the run", (), write)
