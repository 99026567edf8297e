"""Tolerance: how probable it is that further poses err by less than one, by the errors of some measured poses.

The cube root of an error's square, e^(2/3), is nearly normal for errors along any number of axes (Wilson and Hilferty 1931).
A further one is then distributed as Student's t about the measured ones' mean, which is exact for normal figures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi, norm, t

FEWEST = 3  # poses, of fewer no spread is known
NODES = 64  # quantiles of the mean and of the standard deviation over which the task's probability is averaged


@dataclass(frozen=True)
class Errors:
    """What errors of poses tell of further ones like them: mean and standard deviation of e^(2/3), and how many they count as.

    weight is how many independent poses they are worth, which a fitted frame makes fewer.
    """

    mean: float
    sd: float
    weight: float

    @staticmethod
    def of(error: np.ndarray, lost: float = 0.0) -> Errors:
        """Take the sizes of errors (n_poses,), of which a fit took so many poses' worth away."""
        root = np.cbrt(np.asarray(error, dtype=float) ** 2)
        sd = float(root.std(ddof=1)) if len(root) > 1 else float("nan")
        return Errors(float(root.mean()), sd, len(root) - lost)

    def within(self, tolerance: float, poses: int = 1) -> float:
        """Return the probability that so many further poses all err by less than a tolerance, in the errors' unit.

        nan where too few were measured. The mean is known to sd / sqrt(weight), the variance with weight - 1 degrees of
        freedom, both with the prior of a scale and a place (Jeffreys), which makes the probability a frequency.
        """
        freedom = self.weight - 1
        if not freedom >= FEWEST - 1:
            return float("nan")
        limit = float(np.cbrt(tolerance**2))
        if self.sd == 0:
            return float(limit > self.mean)
        spread = self.sd * np.sqrt(1 + 1 / self.weight)
        if poses == 1:
            return float(t.cdf((limit - self.mean) / spread, freedom))
        share = (np.arange(NODES) + 0.5) / NODES
        scale = np.sqrt(freedom) / chi.ppf(share, freedom)  # the true standard deviation over the found one
        off = norm.ppf(share)[:, None] / np.sqrt(self.weight)  # the true mean's distance, in true standard deviations
        return float((norm.cdf((limit - self.mean) / (self.sd * scale) - off) ** poses).mean())

    def reached_by(self, share: float) -> float:
        """Return the error that a further pose stays below with a probability; nan where too few were measured."""
        freedom = self.weight - 1
        if not freedom >= FEWEST - 1:
            return float("nan")
        limit = self.mean + t.ppf(share, freedom) * self.sd * np.sqrt(1 + 1 / self.weight)
        return float(max(limit, 0.0) ** 1.5)
