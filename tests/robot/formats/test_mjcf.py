"""A robot in MJCF is the same robot here, in MuJoCo and in pinocchio."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import calflow as cf
from calflow.model import build
from calflow.robot.formats.mjcf import mjcf_text, urdf_of_mjcf
from calflow.robot.formats.rigid_chain import rigid_chain
from conftest import in_process
from robot.formats.urdfs import tree
from robots import industrial, ur10

ARM = """<mujoco model="arm">
  <compiler angle="degree" eulerseq="zyx"/>
  <default><joint damping="1"/><default class="far"><joint range="-170 170"/></default></default>
  <worldbody>
    <body name="pedestal" pos="0.1 0 0.5" euler="10 0 0">
      <body name="column" pos="0 0 0.2">
        <joint name="turn" axis="0 0 1" class="far"/>
        <inertial pos="0 0 0.1" mass="20" diaginertia="0.1 0.1 0.1"/>
        <body name="upper" pos="0.2 0 0.3" quat="0.7071 0.7071 0 0">
          <joint name="lift" axis="0 0 1" pos="0.05 0.02 0" ref="30" range="-90 120"/>
          <inertial pos="0.2 0 0" mass="10" diaginertia="0.1 0.1 0.1"/>
          <body name="fore" pos="0.6 0 0" axisangle="0 1 0 25">
            <joint name="out" type="slide" axis="1 0 0" ref="0.1" range="-0.2 0.4"/>
            <joint name="roll" axis="1 0 0" pos="0 0.03 0" range="-180 180"/>
            <inertial pos="0.1 0 0" mass="3" diaginertia="0.01 0.01 0.01"/>
            <site name="flange" pos="0.3 0.02 0" zaxis="1 0 0"/>
            <body name="finger" pos="0.2 0 0">
              <joint name="grip" type="slide" axis="0 1 0" range="-0.1 0.1"/>
              <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
            </body>
            <body name="thumb" pos="0.2 0 0">
              <joint name="follow" type="slide" axis="0 1 0" range="-0.1 0.1"/>
              <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
              <site name="tip" pos="0.05 0 0"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="follow" joint2="grip" polycoef="0.02 -1 0 0 0"/></equality>
</mujoco>"""


def placed(model: mujoco.MjModel, site: str, joints: dict[str, float]) -> np.ndarray:
    """A site (4, 4) where MuJoCo has it."""
    data, at = mujoco.MjData(model), np.eye(4)
    for name, value in joints.items():
        data.qpos[model.joint(name).qposadr] = value
    mujoco.mj_kinematics(model, data)
    at[:3, :3], at[:3, 3] = data.site(site).xmat.reshape(3, 3), data.site(site).xpos
    return at


def here(robot: cf.Robot, readings: np.ndarray, marker: int = 0) -> np.ndarray:
    """A marker with its link's turn (4, 4), without payload."""
    model, at = build(robot, ()), np.eye(4)
    row = np.zeros((model.n_conditions, 1))
    row[: robot.n_joints, 0] = readings
    row[robot.n_joints + len(robot.payloads) + marker] = 1.0
    at[:3, :3], at[:3, 3] = model.rotation(model.nominal, row)[0], model.point(model.nominal, row)[0]
    return at


@pytest.mark.parametrize(("tip", "joints"), [("flange", 4), ("tip", 6)])
def test_a_model_is_read_as_mujoco_has_it(tmp_path, tip, joints):
    """Fails if an anchor, a ref, an angle's unit, a second joint of a body or a follower's offset is lost."""
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "arm.urdf").write_text(urdf_of_mjcf(tmp_path / "arm.xml"))
    # A follower's leader is on another branch: both tips are the robot's.
    tips = tip if tip == "flange" else (tip, "finger")
    robot = cf.Robot.from_urdf(tmp_path / "arm.urdf", tip=tips, tool_rotation=(0, 0, 0))
    assert robot.n_joints == joints
    model = mujoco.MjModel.from_xml_string(ARM)
    names = [joint.name for joint in robot.joints]
    for q in np.random.default_rng(1).uniform(-0.1, 0.4, (10, robot.n_joints)):
        value = dict(zip(names, q, strict=True))
        if "follow" in value:
            q[names.index("follow")] = 0.0
            value["follow"] = 0.02 - value["grip"]
        np.testing.assert_allclose(here(robot, q), placed(model, tip, value), atol=1e-9)
    limits = dict(zip(names, robot.limits.tolist(), strict=True))
    np.testing.assert_allclose(limits["lift"], np.deg2rad([-90, 120]))
    assert robot.joints[0].mass == 20


def exported_robots() -> dict[str, cf.Robot]:
    """Robots of both conventions, with masses, signs, a tool and markers."""
    return {"ur10": ur10(base=cf.Base((1.0, 2.0, 0.3), (0.1, 0.2, 0.3))), "industrial": industrial()}


