"""T-optimality (Atkinson and Fedorov 1975): the criterion for discriminating two explanations of the same data.

One explanation is fitted as well as possible to the effect of the other, true one; the residual, in standard deviations of the
noise, is their separation. Poses are added where it grows most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import permutations

import numpy as np
import scipy

from calflow.design.planned import Planned
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Score
from calflow.diagnosis.stepwise import WITHIN
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.probing import probed
from calflow.measurements.measurements import Measurements

Pair = tuple[int, int]  # of explanations, by their numbers


@dataclass(frozen=True, eq=False)
class Imitation:
    """The Jacobian (n_poses, n_units, n) at further poses of an explanation and all other parameters.

    Parameters are whitened by their information in the data, to unit standard deviations. asked: a cache of covariances
    between poses, since many pairs use the same poses.
    """

    turned: np.ndarray
    asked: dict[int, np.ndarray] = field(default_factory=dict)

    @staticmethod
    def of(information: np.ndarray, slopes: np.ndarray) -> Imitation:
        """Return the Jacobian (n_poses, n_units, n) whitened by the parameters' information matrix (n, n)."""
        flat = slopes.reshape(-1, slopes.shape[-1]).T
        turned = scipy.linalg.solve_triangular(np.linalg.cholesky(information), flat, lower=True)
        return Imitation(turned.T.reshape(slopes.shape))

    @cached_property
    def spread(self) -> np.ndarray:
        """Predictive covariance of each pose without its unit noise, shape (n_poses, n_units, n_units)."""
        return np.asarray(np.eye(self.turned.shape[1]) + self.turned @ self.turned.transpose(0, 2, 1))

    def shared(self, pose: int) -> np.ndarray:
        """Return the predictive covariance of each pose with a given one, shape (n_poses, n_units, n_units)."""
        if pose not in self.asked:
            self.asked[pose] = self.turned @ self.turned[pose].T
        return self.asked[pose]


@dataclass(frozen=True, eq=False)
class TCriterion:
    """The separation of a true explanation from another one fitted to its effect with all other parameters.

    squared [sd²]: squared separation in the data; unexplained (n_poses, n_units): residual of that best fit at each
    further pose; spread (n_poses, n_units, n_units): its covariance; taken: covariances of the poses measured since
    with every pose, at unit variance of their own; cost: additional cost of the other explanation.
    """

    squared: float
    unexplained: np.ndarray
    spread: np.ndarray
    imitation: Imitation
    cost: float
    taken: tuple[np.ndarray, ...] = ()

    @staticmethod
    def of(
        information: np.ndarray,
        moment: np.ndarray,
        energy: float,
        new_effect: np.ndarray,
        new_imitate: np.ndarray,
        cost: float,
        imitation: Imitation | None = None,
    ) -> TCriterion:
        """Set up the criterion of a least squares problem in standard deviations of noise and priors.

        information (n, n), moment (n,) and energy are those of the data; new_effect (n_poses, n_units) and new_imitate
        (n_poses, n_units, n) those of further poses. Raises ArithmeticError if values are not finite.
        """
        solved = np.linalg.solve(information, moment)
        squared, unexplained = float(energy - moment @ solved), new_effect - new_imitate @ solved
        if not (np.isfinite(squared) and np.isfinite(unexplained).all()):
            raise ArithmeticError("what one cause does and another imitates is not finite")
        imitation = imitation or Imitation.of(information, new_imitate)
        return TCriterion(squared, unexplained, imitation.spread, imitation, cost)

    @staticmethod
    def between(
        fitted: Fitted, scores: Sequence[Score], choices: Measurements, planned: Planned
    ) -> dict[Pair, TCriterion]:
        """Return the criterion of each pair of explanations of a finding, by indices of the true and the fitted one.

        Args:
            fitted: the fitted model.
            scores: of the causes in the finding's place, with costs relative to the finding's; the first cause is in the model.
            choices: the poses to choose from.
            planned: how a further pose will be measured.
        """
        model, fit = fitted.model, fitted.fit
        # The cost of parameters and variants, up to a constant of the finding.
        costs = [float(score.cost - fit.residual.size * np.log1p(-score.share)) for score in scores]
        both = replace(model, effects=(*model.effects, *(score.cause for score in scores[1:])))
        columns = [both.columns(score.cause) for score in scores]
        rest = np.setdiff1d(np.arange(len(both.parameters)), np.concatenate(columns))
        rest = np.setdiff1d(rest, np.flatnonzero(fit.at_bound))
        point = np.concatenate([fit.estimate, both.nominal[len(fit.estimate) :]])
        sd = both.prior_sd
        seen = probed(LeastSquares.of(both, fitted.data, fitted.noise), point, ())[1] * sd
        new = planned.whitened(both, point, choices.conditions) * sd
        effects = [score.estimate / sd[span] for score, span in zip(scores, columns, strict=True)]
        products = seen.T @ seen
        information = products + np.eye(len(sd))
        imitating = [np.concatenate([rest, span]) for span in columns]
        imitations = [Imitation.of(information[np.ix_(own, own)], new[..., own]) for own in imitating]

        def criterion(true: int, other: int) -> TCriterion:
            own, effect = imitating[other], effects[true]
            moment = products[np.ix_(own, columns[true])] @ effect
            energy = float(effect @ products[np.ix_(columns[true], columns[true])] @ effect)
            return TCriterion.of(information[np.ix_(own, own)], moment, energy, new[..., columns[true]] @ effect, new[..., own],
                                 costs[other] - costs[true], imitations[other])  # fmt: skip

        return {pair: criterion(*pair) for pair in permutations(range(len(scores)), 2)}

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
        solved = np.linalg.solve(self.spread, self.unexplained[..., None])[..., 0]
        return np.asarray((self.unexplained * solved).sum(axis=1))

    def measured(self, pose: int) -> TCriterion:
        """Return the criterion after one more pose."""
        shared = self.imitation.shared(pose) - sum(taken @ taken[pose].T for taken in self.taken)
        factor = np.linalg.cholesky(self.spread[pose])
        half = np.linalg.solve(factor, shared.transpose(0, 2, 1)).transpose(0, 2, 1)
        surprise = np.linalg.solve(factor, self.unexplained[pose])
        return replace(
            self, squared=self.squared + float(surprise @ surprise), unexplained=self.unexplained - half @ surprise,
            spread=self.spread - half @ half.transpose(0, 2, 1), taken=(*self.taken, half),
        )  # fmt: skip


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
        now = {key: criterion.measured(chosen[-1]) for key, criterion in now.items()}
    return chosen, {pair: closest(now, pair) for pair in pairs}
