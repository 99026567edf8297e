"""The difference of two calibrations' parameters and its significance, and what the measurements say without the prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.model import Model
from calflow.robot.parts import Parameter

# Information over the prior's below which measurements do not determine a direction. A covariance with smooth errors, linearised,
# is right to a per cent or so: what is left of less, once the prior is removed, is that error.
DETERMINED = 1e-2


@dataclass(frozen=True)
class Difference:
    """The difference value (n,), second minus first, of the parameters that two models share, by their indices (n,) in each.

    covariance (n, n) is that of the difference under the common prior, independent_covariance (n, n) the sum
    of both covariances without it.
    """

    first: np.ndarray
    second: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    independent_covariance: np.ndarray

    @staticmethod
    def of(first: CalibratedModel, second: CalibratedModel) -> Difference:
        """Return the difference of the parameters that are `comparable`.

        Estimates from independent measurements with a common prior of precision P differ with covariance
        C1 + C2 - C1 P C2 - C2 P C1: it vanishes along directions that only the prior determines.
        """
        pairs = comparable(first, second)
        i, j = (np.array(indices, dtype=int) for indices in (zip(*pairs, strict=True) if pairs else ((), ())))
        sd = first.model.prior_sd[i]
        c1, c2 = first.covariance[np.ix_(i, i)], second.covariance[np.ix_(j, j)]
        shared = c1 @ np.diag(sd**-2.0) @ c2
        return Difference(i, j, second.estimate[j] - first.estimate[i], c1 + c2 - shared - shared.T, c1 + c2)

    def among(self, which: np.ndarray) -> Difference:
        """Return the difference of some of the parameters (n_some,), by their indices among these."""
        both = np.ix_(which, which)
        covariances = self.covariance[both], self.independent_covariance[both]
        return Difference(self.first[which], self.second[which], self.value[which], *covariances)

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the differences (n,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @cached_property
    def whitening(self) -> np.ndarray:
        """Matrix (n_directions, n) to the directions that the measurements determine, each with standard deviation 1."""
        if not len(self.value):
            return np.empty((0, 0))
        own = np.sqrt(np.diag(self.independent_covariance))
        scale = np.outer(own, own)
        share, vectors = scipy.linalg.eigh(self.covariance / scale, self.independent_covariance / scale)
        telling = share > DETERMINED
        return np.asarray((vectors.T / own)[telling] / np.sqrt(share[telling])[:, None])

    @property
    def joint(self) -> tuple[float, int, float]:
        """Chi² of all differences jointly, its degrees of freedom, and its p-value."""
        freedom = len(self.whitening)
        squared = float(((self.whitening @ self.value) ** 2).sum())
        return squared, freedom, float(scipy.stats.chi2.sf(squared, max(1, freedom)))

    def tested(self, wholes: Sequence[str], level: float) -> tuple[np.ndarray, np.ndarray]:
        """Return p-values (n,), and which are significant among all by Holm's method (1979) at a family-wise level.

        wholes (n,): the name of the whole that is tested as one, whose parameters mean nothing alone; empty: none.
        """
        tests = [[k for k, other in enumerate(wholes) if other == name] for name in dict.fromkeys(filter(None, wholes))]
        alone = [k for k, name in enumerate(wholes) if not name]
        z = np.divide(np.abs(self.value), self.sd, out=np.zeros(len(self.value)), where=self.sd > 0)
        chance = [*(2 * scipy.stats.norm.sf(z[alone])), *(self.among(np.array(which)).joint[2] for which in tests)]
        order = np.argsort(chance, kind="stable")
        beyond = np.zeros(len(chance), dtype=bool)
        beyond[order] = np.logical_and.accumulate(
            np.array(chance)[order] <= level / (len(chance) - np.arange(len(chance)))
        )
        p, significant = np.ones(len(wholes)), np.zeros(len(wholes), dtype=bool)
        for which, one, there in zip([*([k] for k in alone), *tests], chance, beyond, strict=True):
            p[which], significant[which] = one, there
        return p, significant


def comparable(first: CalibratedModel, second: CalibratedModel) -> list[tuple[int, int]]:
    """Return pairs of indices of parameters with the same name, nominal figure and prior that are off their bounds in both.

    Errors of base and tool are relative to their registered places, and are compared only where both registered the same. What
    a joint's figures are depends on what else it does in a model (a zero takes up the mean of a curve that another model has): they
    are compared only where both models have the same causes there.
    """
    robots = first.model.robot, second.model.robot
    same = {"base": robots[0].base == robots[1].base, "tool": robots[0].tool_rotation == robots[1].tool_rotation}
    places = {_stated(parameter): k for k, parameter in enumerate(second.model.parameters) if not second.at_bound[k]}
    own, others = _by_joint(first.model), _by_joint(second.model)
    return [
        (k, places[_stated(parameter)])
        for k, parameter in enumerate(first.model.parameters)
        if _stated(parameter) in places and same.get(parameter.part, True) and not first.at_bound[k]
        and (not parameter.joint or own[parameter.joint] == others[parameter.joint])
    ]  # fmt: skip


def _by_joint(model: Model) -> dict[int, set[str]]:
    names = dict[int, set[str]]()
    for parameter in model.declared:
        names.setdefault(parameter.joint, set()).add(parameter.name)
    return names


def _stated(parameter: Parameter) -> tuple[str, float, float, float]:
    return parameter.name, parameter.figure, parameter.prior_mean, parameter.prior_sd


@dataclass(frozen=True)
class LikelihoodEstimate:
    """Estimate (n,) and covariance (n, n) from the measurements alone; prior_sd (n,) are the priors' standard deviations.

    Along a direction that the measurements do not determine the variance is the prior's over DETERMINED.
    """

    value: np.ndarray
    covariance: np.ndarray
    prior_sd: np.ndarray

    @staticmethod
    def of(
        estimate: np.ndarray, covariance: np.ndarray, prior_mean: np.ndarray, prior_sd: np.ndarray
    ) -> LikelihoodEstimate:
        """Divide a normal posterior by its prior, independent by parameter: information, and that times the mean, subtract."""
        scale = np.outer(prior_sd, prior_sd)
        variance, vectors = scipy.linalg.eigh(covariance / scale)
        posterior = 1 / np.maximum(variance, np.finfo(float).tiny)
        information = np.maximum(posterior - 1, DETERMINED)
        along = vectors.T @ ((estimate - prior_mean) / prior_sd)
        value = prior_mean + prior_sd * (vectors @ (posterior / information * along))
        return LikelihoodEstimate(value, scale * ((vectors / information) @ vectors.T), prior_sd)

    @property
    def sd(self) -> np.ndarray:
        """Marginal standard deviations (n,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def told(self) -> np.ndarray:
        """Mask (n,) of the parameters that the measurements alone determine better than the prior."""
        return self.sd < self.prior_sd
