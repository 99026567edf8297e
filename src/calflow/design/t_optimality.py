"""T-optimality (Atkinson and Fedorov 1975): the criterion for discriminating two explanations of the same data.

One explanation is fitted as well as possible to the effect of the other, true one; the residual, in standard deviations of the
noise, is their separation. Poses are added where it grows most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations

import numpy as np
import scipy

from calflow.diagnosis.stepwise import WITHIN

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
