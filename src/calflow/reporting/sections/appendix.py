"""The appendix: the facts of the run, of what was asked and how identify and diagnose ended."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.estimation.calibrated_model import DeviceNoise, FitSummary, IdentifySummary, Placed
from calflow.estimation.noise import Noise
from calflow.files.units import MeasurementUnit
from calflow.files.words import effect_words
from calflow.reporting.blocks import Block, Newspaper, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Section

Facts = list[tuple[str, str]]


def identified_facts(found: IdentifySummary, noises: Sequence[DeviceNoise]) -> Facts:
    """Tell how identify ended, with the noise of each series."""
    sigma = np.array([one.sigma for one in noises])
    units = tuple(MeasurementUnit(one.unit, one.unit, 1.0, 1.0) for one in noises)
    noise = Noise(sigma, tuple(one.source for one in noises), units=units, series=np.arange(len(noises)))
    return [
        ("noise", noise.words),
        ("noise source", _sources(found)),
        *_sigma(found),
        ("reduced chi2", _told(found.reduced_chi2, ".6g")),
        ("lack of fit p", _told(found.lack_of_fit_p, ".3g")),
        *_discrepancy(found),
        ("spread mm", f"{found.spread_mm:.6g}"),
        ("rank", f"{found.rank} of {found.parameters} parameters"),
        *((f"rank {effect}", str(rank)) for effect, rank in found.rank_by_effect.items()),
        ("effective parameters", f"{found.effective_parameters:.4g}"),
        ("loss", found.loss),
        ("training poses", str(found.training_poses)),
        ("heldout poses", str(found.heldout_poses)),
        ("solver", found.solver.words),
        ("converged", str(found.converged)),
        ("equilibrium error um", f"{found.equilibrium_error_um:.2g}"),
        ("starts agreeing", f"{found.starts_agreeing} of {found.starts}"),
        *(("extrapolation", joint.words) for joint in found.extrapolation),
        *(("noise doubted", doubt.words) for doubt in found.noise_doubts),
    ]


def diagnosed_facts(found: DiagnosisSummary) -> Facts:
    """Tell how diagnose ended."""
    return [
        *_sigma(found),
        ("noise source", _sources(found)),
        ("noise growth mm per m", f"{found.noise_growth_mm_per_m:.6g}"),
        *_discrepancy(found),
        ("loss", found.loss),
        ("reduced chi2 before", _told(found.reduced_chi2_before, ".6g")),
        ("reduced chi2", _told(found.reduced_chi2, ".6g")),
        ("lack of fit p", _told(found.lack_of_fit_p, ".3g")),
        ("causes tested", str(found.causes_tested)),
        ("tests", f"{found.tests:.4g}"),
        ("solver", found.solver.words),
        ("converged", str(found.converged)),
    ]


def _sources(found: FitSummary) -> str:
    return ";".join(dict.fromkeys(found.noise_sources))


def _sigma(found: FitSummary) -> Facts:
    return [] if found.sigma_mm is None else [("sigma mm", f"{found.sigma_mm:.6g}")]


def _discrepancy(found: FitSummary) -> Facts:
    return [(f"discrepancy {unit}", f"{size:.6g}") for unit, size in found.discrepancies.items()]


def _told(value: float | None, form: str) -> str:
    return "cannot tell" if value is None else format(value, form)


PACKAGES = ("calflow", "casadi", "emcee", "numpy", "scipy", "pandas")


def _appendix(material: Material) -> list[Block]:
    """Tabulate what was asked, what was used and how it ended."""
    robot, request = material.robot, material.request
    facts: list[tuple[str, str] | str] = [
        "asked",
        ("study", request.name),
        ("robot", f"{robot.name}: {robot.n_joints} joints, {robot.kinematics}"),
        ("effects", ", ".join(effect_words(effect) for effect in request.effects)),
        ("measurements", ", ".join(source.file for source in request.sources) or "none"),
        ("workflow", f"{material.workflow}: {', '.join(material.settings)}"),
        ("seed", str(request.seed)),
        ("versions", ", ".join(f"{name} {version(name)}" for name in PACKAGES)),
        *(
            (f"settings of {stage}", "; ".join(f"{name} = {_plainly(value)}" for name, value in settings.items()))
            for stage, settings in material.settings.items()
            if settings
        ),
        *_identified(material),
        *_diagnosed(material),
    ]
    return [
        Paragraph("Hashes of all input files, durations and the state of each stage are in manifest.json; all tables named in "
                  "this report lie beside it as CSV, in SI units unless a column says otherwise."),
        Newspaper([Table(("what", "value"), facts, "ll", size=None, wide=1)]),
    ]  # fmt: skip


def _identified(material: Material) -> list[tuple[str, str] | str]:
    results, path = material.results, "identify/summary.json"
    if path not in results:
        return []
    noises = results.rows("identify/noise.csv", DeviceNoise)
    return [
        "found by identify",
        *identified_facts(results.document(path, IdentifySummary), noises),
        *_placement(material),
    ]


def _diagnosed(material: Material) -> list[tuple[str, str] | str]:
    path = "diagnose/summary.json"
    if path not in material.results:
        return []
    return ["found by diagnose", *diagnosed_facts(material.results.document(path, DiagnosisSummary))]


def _plainly(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {_plainly(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plainly(inner) for inner in value) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _placement(material: Material) -> list[tuple[str, str]]:
    facts = []
    for placed in material.results.rows("identify/placement.csv", Placed):
        place = [
            f"{axis} {1e3 * value:.2f} mm"
            for axis, value in zip("xyz", (placed.x_m, placed.y_m, placed.z_m), strict=True)
        ]
        turn = [f"rx {placed.rx_deg:.3f} deg", f"ry {placed.ry_deg:.3f} deg", f"rz {placed.rz_deg:.3f} deg"]
        said = ", ".join(place + turn * (placed.what == "base"))
        facts.append(("nominal place", f"{placed.what}: {said} ({placed.source})"))
    return facts


APPENDIX_SECTION = Section(90, "Appendix: the run", (), _appendix)
