"""The graph over many rows: positions, rotations, markers and payloads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.measurements.measurements import Measurements
from calflow.model import BLOCK_ROWS, Model, build
from calflow.observations import observations
from calflow.robot.robot import Robot

MARKERS = {
    name: {"point_m": point} for name, point in {"A": [0.1, 0, 0.2], "B": [0, -0.3, 0.1], "C": [0, 0, 0]}.items()
}
ROBOTS = {
    "hh800": robots.hh800(base=robots.ASKEW, tool_rotation=(0.3, -0.5, 1.2)),
    "ur10": replace(robots.ur10(tool_rotation_deg=[90, 20, -45]), base=robots.ASKEW),
    "no tool": robots.industrial(),
}


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Machine code from elsewhere must not stand in for the graph."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_rotation_is_that_of_the_tool(robot: Robot) -> None:
    """Breaks if rotations come out transposed, improper, of the flange, or in the robot's own base."""
    model, q = Model(robot, ()), robots.poses(robot, 20)
    found = model.rotation(np.zeros(0), robots.rows(model, q))
    assert found.shape == (20, 3, 3)
    assert_allclose(found, robots.tool_rotation(robot, q), atol=1e-12)
    assert_allclose(found @ found.transpose(0, 2, 1), np.broadcast_to(np.eye(3), found.shape), atol=1e-12)
    assert_allclose(np.linalg.det(found), 1.0, atol=1e-12)


def test_rows_choose_their_marker() -> None:
    """Breaks if markers are mixed up, or all rows get the first one's."""
    robot = robots.ur10(markers=MARKERS)
    model, q = build(robot, ["geometry"]), robots.poses(robot, 9)
    conditions = np.hstack([robots.rows(model, q[k::3], marker=name) for k, name in enumerate(MARKERS)])
    found = model.position(model.nominal, conditions).reshape(3, 3, 3)
    for k in range(3):
        assert_allclose(found[k], robots.marker_position(robot, q[k::3], marker=k), atol=1e-12)
    for k, name in enumerate(MARKERS):  # and a marker's own error moves no other
        moved = np.abs(model.position(model.nominal + 0.01 * is_of(model, name), conditions).reshape(3, 3, 3) - found)
        assert [change.max() > 1e-3 for change in moved] == [other == k for other in range(3)]


def is_of(model: Model, part: str) -> np.ndarray:
    """Which parameters belong to a part."""
    return np.array([parameter.part == part for parameter in model.parameters])


def test_rows_choose_their_payload() -> None:
    """Breaks if payloads are mixed up, or one hangs on rows that name none."""
    loads = {"light": {"mass_kg": 2.0}, "heavy": {"mass_kg": 9.0, "com_m": [0.1, 0, 0.1]}}
    robot, s = robots.ur10(payloads=loads), np.full(6, 2e-5)
    model, q = build(robot, ["joint-compliance"]), robots.poses(robot, 5)
    conditions = np.hstack([robots.rows(model, q, payload) for payload in ("heavy", "", "light")])
    for found, payload in zip(model.position(s, conditions).reshape(3, 5, 3), ("heavy", "", "light"), strict=True):
        bent = q - s * robots.holding_torque(robot, q - s * robots.holding_torque(robot, q, payload), payload)
        assert_allclose(found, robots.marker_position(robot, bent), atol=1e-5)
        others = {"heavy", "", "light"} - {payload}
        assert all(np.abs(found - model.position(s, robots.rows(model, q, other))).max() > 1e-4 for other in others)


def test_many_rows_equal_single_ones() -> None:
    """Breaks if a block's border drops, repeats or reorders rows."""
    robot = robots.ur10()
    model = build(robot, ["joint-compliance"])
    conditions = robots.rows(model, robots.poses(robot, 20_000), "load")
    p = np.full(6, 1e-5)
    found, derivative = model.position(p, conditions), model.position_jacobian(p, conditions[:, : BLOCK_ROWS + 7])
    assert found.shape == (20_000, 3)
    some = [0, 1, BLOCK_ROWS - 1, BLOCK_ROWS, BLOCK_ROWS + 1, 2 * BLOCK_ROWS - 1, 2 * BLOCK_ROWS, 19_999]
    for k in some:
        assert np.array_equal(found[k], model.position(p, conditions[:, [k]])[0])
    assert np.array_equal(found, np.vstack([model.position(p, part) for part in np.array_split(conditions, 7, axis=1)]))
    for k in some[:5]:
        assert np.array_equal(derivative[k], model.position_jacobian(p, conditions[:, [k]])[0])


def test_no_rows_have_no_derivatives() -> None:
    """Fails if a study that holds nothing out ends in an error where its held-out rows are predicted."""
    robot = robots.ur10()
    (observed,) = observations(Measurements.from_arrays(robot, robots.poses(robot, 1), None))
    model = build(robot, ["geometry"], (), (observed,))
    none, p = np.zeros((model.n_conditions, 0)), model.nominal
    shape = (0, 3, len(model.parameters))
    assert model.observed_jacobian(observed, p, none, np.zeros((observed.reports, 0))).shape == shape
    assert model.point_jacobian(p, none).shape == model.rotation_jacobian(p, none).shape == shape


def test_whole_numbers_are_numbers() -> None:
    """Breaks if parameters that come as integers are read as the bits of floating-point ones."""
    robot = robots.hh800()
    model, conditions = build(robot, ("geometry",)), robots.rows(Model(robot, ()), robots.poses(robot, 3))
    whole = np.zeros(len(model.parameters), dtype=int)
    whole[0] = 1
    assert_allclose(model.position(whole, conditions), model.position(whole.astype(float), conditions), atol=0)


def test_closure_is_told_for_each_row() -> None:
    """Breaks if the closure's cosine is another row's; a robot without loop can always be closed."""
    robot = robots.hh800_with_bars(0.75, 1.7, 0.9)
    model, q = build(robot, ["geometry"]), robots.poses(robot, 30)
    distance = np.abs(1.6 * np.exp(1j * q[:, 1]) - 0.75 * np.exp(1j * q[:, 2]))
    wanted = (1.7**2 - distance**2 - 0.9**2) / (2 * distance * 0.9)
    assert_allclose(model.closure_cosine(model.nominal, robots.rows(model, q)), wanted, atol=1e-12)
    serial = Model(robots.ur10(), ())
    assert (serial.closure_cosine(np.zeros(0), robots.rows(serial, q)) == 0).all()


def test_parameters_come_effect_by_effect() -> None:
    """Breaks if an effect gets another one's parameters, or names, priors and bounds get out of step."""
    robot = robots.hh800()
    both, apart = (
        build(robot, ["joint-compliance", "geometry"]),
        [build(robot, [e]) for e in ("joint-compliance", "geometry")],
    )
    assert both.parameters == apart[0].parameters + apart[1].parameters
    for figure in ("nominal", "prior_sd", "bounds"):
        assert_allclose(getattr(both, figure), np.concatenate([getattr(model, figure) for model in apart]))
    assert both.bounds.shape == (37, 2)
    assert Model(robot, ()).bounds.shape == (0, 2)
    conditions = robots.rows(both, robots.poses(robot, 5), "rated")
    swapped = build(robot, ["geometry", "joint-compliance"])
    s, g = np.full(6, 2e-7), np.random.default_rng(12).normal(scale=2e-3, size=31)
    found = both.position(np.concatenate([s, g]), conditions)
    assert_allclose(found, swapped.position(np.concatenate([g, s]), conditions), atol=1e-12)
