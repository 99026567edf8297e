"""A robot on a rail that is not straight, against a chain in plain numpy that knows nothing of calflow's."""

from __future__ import annotations

from math import pi

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow import Measurements, identify
from calflow.design.candidates import packed_conditions
from calflow.effects.axis_straightness import AxisStraightness
from calflow.model import Model
from calflow.robot.frames import modified_dh
from calflow.robot.parts import Joint, Marker
from calflow.robot.robot import Robot
from hidden.simulator import moved, placed, shifted, turned

TRAVEL, SIGMA = 3.0, 3e-5  # m
MARKER = np.array([0.1, 0.05, 0.2])
ON_A_RAIL = Robot(
    [
        Joint(modified_dh(alpha=pi / 2), kind="prismatic", limits=(0, TRAVEL)),
        Joint(modified_dh(alpha=-pi / 2, d=0.5), limits=(-3, 3)),
        Joint(modified_dh(alpha=-pi / 2, a=0.2), limits=(-2, 0.5)),
        Joint(modified_dh(a=0.8), limits=(-1.5, 1.5)),
        Joint(modified_dh(alpha=-pi / 2, d=0.7), limits=(-3, 3)),
        Joint(modified_dh(alpha=pi / 2), limits=(-2, 2)),
    ],
    markers={"tool": Marker(tuple(MARKER))},
)  # fmt: skip


def points(q: np.ndarray, off: np.ndarray, length: float = 0.8) -> np.ndarray:
    """The marker (n, 3) with the carriage off by a twist (n, 6) in its own axes."""
    rail = turned(0, pi / 2) @ shifted(z=q[:, 0]) @ placed(off)
    upper = rail @ turned(0, -pi / 2) @ turned(2, q[:, 1]) @ shifted(z=0.5) @ shifted(0.2) @ turned(0, -pi / 2)
    elbow = upper @ turned(2, q[:, 2]) @ shifted(length) @ turned(2, q[:, 3]) @ turned(0, -pi / 2)
    wrist = elbow @ turned(2, q[:, 4]) @ shifted(z=0.7) @ turned(0, pi / 2) @ turned(2, q[:, 5])
    return moved(wrist, MARKER)


def crooked(rng: np.random.Generator, rail: np.ndarray, shift: float, turn: float) -> np.ndarray:
    """Smooth random errors (n, 6) of a carriage at places (n,) [m], of these rms along and about each axis."""
    rate, phase = rng.normal(0, 3.0, (6, 60)), rng.uniform(0, 2 * pi, (6, 60))
    curve = np.cos(rail[:, None, None] * rate + phase).sum(axis=2) / np.sqrt(30)
    return curve * np.array([shift] * 3 + [turn] * 3)


def drawn(poses: int, rng: np.random.Generator, places: int = 0) -> np.ndarray:
    """Random readings; places says that the rail stands at so many only."""
    q = rng.uniform(*ON_A_RAIL.limits.T, (poses, 6))
    return np.hstack([np.round(q[:, :1] / TRAVEL * places) * TRAVEL / places, q[:, 1:]]) if places else q


def measured(q: np.ndarray, off: np.ndarray, rng: np.random.Generator) -> Measurements:
    """What a tracker sees of a robot whose upper arm is 0.3 mm longer than its maker says."""
    seen = points(q, off, 0.8003) + SIGMA * rng.standard_normal((len(q), 3))
    return Measurements.from_arrays(ON_A_RAIL, q, seen, sigma=SIGMA).split(seed=3)


def test_a_carriage_moves_and_turns_the_arm_as_in_plain_numpy():
    """Fails if an axis of the rail is another's, a turn is not about the carriage, or a wave or its size is not what it says."""
    q = drawn(30, np.random.default_rng(1))
    low, high = (0.0,) * 6, (TRAVEL, *(0.0,) * 5)
    effect = AxisStraightness(ON_A_RAIL, low, high, 0.3, True)
    model = Model(ON_A_RAIL, (effect,))
    values = {"wave1x": 2e-4, "wave2y": -1e-4, "wave3z": 3e-4, "wave1rx": 4e-5, "wave2ry": -8e-5, "wave3rz": 1e-4}
    p = np.array([values.get(parameter.symbol, 0.0) for parameter in effect.declared])
    assert np.count_nonzero(p) == 6
    wave = np.sin(np.outer(q[:, 0] / TRAVEL + 0.215, pi * np.arange(1, 4)) / 1.43)
    off = wave[:, [0, 1, 2, 0, 1, 2]] * list(values.values())
    at = np.linspace(0, 1, 400)
    every = np.sin(np.outer(at + 0.215, pi * np.arange(1, 4)) / 1.43) * [2e-4, -1e-4, 3e-4]
    every -= np.polynomial.polynomial.polyval(at, np.polynomial.polynomial.polyfit(at, every, 1)).T
    size = float(ca.evalf(effect.size(ca.SX(p), effect.declared)))
    assert size == pytest.approx(np.sqrt((every**2).sum(axis=1).mean()), rel=0.02)
    found = model.position(p, packed_conditions(model, q, "", "tool"))
    assert_allclose(found, points(q, off), rtol=0, atol=1e-7)
    assert np.abs(found - points(q, 0 * off)).max() > 1e-4


