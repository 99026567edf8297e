"""T-optimality (Atkinson and Fedorov 1975): the criterion for discriminating two explanations of the same data.

One explanation is fitted as well as possible to the effect of the other, true one; the residual, in standard deviations of the
noise, is their separation. Poses are added where it grows most."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calflow.design.augmentation import Augmentation
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

    squared (n, n) [sd²]: squared separations by the true and the fitted one; costs (n,): of each, up to a common constant; by the
    fitted one, the poses that may be added, with the residuals of its best fit to the effect of each.
    """

    squared: np.ndarray
    costs: np.ndarray
    added: tuple[Augmentation, ...]

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
        moments, squared, added = products @ true, [], []
        for columns in own:
            fit = np.concatenate([common, columns])
            covariance = np.linalg.inv(products[np.ix_(fit, fit)] + np.eye(len(fit)))
            imitating = covariance @ moments[fit]
            squared.append((true * moments).sum(axis=0) - (moments[fit] * imitating).sum(axis=0))
            slopes = new[..., fit]
            added.append(Augmentation.of(slopes, covariance, new @ true - slopes @ imitating))
        figures = [*squared, *(values for each in added for values in (each.inside, each.moved))]
        if not all(np.isfinite(values).all() for values in figures):
            raise ArithmeticError("what one cause does and another imitates is not finite")
        return Discrimination(np.transpose(squared), np.array(costs), tuple(added))

    def __getitem__(self, pair: Pair) -> TCriterion:
        true, fitted = pair
        return TCriterion(float(self.squared[pair]), float(self.costs[fitted] - self.costs[true]))

    def closest(self, pair: Pair) -> TCriterion:
        """Return the smaller of a pair's two criteria, with either explanation as the true one."""
        return min((self[pair], self[pair[::-1]]), key=lambda criterion: criterion.lead)

    def measured(self, pose: int, fitted: Collection[int]) -> Discrimination:
        """Return the discrimination after one more pose, by some of the fitted explanations."""
        squared, added = self.squared.copy(), list(self.added)
        for k in fitted:
            inside, residual = added[k].inside[pose], added[k].moved[pose]
            squared[:, k] += (residual * np.linalg.solve(np.eye(len(inside)) + inside, residual)).sum(axis=0)
            added[k] = added[k].updated(pose)
        return replace(self, squared=squared, added=tuple(added))

    def propose(self, pairs: Sequence[Pair], number: int) -> tuple[list[int], dict[Pair, TCriterion]]:
        """Choose poses one by one for the smallest criterion; return them and each pair's smaller criterion after them."""
        now, either = self, [key for pair in pairs for key in (pair, pair[::-1])]
        chosen = list[int]()
        for _ in range(min(number, len(self.added[0].moved))):
            true, fitted = min(either, key=lambda pair: now[pair].lead)
            growth = now.added[fitted].explained([true])
            growth[chosen] = -1.0
            chosen.append(int(np.argmax(growth)))
            now = now.measured(chosen[-1], {fitted for _, fitted in either})
        return chosen, {pair: now.closest(pair) for pair in pairs}
