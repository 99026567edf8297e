"""Plane: heights over a surface of unknown place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.design.candidates import candidates
from calflow.files.problems import InputError
from calflow.files.toml import Origin, validate_table
from calflow.measurements.measurements import combined
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations.plane import Plane, PlaneSettings
from calflow.robot.parts import Base
from hidden.devices import Arm, measured, surface, wire
from hidden.trials import calibrated, error_of_tool
from observations.graph import error, frame, no_links, through_json
from robots import ur10

PLACE = np.array([0.4, -0.2, -0.6, 0.15, -0.1, 0.0])


def on_plane(rng: np.random.Generator, n: int, place: np.ndarray = PLACE) -> np.ndarray:
    """Points on a plane."""
    turn, origin = frame(place)
    return origin + np.hstack([rng.uniform(-1, 1, (n, 2)), np.zeros((n, 1))]) @ turn.T


def test_the_error_is_the_height_less_the_reading():
    """Fails if height, tilts or their order are wrong, or a row is held against another plane."""
    rng = np.random.default_rng(1)
    points, reading = rng.normal(size=(6, 3)), rng.normal(size=6)
    rows = pd.DataFrame({"reading": reading, "plane": ["table", "wall"] * 3})
    one = Plane.of(Series(), rows)
    p = 0.2 * rng.normal(size=6)
    found = error(one, p, points, rows)[:, 0]
    for i in range(6):
        z, rx, ry = p[3 * (i % 2) : 3 * (i % 2) + 3]
        turn, _ = frame(np.array([0, 0, 0, rx, ry, 0]))
        assert abs(found[i] - (turn[:, 2] @ (points[i] - [0, 0, z]) - reading[i])) < 1e-12
    assert [q.name for q in one.declared] == [f"plane-{n}.{s}" for n in ("table", "wall") for s in ("z", "rx", "ry")]


def test_a_plane_is_laid_through_its_points():
    """Fails if exact points leave an error, or the normal points away from the robot."""
    rng = np.random.default_rng(2)
    points = on_plane(rng, 12)
    rows = pd.DataFrame({"plane": ["table"] * 12})
    one = Plane.of(Series(), rows).registered(points, no_links, rows)
    np.testing.assert_allclose(error(one, np.zeros(3), points, rows), 0, atol=1e-12)
    turn, origin = frame(np.array(one.nominal[0]))
    assert turn[:, 2] @ -origin > 0
    assert through_json(one) == one


def test_a_gauge_reads_heights_over_it():
    """Fails if readings are not taken off before the plane is laid."""
    rng = np.random.default_rng(3)
    turn, _ = frame(PLACE)
    reading = np.full(9, 0.01)
    points = on_plane(rng, 9) + reading[:, None] * turn[:, 2]
    rows = pd.DataFrame({"reading": reading})
    one = Plane.of(Series(), rows).registered(points, no_links, rows)
    np.testing.assert_allclose(error(one, np.zeros(3), points, rows), 0, atol=1e-12)


def test_readings_that_differ_still_lay_the_plane():
    """Fails if heights of several millimetres tilt the plane."""
    rng = np.random.default_rng(4)
    turn, _ = frame(PLACE)
    reading = rng.uniform(0, 0.01, 40)
    points = on_plane(rng, 40) + reading[:, None] * turn[:, 2]
    rows = pd.DataFrame({"reading": reading})
    one = Plane.of(Series(), rows).registered(points, no_links, rows)
    np.testing.assert_allclose(error(one, np.zeros(3), points, rows), 0, atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_readings_count_from_either_side(side):
    """Fails if heights over a table above the robot's foot are read as depths, or a point of another plane tilts it."""
    rng = np.random.default_rng(9)
    turn, _ = frame(PLACE)
    reading = rng.uniform(0, 2e-3, 40)
    points = on_plane(rng, 40) + side * reading[:, None] * turn[:, 2] + 3e-4 * rng.normal(size=(40, 3))
    points[7] += 0.2 * turn[:, 2]
    rows = pd.DataFrame({"reading": reading})
    one = Plane.of(Series(), rows).registered(points, no_links, rows)
    left = np.delete(error(one, np.zeros(3), points, rows)[:, 0], 7)
    assert np.sqrt(np.mean(left**2)) < 4e-4


