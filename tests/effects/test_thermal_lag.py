"""What follows the air's temperature, beside the solved differential equation of one heat capacity."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pandas as pd
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import robots
from calflow import identify
from calflow.effects.device_growth import ScaleGrowth
from calflow.effects.gear_ratio_error import GearRatioError
from calflow.effects.thermal_growth import ThermalGrowth
from calflow.effects.thermal_lag import AT_FIRST, LAGS, REFERENCE, ThermalLag
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from effects.test_axis_straightness import ON_A_RAIL, SIGMA, drawn, points
from effects.test_slides import GANTRY
from hidden.frame_causes import behind

ROBOT = robots.ur10()
TIME = np.cumsum(np.random.default_rng(4).uniform(10, 300, 60)) + 9000 * (np.arange(60) > 30) - 10
AIR = 295 + 3 * np.sin(TIME / 4000) + np.random.default_rng(5).normal(0, 0.1, 60)


def _rows(time: np.ndarray, air: np.ndarray, robot=ROBOT) -> Measurements:
    return Measurements(
        robot, pd.DataFrame({"time": time, "temperature": air, **{f"q{k + 1}": 0.0 * time for k in range(6)}})
    )


def _at(effect: ThermalLag, given: tuple[str, ...] = ("time", "temperature")) -> Callable:
    """How much warmer than 20 °C it is at a time and a temperature of the air, and what is left of what it was beyond that."""
    row, every = Row.symbols(ROBOT, given), Row.symbols(ROBOT)
    values = ca.vertcat(*effect.above_reference(row))
    known = [
        value if value.nnz() else at for value, at in ((row.time, every.time), (row.temperature, every.temperature))
    ]
    of = ca.Function("warm", known, [values])
    return lambda time, air: of(time, air).full().ravel()


def test_a_structure_follows_the_air_as_the_differential_equation_says() -> None:
    """Fails if a pause is taken for a step, rows for evenly spaced, or what the structure differs by at first does not fade."""
    assert [effect.lag for effect in ThermalGrowth.variants(ROBOT, _rows(TIME, AIR))[:5]] == [0.0, *LAGS]
    for effect in ThermalGrowth(ROBOT).lagging(_rows(TIME, AIR))[1:]:
        solved = solve_ivp(
            lambda t, warm, lag=effect.lag: (np.interp(t, TIME, AIR) - warm) / lag, (TIME[0], TIME[-1]), [AIR[0] - 2],
            t_eval=TIME, max_step=20.0, rtol=1e-8, atol=1e-8,
        )  # fmt: skip
        warm, fades = np.array([_at(effect)(*row) for row in zip(TIME, AIR, strict=True)]).T
        assert_allclose(REFERENCE + warm - 2 * fades / AT_FIRST, solved.y[0], atol=5e-3)
        later = warm[-1] + REFERENCE + (280 - warm[-1] - REFERENCE) * -np.expm1(-1000 / effect.lag)
        assert_allclose(_at(effect)(TIME[-1] + 1000, 280.0)[0], later - REFERENCE, atol=1e-6)


def test_without_a_lag_or_a_time_it_is_as_warm_as_the_air() -> None:
    """Fails if a row's own temperature counts for nothing where no course is known, or parameters get lost."""
    plain, late = ThermalGrowth(ROBOT).lagging(_rows(TIME, AIR))[::4]
    assert_allclose(_at(plain)(TIME[9], 300.0), [300 - REFERENCE])
    assert_allclose(_at(late, ("temperature",))(0.0, 300.0), [300 - REFERENCE, 0.0])
    assert ThermalGrowth(ROBOT).lagging(_rows(TIME, 295 + 0 * AIR)) == ()
    assert [at.shape for at in late.above_reference(Row.symbols(ROBOT, ("time",)))] == [(1, 1), (1, 1)]


def test_a_series_with_a_clock_of_its_own_begins_as_warm_as_its_air() -> None:
    """Fails if another series is as warm as the fitted one was, or differs at first as that did."""
    late = ThermalGrowth(ROBOT).lagging(_rows(TIME, AIR))[2]
    other = late.later(_rows(TIME - TIME[0], AIR[::-1]))
    assert_allclose(_at(other)(0.0, AIR[-1]), [AIR[-1] - REFERENCE, 0.0], atol=1e-9)
    assert other.declared == late.declared
    assert late.later(None) == late
    assert other.of_figures(ROBOT, other.figures_text) == other
    assert "followed" not in late.variant + repr(late)


def test_a_rack_and_a_scale_follow_the_air_too() -> None:
    """Fails if a slide's rack, or a device's scale, grows with the air at once alone, or a scale is not zero where it was left."""
    racks = [effect for effect in GearRatioError.variants(GANTRY, _rows(TIME, AIR, GANTRY)) if effect.warm]
    assert [rack.lag for rack in racks] == [0.0, *LAGS]
    assert [p.symbol for p in racks[1].declared if p.joint == 1] == ["kappa", "kappa0"]
    late = ScaleGrowth.variants(ROBOT, _rows(TIME, AIR))[2]
    row, p = Row.symbols(ROBOT), ca.SX.sym("p", 2)
    moved = ca.Function("moved", [p, row.time, row.temperature], [late.device(p, ca.SX([1.0, 0.0, 0.0]), row)])
    warm, left = _at(late)(TIME[20], AIR[20])[0] + REFERENCE, AIR.mean()
    assert_allclose(moved([1e-3, 0.0], TIME[20], AIR[20])[0], 1 + 1e-3 * (warm - left))


def test_a_rack_that_follows_the_air_late_is_told() -> None:
    """Fails if a rack that grows hours after the air is called a drift of the device, or one that grows at once is called late."""
    rng = np.random.default_rng(1)
    q = drawn(120, rng)
    time = np.cumsum(rng.uniform(50, 150, 120)) + 5400 * (np.arange(120) > 60)
    air = 295 + 3 * np.sin(time / 1500) + 3 * np.sin(time / 3000 + 1)
    for warm, late in ((behind(time, air, 7200.0, 1.0), True), (air, False)):
        real = np.column_stack([q[:, 0] * (1 + 2.4e-5 * (warm - REFERENCE)), q[:, 1:]])
        seen = points(real, np.zeros((120, 6))) + SIGMA * rng.standard_normal((120, 3))
        data = Measurements.from_arrays(ON_A_RAIL, q, seen, sigma=SIGMA, time=time, temperature=air).split(seed=3)
        others = ["frame-drift", "stand-growth", "thermal-growth", "scale-growth", "joint-step", "frame-step"]
        told = identify(ON_A_RAIL, data, ("geometry",), starts=1).diagnose(catalogue=["gear-ratio-error", *others])
        (found,) = told.findings
        assert (found.status, found.cause, found.joint, "late" in found.detail) == (
            "named",
            "gear-ratio-error",
            1,
            late,
        )
        assert abs(found.estimate - 2.4e-4) < 3 * found.sd
