"""The summary of sample: how long the chain is, and whether that is enough."""

from __future__ import annotations

from dataclasses import dataclass

from calflow.files.tables import column


@dataclass(frozen=True, kw_only=True)
class Cut:
    """A parameter whose posterior its bounds cut, so that its quantiles say more than its mean and sd."""

    parameter: str = column("its name")
    unit: str = column("of the bounds (SI)")
    lower: float = column("the least that is allowed")
    upper: float = column("the most that is allowed")


@dataclass(frozen=True, kw_only=True)
class ChainSummary:
    """How sample ended: length and mixing of the chain."""

    steps: int = column("of each walker")
    burn_in_steps: int = column("of these, left out at the start")
    ensembles: int = column("independent ensembles of walkers")
    walkers: int = column("in each ensemble")
    autocorrelation_steps: float | None = column("steps until a walker forgets; null: some never moved")
    acceptance_independent: float | None = column("share of independent proposals that are accepted; null: not used")
    worst_rhat: float = column("the largest R-hat of all parameters")
    smallest_ess: float = column("the smallest effective sample size")
    sd_over_laplace_least: float | None = column(
        "sampled sd over the fit's, the least; null: every parameter is at a bound"
    )
    sd_over_laplace_most: float | None = column("the same, the most")
    missing_steps: int = column("about how many more are needed; 0: long enough")
    cut: tuple[Cut, ...] = column(
        "parameters whose posterior their bounds cut: parameter, unit, lower, upper", default=()
    )
