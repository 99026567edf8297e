"""The criterion between two explanations of the same data: how far they are apart, and which further poses set them apart.

T-optimality (Atkinson and Fedorov 1975): one explanation is fitted as well as it can be to what the other, true one does; what
it cannot imitate, in standard deviations of the noise, is the separation. Poses are added where it grows most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.stats import norm

from calflow.design.planned import Planned
from calflow.diagnosis.findings.verdict import WITHIN
from calflow.diagnosis.screening.screening import Score
from calflow.diagnosis.search.fitted import Fitted
from calflow.estimation.least_squares import LeastSquares

Pair = tuple[int, int]  # of explanations, by their numbers


@dataclass(frozen=True)
class Choices:
    """Poses to choose from: readings and approach (n, n_joints), payload names, and the packed rows (n_conditions, n)."""

    readings: np.ndarray
    approach: np.ndarray
    payloads: tuple[str, ...]
    rows: np.ndarray

    def only(self, which: Sequence[int]) -> Choices:
        """Return some of the poses."""
        chosen = list(which)
        payloads = tuple(self.payloads[k] for k in chosen)
        return Choices(self.readings[chosen], self.approach[chosen], payloads, self.rows[:, chosen])


@dataclass(frozen=True)
class Explanation:
    """A cause in a finding's place as it was scored, and its place's BIC relative to the finding's."""

    score: Score
    bic: float

    def cost(self, n: int) -> float:
        """What its parameters and variants cost in BIC, up to a constant of the finding; n is the number of residuals."""
        return float(self.bic - n * np.log1p(-self.score.share))


@dataclass(frozen=True)
class TCriterion:
    """An explanation's effect, and how well another one and all other parameters can imitate it: in the data, and further on.

    information (n, n), moment (n,) and energy are of the least squares problem in standard deviations of noise and priors;
    new_effect (n_poses, n_units) and new_imitate (n_poses, n_units, n) what a further pose would add to it. cost is by how much
    the other is dearer in BIC.
    """

    information: np.ndarray
    moment: np.ndarray
    energy: float
    new_effect: np.ndarray
    new_imitate: np.ndarray
    cost: float

    @staticmethod
    def between(
        fitted: Fitted, explanations: Sequence[Explanation], choices: Choices, planned: Planned
    ) -> dict[Pair, TCriterion]:
        """Set explanations of a finding against each other: keys are the true one's number and that of what imitates it.

        The first is in the fitted model, the others are not; planned is how a further pose will be measured.
        """
        model, fit = fitted.model, fitted.fit
        scores = [explanation.score for explanation in explanations]
        costs = [explanation.cost(fit.residual.size) for explanation in explanations]
        both = replace(model, effects=(*model.effects, *(score.cause for score in scores[1:])))
        columns = [both.columns(score.cause) for score in scores]
        rest = np.setdiff1d(np.arange(len(both.parameters)), np.concatenate(columns))
        rest = np.setdiff1d(rest, np.flatnonzero(fit.at_bound))
        point = np.concatenate([fit.estimate, both.nominal[len(fit.estimate) :]])
        seen = LeastSquares.of(both, fitted.data, fitted.noise).screened(point)[1]
        new = planned.whitened(both, point, choices.rows)

        def criterion(true: int, other: int) -> TCriterion:
            imitating = np.concatenate([rest, columns[other]])
            sd = both.prior_sd[imitating]
            effect, new_effect = (slopes[..., columns[true]] @ scores[true].estimate for slopes in (seen, new))
            imitate, new_imitate = (slopes[..., imitating] * sd for slopes in (seen, new))
            information = np.eye(len(sd)) + imitate.T @ imitate
            moment = imitate.T @ effect
            energy, dearer = float((effect**2).sum()), costs[other] - costs[true]
            return TCriterion(information, moment, energy, new_effect, new_imitate, dearer)

        return {pair: criterion(*pair) for pair in permutations(range(len(explanations)), 2)}

    @property
    def separation(self) -> float:
        """What cannot be imitated [sd]."""
        left = self.energy - float(self.moment @ np.linalg.solve(self.information, self.moment))
        return float(np.sqrt(max(left, 0.0)))

    @property
    def lead(self) -> float:
        """By how many of its standard deviations the BIC is expected to exclude the other (to be WITHIN above the true one's)."""
        apart = max(self.separation, 1e-9)
        return (apart**2 + self.cost - WITHIN) / (2 * apart)

    @property
    def chance(self) -> float:
        """The chance that the other explanation is excluded."""
        return float(norm.cdf(self.lead))

    @property
    def growth(self) -> np.ndarray:
        """By how much each further pose would raise the separation's square, shape (n_poses,)."""
        covariance = np.linalg.inv(self.information)
        unexplained = self.new_effect - self.new_imitate @ (covariance @ self.moment)
        spread = np.eye(self.new_effect.shape[1]) + np.einsum(
            "rai,ij,rbj->rab", self.new_imitate, covariance, self.new_imitate, optimize=True
        )
        return np.einsum("ra,ra->r", unexplained, np.linalg.solve(spread, unexplained[..., None])[..., 0])

    def measured(self, pose: int) -> TCriterion:
        """Return the criterion after one more pose."""
        effect, imitate = self.new_effect[pose], self.new_imitate[pose]
        return replace(self, information=self.information + imitate.T @ imitate, moment=self.moment + imitate.T @ effect,
                       energy=self.energy + float((effect**2).sum()))  # fmt: skip


def closest(criteria: Mapping[Pair, TCriterion], pair: Pair) -> TCriterion:
    """Return the harder one of a pair's two criteria."""
    return min((criteria[pair], criteria[pair[::-1]]), key=lambda criterion: criterion.lead)


def propose(
    criteria: Mapping[Pair, TCriterion], pairs: Sequence[Pair], number: int
) -> tuple[list[int], dict[Pair, TCriterion]]:
    """Choose poses, each for the criterion that is then the hardest, and return the harder criterion of every pair after them."""
    now = {key: criteria[key] for pair in pairs for key in (pair, pair[::-1])}
    chosen = list[int]()
    for _ in range(min(number, *(len(criterion.new_effect) for criterion in now.values()))):
        growth = min(now.values(), key=lambda criterion: criterion.lead).growth
        growth[chosen] = -1.0
        chosen.append(int(np.argmax(growth)))
        now = {key: criterion.measured(chosen[-1]) for key, criterion in now.items()}
    return chosen, {pair: closest(now, pair) for pair in pairs}
