"""Which smooth functions there may be: of joints that move the same seen point, and of no others."""

from __future__ import annotations

import numpy as np

import calflow as cf
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.smooth_functions import Field, smooth_functions
from calflow.model import build
from estimation.data import stated
from hidden.test_arms import robot

TORSO, LEFT, RIGHT = {0}, {1, 2, 3, 4}, {5, 6, 7, 8}


def fields(markers):
    """The joints of each field, of a torso with two arms that are seen by these markers."""
    arms = robot()
    q = np.random.default_rng(1).uniform(-2, 2, (20, arms.n_joints))
    data = cf.Measurements.from_arrays(arms, q, np.zeros((20, 3)), marker=np.resize(markers, 20))
    problem = LeastSquares.of(build(arms, ("geometry",), data.given), data, stated(data))
    every = [one for _, some in smooth_functions(problem, problem.model.nominal, data) for one in some]
    return {frozenset(one.of) for one in every if isinstance(one, Field)}


def test_two_arms_have_no_functions_of_each_other():
    """Fails if a point errs by the angle of a joint that moves other points than it, or a joint on its branch is left out."""
    assert fields(["left", "right"]) == {frozenset(TORSO | LEFT), frozenset(TORSO | RIGHT)}


def test_a_branch_that_nothing_is_seen_of_has_no_functions():
    """Fails if joints that move no measured point are searched for errors."""
    assert fields(["left"]) == {frozenset(TORSO | LEFT)}
