"""External axes: an arm on a rail beside a turntable that carries the piece, against pinocchio's idea of the true cell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import calflow as cf
from calflow.files.problems import InputError
from calflow.model import build
from calflow.robot.frames import modified_dh
from calflow.robot.mechanism import gravity_torque
from calflow.robot.parts import Base, Joint, Marker
from calflow.runs.given_rows import check_external
from robot.formats.urdfs import Reference
from robots import industrial, marker_position, rows

PLACES = {  # of each joint in its parent, [m] and [rad]: as the maker says, and by how much the true cell is off [mm, mrad]
    "table": ("1.6 0.2 0.5", "0 0 0", (0.8, -0.5, 0.3), (0.4, -0.3, 0.0)),
    "rail": ("0 0 0.1", "0 0 0", (0.0, 0.0, 0.0), (0.3, 0.0, 0.5)),
    "j1": ("0 0 0.3", "0 0 0", (0.4, 0.0, 0.2), (0.2, -0.3, 0.0)),
    "j2": ("0.25 0 0.3", "0 0 0", (0.3, -0.2, 0.0), (0.2, 0.8, 0.0)),
    "j3": ("0 0 0.8", "0 0 0", (0.0, 0.2, 0.5), (0.1, -0.9, 0.2)),
    "j4": ("0.2 0 0.15", "0 0 0", (0.0, 0.1, -0.3), (0.6, 0.2, 0.1)),
    "j5": ("0.6 0 0", "0 0 0", (0.4, 0.0, 0.1), (0.0, 0.7, 0.2)),
    "j6": ("0.12 0 0", "0 0 0", (0.0, 0.1, 0.1), (0.5, 0.1, -0.2)),
}
AXES = {"table": "0 0 1", "rail": "0 1 0", "j1": "0 0 1", "j2": "0 1 0", "j3": "0 1 0", "j4": "1 0 0", "j5": "0 1 0",
        "j6": "1 0 0"}  # fmt: skip
TOOL = np.array([0.02, -0.03, 0.15])
NOISE = 0.02e-3


def cell(off: float) -> str:
    """The cell as a URDF, off from what the maker says by a share of what the true one is."""
    text, at = "", {"table": "world", "rail": "world"}
    for name, (xyz, rpy, shift, turn) in PLACES.items():
        place = np.array(xyz.split(), float) + off * 1e-3 * np.array(shift)
        turned = np.array(rpy.split(), float) + off * 1e-3 * np.array(turn)
        kind = "prismatic" if name == "rail" else "revolute"
        parent = at.get(name) or ("of_rail" if name == "j1" else f"of_j{int(name[1]) - 1}")
        text += (
            f'<link name="of_{name}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="of_{name}"/>'
            f'<origin xyz="{" ".join(map(str, place))}" rpy="{" ".join(map(str, turned))}"/><axis xyz="{AXES[name]}"/>'
            '<limit lower="-2.8" upper="2.8" effort="0" velocity="1"/></joint>'
        )
    fixed = '<origin xyz="0.1 0 0.2" rpy="0 0 0.5"/></joint>'
    piece = f'<link name="piece"/><joint name="c" type="fixed"><parent link="of_table"/><child link="piece"/>{fixed}'
    return f'<robot name="cell"><link name="world"/>{text}{piece}</robot>'


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory):
    """The maker's cell with its external axes, the true one, and a calibration of 80 poses seen from the piece."""
    folder = tmp_path_factory.mktemp("cell")
    for name, off in (("nominal", 0.0), ("true", 1.0)):
        (folder / f"{name}.urdf").write_text(cell(off))
    stated = cf.Robot.from_urdf(
        folder / "nominal.urdf", tip="of_j6", base_link="piece", markers={"ball": Marker(tuple(TOOL))}
    )
    numbers = {"rail": 1, "table": 2}
    joints = tuple(replace(joint, external=numbers.get(joint.name)) for joint in stated.joints)
    robot = replace(stated, joints=joints, base=Base(known=False))
    true = Reference(folder / "true.urdf", [joint.name for joint in joints])
    q = readings(120, 1)
    seen = where(true, q) + NOISE * np.random.default_rng(2).standard_normal((len(q), 3))
    data = cf.Measurements.from_arrays(robot, q, seen, sigma=NOISE).split(holdout=1 / 3, seed=1)
    return robot, true, cf.identify(robot, data, effects=["geometry"], starts=1)


