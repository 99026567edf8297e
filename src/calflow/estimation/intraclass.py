"""The intraclass correlation: how alike the positions measured at one standstill err, and a fit that counts that once.

Its size is that of the greatest restricted likelihood (Patterson and Thompson 1971), in which the parameters' directions do not
count: they fix what markers have in common rather than what they have apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from calflow.estimation.fit import Fit, fit
from calflow.estimation.lack_of_fit import LackOfFit
from calflow.estimation.least_squares import LeastSquares, Loss, may_share
from calflow.estimation.noise import LEAST_SCATTER, Noise
from calflow.estimation.repeats import averaged, standstills
from calflow.estimation.reweighting import fit_reweighted
from calflow.measurements.measurements import Measurements
from calflow.model import Model

ENOUGH = 10.0  # degrees of freedom of what standstills have in common, below which they say too little
MOST = 0.98  # correlation: beyond it what markers have apart would be less than any device's noise
LARGEST = 5.0  # logarithm of the factor by which weights may be wrong
PASSES, SAME = 4, 0.01  # refits in which correlation and size settle, and the difference that is none


def fit_sharing(
    model: Model, train: Measurements, noise: Noise, starts: np.ndarray, loss: Loss
) -> tuple[Fit, Noise, LackOfFit, int]:
    """Fit as `fit_reweighted` does, what the markers of a standstill err in common counted once.

    Rows of which each is the only one at its standstill are fitted as there.
    """
    means, _ = averaged(train, noise)
    result, noise, lack, agree = fit_reweighted(model, train, noise, starts, loss)
    for _ in range(PASSES):
        before = noise
        correlation, level = found_alike(result, means, noise)
        if not correlation and not before.intraclass:
            break
        noise = _sized(replace(noise, intraclass=correlation), level)
        result, _ = fit(LeastSquares.of(result.model, means, noise), result.estimate[None], loss)
        if np.allclose(noise.total, before.total, rtol=SAME) and abs(noise.intraclass - before.intraclass) < SAME:
            break
    return result, noise, lack, agree


def found_alike(result: Fit, data: Measurements, noise: Noise) -> tuple[float, float]:
    """Return the correlation of a fit's rows, and by how much their variance is larger than their weights say.

    None is claimed of too few standstills, nor of a fit with a robust loss, which weighs each row for itself.
    """
    if result.loss != "linear" or np.bincount(standstills(data)).max() == 1:
        return 0.0, 1.0
    products = Products.of(result, data, noise)
    return products.likeliest() if products.common >= ENOUGH else (0.0, 1.0)


def _sized(noise: Noise, level: float) -> Noise:
    """Return a noise whose variance about the model is so many times as large: what of it is not known from elsewhere."""
    sigma = np.where(
        noise.estimated, np.maximum(noise.sigma * np.sqrt(level), LEAST_SCATTER * noise.usual), noise.sigma
    )
    discrepancy = noise.discrepancy
    for unit in dict.fromkeys(noise.leading):
        if size := discrepancy[unit]:
            known = float(np.mean(noise.sigma[~noise.estimated & noise.in_unit(unit)] ** 2))
            discrepancy = discrepancy.having(unit, float(np.sqrt(max(level * (known + size**2) - known, 0.0))))
    return replace(noise, sigma=sigma, discrepancy=discrepancy)


@dataclass(frozen=True, eq=False)
class Together:
    """Products over the standstills of so many markers: of what these have apart, and of their means, times their number.

    units is how many means there are, three a standstill.
    """

    markers: int
    units: int
    apart: np.ndarray
    means: np.ndarray

    @staticmethod
    def of(both: np.ndarray) -> Together:
        """Form the products of what standstills have, side by side (n_standstills, n_markers, n_units, p + 1)."""
        _, markers, _, size = both.shape
        rows, means = both.reshape(-1, size), both.mean(axis=1).reshape(-1, size)
        product = markers * means.T @ means
        return Together(markers, len(means), rows.T @ rows - product, product)

    def log_determinant(self, correlation: float) -> float:
        """Return the log of the determinant of the errors' covariance."""
        apart, common = np.log1p(-correlation), np.log1p((self.markers - 1) * correlation)
        return float(self.units * ((self.markers - 1) * apart + common))

    def weighed(self, correlation: float) -> np.ndarray:
        """Return the product over all their rows, weighed by the inverse of the errors' covariance."""
        return np.asarray(self.apart / (1 - correlation) + self.means / (1 + (self.markers - 1) * correlation))


