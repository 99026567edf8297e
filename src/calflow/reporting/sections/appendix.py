"""Appendix: inputs, settings and versions of the run, and how the fits of identify and diagnose ended."""

from __future__ import annotations

from importlib.metadata import version

from calflow.files.words import effect_words, number
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import section

PACKAGES = ("calflow", "casadi", "emcee", "numpy", "scipy", "pandas")


def _in_a_line(value: object) -> str:
    """Return a setting's value in one line."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name} = {_in_a_line(inner)}' for name, inner in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_in_a_line, value))}]"
    if isinstance(value, tuple):
        return "; ".join(dict.fromkeys(map(_in_a_line, value)))
    return f"{value:.4g}" if isinstance(value, float) else getattr(value, "words", str(value))


@section(90, "Appendix: the run", "")
def appendix_section(material: Material) -> list[Block]:
    """Tabulate the request, the versions used and the outcome."""
    robot, request = material.robot, material.request
    facts: list[tuple[str, str] | str] = [
        "request",
        ("study", request.name),
        ("robot", f"{robot.name}: {robot.n_joints} joints, {robot.kinematics}"),
        ("effects", ", ".join(effect_words(effect) for effect in request.effects)),
        ("measurements", ", ".join(source.file for source in request.sources) or "none"),
        ("workflow", f"{material.workflow}: {', '.join(material.settings)}"),
        ("seed", str(request.seed)),
        ("versions", ", ".join(f"{name} {version(name)}" for name in PACKAGES)),
        *(
            (f"settings of {stage}", _in_a_line(settings)[1:-1])
            for stage, settings in material.settings.items()
            if settings
        ),
        *_identified(material),
    ]
    return [
        Paragraph("manifest.json has the hashes of all input files, and when and how each stage ended; each stage's summary.json "
                  "has more. All tables are in the run folder as CSV, in SI units unless a column's name has another.", keep=True),
        Table(("what", "value"), facts, "ll", size=None, wide=1, halved=True),
    ]  # fmt: skip


def _identified(material: Material) -> list[tuple[str, str] | str]:
    if "identify/summary.json" not in material.results:
        return []
    summary = material.summary
    facts = [
        ("noise", material.certainty.noise),
        ("starting points", f"{summary.starts_agreeing} of {summary.starts} agree"),
        ("fit of identify", summary.solver.words),
    ]
    if "diagnose/summary.json" in material.results:
        diagnosed = material.diagnosis_summary
        facts += [("fit of diagnose", diagnosed.solver.words), ("causes tested", str(diagnosed.causes_tested))]
    return ["outcome", *facts, *_placement(material)]


def _placement(material: Material) -> list[tuple[str, str]]:
    facts = []
    for placed in material.placement:
        place = [
            f"{axis} {number(1e3 * value, '.2f')} mm"
            for axis, value in zip("xyz", (placed.x_m, placed.y_m, placed.z_m), strict=True)
        ]
        turn = [f"{axis} {number(getattr(placed, f'{axis}_deg'), '.3f')} deg" for axis in ("rx", "ry", "rz")]
        place_words = ", ".join(place + turn * (placed.what == "base"))
        facts.append(("nominal pose", f"{placed.what}: {place_words} ({placed.source})"))
    return facts
