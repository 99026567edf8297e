"""Optimality: criteria of experimental design, as observability indices and as losses to minimise.

A criterion is a function of the parameters' covariance C, the inverse of the prior's plus the poses' information. It has a root of
the parameters' weight matrix (n_parameters, r), with r = 0 where all count alike; the power of the sensitivities with which the
multiplicative algorithm converges monotonically; the loss to be minimised; the slope F (n_parameters, r), |J F|² being the
sensitivity of the loss to the information JᵀJ of a pose; and the gains of candidates (n,), from J C Jᵀ (n, n_axes, n_axes) and
J C root (n, n_axes, r).

T-optimality (Atkinson and Fedorov 1975) discriminates two explanations of the same data. One is fitted as well as possible to the
effect of the other, true one; the residual, in standard deviations of the noise, is their separation. Poses are added where it
grows most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations

import numpy as np
import scipy

from calflow.diagnosis.stepwise import WITHIN

RANK = 1e-12  # share of the largest eigenvalue below which a direction of the parameters does not move the tool


def indices(jacobian: np.ndarray, rank: int) -> np.ndarray:
    """Return the observability indices O1 … O5 of a scaled Jacobian (n_rows, n_parameters) with this rank.

    With singular values s1 >= … >= sr and m poses of three rows: O1 their geometric mean over sqrt(m) (Borm and Menq 1991,
    D-optimal), O2 = sr / s1 (Driels and Pathre 1990), O3 = sr (Nahvi et al. 1994, E-optimal), O4 = sr² / s1 (Nahvi and
    Hollerbach 1996, noise amplification), O5 = 1 / sum(1/s) (Sun and Hollerbach 2008, A-optimal). Numbering as there.
    """
    s = np.linalg.svd(jacobian, compute_uv=False)[:rank]
    if len(s) < rank or s[-1] <= 0:
        return np.zeros(5)
    poses = len(jacobian) / 3
    return np.array(
        [np.exp(np.log(s).mean()) / np.sqrt(poses), s[-1] / s[0], s[-1], s[-1] ** 2 / s[0], 1 / (1 / s).sum()]
    )


def information(jacobians: np.ndarray, prior: np.ndarray, weights: np.ndarray | float = 1.0) -> np.ndarray:
    """Return the information matrix of weighted poses (n_poses, n_axes, n_parameters) and the prior."""
    weighted = jacobians * np.sqrt(np.broadcast_to(weights, len(jacobians)))[:, None, None]
    flat = weighted.reshape(-1, jacobians.shape[2])
    return np.asarray(prior + flat.T @ flat)


@dataclass(frozen=True, eq=False)
class ParameterCriterion:
    """D-optimality: the loss is the geometric mean of n parameters' standard deviations, det(C)^(1/2n), the inverse of O1."""

    n: int
    power = 1.0

    @property
    def root(self) -> np.ndarray:
        """Empty: all parameters count alike."""
        return np.empty((self.n, 0))

    def loss(self, covariance: np.ndarray) -> float:
        """Return the geometric mean of the standard deviations along the covariance's own axes."""
        return float(np.exp(np.linalg.slogdet(covariance)[1] / (2 * self.n)))

    def slope(self, covariance: np.ndarray) -> np.ndarray:
        """Return a root of the covariance: log det M grows by the trace of J C Jᵀ."""
        return np.asarray(np.linalg.cholesky(covariance))

    def gains(self, inside: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Return how much the logarithm of the information's determinant grows."""
        return np.asarray(np.linalg.slogdet(np.eye(inside.shape[1]) + inside)[1])


@dataclass(frozen=True, eq=False)
class ToolError:
    """I-optimality: the loss is the root mean square of the tool's standard deviation [m] over task points.

    slopes (n_points, 3, n_parameters): Jacobian of the predicted tool; shares (n_points,): weights of the points, which
    sum to 1. The test poses of Klimchik et al. 2012 are this criterion with a few points.
    """

    slopes: np.ndarray
    shares: np.ndarray
    power = 0.5

    @cached_property
    def root(self) -> np.ndarray:
        """A root R of the mean of the points' slopes squared, so that the loss is the root of trace(Rᵀ C R)."""
        flat = (self.slopes * np.sqrt(self.shares)[:, None, None]).reshape(-1, self.slopes.shape[2])
        values, vectors = np.linalg.eigh(flat.T @ flat)
        kept = values > RANK * values[-1]
        return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))

    def variances(self, covariance: np.ndarray) -> np.ndarray:
        """Return the variance [m²] of the predicted tool at each point, all three axes, shape (n_points,)."""
        return np.asarray(((self.slopes @ np.linalg.cholesky(covariance)) ** 2).sum(axis=(1, 2)))

    def loss(self, covariance: np.ndarray) -> float:
        """Return the root mean square of the tool's standard deviation [m]."""
        return float(np.sqrt(np.sum(self.root * (covariance @ self.root))))

    def slope(self, covariance: np.ndarray) -> np.ndarray:
        """Return C R: the mean variance falls by the trace of J C R Rᵀ C Jᵀ."""
        return covariance @ self.root

    def gains(self, inside: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Return by how much the mean variance [m²] falls."""
        # An inverse of three rows and columns takes a fifth of the time of as many equations as the task has directions.
        left = np.linalg.inv(np.eye(inside.shape[1]) + inside)
        return np.asarray(np.einsum("nab,nab->n", left, moved @ moved.transpose(0, 2, 1)))


Criterion = ParameterCriterion | ToolError


Pair = tuple[int, int]  # of explanations, by their numbers


@dataclass(frozen=True, eq=False)
class PredictiveCovariance:
    """The predictive covariance of further poses by an explanation and all other parameters, as fitted to the data.

    whitened (n_poses, n_units, n): Jacobian by the parameters, whitened by their information in the data to unit standard
    deviations; spread (n_poses, n_units, n_units): covariance of each pose; taken: covariances of the poses measured
    since with every pose, at unit variance of their own.
    """

    whitened: np.ndarray
    spread: np.ndarray
    taken: tuple[np.ndarray, ...] = ()

    @staticmethod
    def of(information: np.ndarray, slopes: np.ndarray) -> PredictiveCovariance:
        """Return the covariance from the parameters' information matrix (n, n) and Jacobian (n_poses, n_units, n)."""
        flat = slopes.reshape(-1, slopes.shape[-1]).T
        whitened = scipy.linalg.solve_triangular(np.linalg.cholesky(information), flat, lower=True).T.reshape(
            slopes.shape
        )
        return PredictiveCovariance(whitened, np.eye(slopes.shape[1]) + whitened @ whitened.transpose(0, 2, 1))

    def measured(self, pose: int) -> PredictiveCovariance:
        """Return the covariance after one more pose."""
        shared = self.whitened @ self.whitened[pose].T - sum(taken @ taken[pose].T for taken in self.taken)
        half = np.linalg.solve(np.linalg.cholesky(self.spread[pose]), shared.transpose(0, 2, 1)).transpose(0, 2, 1)
        return replace(self, spread=self.spread - half @ half.transpose(0, 2, 1), taken=(*self.taken, half))


@dataclass(frozen=True, eq=False)
class TCriterion:
    """The separation of a true explanation from another one fitted to its effect with all other parameters.

    squared [sd²]: squared separation in the data; unexplained (n_poses, n_units): residual of that best fit at each
    further pose; predictive: its covariance; cost: additional cost of the other explanation.
    """

    squared: float
    unexplained: np.ndarray
    predictive: PredictiveCovariance
    cost: float

    @staticmethod
    def between(
        seen: np.ndarray, new: np.ndarray, common: np.ndarray, own: Sequence[np.ndarray], effects: Sequence[np.ndarray],
        costs: Sequence[float],
    ) -> dict[Pair, TCriterion]:  # fmt: skip
        """Return the criterion of each pair of explanations, by indices of the true and the fitted one.

        Args:
            seen: Jacobian of the data (n_rows, n) by all parameters, in standard deviations of noise and priors.
            new: that of further poses, (n_poses, n_units, n).
            common: the columns of the parameters that every explanation has.
            own: those of each explanation's own parameters.
            effects: each explanation's values of these, in standard deviations of priors.
            costs: of each explanation, up to a common constant.

        Raises:
            ArithmeticError: values are not finite.
        """
        products = seen.T @ seen
        information = products + np.eye(len(products))
        imitating = [np.concatenate([common, columns]) for columns in own]
        predictive = [PredictiveCovariance.of(information[np.ix_(fit, fit)], new[..., fit]) for fit in imitating]

        def criterion(true: int, other: int) -> TCriterion:
            fit, columns, effect = imitating[other], own[true], effects[true]
            moment = products[np.ix_(fit, columns)] @ effect
            solved = np.linalg.solve(information[np.ix_(fit, fit)], moment)
            energy = float(effect @ products[np.ix_(columns, columns)] @ effect)
            squared, unexplained = float(energy - moment @ solved), new[..., columns] @ effect - new[..., fit] @ solved
            if not (np.isfinite(squared) and np.isfinite(unexplained).all()):
                raise ArithmeticError("what one cause does and another imitates is not finite")
            return TCriterion(squared, unexplained, predictive[other], costs[other] - costs[true])

        return {pair: criterion(*pair) for pair in permutations(range(len(own)), 2)}

    @property
    def separation(self) -> float:
        """The separation [sd]: the norm of the residual of the best fit."""
        return float(np.sqrt(max(self.squared, 0.0)))

    @property
    def lead(self) -> float:
        """Expected excess of the other's cost over the true one's, beyond WITHIN, in standard deviations."""
        apart = max(self.separation, 1e-9)
        return (apart**2 + self.cost - WITHIN) / (2 * apart)

    @property
    def chance(self) -> float:
        """The probability that the other explanation is excluded."""
        return float(scipy.stats.norm.cdf(self.lead))

    @cached_property
    def growth(self) -> np.ndarray:
        """Increase of the squared separation by each further pose, shape (n_poses,)."""
        solved = np.linalg.solve(self.predictive.spread, self.unexplained[..., None])[..., 0]
        return np.asarray((self.unexplained * solved).sum(axis=1))

    def measured(self, pose: int, predictive: PredictiveCovariance) -> TCriterion:
        """Return the criterion after one more pose, from the covariance after it."""
        surprise = np.linalg.solve(np.linalg.cholesky(self.predictive.spread[pose]), self.unexplained[pose])
        unexplained = self.unexplained - predictive.taken[-1] @ surprise
        return TCriterion(self.squared + float(surprise @ surprise), unexplained, predictive, self.cost)


def closest(criteria: Mapping[Pair, TCriterion], pair: Pair) -> TCriterion:
    """Return the smaller of a pair's two criteria, with either explanation as the true one."""
    return min((criteria[pair], criteria[pair[::-1]]), key=lambda criterion: criterion.lead)


def propose(
    criteria: Mapping[Pair, TCriterion], pairs: Sequence[Pair], number: int
) -> tuple[list[int], dict[Pair, TCriterion]]:
    """Choose poses one by one for the smallest criterion; return them and each pair's smaller criterion after them."""
    now = {key: criteria[key] for pair in pairs for key in (pair, pair[::-1])}
    chosen = list[int]()
    for _ in range(min(number, *(len(criterion.unexplained) for criterion in now.values()))):
        growth = min(now.values(), key=lambda criterion: criterion.lead).growth.copy()
        growth[chosen] = -1.0
        chosen.append(int(np.argmax(growth)))
        after = {one: one.measured(chosen[-1]) for one in {criterion.predictive for criterion in now.values()}}
        now = {key: criterion.measured(chosen[-1], after[criterion.predictive]) for key, criterion in now.items()}
    return chosen, {pair: closest(now, pair) for pair in pairs}
