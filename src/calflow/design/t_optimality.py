"""T-optimality (Atkinson and Fedorov 1975): the criterion for discriminating two explanations of the same data.

One explanation is fitted as well as possible to the effect of the other, true one; the residual, in standard deviations of the
noise, is their separation. Poses are added where it grows most."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import scipy

from calflow.diagnosis.stepwise import WITHIN

Pair = tuple[int, int]  # of explanations, by their numbers: the true and the fitted one


@dataclass(frozen=True)
class TCriterion:
    """The separation of a true explanation from another one fitted to its effect with all other parameters.

    squared [sd²]: squared separation; cost: additional cost of the other explanation.
    """

    squared: float
    cost: float

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


@dataclass(frozen=True, eq=False)
class Discrimination:
    """Explanations of the same data, each fitted to the effects of all, and the poses that may be measured next.

    squared (n, n) [sd²]: squared separations by the true and the fitted one; costs (n,): of each, up to a common constant. By the
    fitted one, slopes (n_poses, n_units, n_fit): Jacobian J of the poses; covariance (n_fit, n_fit): of its parameters, C; spread
    (n_poses, n_units, n_units): I + J C Jᵀ; left (n_poses, n_units, n): residual of its best fit to the effect of each.
    """

    squared: np.ndarray
    costs: np.ndarray
    slopes: tuple[np.ndarray, ...]
    covariance: tuple[np.ndarray, ...]
    spread: tuple[np.ndarray, ...]
    left: tuple[np.ndarray, ...]

    @staticmethod
    def between(
        seen: np.ndarray, new: np.ndarray, common: np.ndarray, own: Sequence[np.ndarray], effects: Sequence[np.ndarray],
        costs: Sequence[float],
    ) -> Discrimination:  # fmt: skip
        """Return the discrimination of explanations before further poses.

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
        true = np.zeros((len(products), len(own)))
        for k, (columns, effect) in enumerate(zip(own, effects, strict=True)):
            true[columns, k] = effect
        moments, squared, every = products @ true, [], []
        for columns in own:
            fit = np.concatenate([common, columns])
            covariance = np.linalg.inv(products[np.ix_(fit, fit)] + np.eye(len(fit)))
            imitating = covariance @ moments[fit]
            squared.append((true * moments).sum(axis=0) - (moments[fit] * imitating).sum(axis=0))
            slopes = new[..., fit]
            spread = np.eye(new.shape[1]) + slopes @ covariance @ slopes.transpose(0, 2, 1)
            every.append((slopes, covariance, spread, new @ true - slopes @ imitating))
        if not all(np.isfinite(values).all() for values in (*squared, *chain.from_iterable(every))):
            raise ArithmeticError("what one cause does and another imitates is not finite")
        return Discrimination(np.transpose(squared), np.array(costs), *zip(*every, strict=True))

    def __getitem__(self, pair: Pair) -> TCriterion:
        true, fitted = pair
        return TCriterion(float(self.squared[pair]), float(self.costs[fitted] - self.costs[true]))

    def closest(self, pair: Pair) -> TCriterion:
        """Return the smaller of a pair's two criteria, with either explanation as the true one."""
        return min((self[pair], self[pair[::-1]]), key=lambda criterion: criterion.lead)

    def growth(self, pair: Pair) -> np.ndarray:
        """Return the increase of a pair's squared separation by each further pose, shape (n_poses,)."""
        true, fitted = pair
        residual = self.left[fitted][..., true]
        return np.asarray((residual * np.linalg.solve(self.spread[fitted], residual[..., None])[..., 0]).sum(axis=1))

    def measured(self, pose: int, fitted: Collection[int]) -> Discrimination:
        """Return the discrimination after one more pose, by some of the fitted explanations (Woodbury 1950)."""
        squared, covariance, spread, left = self.squared.copy(), *map(list, (self.covariance, self.spread, self.left))
        for k in fitted:
            inverse, residual = np.linalg.inv(spread[k][pose]), left[k][pose]
            gain = covariance[k] @ self.slopes[k][pose].T
            shared = np.tensordot(self.slopes[k], gain, 1)  # one product; `@` makes one for each pose
            squared[:, k] += (residual * (inverse @ residual)).sum(axis=0)
            covariance[k] = covariance[k] - gain @ inverse @ gain.T
            spread[k] = spread[k] - shared @ inverse @ shared.transpose(0, 2, 1)
            left[k] = left[k] - shared @ (inverse @ residual)
        return replace(self, squared=squared, covariance=tuple(covariance), spread=tuple(spread), left=tuple(left))

    def propose(self, pairs: Sequence[Pair], number: int) -> tuple[list[int], dict[Pair, TCriterion]]:
        """Choose poses one by one for the smallest criterion; return them and each pair's smaller criterion after them."""
        now, either = self, [key for pair in pairs for key in (pair, pair[::-1])]
        chosen = list[int]()
        for _ in range(min(number, len(self.left[0]))):
            growth = now.growth(min(either, key=lambda pair: now[pair].lead))
            growth[chosen] = -1.0
            chosen.append(int(np.argmax(growth)))
            now = now.measured(chosen[-1], {fitted for _, fitted in either})
        return chosen, {pair: now.closest(pair) for pair in pairs}
