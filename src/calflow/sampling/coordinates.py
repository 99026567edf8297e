"""Coordinates in which a posterior is round and has no bounds: a normal that bounds cut, as a function of a standard normal.

Parameters near a bound come first, each given those before it a normal that is cut at its bounds: the triangular map that
draws cut normals one by one (Geweke 1991; Hajivassiliou and McFadden 1998). All others are linear in the coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtri_exp
from scipy.stats import norm

NEAR = 5.0  # standard deviations of the fit from a bound, within which a parameter is transformed


@dataclass(frozen=True)
class Coordinates:
    """The map from coordinates u (..., n) to parameters x (..., n).

    Parameter number order[k] is mean[k] + factor[k] @ z, factor (n, n) lower triangular; of the first n_cut parameters z[k] is u[k]
    mapped into the bounds, of the others it is u[k]. lower and upper (n_cut,) are the bounds of the former.
    """

    order: np.ndarray
    mean: np.ndarray
    factor: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @staticmethod
    def about(estimate: np.ndarray, mean: np.ndarray, covariance: np.ndarray, bounds: np.ndarray) -> Coordinates:
        """Return the coordinates of a normal (mean, covariance) cut at bounds (n, 2), whose mode within them is the estimate."""
        sd = np.sqrt(np.diag(covariance))
        near = (np.abs(bounds - estimate[:, None]) < NEAR * sd[:, None]).any(axis=1)
        inside = np.diff(norm.cdf((bounds - mean[:, None]) / sd[:, None]), axis=1).ravel()
        order = np.lexsort((inside, ~near))  # what is cut most is drawn first
        scaled = covariance[np.ix_(order, order)] / np.outer(sd[order], sd[order])
        factor = np.linalg.cholesky(scaled) * sd[order][:, None]
        cut = order[: np.count_nonzero(near)]
        return Coordinates(order, mean[order], factor, *bounds[cut].T)

    @property
    def n_cut(self) -> int:
        """How many parameters are transformed."""
        return len(self.lower)

    @property
    def cut(self) -> np.ndarray:
        """The numbers of these parameters."""
        return self.order[: self.n_cut]

    @property
    def log_scale(self) -> float:
        """Logarithm of the determinant of the linear part."""
        return float(np.log(np.diag(self.factor)).sum())

    def mapped(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x (..., n) and the logarithm of |dx/du| (...) without that of the linear part, for u (..., n)."""
        z = np.array(u)
        log_slope = np.zeros(u.shape[:-1])
        for k in range(self.n_cut):
            least, most = self._allowed(z, k)
            z[..., k], slope = _into(u[..., k], least, most)
            log_slope += slope
        x = np.empty_like(z)
        x[..., self.order] = self.mean + z @ self.factor.T
        x[..., self.cut] = np.clip(x[..., self.cut], self.lower, self.upper)  # they are beyond by round-off alone
        return x, log_slope

    def _allowed(self, z: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Between which z[k] must be, given those before it."""
        middle = self.mean[k] + z[..., :k] @ self.factor[k, :k]
        return (self.lower[k] - middle) / self.factor[k, k], (self.upper[k] - middle) / self.factor[k, k]


def _into(u: np.ndarray, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Map a standard normal onto one that is cut at least and most; the second result is the logarithm of its slope."""
    sign, low, high = _lower_half(least, most)
    z = sign * ndtri_exp(np.logaddexp(log_ndtr(low) + log_ndtr(-sign * u), log_ndtr(high) + log_ndtr(sign * u)))
    return z, (z**2 - u**2) / 2 + _log_mass(low, high)


def _lower_half(least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turn an interval round where it lies above zero: logarithms of the normal's distribution are exact below."""
    turned = least + most > 0
    return np.where(turned, -1.0, 1.0), np.where(turned, -most, least), np.where(turned, -least, most)


def _log_mass(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Logarithm of a standard normal's share between low and high, of which low is the farther from zero, or below it."""
    top = log_ndtr(high)
    with np.errstate(divide="ignore"):
        return np.asarray(top + np.log(-np.expm1(np.minimum(log_ndtr(low) - top, 0.0))))
