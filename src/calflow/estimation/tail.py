"""The tail of residuals: how far the largest of so many may be, by how heavy-tailed the others are."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import gammaln, stdtr
from scipy.stats import chi, norm, t

FALSE = 1 / 300  # data sets without an outlier in which one is named
CENSORED, LEAST_CENSORED = 0.02, 4  # share and number of the largest values of which only the number counts
DEGREES = (2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 11.0, 15.0, 22.0, 35.0, 60.0, 1e3)  # of Student's t, that are tried
DOUBT = 1.0  # fall of twice the log-likelihood up to which heavier tails are reckoned with
FEWEST = 60  # values, of which a tail can be told
TOGETHER = 1.06  # by which three values of a heavy tail are longer together than the largest of them


def limit_of_length(values: np.ndarray, size: int, rows: int) -> float:
    """Return the length that a row of independent residuals exceeds once in so many data sets, of this many rows.

    values (n,) are the studentised residuals of good and bad rows, size of which make a row. The tail is that of Student's t whose
    degrees of freedom the bulk of the values allows: the largest values, which may be wrong, only count as large.
    """
    absolute = np.sort(np.abs(values))
    if len(absolute) < FEWEST:
        return np.inf
    cut = len(absolute) - max(LEAST_CENSORED, round(CENSORED * len(absolute)))
    fitted = [_fitted(absolute[:cut], len(absolute) - cut, degrees) for degrees in DEGREES]
    best = min(cost for cost, _ in fitted)
    degrees, scale = next(
        (degrees, scale) for degrees, (cost, scale) in zip(DEGREES, fitted, strict=True) if 2 * (cost - best) <= DOUBT
    )
    chance = FALSE / rows
    alone = t.isf(chance / (2 * size), degrees) if degrees < DEGREES[-1] else norm.isf(chance / (2 * size))
    return float(scale * max(chi.isf(chance, size), TOGETHER * alone))


def _fitted(bulk: np.ndarray, beyond: int, degrees: float) -> tuple[float, float]:
    """Return minus the log-likelihood and the scale of Student's t for sorted sizes (n,), of which further ones are larger."""

    def cost(log_scale: float) -> float:
        scaled = bulk / np.exp(log_scale)
        inside = len(bulk) * (constant - log_scale) - (degrees + 1) / 2 * np.log1p(scaled**2 / degrees).sum()
        return -float(inside + beyond * np.log(stdtr(degrees, -scaled[-1])))

    constant = gammaln((degrees + 1) / 2) - gammaln(degrees / 2) - np.log(degrees * np.pi) / 2
    middle = np.log(np.median(bulk) / t.isf(0.25, degrees))
    found = minimize_scalar(cost, bounds=(middle - 1.0, middle + 1.0), method="bounded")
    return float(found.fun), float(np.exp(found.x))
