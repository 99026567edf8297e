"""The poses that are proposed separate rivals better than others do."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
import pytest

from calflow.design.discrimination import MOST_NEXT_POSES, discrimination
from calflow.design.planned import Planned
from calflow.design.t_optimality import Discrimination
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.stepwise import WITHIN
from calflow.diagnosis.trial import Linearisation
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.estimation.fit import fit_reweighted
from calflow.model import Model, build
from estimation.data import SIGMA, measured, stated
from robots import industrial

ROBOT = industrial()
RATIO = Cause(ROBOT, catalogue()["gear-ratio-error"](ROBOT), "joint2")
ECCENTRIC = Cause(ROBOT, catalogue()["joint-eccentricity"](ROBOT), "joint2")
SECOND = Cause(ROBOT, catalogue()["joint-eccentricity"](ROBOT, order=2), "joint2")
MODEL = Model(ROBOT, (*build(ROBOT, ("geometry",)).effects, RATIO))
TRUTH = np.append(np.zeros(len(MODEL.parameters) - 1), 5e-4)


@pytest.fixture(scope="module")
def fitted():
    """A gear ratio fitted on short travel, where rivals look alike."""
    near = measured(MODEL, TRUTH, 60, np.random.default_rng(9))
    near = near.only(np.abs(near.joints[:, 1]) < 0.8)
    fit, noise, lack, _ = fit_reweighted(MODEL, near, stated(near), MODEL.nominal[None], "linear")
    return Fitted(fit, near, noise, lack, noise)


@pytest.fixture(scope="module")
def choices():
    """Poses over all the travel."""
    return measured(MODEL, TRUTH, 300, np.random.default_rng(2))


def explanations(fitted, *rivals):
    """The gear ratio as it was fitted, and rivals in its place."""
    looked = Linearisation.at(fitted, rivals).apart([RATIO]).scores
    scores = [next(score for score in looked if score.cause == cause) for cause in (RATIO, *rivals)]
    return [replace(score, cost=score.cost - scores[0].cost) for score in scores]


def separation(fitted, true, rival, conditions):
    """What a rival's best fit leaves of the true cause's effect in the data and at further rows, by plain least squares."""
    base = Model(ROBOT, (*MODEL.effects[:-1], true.cause, rival.cause))
    known = np.delete(fitted.fit.estimate, MODEL.columns(RATIO))
    conditions = np.hstack([fitted.data.conditions, conditions])
    point = np.append(known, np.zeros(len(true.estimate) + len(rival.estimate)))
    jacobian = base.position_jacobian(point, conditions).reshape(3 * conditions.shape[1], -1) / SIGMA
    own = base.columns(true.cause)
    others = np.delete(np.arange(jacobian.shape[1]), own)
    whole = np.vstack([jacobian[:, others], np.diag(1 / base.prior_sd[others])])
    effect = np.append(jacobian[:, own] @ true.estimate, np.zeros(len(others)))
    return np.linalg.norm(effect - whole @ np.linalg.lstsq(whole, effect)[0])


def nearest(fitted, scores, rows):
    """The least separation of all ordered pairs."""
    return min(separation(fitted, true, rival, rows) for true, rival in permutations(scores, 2))


def test_proposed_poses_separate_more_than_random_ones(fitted, choices):
    """Breaks if poses are chosen for anything but what the other cannot imitate, or their worth is misstated."""
    scores = explanations(fitted, ECCENTRIC)
    criteria = discrimination(fitted, scores, choices, Planned(fitted.model.observations[0], SIGMA))
    chosen, ends = criteria.propose([(0, 1)], MOST_NEXT_POSES)
    after = ends[0, 1].separation
    assert len(set(chosen)) == MOST_NEXT_POSES
    for pair in ((0, 1), (1, 0)):
        one, other = (scores[k] for k in pair)
        assert criteria[pair].separation == pytest.approx(
            separation(fitted, one, other, choices.conditions[:, :0]), rel=0.02
        )
    assert after == pytest.approx(nearest(fitted, scores, choices.conditions[:, chosen]), rel=0.02)
    assert after > 1.5 * nearest(fitted, scores, choices.conditions[:, :0])
    assert after > 1.1 * nearest(fitted, scores, choices.conditions[:, :MOST_NEXT_POSES])


def test_poses_for_all_serve_the_closest_pair(fitted, choices):
    """Breaks if poses that exclude one rival leave another as near as it was, or rivals as near each other."""
    scores = explanations(fitted, ECCENTRIC, SECOND)
    criteria = discrimination(fitted, scores, choices, Planned(fitted.model.observations[0], SIGMA))
    pairs = list(combinations(range(3), 2))
    alone = {pair: criteria.propose([pair], MOST_NEXT_POSES) for pair in pairs}
    chosen, ends = criteria.propose(pairs, MOST_NEXT_POSES)
    together = min(criterion.separation for criterion in ends.values())
    assert together > 0.8 * min(after[pair].separation for pair, (_, after) in alone.items())
    assert together == pytest.approx(nearest(fitted, scores, choices.conditions[:, chosen]), rel=0.02)
    for pair in ((0, 1), (0, 2)):
        assert together > nearest(fitted, scores, choices.conditions[:, alone[pair][0]])


def test_a_rival_is_excluded_as_often_as_is_said():
    """Breaks if the chance of excluding a rival is anything but how often its cost comes out WITHIN above the true one's."""
    rng = np.random.default_rng(3)
    true, rival = rng.standard_normal((2, 90))
    effect, dearer = 0.45 * true, -3.0  # the rival has fewer parameters
    scale = 1e4  # of the priors, which then tell nothing
    columns = scale * np.column_stack([true, rival])
    own, sizes = [np.array([0]), np.array([1])], [np.array([0.45 / scale]), np.zeros(1)]
    nothing = np.zeros((1, 3, 2))
    criterion = Discrimination.between(columns, nothing, np.arange(0), own, sizes, [0.0, dearer])[0, 1]
    seen = effect + rng.standard_normal((4000, 90))
    left = [(seen**2).sum(axis=1) - (seen @ one) ** 2 / (one @ one) for one in (rival, true)]
    excluded = np.mean(left[0] - left[1] + dearer > WITHIN)
    assert 0.2 < excluded < 0.9
    assert criterion.chance == pytest.approx(excluded, abs=0.03)
