"""Followers: joints that others move have no reading, in files, in what is planned and in what is commanded."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from calflow.deployment.inverse_kinematics import Targets, landing, nominal_readings
from calflow.design.candidates import candidates
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.robot.formats.rigid_chain import rigid_chain, said_of_variables, urdf_text
from calflow.robot.frames import modified_dh
from calflow.robot.mechanism import reading_columns
from calflow.robot.parts import Coupling, Joint, Marker, Payload
from calflow.robot.robot import Robot
from robot.formats.test_urdf import ARM

LIMIT = '<limit lower="-3" upper="3" effort="0" velocity="1"/>'
MULTIPLIER, OFFSET = -0.5, 0.2  # of the file's wrist
ROWS = "q1_deg,q2_deg,x_mm,y_mm,z_mm\n10,20,700,0,100\n30,-40,600,0,200\n-20,60,500,0,300\n"


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    """An arm whose wrist, joint 3, follows its elbow, joint 2."""
    (tmp_path / "arm.urdf").write_text(ARM)
    return Robot.from_urdf(tmp_path / "arm.urdf")


@pytest.fixture
def csv(tmp_path: Path) -> Path:
    """Measurements without a column of joint 3."""
    (tmp_path / "rows.csv").write_text(ROWS)
    return tmp_path / "rows.csv"


def test_a_follower_is_where_pinocchio_has_it(arm: Robot, csv: Path) -> None:
    """Fails if multiplier, offset or the zero reading of a follower is lost between the file and the graph."""
    data = Measurements.from_csv(csv, arm, sigma=1e-4)
    text = re.sub("<inertial>.*</inertial>", "", ARM).replace("continuous", "revolute")
    text = re.sub("<limit[^/]*/>", "", text).replace('<axis xyz="0 1 0"/>', f'<axis xyz="0 1 0"/>{LIMIT}')
    reference = pin.buildModelFromXML(text, mimic=True)
    assert reference.nq == 2
    there, tool = reference.createData(), reference.getFrameId("tool")
    model = build(arm, (), data.given)
    for own, place in zip(data.joints, model.point(np.zeros(0), data.conditions), strict=True):
        pin.framesForwardKinematics(reference, there, own[:2])
        assert_allclose(place, there.oMf[tool].translation, atol=1e-12)
    assert not data.joints[:, 2].any()


def test_what_a_file_says_of_a_follower_is_compared(arm: Robot, csv: Path) -> None:
    """Fails if a log of all joints' own angles counts the follower's as a drive's besides, or a wrong one is taken."""
    table = pd.read_csv(csv)
    plain = Measurements.from_csv(csv, arm, sigma=1e-4)
    for offset in (0.0, OFFSET):
        table.assign(q3_deg=MULTIPLIER * table["q2_deg"] + np.rad2deg(offset)).to_csv(csv, index=False)
        assert_allclose(Measurements.from_csv(csv, arm, sigma=1e-4).joints, plain.joints)
    table.assign(q3_deg=0).to_csv(csv, index=False)
    assert_allclose(Measurements.from_csv(csv, arm, sigma=1e-4).joints, plain.joints)
    table.assign(q3_deg=[0, 5, 0]).to_csv(csv, index=False)
    with pytest.raises(InputError, match=r"q3: joint 3 has no drive of its own, it follows q2: .* off by up to"):
        Measurements.from_csv(csv, arm, sigma=1e-4)
    two = Measurements.from_arrays(arm, plain.joints[:, :2], plain.position, sigma=1e-4)
    assert_allclose(two.joints, plain.joints)


def test_planned_and_commanded_readings_leave_a_follower_out(arm: Robot) -> None:
    """Fails if a pose is planned or a target reached by moving a joint that has no drive."""
    model = build(arm, ())
    readings, conditions = candidates(model, 64, "", "tool", None, np.random.default_rng(1))
    assert not readings[:, 2].any()
    angles = readings @ arm.reading_matrix.T
    assert_allclose(angles[:, 2], MULTIPLIER * angles[:, 1])
    assert arm.within_limits(angles, 1e-6).all()
    assert reading_columns(arm) == ["q1_deg", "q2_deg"]
    targets = Targets(model.point(np.zeros(0), conditions))
    for start in (
        readings + np.array([0.05, -0.04, 0.0]),
        nominal_readings(model, conditions, targets, np.random.default_rng(2))[0],
    ):
        found = landing(model, np.zeros(0), conditions, targets, start)
        assert found.reached.mean() > 0.9
        assert not found.readings[:, 2].any()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_follower_is_exported_as_one(arm: Robot, sign: int) -> None:
    """Fails if a joint without drive is one with a drive in the URDF, or follows by another factor, as pinocchio reads it."""
    joints = (arm.joints[0], replace(arm.joints[1], sign=sign, limits=(-3, 3)), replace(arm.joints[2], sign=-1))
    robot = replace(arm, joints=joints)
    chain = rigid_chain(robot)
    assert said_of_variables(robot) == []
    reference = pin.buildModelFromXML(urdf_text(chain, ""), mimic=True)
    assert reference.nq == 2
    model, there = build(robot, ()), reference.createData()
    q = np.random.default_rng(1).uniform(-1, 1, (5, 2))
    places = model.point(
        np.zeros(0), Measurements.from_arrays(robot, q, None, pose=np.arange(5)).stating(()).conditions
    )
    for own, place in zip(q, places, strict=True):
        pin.framesForwardKinematics(reference, there, own)
        assert_allclose(place, there.oMf[reference.getFrameId("marker_tool")].translation, atol=1e-12)


