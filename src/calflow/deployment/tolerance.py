"""Tolerance: how probable it is that further poses err by less than one, by the errors of some measured poses.

Some power of the errors is taken for normal (Box and Cox 1964): 2/3 where they differ by noise alone, along any number of axes
(Wilson and Hilferty 1931), 0, the logarithm, where they differ by factors from place to place, more where they are much alike.
Which one is not known: each counts as probable as the errors make it. A further error is then distributed as Student's t about
the measured ones' mean, which is exact for normal figures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

FEWEST_FOR_SPREAD = 3  # poses, of fewer no spread is known
POWERS = np.arange(5) / 3.0  # as many below 2/3 as above, as probable as each other before any error is seen
NODES = 64  # quantiles of the mean and of the standard deviation over which the task's probability is averaged
ROUNDING_SHARE = 1e-6  # of the largest error: what is below it is rounding
FURTHEST_LOGARITHM = 25.0  # in logarithms of the typical error: no error is further from it


@dataclass(frozen=True)
class Errors:
    """What errors of poses tell of further ones like them: their geometric mean, and of each power the mean, sd and probability.

    weight is how many independent poses they are worth, which a fitted frame makes fewer.
    """

    typical: float
    mean: np.ndarray
    sd: np.ndarray
    probability: np.ndarray
    weight: float

    @staticmethod
    def of(error: np.ndarray, lost: float = 0.0) -> Errors:
        """Take the sizes of errors (n_poses,), of which a fit took so many poses' worth away."""
        size, weight = np.asarray(error, dtype=float), len(error) - lost
        size = np.maximum(size, max(ROUNDING_SHARE * size.max(), np.finfo(float).tiny))
        typical = float(np.exp(np.log(size).mean()))
        powers = _powers(size / typical)
        mean = powers.mean(axis=1)
        if len(size) < 2 or np.ptp(size) == 0:
            sd = np.full(len(POWERS), 0.0 if len(size) > 1 else np.nan)
            return Errors(typical, mean, sd, np.full(len(POWERS), 1 / len(POWERS)), weight)
        sd = powers.std(axis=1, ddof=1)
        # the likelihood of a power, mean and sd integrated out; in units of the geometric mean the powers' Jacobian is 1
        likelihood = (sd / sd.min()) ** -max(weight - 1, 0.0)
        return Errors(typical, mean, sd, likelihood / likelihood.sum(), weight)

    def within(self, tolerance: float, poses: int = 1) -> float:
        """Return the probability that so many further poses all err by less than a tolerance, in the errors' unit.

        nan where too few were measured. The mean is known to sd / sqrt(weight), the variance with weight - 1 degrees of
        freedom, both with the prior of a scale and a place (Jeffreys), which makes the probability a frequency.
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
        # The true standard deviation over the found one, and the true mean's distance in true standard deviations.
        scale = np.sqrt(freedom / (2 * scipy.special.gammaincinv(freedom / 2, share)))
        aside = scipy.special.ndtri(share)[:, None] / np.sqrt(self.weight)
        within = scipy.special.ndtr(off[:, None, None] / scale - aside)
        return float(self.probability @ (within**poses).mean(axis=(1, 2)))

    def reached_by(self, share: float, poses: int = 1) -> float:
        """Return the error that so many further poses all stay below with a probability; nan where too few were measured."""
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
    """Each of the POWERS of sizes (n,), in Box and Cox's form, which goes over into the logarithm, shape (n_powers, n)."""
    power = POWERS[1:, None]
    return np.vstack([np.log(size), (size**power - 1) / power])
