"""base-off-level: an arm that gives way sags along gravity, wherever the robot file has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calflow.faults.changed_setup import LEVEL
from calflow.model import Model
from effects.bench import ROBOTS, Bench, made
from hidden import simulator

TILT = np.array([3e-3, -2e-3])  # rad


def points(bench: Bench, tilt: np.ndarray, *, soft: bool = True, turned: Rotation | None = None) -> np.ndarray:
    """Where calflow has the markers of a robot whose springs give way, or not; turned is gravity's place in the file."""
    robot = replace(bench.robot, gravity=turned.apply(bench.robot.gravity)) if turned else bench.robot
    springs, level = made(bench, "joint-compliance"), made(bench, "base-off-level")
    model = Model(robot, (replace(springs, robot=robot), replace(level, robot=robot)), bench.data.given)
    return model.position(np.r_[soft * bench.real.compliance, tilt], bench.table.conditions)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_tilt_turns_what_pulls(benches: dict[str, Bench], monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Breaks if gravity turns the wrong way, by another axis or not through the loads: the simulator turns its weights."""
    bench = benches[name]
    plain = bench.points()
    tilted = Rotation.from_rotvec([*TILT, 0.0]).apply(simulator.WEIGHT)
    monkeypatch.setattr(simulator, "WEIGHT", tilted)
    monkeypatch.setattr(simulator, "LEVERS", np.cross(np.eye(3), tilted))
    real = bench.points()
    effect = np.linalg.norm(real - plain, axis=1).max()
    assert effect > 1e-5
    assert np.linalg.norm(points(bench, TILT) - real, axis=1).max() < 5e-3 * effect


def test_nothing_shows_where_nothing_gives_way(benches: dict[str, Bench]) -> None:
    """Breaks if a tilt against gravity moves the arm as a turn of the base does."""
    rigid = points(benches["serial"], np.zeros(2), soft=False)
    np.testing.assert_array_equal(points(benches["serial"], TILT, soft=False), rigid)


def test_an_arm_on_a_wall_is_off_by_the_two_axes_that_gravity_does_not_go_along(benches: dict[str, Bench]) -> None:
    """Breaks if the axes are always x and y, one of which moves nothing on a wall."""
    bench, wall = benches["serial"], Rotation.from_euler("x", 90, degrees=True)
    level = replace(made(bench, "base-off-level"), robot=replace(bench.robot, gravity=(0.0, 9.80665, 0.0)))
    assert [p.symbol for p in level.declared] == ["rx", "rz"]
    further = Rotation.from_rotvec([TILT[0], 0.0, TILT[1]]) * wall
    effect = points(bench, TILT, turned=wall) - points(bench, np.zeros(2), turned=wall)
    apart = points(bench, np.zeros(2), turned=further) - points(bench, TILT, turned=wall)
    assert np.abs(apart).max() < 5e-3 * np.abs(effect).max()


def test_a_mistake_in_the_robot_file_begins_where_the_cause_ends(benches: dict[str, Bench]) -> None:
    """Breaks if what a floor may be off by stops the diagnosis, or a lean is too far for the one and not for the other."""
    assert {p.upper for p in made(benches["serial"], "base-off-level").declared} == {LEVEL}