@dataclass(frozen=True, eq=False)
class Products:
    """Products of a fit's whitened Jacobian and residuals, side by side and scaled by the priors: all that a correlation needs.

    alone (p + 1, p + 1) is that of rows without others at their standstill; pull (p,) is how far each parameter is from its
    prior mean, in prior standard deviations. n is the number of residuals.
    """

    alone: np.ndarray
    together: tuple[Together, ...]
    pull: np.ndarray
    n: int

    @staticmethod
    def of(result: Fit, data: Measurements, noise: Noise) -> Products:
        """Form the products at a fit's estimate."""
        model, size = result.model, len(result.estimate) + 1
        alone, together, n = np.zeros((size, size)), tuple[Together, ...](), 0
        standstill = standstills(data)
        for block in LeastSquares.of(model, data, replace(noise, intraclass=0.0)).blocks:
            group = standstill if may_share(block.observation, noise) else np.arange(len(data))
            block = block.together(group[block.rows])
            for rows, residual, jacobian in block.linearised(result.estimate, group[block.rows]):
                both = np.concatenate([jacobian * model.prior_sd, residual[:, :, None]], axis=2)
                _, own, count = np.unique(group[rows], return_inverse=True, return_counts=True)
                single = both[count[own] == 1].reshape(-1, size)
                alone += single.T @ single
                for markers in np.unique(count[count > 1]):
                    several = both[count[own] == markers].reshape(-1, markers, *both.shape[1:])
                    together = _merged((*together, Together.of(several)))
                n += both.shape[0] * both.shape[1]
        pull = (result.estimate - model.prior_mean) / model.prior_sd
        return Products(alone, together, pull, n)

    @property
    def common(self) -> float:
        """Degrees of freedom of what markers of a standstill have in common, which the parameters take theirs of."""
        information = self._weighed(0.0, 0.0)[:-1, :-1]
        determined = np.trace(np.linalg.solve(information + np.eye(len(information)), information))
        return float(sum(one.units for one in self.together) - determined)

    def likeliest(self) -> tuple[float, float]:
        """Return the correlation, 0 where errors are no more alike than by chance, and how many times as large their variance is.

        Both together are those of the greatest restricted likelihood.
        """
        bounds = ((0.0, MOST), (-LARGEST, LARGEST))
        starts = (0.0, 0.5)  # beside a likelihood that is flat at one end
        found = min((minimize(self._cost, (start, 0.0), bounds=bounds) for start in starts), key=lambda one: one.fun)
        return float(found.x[0]), float(np.exp(found.x[1]))

    def _cost(self, at: np.ndarray) -> float:
        correlation, log_level = at
        inside = self._weighed(correlation, log_level)
        information, gradient = inside[:-1, :-1] + np.eye(len(inside) - 1), inside[:-1, -1] + self.pull
        squares = inside[-1, -1] + self.pull @ self.pull - gradient @ np.linalg.solve(information, gradient)
        errors = self.n * log_level + sum(one.log_determinant(correlation) for one in self.together)
        return 0.5 * float(squares + errors + np.linalg.slogdet(information)[1])

    def _weighed(self, correlation: float, log_level: float) -> np.ndarray:
        return (self.alone + sum(one.weighed(correlation) for one in self.together)) * np.exp(-log_level)


def _merged(together: Sequence[Together]) -> tuple[Together, ...]:
    """Return the products over standstills of as many markers added up."""
    found: dict[int, Together] = {}
    for one in together:
        known = found.get(one.markers)
        found[one.markers] = one if known is None else Together(
            one.markers, known.units + one.units, known.apart + one.apart, known.means + one.means
        )  # fmt: skip
    return tuple(found[markers] for markers in sorted(found))