def test_a_note_says_what_the_variable_of_a_coupled_joint_is() -> None:
    """Fails if the note's sum of readings, as the URDF's variable, leads elsewhere than the model: of joints with a sign."""
    joints = [Joint(modified_dh(alpha=-np.pi / 2, a=0.3 * k), limits=(-3, 3), sign=(-1) ** k) for k in range(4)]
    joints[3] = replace(joints[3], driven=False)
    couplings = (Coupling(2, 1, -0.5), Coupling(4, 1, 1.0), Coupling(4, 3, -2.0))
    robot = Robot(joints, couplings=couplings, markers={"tool": Marker((0.2, 0.1, 0.05))})
    said = {}
    for note in said_of_variables(robot):
        joint, made = re.fullmatch(r"joint (\d)'s variable is (.*), which this format cannot state", note).groups()
        terms = re.findall(r"(?:([+-][\d.]+) · )?reading (\d)", made)
        said[int(joint)] = {int(of): float(factor or 1) for factor, of in terms}
    assert said == {2: {2: 1.0, 1: 0.5}, 4: {1: -1.0, 3: 2.0}}
    reference = pin.buildModelFromXML(urdf_text(rigid_chain(robot), ""))
    model, there = build(robot, ()), reference.createData()
    q = np.random.default_rng(6).uniform(-1, 1, (5, 3))
    rows = Measurements.from_arrays(robot, q, None, pose=np.arange(5)).stating(()).conditions
    for readings, place in zip(q, model.point(np.zeros(0), rows), strict=True):
        known = dict(enumerate(readings, start=1))
        variables = [sum(f * known[of] for of, f in said.get(i, {i: 1.0}).items()) for i in range(1, 5)]
        pin.framesForwardKinematics(reference, there, np.array(variables))
        assert_allclose(place, there.oMf[reference.getFrameId("marker_tool")].translation, atol=1e-12)


def test_a_follower_goes_where_its_drives_yield() -> None:
    """Fails if rods that keep a wrist level tilt it as drives wind up: against an equilibrium in plain numpy."""
    upper, fore, out, load = 1.2, 1.0, 0.3, 80.0
    spring = np.array([4e-6, 6e-6])
    links = [modified_dh(alpha=-np.pi / 2), modified_dh(a=upper), modified_dh(a=fore)]
    joints = [Joint(link, limits=(-3, 3), mass=10.0, com=(0, 0, 0), driven=k < 2) for k, link in enumerate(links)]
    robot = Robot(
        joints, couplings=(Coupling(3, 1, -1.0), Coupling(3, 2, -1.0)), markers={"tool": Marker((out, 0, 0))},
        payloads={"box": Payload(load, (out, 0, 0))},
    )  # fmt: skip
    q = np.random.default_rng(4).uniform(-1, 1, (6, 2))
    down = q.copy()
    for _ in range(50):
        first, second = down[:, 0], down.sum(axis=1)
        weight = 9.80665 * np.array([10.0 + 10.0 + load, 10.0 + load])
        torque = np.column_stack([weight[0] * upper * np.cos(first), 0 * first])
        torque += (weight[1] * fore * np.cos(second))[:, None]
        down = q + spring * torque
    first, second = down[:, 0], down.sum(axis=1)
    x, z = upper * np.cos(first) + fore * np.cos(second) + out, -upper * np.sin(first) - fore * np.sin(second)
    model = build(robot, ("joint-compliance",))
    p = np.array([*spring, 0.0])
    rows = Measurements.from_arrays(robot, q, None, pose=np.arange(6), payload="box").stating(model.given)
    assert_allclose(model.point(p, rows.conditions), np.column_stack([x, 0 * x, z]), atol=1e-8)


def test_what_cannot_follow_is_refused(arm: Robot, tmp_path: Path) -> None:
    """Fails if a joint without drive moves by nothing, or follows one that follows."""
    with pytest.raises(InputError, match=r"joints\[3\]: is not driven, and no coupling moves it"):
        replace(arm, couplings=())
    with pytest.raises(InputError, match=r"couplings\[2\].source: joint 3 follows another itself"):
        replace(arm, couplings=(*arm.couplings, Coupling(1, 3, 1.0)))
    arm.to_toml(tmp_path / "robot.toml")
    assert Robot.from_toml(tmp_path / "robot.toml") == arm
    assert "driven = false" in (tmp_path / "robot.toml").read_text()
