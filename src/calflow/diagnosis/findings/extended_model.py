"""The extended model as a table and a document tell it: its accuracy, its noise, and how the search ended.

The summary of diagnose: what was searched, and what the extended model leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calflow.diagnosis.findings.misfit import MisfitRegion
from calflow.diagnosis.findings.tables import Diagnosis
from calflow.estimation.accuracy import Accuracy, accuracy, leading_errors
from calflow.estimation.calibrated_model import (
    CalibratedModel,
    FitSummary,
    Solver,
    discrepancies,
    needed_conditions,
    noise_table,
    series_noise,
)
from calflow.estimation.noise import Noise
from calflow.files.tables import column, to_frame
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements


@dataclass(frozen=True, kw_only=True)
class DiagnosisSummary(FitSummary):
    """How diagnose ended: noise and lack of fit of the extended model, and how much was searched."""

    reduced_chi2_before: float | None = column("of the study's own model; null: cannot be told")
    causes_tested: int = column("places of effects that were tested")
    tests: float = column("independent tests that these are worth")
    worst: MisfitRegion | None = column(
        "where the extended model's lack of fit is largest; null: no lack of fit, or about alike everywhere",
        default=None,
    )
    capped: bool = column("whether as many causes were found as were allowed, so that there may be more", default=False)

    @property
    def unseen(self) -> str:
        """Say what no test could see because the noise is not known apart from the fit; empty where it is known."""
        if self.noise_known:
            return ""
        return (
            "the noise was estimated from the fit, so a lack of fit cannot be told from it: what depends on no joint, pair of "
            "joints, place or time that was tried could not be seen"
        )


def extended_model(found: Diagnosis, known: CalibratedModel, data: Measurements) -> CalibratedModel:
    """Return the extended model as the stages after it start from it; known is what it was extended from."""
    final = found.extended.fitted
    return CalibratedModel(
        final.model, final.fit.estimate, final.fit.covariance, final.fit.at_bound,
        series_noise(_noise(found, known, data), _growth(found)), final.noise.discrepancy,
        final.loss, final.elsewhere, tuple(one.alternative for one in found.alternatives),
        intraclass=final.intraclass,
        in_reach=found.in_reach,
        needed=needed_conditions(final.model, final.fit.estimate, data),
        time_origin=known.time_origin,
    )  # fmt: skip


def accuracy_table(found: Diagnosis, data: Measurements, before: Sequence[Accuracy]) -> pd.DataFrame:
    """Return the accuracy of the models before, and one step for each cause."""
    name, step, rows = before[-1].model, before[-1].step, list(before)
    for k, (cause, fit) in enumerate(zip(found.causes, found.extended.path, strict=True), start=step + 1):
        name += f" + {cause.id} {cause.part}"
        rows += accuracy(name, leading_errors(fit.model, fit.estimate, data), data, k, cause)
    return to_frame(rows, Accuracy)


def extended_noise(found: Diagnosis, known: CalibratedModel, data: Measurements) -> pd.DataFrame:
    """Return the table of each series' noise as the extended model leaves it."""
    return noise_table(_noise(found, known, data), found.extended.fitted.model.observations, _growth(found))


def diagnosis_summary(found: Diagnosis, known: CalibratedModel) -> DiagnosisSummary:
    """Say how the search ended."""
    final, first = found.extended.fitted, found.start
    sigma = found.growth.floor if found.growth else known.sigma
    if final.noise.sources[0] == "estimated" and not found.growth:
        sigma = float(np.median(final.noise.sigma[final.noise.of_series(0)]))
    return DiagnosisSummary(
        noise_sources=final.noise.sources,
        sigma_mm=1e3 * sigma if final.noise.leading[0] == METRE else None,
        noise_growth_mm_per_m=1e3 * found.growth.slope if found.growth else 0.0,
        **discrepancies(final.noise),
        elsewhere_mm=1e3 * final.elsewhere,
        intraclass=final.intraclass,
        loss=final.loss,
        reduced_chi2=final.lack.reduced_chi2 if final.noise.known else None,
        lack_of_fit_p=final.lack.p if final.noise.known else None,
        solver=Solver(status=final.fit.status, iterations=final.fit.iterations),
        converged=final.fit.converged,
        reduced_chi2_before=first.lack.reduced_chi2 if first.noise.known else None,
        causes_tested=len(found.extended.first.places),
        tests=found.extended.first.family.places,
        worst=found.misfit.region if found.misfit else None,
        capped=found.capped,
    )


def _noise(found: Diagnosis, known: CalibratedModel, data: Measurements) -> Noise:
    final = found.extended.fitted
    noise = known.noise(data)
    sigma = noise.sigma.copy()
    for k, source in enumerate(noise.sources):
        if source == "estimated":
            sigma[noise.of_series(k)] = np.median(final.noise.sigma[final.noise.of_series(k)])
    return replace(noise, sigma=sigma)


def _growth(found: Diagnosis) -> tuple[float, float] | None:
    return (found.growth.floor, found.growth.slope) if found.growth else None
