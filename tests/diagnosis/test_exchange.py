"""Two causes at once replace what resembles both."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.screening import Family
from calflow.diagnosis.stepwise import CauseAcceptance, Stepwise
from calflow.diagnosis.trial import Screened
from calflow.estimation.progress import nobody
from calflow.linear import Block, LinearProblem, LinearTrial

ROWS = 300
RNG = np.random.default_rng(1)
# The third looks like the first and the second together.
COLUMNS = RNG.standard_normal((ROWS, 4)) @ [[1, 0, 1, 0], [0, 1, 1, 0], [0, 0, 0.8, 0], [0, 0, 0, 1]]
BLOCKS = A, B, BOTH, OTHER = tuple(Block(name, COLUMNS[:, [k]], 1.0) for k, name in enumerate("abcd"))


def exchanges(sizes, *found, false_alarm=0.01):
    """What is proposed instead of the blocks found, where blocks of these sizes act beside noise of one."""
    residual = RNG.standard_normal(ROWS) + COLUMNS @ sizes
    problem = LinearProblem(residual, np.ones((ROWS, 1)), np.ones(1), BLOCKS, COLUMNS, True, None)
    trial = LinearTrial(Screened((), Family({}, 30.0), ROWS - 1), problem, np.random.default_rng(0), found)
    steps = Stepwise(CauseAcceptance(false_alarm, 10), np.random.default_rng(1), nobody, nobody).exchanges(trial)
    return [set(step.causes) for step in steps]


@pytest.mark.parametrize(("false_alarm", "proposed"), [(0.01, 1), (1e-300, 0)])
def test_a_pair_is_proposed_where_each_is_significant_beside_the_other(false_alarm, proposed):
    """Breaks if two causes take the place of one although one of them is not significant, or if none ever do."""
    assert exchanges([0.6, 0.6, 0, 0], BOTH, false_alarm=false_alarm) == [{A, B}] * proposed


def test_two_that_are_right_stand():
    """Breaks if what looks like two takes their place, or two that nothing resembles give way to whatever comes first."""
    assert not exchanges([0.6, 0.6, 0, 0], A, B)
    assert not exchanges([0.6, 0, 0, 0.4], A, OTHER)


def test_one_cause_takes_the_place_of_two_that_imitate_it():
    """Breaks if two causes that together resemble a third keep it out, or one gives way to what resembles it with another."""
    assert exchanges([0, 0, 0.6, 0], A, B)[0] == {BOTH}
    assert not exchanges([0, 0, 0.6, 0], BOTH)
