"""Which smooth functions there may be: of joints that move the same seen point, and of no others."""

from __future__ import annotations

import numpy as np

import calflow as cf
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.smooth_functions import JointField, OfJoints, smooth_functions
from calflow.model import build
from estimation.data import stated
from hidden.test_arms import robot

TORSO, LEFT, RIGHT = {0}, {1, 2, 3, 4}, {5, 6, 7, 8}


def functions(markers):
    """Those of joints, of a torso with two arms that are seen by these markers."""
    arms = robot()
    q = np.random.default_rng(1).uniform(-2, 2, (20, arms.n_joints))
    data = cf.Measurements.from_arrays(arms, q, np.zeros((20, 3)), marker=np.resize(markers, 20))
    problem = LeastSquares.of(build(arms, ("geometry",), data.given), data, stated(data))
    every = [one for _, some in smooth_functions(problem, problem.model.nominal, data) for one in some]
    return [one for one in every if isinstance(one, OfJoints)]


def test_two_arms_have_no_functions_of_each_other():
    """Fails if a joint errs by the angle of one that moves other points than it does, or a pair on one branch is left out."""
    every = functions(["left", "right"])
    pairs = {frozenset(one.of) for one in every if len(one.of) == 2}
    assert {0, 3} in pairs
    assert {6, 8} in pairs
    assert len(pairs) == 2 * 10
    for one in every:
        acting = {*one.of, *(one.erring if isinstance(one, JointField) else ())}
        assert set(one.of) <= TORSO or acting <= TORSO | LEFT or acting <= TORSO | RIGHT


def test_a_branch_that_nothing_is_seen_of_has_no_functions():
    """Fails if joints that move no measured point are searched for errors."""
    assert set().union(*(one.of for one in functions(["left"]))) == TORSO | LEFT
