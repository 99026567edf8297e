"""The summary of diagnose: what was searched, and what the extended model leaves."""

from __future__ import annotations

from dataclasses import dataclass

from calflow.diagnosis.findings.misfit import Region
from calflow.estimation.fit_summary import FitSummary
from calflow.files.tables import column


@dataclass(frozen=True, kw_only=True)
class DiagnosisSummary(FitSummary):
    """How diagnose ended: noise and lack of fit of the extended model, and how much was searched."""

    reduced_chi2_before: float | None = column("of the study's own model; null: cannot be told")
    causes_tested: int = column("places of effects that were tested")
    tests: float = column("independent tests that these are worth")
    worst: Region | None = column(
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