@pytest.mark.parametrize("name", ["ur10", "industrial"])
def test_a_robot_is_written_as_mujoco_and_pinocchio_read_it(name, tmp_path):
    """Fails if a body, a sign, a site or the measuring frame is elsewhere in another program."""
    robot = exported_robots()[name]
    robot = replace(robot, couplings=())
    text = mjcf_text(rigid_chain(robot), "a note -- of two hyphens")
    model = mujoco.MjModel.from_xml_string(text)
    names = [joint.name for joint in rigid_chain(robot).joints]
    (tmp_path / "robot.xml").write_text(text)
    other = pin.buildModelFromMJCF(str(tmp_path / "robot.xml"))
    data = other.createData()
    for q in np.random.default_rng(2).uniform(-0.5, 0.5, (10, robot.n_joints)):
        value = dict(zip(names, q, strict=True))
        origin = placed(model, "measuring_frame", value)
        for k, marker in enumerate(robot.markers):
            at = placed(model, f"marker_{marker}", value)
            expected = here(robot, q, k)
            np.testing.assert_allclose((np.linalg.inv(origin) @ at)[:3, 3], expected[:3, 3], atol=1e-9)
            pin.framesForwardKinematics(other, data, q)
            frame = data.oMf[other.getFrameId(f"marker_{marker}")]
            np.testing.assert_allclose(frame.translation, at[:3, 3], atol=1e-9)
        tool = (np.linalg.inv(origin) @ placed(model, "tool0", value))[:3, :3]
        np.testing.assert_allclose(tool, here(robot, q)[:3, :3], atol=1e-9)
    weighed = [joint.mass for joint in robot.joints if joint.mass]
    assert sum(weighed) <= model.body_mass.sum() < sum(weighed) + 0.1


@pytest.mark.parametrize("seed", range(3))
def test_what_is_written_reads_back(tmp_path, seed):
    """Fails if a robot comes back from MJCF as another one."""
    (tmp_path / "tree.urdf").write_text(tree(seed))
    robot = cf.Robot.from_urdf(tmp_path / "tree.urdf", tip="tip", tool_rotation=(0, 0, 0))
    (tmp_path / "again.xml").write_text(mjcf_text(rigid_chain(robot), ""))
    (tmp_path / "again.urdf").write_text(urdf_of_mjcf(tmp_path / "again.xml"))
    again = cf.Robot.from_urdf(tmp_path / "again.urdf", tip="flange", base_link="base_link", tool_rotation=(0, 0, 0))
    assert [joint.kind for joint in again.joints] == [joint.kind for joint in robot.joints]
    for q in np.random.default_rng(seed).uniform(-1, 1, (5, robot.n_joints)):
        np.testing.assert_allclose(here(again, q), here(robot, q), atol=1e-9)


def test_a_study_of_a_model_is_one_of_its_urdf(tmp_path, monkeypatch):
    """Fails if `calflow new` does not take MJCF, or leaves the study without the robot."""
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(ARM)
    assert in_process("new", "cell", "--robot", "arm.xml", "--tip", "flange").code == 0
    assert cf.Robot.from_toml("cell/robot.toml").n_joints == 4
    assert (tmp_path / "cell" / "arm.urdf").is_file()
    Path("wrong.xml").write_text("<mujoco><worldbody><body><joint type='none'/></body></worldbody></mujoco>")
    answer = in_process("new", "other", "--robot", "wrong.xml")
    assert answer.code == 2
    assert "wrong.xml: MuJoCo cannot read it" in answer.err
    assert "no such file" in in_process("new", "other", "--robot", "absent.xml").err


def test_a_robot_of_another_package_is_taken(tmp_path, monkeypatch):
    """Fails if a name of robot_descriptions is not looked up there, or a wrong one is not told with the nearest."""
    package = tmp_path / "packages" / "robot_descriptions"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (tmp_path / "arm.xml").write_text(ARM)
    (package / "arm_mj_description.py").write_text(f"MJCF_PATH = {str(tmp_path / 'arm.xml')!r}\n")
    (package / "bent_description.py").write_text("XACRO_PATH = 'bent.xacro'\n")
    (package / "far_description.py").write_text("raise OSError('no route to host')\n")
    monkeypatch.syspath_prepend(str(package.parent))
    for name in [name for name in sys.modules if name.startswith("robot_descriptions")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.chdir(tmp_path)
    assert in_process("new", "cell", "--robot", "arm_mj_description", "--tip", "flange").code == 0
    assert cf.Robot.from_toml("cell/robot.toml").n_joints == 4
    assert "did you mean 'arm_mj_description'?" in in_process("new", "b", "--robot", "arm_md_description").err
    assert "cannot get 'far_description': no route to host" in in_process("new", "b", "--robot", "far_description").err
    assert "is a xacro: expand it" in in_process("new", "b", "--robot", "bent_description").err
