"""The summary of diagnose: what was searched, and what the extended model leaves."""

from __future__ import annotations

from dataclasses import dataclass

from calflow.estimation.fit_summary import FitSummary
from calflow.files.tables import column


@dataclass(frozen=True, kw_only=True)
class DiagnosisSummary(FitSummary):
    """How diagnose ended: noise and lack of fit of the extended model, and how much was searched."""

    reduced_chi2_before: float | None = column("of the study's own model; null: cannot be told")
    causes_tested: int = column("places of effects that were tested")
    tests: float = column("independent tests that these are worth")