def readings(number: int, seed: int) -> np.ndarray:
    """Readings of table, rail and arm within the ranges of work."""
    low = np.array([-2.5, -1.0, -1.0, -0.6, -0.6, -2.0, -1.5, -2.5])
    return np.random.default_rng(seed).uniform(low, -low, (number, len(low)))


def where(of: Reference, q: np.ndarray) -> np.ndarray:
    """Where the ball is as the piece sees it, by pinocchio."""
    frames = [of.frame(row, "of_j6", "piece") for row in q]
    return np.array([frame[:3, :3] @ TOOL + frame[:3, 3] for frame in frames])


def test_the_table_is_identified_with_the_arm(made) -> None:
    """Fails if the table's place or tilt, or the rail's direction, is taken for an error of the arm, or not found."""
    _, _, fit = made
    accuracy = fit.accuracy.table.set_index(["model", "split"])["mean_mm"]
    assert accuracy["nominal", "holdout"] > 0.5
    assert accuracy["geometry", "holdout"] < 2.5e3 * NOISE


def test_commands_move_the_arm_alone(made) -> None:
    """Fails if a correction moves a rail or a table, or the piece is not where the table's reading has it."""
    robot, true, fit = made
    q = readings(40, 3)
    targets = where(true, q + np.array([0, 0, 0.02, 0.03, -0.02, 0.05, 0.03, 0.0]))
    found = fit.compensate(targets, start=q)
    assert_allclose(found.readings[:, robot.external], q[:, robot.external], rtol=0, atol=1e-15)
    assert found.reached.mean() > 0.9
    miss = np.linalg.norm(where(true, found.readings) - targets, axis=1)[found.reached]
    assert np.sqrt((miss**2).mean()) < 3 * NOISE
    free = q.copy()
    free[:, robot.arm] = np.nan
    again = fit.compensate(targets, start=free)
    assert_allclose(again.readings[:, robot.external], q[:, robot.external])
    assert again.reached.mean() > 0.9


def test_where_an_external_axis_is_must_be_said(made) -> None:
    """Fails if a rail's place is made up."""
    _, true, fit = made
    with pytest.raises(InputError, match=r"readings of the external axes \(joints 1, 2\)"):
        fit.compensate(where(true, readings(1, 1)))


def test_targets_of_a_file_say_where_external_axes_are(made, tmp_path: Path) -> None:
    """Fails if a file that gives the readings of table and rail alone is refused, or one without them is done."""
    robot, _, _ = made
    path = tmp_path / "targets.csv"
    path.write_text("q1_deg,q2_mm,x_mm,y_mm,z_mm\n20,100,0,0,300\n")
    data = cf.Measurements.to_reach(path, robot)
    check_external(data, path)
    assert_allclose(data.joints[0, :2], [np.deg2rad(20), 0.1])
    path.write_text("x_mm,y_mm,z_mm\n0,0,300\n")
    with pytest.raises(InputError) as found:
        check_external(cf.Measurements.to_reach(path, robot), path)
    assert [one.message.split(":")[0] for one in found.value.problems] == [
        "expected q1_deg of every target", "expected q2_mm of every target",
    ]  # fmt: skip


def test_a_table_in_a_robot_file_of_ones_own(tmp_path: Path) -> None:
    """Fails if a table stated by DH figures turns the piece the other way, or gravity turns with the piece."""
    arm = industrial()
    table = Joint(modified_dh(), sign=-1, external=1, mass=500.0, name="table")
    swivel = replace(arm.joints[0], frame=modified_dh(a=1.5, d=arm.joints[0].frame.figures["d"]))
    joints = (table, swivel, *arm.joints[1:])
    down = (3.0, 0.0, -9.0)  # as where all of the cell leans
    whole = replace(arm, joints=joints, ground=1, gravity=down)
    whole.to_toml(tmp_path / "robot.toml")
    assert cf.Robot.from_toml(tmp_path / "robot.toml") == whole
    rng = np.random.default_rng(4)
    alone, marker = replace(arm, gravity=down), next(iter(arm.markers))
    model = build(whole, ())
    for turn, q in zip(rng.uniform(-3, 3, 5), rng.uniform(-1, 1, (5, 6)), strict=True):
        seen = model.point(np.zeros(0), rows(model, np.array([[turn, *q]]), "load", marker))
        place = marker_position(arm, q[None])[0] + [1.5, 0, 0]
        about = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        assert_allclose(seen[0], about @ place, atol=1e-12)
        load = np.ones(1)
        held = np.array(gravity_torque(whole)(np.array([-turn, *q]), load)).ravel()
        assert_allclose(held[1:], np.array(gravity_torque(alone)(q, load)).ravel(), atol=1e-8)