def test_a_crooked_rail_is_found():
    """Fails if the rail's errors are passed over, or called anything else with certainty."""
    rng = np.random.default_rng(2)
    q = drawn(120, rng)
    data = measured(q, crooked(rng, q[:, 0], 1.5e-4, 5e-5), rng)
    fit = identify(ON_A_RAIL, data, ("geometry",), starts=1)
    alike = ["joint-error-map", "periodic-joint-error", "gear-ratio-error", "link-bending", "frame-drift", "frame-step"]
    told = fit.diagnose(catalogue=["axis-straightness", *alike])
    first = told.findings[0]
    assert (first.cause, first.joint, len(told.findings)) == ("axis-straightness", 1, 1)
    assert first.estimate == pytest.approx(np.sqrt(3) * 1.5e-4, rel=0.4)
    steps = told.accuracy.table[told.accuracy.table["split"] == "holdout"]["mean_mm"]
    assert steps.iloc[-1] < 0.6 * steps.iloc[-2]


@pytest.mark.parametrize("length", [0.3, 0.1])
def test_a_curve_is_free_at_the_ends_of_its_travel(length: float):
    """Fails if a rail counts as straight where its travel ends: what it turns by there then looked like a base that tilts."""
    rail = AxisStraightness(ON_A_RAIL, (0.0,) * 6, (TRAVEL, *(0.0,) * 5), length, True)
    model = Model(ON_A_RAIL, (rail,))
    q = np.array([[at * TRAVEL, 0, 0, 0, 0, 0] for at in (0.0, 0.5, 1.0)])
    along = [k for k, one in enumerate(rail.declared) if one.symbol.endswith("z") and "r" not in one.symbol]
    slope = model.position_jacobian(np.zeros(len(rail.declared)), packed_conditions(model, q, "", "tool"))[:, :, along]
    sd = np.sqrt((slope**2 @ model.prior_sd[along] ** 2).sum(axis=1)) / rail.shift
    assert sd[1] == pytest.approx(1.0, abs=0.1)
    assert (sd[[0, 2]] > 0.6).all()


def test_a_wave_along_the_rail_is_told_by_its_way():
    """Fails if what a rack and its pinion repeat has no name, or another period or size than it has."""
    rng = np.random.default_rng(5)
    q = drawn(150, rng)
    wave = np.zeros((150, 6))
    wave[:, 2] = 1.2e-4 * np.cos(2 * pi * q[:, 0] / 0.412 + 0.7)
    fit = identify(ON_A_RAIL, measured(q, wave, rng), ("geometry",), starts=1)
    (found,) = fit.diagnose(catalogue=["axis-straightness", "periodic-joint-error", "gear-ratio-error"]).findings
    assert (found.cause, found.joint, found.unit) == ("periodic-joint-error", 1, "m")
    assert found.estimate == pytest.approx(1.2e-4, rel=0.1)
    assert found.detail.endswith("on a slide every 412 mm")


def test_a_straight_rail_is_left_alone():
    """Fails if a rail's straightness is seen in noise, or in too few places to tell."""
    rng = np.random.default_rng(4)
    q = drawn(100, rng)
    data = measured(q, np.zeros((100, 6)), rng)
    fit = identify(ON_A_RAIL, data, ("geometry",), starts=1)
    assert not len(fit.diagnose(catalogue=["axis-straightness", "gear-ratio-error"]).findings)
    few = measured(drawn(60, rng, places=4), np.zeros((60, 6)), rng)
    assert "7 different positions" in AxisStraightness.lacking(ON_A_RAIL, few)
    assert AxisStraightness.variants(ON_A_RAIL, few) == ()
