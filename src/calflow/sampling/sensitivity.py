"""How much of a parameter's posterior is its prior, and how much the data: power scaling."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd

ALPHAS = (0.99, 1.01)  # powers to which a density is raised: near enough to 1 that the draws need no new sampling
SENSITIVE = (
    0.05  # from here on the posterior changes with a density; a normal that is this density alone has about 0.08
)


def sensitivity(values: np.ndarray, log_density: np.ndarray) -> np.ndarray:
    """Return how much each parameter's posterior changes when one of its factors is raised to a power near 1.

    The cumulative Jensen-Shannon distance per log2 of the power, by importance weights density^(alpha - 1), Pareto-smoothed
    (Kallioinen et al. 2023, eq. 11).

    Args:
        values: the draws, shape (n_chains, n_draws, n_parameters).
        log_density: of each draw the log of the prior, or of the likelihood, up to a constant, shape (n_chains, n_draws).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats.base import array_stats

    lower, upper = (power_weights(log_density, alpha) for alpha in ALPHAS)
    return np.array([float(array_stats.power_scale_sense(values[..., k], lower, upper, *ALPHAS))
                     for k in range(values.shape[-1])])  # fmt: skip


def power_weights(log_density: np.ndarray, alpha: float) -> np.ndarray:
    """Return each draw's weight where a factor of the posterior is raised to the power alpha; they add up to 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats.base import array_stats

    log_weights = array_stats.power_scale_lw(log_density, alpha=alpha, axis=(0, 1))
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def prior_dominates(posterior: pd.DataFrame) -> np.ndarray:
    """Return of which rows of `sample/posterior.csv` the prior says where they lie, and the data hardly anything."""
    prior, likelihood = _sensitive(posterior)
    return prior & ~likelihood


def shared(posterior: pd.DataFrame) -> np.ndarray:
    """Return of which rows of `sample/posterior.csv` both the prior and the data say where they lie."""
    prior, likelihood = _sensitive(posterior)
    return prior & likelihood


def _sensitive(posterior: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    prior, likelihood = (posterior[f"{name}_sensitivity"].to_numpy(dtype=float) for name in ("prior", "likelihood"))
    return prior > SENSITIVE, likelihood > SENSITIVE
