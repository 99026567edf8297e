"""Time offset: hidden in photographs of an arm that moves on between joints and image, by physics of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import calflow as cf
from calflow.calibration import Calibration
from calflow.effects.time_offset import TimeOffset
from calflow.templates import library_file
from conftest import in_process
from observations.photographed import UR5E, Arm, Photographs, board, photographed
from observations.test_camera import study

IMAGES = 20
BOARD = board(4, 3, 0.06)
SPEEDS = [f"speed{i}_rad_per_s" for i in range(1, 7)]
ACCELERATIONS = [f"acceleration{i}_rad_per_s2" for i in range(1, 7)]
ONLY = '\n[stages.diagnose]\ncatalogue = ["time-offset", "joint-eccentricity", "camera-slip", "board-bent"]\n'


def moving(seed: int, late: float, rate: float = 0.0) -> Photographs:
    """Photographs of a worn arm in motion, taken so much later [s] than its joints were read, with the joints' speeds.

    Where a rate [rad/s] is given the joints swing at it, about wherever they are, and their accelerations are there too.
    """
    rng = np.random.default_rng(seed)
    speed = 0.3 * rng.normal(size=(IMAGES, 6))  # rad/s, at the reading
    aside = 0.3 * rng.normal(size=(IMAGES, 6)) if rate else 0.0  # rad, of the middle of each swing
    swung = speed * np.sin(rate * late) / rate + aside * (np.cos(rate * late) - 1) if rate else speed * late

    class Moving(Arm):
        def links(self, q):
            return super().links(q + swung if len(q) == IMAGES else q)

    worn = Moving(UR5E.worn(rng).figures, False, UR5E.limits)
    made = photographed(UR5E, True, IMAGES, rng, points=BOARD, worn=worn)
    made.rows[SPEEDS] = speed[made.rows["pose"] - 1]
    if rate:
        made.rows[ACCELERATIONS] = (-(rate**2) * aside)[made.rows["pose"] - 1]
    return made


def test_an_image_that_was_taken_earlier_is_found(tmp_path):
    """Fails if the offset is missed, taken for another cause, of another size or sign, or leaves out the acceleration."""
    late = -30e-3
    study(tmp_path, moving(3, late, rate=2.0), "ur5e", True, ONLY)
    assert in_process("run", tmp_path / "study.toml", "--out", tmp_path / "runs").code == 0
    found = pd.read_csv(tmp_path / "runs" / "diagnose" / "findings.csv").set_index("cause")
    assert [*found.index] == ["time-offset"]
    assert found.loc["time-offset", "status"] == "named"
    assert found.loc["time-offset", "estimate"] == pytest.approx(late, abs=4 * found.loc["time-offset", "sd"])
    assert found.loc["time-offset", "sd"] < 2e-4
    rests_without_speeds(Calibration.load(tmp_path / "runs"))


def test_an_offset_is_looked_for_where_something_tells_of_it(tmp_path):
    """Fails if an offset is looked for of an arm that rests, or whose speeds nobody states."""
    made = moving(4, 0.0)
    kept = study(tmp_path, made, "ur5e", True, ONLY)
    data = kept.measurements()
    assert TimeOffset.lacking(kept.robot, data) == ""
    made.rows[SPEEDS] = 0.0
    assert "moves" in TimeOffset.lacking(kept.robot, study(tmp_path, made, "ur5e", True).measurements())
    unknown = replace(made, rows=made.rows.drop(columns=SPEEDS))
    assert "speed1_deg_per_s" in TimeOffset.lacking(kept.robot, study(tmp_path, unknown, "ur5e", True).measurements())


def rests_without_speeds(found: Calibration) -> None:
    """Fails if rows must say that they do not move before it is predicted where they are, or the device's clock moves the arm."""
    q = np.full((1, 6), 0.4)
    at_rest = found.predict(q)
    moved = found.predict(q, speed=np.full((1, 6), 0.3))
    np.testing.assert_array_equal(moved.position, at_rest.position)


def tracked(rng: np.random.Generator, arm: Arm, late: float, n: int) -> dict[str, np.ndarray]:
    """Readings and speeds of an arm in motion, and where a tracker saw its ball so much later [s]."""
    q, speed = rng.uniform(-2, 2, (n, 6)), 0.3 * rng.normal(size=(n, 6))
    seen = arm.links(q + late * speed)[-1] @ np.array([0.06, 0.03, 0.1, 1.0])
    return {"q": q, "speed": speed, "position": seen[:, :3] + 3e-5 * rng.normal(size=(n, 3))}


def test_an_arm_that_is_measured_again_as_it_moves_keeps_its_promise(tmp_path):
    """Fails if the delay that a calibration found is taken for an error of the robot where later rows state their speeds."""
    rng, late = np.random.default_rng(5), 2e-3
    (tmp_path / "robot.toml").write_text(library_file("ur5e"), encoding="utf-8")
    robot = replace(cf.Robot.from_toml(tmp_path / "robot.toml"), markers={"ball": cf.Marker((0.06, 0.03, 0.1))})
    worn = UR5E.worn(rng)
    first, again = (cf.Measurements.from_arrays(robot, **tracked(rng, worn, late, n), sigma=3e-5) for n in (60, 40))
    found = cf.identify(robot, first.split(holdout=0.2), effects=["geometry", "time-offset"], starts=1)
    checked = found.validate(again)
    poses = checked.results.tables["poses.csv"]
    assert 0.7 < np.sqrt(np.mean((poses["calibrated"] / poses["promised"]) ** 2)) < 1.4
    assert found.drift(again).summary.status == "in place"
