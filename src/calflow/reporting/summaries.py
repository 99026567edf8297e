"""The summaries of identify and diagnose as an appendix tells them: what was found, item by item."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calflow.diagnosis.findings.diagnosis_summary import DiagnosisSummary
from calflow.estimation.calibrated import DeviceNoise
from calflow.estimation.fit_summary import FitSummary, IdentifySummary
from calflow.estimation.noise import Noise

Facts = list[tuple[str, str]]


def identified(found: IdentifySummary, noises: Sequence[DeviceNoise]) -> Facts:
    """Tell how identify ended, with the noise of each series."""
    sigma = np.array([one.sigma_mm / 1e3 for one in noises])
    noise = Noise(sigma, tuple(one.source for one in noises), series=np.arange(len(noises)))
    return [
        ("noise", noise.words),
        ("noise source", _sources(found)),
        ("sigma mm", f"{found.sigma_mm:.6g}"),
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


def diagnosed(found: DiagnosisSummary) -> Facts:
    """Tell how diagnose ended."""
    return [
        ("sigma mm", f"{found.sigma_mm:.6g}"),
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


def _discrepancy(found: FitSummary) -> Facts:
    rotation = found.rotation_discrepancy_mrad
    own = [] if rotation is None else [("rotation discrepancy mrad", f"{rotation:.6g}")]
    return [("discrepancy mm", f"{found.discrepancy_mm:.6g}"), *own]


def _told(value: float | None, form: str) -> str:
    return "cannot tell" if value is None else format(value, form)
