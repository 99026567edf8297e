"""The poses that are proposed separate rivals better than others do."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.effects import catalogue
from calflow.model import Model, build
from calflow.stages.causes import Cause
from calflow.stages.discrimination import POSES, Choices, Contest, propose
from calflow.stages.fitted import Fitted
from calflow.stages.settle import fit_settled
from robots import industrial
from stages.data import SIGMA, measured, stated

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
    fit, noise, lack, _ = fit_settled(MODEL, near, stated(near), MODEL.nominal[None], "linear")
    return Fitted(fit, near, noise, lack, "linear", noise)


@pytest.fixture(scope="module")
def choices():
    """Poses over all the travel."""
    more = measured(MODEL, TRUTH, 300, np.random.default_rng(2))
    return Choices(more.joints, np.ones(more.joints.shape), ("",) * len(more), more.rows)


def separation(fitted, rival, rows):
    """What a rival's best fit leaves of the effect in the data and at further rows, by plain least squares."""
    both = Model(ROBOT, (*MODEL.effects, rival))
    rows = np.hstack([fitted.data.rows, rows])
    point = np.append(fitted.fit.estimate, np.zeros(len(rival.declared)))
    jacobian = both.position_jacobian(point, rows).reshape(3 * rows.shape[1], -1) / SIGMA
    own = len(fitted.fit.estimate) - 1
    others = np.delete(np.arange(jacobian.shape[1]), own)
    whole = np.vstack([jacobian[:, others], np.diag(1 / both.prior_sd[others])])
    effect = np.append(jacobian[:, own] * fitted.fit.estimate[own], np.zeros(len(others)))
    return np.linalg.norm(effect - whole @ np.linalg.lstsq(whole, effect)[0])


def test_proposed_poses_separate_more_than_random_ones(fitted, choices):
    """Breaks if poses are chosen for anything but what the rival cannot imitate, or their worth is misstated."""
    contest = Contest.of(fitted, RATIO, ECCENTRIC, choices, SIGMA)
    chosen, (after,) = propose([contest], POSES)
    assert len(set(chosen)) == POSES
    assert contest.separation == pytest.approx(separation(fitted, ECCENTRIC, choices.rows[:, :0]), rel=0.02)
    assert after.separation == pytest.approx(separation(fitted, ECCENTRIC, choices.rows[:, chosen]), rel=0.02)
    assert after.separation > 1.5 * contest.separation
    assert after.separation > 1.1 * separation(fitted, ECCENTRIC, choices.rows[:, :POSES])


def test_poses_for_two_rivals_serve_the_nearer_one(fitted, choices):
    """Breaks if poses that exclude one rival leave another as near as it was."""
    contests = [Contest.of(fitted, RATIO, rival, choices, SIGMA) for rival in (ECCENTRIC, SECOND)]
    alone = [propose([contest], POSES)[1][0].separation for contest in contests]
    for_one = propose(contests[1:], POSES)[0]
    together = [contest.separation for contest in propose(contests, POSES)[1]]
    assert min(together) > 0.9 * min(alone)
    assert min(together) > 1.02 * min(separation(fitted, r, choices.rows[:, for_one]) for r in (ECCENTRIC, SECOND))
