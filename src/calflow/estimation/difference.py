"""The difference of two calibrations: whether their parameters differ by more than both leave open.

What measurements say alone: an estimate and its covariance once the prior is taken out of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.robot.parts import Parameter

TELLING = 1e-7  # share of both variances that a difference has, below which two calibrations say the same: nothing


@dataclass(frozen=True)
class Difference:
    """The parameters that two models share, as indices into each (n,), second minus first (n,), and its covariance (n, n).

    apart (n, n) is the covariance that it would have if the two had no prior in common: the sum of both.
    """

    first: np.ndarray
    second: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    apart: np.ndarray

    @staticmethod
    def of(first: CalibratedModel, second: CalibratedModel) -> Difference:
        """Compare the parameters that are `comparable`.

        Estimates from independent measurements that were drawn to priors of the same precision P differ by chance with
        covariance C1 + C2 - C1 P C2 - C2 P C1: where only the prior knows, both say the same, and nothing of it.
        """
        pairs = comparable(first, second)
        i, j = (np.array(indices, dtype=int) for indices in (zip(*pairs, strict=True) if pairs else ((), ())))
        sd = first.model.prior_sd[i]
        c1, c2 = first.covariance[np.ix_(i, i)], second.covariance[np.ix_(j, j)]
        shared = c1 @ np.diag(sd**-2.0) @ c2
        return Difference(i, j, second.estimate[j] - first.estimate[i], c1 + c2 - shared - shared.T, c1 + c2)

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the differences (n,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def joint(self) -> tuple[float, int, float]:
        """Chi² of all differences together with their covariances, its degrees of freedom, and the chance of so much."""
        if not len(self.value):
            return 0.0, 0, 1.0
        scale = np.sqrt(np.outer(np.diag(self.apart), np.diag(self.apart)))
        share, vectors = scipy.linalg.eigh(self.covariance / scale, self.apart / scale)
        telling = share > TELLING
        along = (vectors.T @ (self.value / np.sqrt(np.diag(self.apart))))[telling]
        squared = float((along**2 / share[telling]).sum())
        return squared, int(telling.sum()), float(scipy.stats.chi2.sf(squared, max(1, int(telling.sum()))))


def _prior(parameter: Parameter) -> tuple[float, float]:
    return parameter.prior_mean, parameter.prior_sd


def comparable(first: CalibratedModel, second: CalibratedModel) -> list[tuple[int, int]]:
    """Return the indices in each of parameters of one name, figure and prior that are off their bounds in both.

    What base and tool are off counts from where each calibration placed them: they are compared where that is the same place.
    """
    elsewhere = _elsewhere(first, second)
    places = {parameter.name: k for k, parameter in enumerate(second.model.parameters)}
    return [
        (k, places[parameter.name])
        for k, parameter in enumerate(first.model.parameters)
        if parameter.name in places
        and parameter.part not in elsewhere
        and parameter.figure == second.model.parameters[places[parameter.name]].figure
        and _prior(parameter) == _prior(second.model.parameters[places[parameter.name]])
        and not first.at_bound[k]
        and not second.at_bound[places[parameter.name]]
    ]


def _elsewhere(first: CalibratedModel, second: CalibratedModel) -> set[str]:
    """The parts that two calibrations placed apart."""
    first_robot, other = first.model.robot, second.model.robot
    same = {"base": first_robot.base == other.base, "tool": first_robot.tool_rotation == other.tool_rotation}
    return {part for part, agrees in same.items() if not agrees}


NOTHING = 1e-10  # information, in the prior's, below which measurements say nothing along a direction


@dataclass(frozen=True)
class Alone:
    """Values (n,) and covariance (n, n) that measurements alone give; prior_sd (n,) is what was known before them.

    Along a direction that the measurements do not determine the variance is NOTHING's inverse in units of the prior's.
    """

    value: np.ndarray
    covariance: np.ndarray
    prior_sd: np.ndarray

    @staticmethod
    def of(estimate: np.ndarray, covariance: np.ndarray, prior_mean: np.ndarray, prior_sd: np.ndarray) -> Alone:
        """Take a normal prior, independent by parameter, out of a normal posterior.

        Its information is the posterior's less the prior's, and what it is weighted with is the posterior's information times
        the estimate less that of the prior (the product of two normal densities, backwards).
        """
        scale = np.outer(prior_sd, prior_sd)
        variance, vectors = scipy.linalg.eigh(covariance / scale)
        posterior = 1 / np.maximum(variance, np.finfo(float).tiny)
        information = np.maximum(posterior - 1, NOTHING)
        along = vectors.T @ ((estimate - prior_mean) / prior_sd)
        value = prior_mean + prior_sd * (vectors @ (posterior / information * along))
        return Alone(value, scale * ((vectors / information) @ vectors.T), prior_sd)

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (n,), whatever the other parameters are."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def told(self) -> np.ndarray:
        """Which parameters (n,) the measurements know better by themselves than the prior did."""
        return self.sd < self.prior_sd
