"""Tolerance: probability that the errors of further poses stay below a tolerance, from the errors of measured poses.

A power of the errors is taken as normal (Box and Cox 1964): 2/3 for errors of noise alone, in any number of axes
(Wilson and Hilferty 1931), 0, the logarithm, for log-normal ones, more for nearly equal ones. The powers are averaged
by their posterior probabilities. A further error then has a Student's t distribution, exact for normal values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

FEWEST_FOR_SPREAD = 3  # poses needed to estimate a spread
POWERS = np.arange(5) / 3.0  # symmetric about 2/3, with equal prior probabilities
NODES = 64  # quantiles of the mean and of the standard deviation over which the task's probability is averaged
ROUNDING_SHARE = 1e-6  # relative to the largest error: what is below it is rounding
FURTHEST_LOGARITHM = 25.0  # bound of the search, as logarithm of an error over the typical error


@dataclass(frozen=True)
class Errors:
    """Predictive distribution of further errors: geometric mean typical; mean, sd, probability (n_powers,).

    weight is the equivalent number of independent poses, which a fitted frame reduces.
    """

    typical: float
    mean: np.ndarray
    sd: np.ndarray
    probability: np.ndarray
    weight: float

    @staticmethod
    def of(error: np.ndarray, lost: float = 0.0) -> Errors:
        """Return the distribution from the sizes of errors (n_poses,), with lost poses' worth of degrees of freedom."""
        size, weight = np.asarray(error, dtype=float), len(error) - lost
        size = np.maximum(size, max(ROUNDING_SHARE * size.max(), np.finfo(float).tiny))
        typical = float(np.exp(np.log(size).mean()))
        powers = _powers(size / typical)
        mean = powers.mean(axis=1)
        if len(size) < 2 or np.ptp(size) == 0:
            sd = np.full(len(POWERS), 0.0 if len(size) > 1 else np.nan)
            return Errors(typical, mean, sd, np.full(len(POWERS), 1 / len(POWERS)), weight)
        sd = powers.std(axis=1, ddof=1)
        # Likelihood of a power with mean and sd integrated out; relative to the geometric mean the Jacobian is 1.
        likelihood = (sd / sd.min()) ** -max(weight - 1, 0.0)
        return Errors(typical, mean, sd, likelihood / likelihood.sum(), weight)

    def within(self, tolerance: float, poses: int = 1) -> float:
        """Return the probability that so many further poses all err by less than a tolerance, in the errors' unit.

        nan with too few measured poses. The mean has standard error sd / sqrt(weight) and the variance weight - 1
        degrees of freedom, both under Jeffreys' prior for location and scale, which gives frequentist coverage.
        """
        freedom = self.weight - 1
        if not freedom >= FEWEST_FOR_SPREAD - 1:
            return float("nan")
        if not self.sd.any():
            return float(tolerance > self.typical)
        off = (_powers(np.array([tolerance / self.typical]))[:, 0] - self.mean) / self.sd
        if poses == 1:
            return float(self.probability @ scipy.special.stdtr(freedom, off / np.sqrt(1 + 1 / self.weight)))
        share = (np.arange(NODES) + 0.5) / NODES
        # Ratio of true to estimated standard deviation, and the true mean's deviation in true standard deviations.
        scale = np.sqrt(freedom / (2 * scipy.special.gammaincinv(freedom / 2, share)))
        aside = scipy.special.ndtri(share)[:, None] / np.sqrt(self.weight)
        within = scipy.special.ndtr(off[:, None, None] / scale - aside)
        return float(self.probability @ (within**poses).mean(axis=(1, 2)))

    def reached_by(self, share: float, poses: int = 1) -> float:
        """Return the error below which so many further poses all stay with a probability; nan with too few poses."""
        if np.isnan(self.within(self.typical)):
            return float("nan")
        if not self.sd.any():
            return self.typical
        exponent = scipy.optimize.brentq(
            lambda u: self.within(self.typical * np.exp(u), poses) - share,
            -FURTHEST_LOGARITHM,
            FURTHEST_LOGARITHM,
            xtol=1e-9,
        )
        return float(self.typical * np.exp(exponent))


def _powers(size: np.ndarray) -> np.ndarray:
    """Return the Box-Cox transforms of sizes (n,) with each of POWERS, shape (n_powers, n)."""
    return np.asarray(scipy.special.boxcox(size, POWERS[:, None]))
