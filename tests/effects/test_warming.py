"""How warm a robot is, beside the solved differential equation of one heat capacity."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pandas as pd
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp, trapezoid

import robots
from calflow.effects.device_growth import StandGrowth
from calflow.effects.housing_growth import HousingGrowth
from calflow.effects.warming import IN_SHIFTS, SHIFT, heat_lost
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


def test_what_a_robot_may_have_lost_by_then_is_that_of_shifts_and_of_working_around_the_clock() -> None:
    """Fails if a warm-up's mean or spread later is not that of robots that stop at a random moment, if they stop at all."""
    row, warming = Row.symbols(ROBOT), HousingGrowth(ROBOT, 1800.0, (), until=5000.0)
    assert HousingGrowth.variants(ROBOT, _rows(100.0 * np.arange(51)))[-1].until == 5000.0
    part = ca.SX([1.0] + [0.0] * (len(warming.declared) - 1))
    warmth = ca.Function("warmth", [row.time], [warming.warmth(part, row)[0]])
    for passed in (-1000.0, 600.0, 86400.0):
        stop = np.linspace(0, max(passed, 0), 200_001)
        density = IN_SHIFTS * np.exp(-stop / SHIFT) / SHIFT
        lost = 1 - np.exp(-(stop[-1] - stop) / 1800)
        mean, square = trapezoid(density * lost, stop), trapezoid(density * lost**2, stop)
        assert_allclose(float(warmth(5000 + passed)), 1 - np.exp(-(5000 + passed) / 1800) - mean, atol=1e-8)
        told = [float(value) for value in heat_lost(ca.DM(passed), 1800.0)]
        assert_allclose(told, [mean, np.sqrt(square - mean**2)], atol=1e-6)


def test_a_robot_may_cool_as_slowly_as_it_works() -> None:
    """Fails if a time constant of just a shift, or of two, is divided by zero."""
    for constant in (SHIFT, 2 * SHIFT):
        near = [heat_lost(ca.DM(9000.0), factor * constant) for factor in (0.999, 1.001)]
        between = np.mean(np.array(near, dtype=float), axis=0)
        assert_allclose(np.array(heat_lost(ca.DM(9000.0), constant), dtype=float), between, rtol=1e-5)


def test_pauses_are_those_longer_than_the_shortest_warm_up_and_ten_ordinary_gaps() -> None:
    """Fails if slow measuring by hand is taken for pauses, or a pause of an hour is not."""
    ordinary = np.arange(30.0)

    def tried(time: np.ndarray) -> set[tuple[tuple[float, float], ...]]:
        return {effect.pauses for effect in HousingGrowth.variants(ROBOT, _rows(time))}

    assert tried(1000 * ordinary) == tried(30 * ordinary + 600 * (ordinary > 10)) == {()}
    assert tried(30 * ordinary + 3600 * (ordinary > 10)) == {(), ((300.0, 3930.0),)}


def test_a_series_with_a_clock_of_its_own_has_its_own_pauses() -> None:
    """Fails if another series is cold at the times of the fitted one's pauses, warm in its own, or loses parameters."""
    warming, row = HousingGrowth(ROBOT, 1800.0, PAUSES), Row.symbols(ROBOT)
    assert warming.later(None) == warming
    part = ca.SX([1.0, BEGINS] + [0.0] * (len(warming.declared) - 2))
    cold = 1 - (1 - BEGINS) * np.exp(-300 / 1800)
    for pause, warm in (
        (0.0, 1 - (1 - BEGINS) * np.exp(-900 / 1800)),
        (9000.0, 1 + (cold * np.exp(-9100 / 1800) - 1) * np.exp(-500 / 1800)),
    ):
        elsewhen = warming.later(_rows(100.0 * np.arange(10) + pause * (np.arange(10) > 3)))
        assert elsewhen.declared == warming.declared
        warmth = ca.Function("warmth", [row.time], [elsewhen.warmth(part, row)[0]])
        assert_allclose(float(warmth(900.0 + pause)), warm)
        assert elsewhen.of_figures(ROBOT, elsewhen.figures_text) == elsewhen
    assert "3000" not in warming.variant


def _rows(time: np.ndarray) -> Measurements:
    return Measurements(ROBOT, pd.DataFrame({"time": time, **{f"q{k + 1}": 0.0 * time for k in range(6)}}))


def test_a_stand_is_where_it_was_left() -> None:
    """Fails if later measurements are predicted in the frame that the device had at first, or will have when all has settled."""
    data, row = _rows(300 * np.arange(40.0)), Row.symbols(ROBOT)
    point, p = ca.SX([1.0, 2.0, 3.0]), ca.SX.sym("p", 6)
    for stand in StandGrowth.variants(ROBOT, data):
        moved = stand.device(p[: len(stand.declared)], point, row)
        at = ca.Function("moved", [p, row.time], [moved])
        amplitudes = np.full(6, 1e-3)
        assert_allclose(at(amplitudes, data.table["time"].max()).full().ravel(), [1, 2, 3], rtol=1e-12)
        assert np.abs(at(amplitudes, 0.0).full().ravel() - [1, 2, 3]).max() > 1e-4