def test_a_new_plane_is_lacking_until_it_is_added():
    """Fails if an unknown plane goes unseen, or adding it moves the one that is known."""
    rng = np.random.default_rng(5)
    points = on_plane(rng, 8)
    rows, new = (pd.DataFrame({"plane": [name] * 8}) for name in ("table", "wall"))
    one = Plane.of(Series(), rows).registered(points, no_links, rows)
    assert one.lacks(new)
    assert not one.lacks(rows)
    wider = one.extended(new)
    assert wider.placements | one.placements == wider.placements
    assert not wider.lacks(new)
    assert one == Plane.of(Series(), rows).placed(one.placements)


def test_what_is_expected_leaves_no_error():
    """Fails if a planned row is packed otherwise than a measured one."""
    rng = np.random.default_rng(6)
    points = rng.normal(size=(5, 3))
    rows = pd.DataFrame({"plane": ["table"] * 5})
    one = Plane.of(Series(), rows).registered(on_plane(rng, 5), no_links, rows)
    reading = one.expected(points, np.zeros((5, 3, 3)))[0]
    np.testing.assert_allclose(error(one, np.zeros(3), points, rows.assign(reading=reading)), 0, atol=1e-12)


def stated(**more) -> Series:
    """A surface plate 200 mm under the base, in front of it."""
    return Series.of("plate", "plane", {"point": (0.6, 0.0, -0.2), "normal": (0.0, 0.0, 1.0), **more})


def test_planned_poses_touch_the_plane_that_is_stated():
    """Fails if candidates miss the plane, leave the joints' limits, or a plane of unknown place is planned for."""
    plane = Plane.planned(stated())
    robot = replace(ur10(), base=Base(fixed=True))
    model = build(robot, ("geometry",), (), (plane,))
    readings, conditions = candidates(model, 30, "", "E", None, np.random.default_rng(1), plane)
    assert len(readings) == 30
    np.testing.assert_allclose(model.point(model.nominal, conditions)[:, 2], -0.2, atol=2e-6)
    with pytest.raises(ValueError, match="point_mm"):
        Plane.planned(Series("plate", "plane"))


def test_touches_of_a_plane_and_a_wire_calibrate_a_robot():
    """Fails if a plane beside another device, its place unknown, biases the fit or promises too much."""
    rng = np.random.default_rng(2)
    arm = Arm.drawn(ur10(), rng)
    touches = surface(arm, np.array([0.6, 0.0, -0.2]), np.array([0.0, 0.0, 1.0]), 60, 5e-5, rng)
    lengths = wire(arm, arm.random(60, rng), np.array([1.2, 0.5, 0.1]), 5e-5, rng)
    data = combined(
        [measured(arm.robot, touches, stated(), 5e-5), measured(arm.robot, lengths, Series("wire", "distance"), 5e-5)]
    )
    found = calibrated(data, ("geometry",)).fit
    squared = float((found.residual**2).sum()) / (found.residual.size - found.effective_parameters)
    assert 0.6 < squared < 1.5
    tool = error_of_tool(found, arm, 300, rng)
    assert tool.true < 1.5 * tool.promised


def test_a_plane_without_direction_is_refused(tmp_path):
    """Fails if a normal of no length goes through."""
    path = tmp_path / "study.toml"
    path.write_text("[measurements.settings]\nnormal = [0, 0, 0]\n")
    with pytest.raises(InputError, match="direction"):
        validate_table({"normal": [0, 0, 0]}, PlaneSettings, Origin.of(path, "measurements", "settings"))
