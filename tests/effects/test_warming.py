"""How warm a robot is, beside the solved differential equation of one heat capacity."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pandas as pd
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import robots
from calflow.effects.housing_growth import HousingGrowth
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row

PAUSES = ((3000.0, 8000.0), (9000.0, 40000.0))
BEGINS = 0.3  # warmth at the first row
ROBOT = robots.ur10()


def test_a_robot_that_stands_cools_as_the_differential_equation_says() -> None:
    """Fails if warmth jumps at a pause, cools at another rate than it warms, or what was left of it is lost."""
    row = Row.symbols(ROBOT)
    warming = HousingGrowth(ROBOT, 1800.0, PAUSES)
    part = ca.SX([1.0, BEGINS] + [0.0] * (len(warming.declared) - 2))
    warmth = ca.Function("warmth", [row.time], [warming.warmth(part, row)[0]])
    ends = [0.0, *(time for pause in PAUSES for time in pause), 45000.0]
    warm = BEGINS
    for k, (begin, end) in enumerate(pairwise(ends)):
        works = 1.0 - k % 2
        at = np.linspace(begin, end, 7)
        solved = solve_ivp(
            lambda _, w, works=works: (works - w) / 1800, (begin, end), [warm], t_eval=at, rtol=1e-9, atol=1e-9
        )
        assert_allclose(warmth.map(len(at))(at).full().ravel(), solved.y[0], atol=1e-7)
        warm = solved.y[0, -1]


def test_pauses_are_those_longer_than_the_shortest_warm_up_and_ten_ordinary_gaps() -> None:
    """Fails if slow measuring by hand is taken for pauses, or a pause of an hour is not."""
    ordinary = np.arange(30.0)

    def tried(time: np.ndarray) -> set[tuple[tuple[float, float], ...]]:
        data = Measurements(ROBOT, pd.DataFrame({"time": time, **{f"q{k + 1}": 0.0 * time for k in range(6)}}))
        return {effect.pauses for effect in HousingGrowth.variants(ROBOT, data)}

    assert tried(1000 * ordinary) == tried(30 * ordinary + 600 * (ordinary > 10)) == {()}
    assert tried(30 * ordinary + 3600 * (ordinary > 10)) == {(), ((300.0, 3930.0),)}


def test_another_clock_knows_nothing_of_the_pauses() -> None:
    """Fails if the times of another series, which begins cold, are taken for those of the fitted one's pauses."""
    warming = HousingGrowth(ROBOT, 1800.0, PAUSES)
    assert warming.later(same_clock=True) == warming
    assert warming.later(same_clock=False).pauses == ()
    assert "30000" not in warming.variant
    assert warming.variant != warming.later(same_clock=False).variant
