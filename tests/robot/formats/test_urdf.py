"""URDF: what is read of it against pinocchio's reader, and what is wrong with it told at once."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow.files.problems import InputError
from calflow.robot.mechanism import Deflection, gravity_torque, nominal_dimensions, pose
from calflow.robot.parts import Base, Coupling, Marker
from calflow.robot.robot import Robot
from robot.formats import urdfs

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="world"/>
  <link name="foot"/>
  <link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="4"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.1 0 0"/><mass value="2"/></inertial></link>
  <link name="hand"><inertial><mass value="1"/></inertial></link>
  <link name="tool"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="foot"/><origin xyz="0 0 0.1"/></joint>
  <joint name="shoulder" type="revolute"><parent link="foot"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="0" velocity="1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/></joint>
  <joint name="wrist" type="revolute"><parent link="fore"/><child link="hand"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3"/><mimic joint="elbow" multiplier="-0.5" offset="0.2"/></joint>
  <joint name="grip" type="fixed"><parent link="hand"/><child link="tool"/><origin xyz="0.05 0 0" rpy="0 1.5707963 0"/></joint>
</robot>
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """The file above."""
    (tmp_path / "arm.urdf").write_text(ARM)
    return tmp_path / "arm.urdf"


def flange(robot: Robot) -> ca.Function:
    """The flange (4, 4) as the base sees it, by joint variables."""
    q = ca.SX.sym("q", robot.n_joints)
    return ca.Function(
        "flange", [q], [pose(robot, nominal_dimensions(robot), q, Deflection.zero(robot.n_joints)).flange]
    )


@pytest.mark.parametrize("seed", range(12))
def test_a_tree_moves_and_weighs_as_in_pinocchio(seed: int, tmp_path: Path) -> None:
    """Fails if an origin, an axis, a fixed joint, a slide or the mass of a branch is not taken as URDF means it."""
    path = tmp_path / "tree.urdf"
    path.write_text(urdfs.tree(seed))
    robot = Robot.from_urdf(path, tip="tip")
    reference = urdfs.Reference(path, [joint.name for joint in robot.joints])
    frame, torque = flange(robot), gravity_torque(robot)
    for q in np.random.default_rng(seed).uniform(-2, 2, (5, robot.n_joints)):
        assert_allclose(np.array(frame(q)), reference.frame(q, "tip"), atol=1e-12)
        assert_allclose(np.array(torque(q, np.zeros(0))).ravel(), reference.torque(q), atol=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_a_base_within_the_tree(seed: int, tmp_path: Path) -> None:
    """Fails if the chain does not begin at the base link, or gravity is not along the root's z."""
    path = tmp_path / "tree.urdf"
    path.write_text(urdfs.tree(seed))
    robot = Robot.from_urdf(path, tip="tip", base_link="l3")
    reference = urdfs.Reference(path, [joint.name for joint in robot.joints])
    frame, torque = flange(robot), gravity_torque(robot)
    for q in np.random.default_rng(seed).uniform(-2, 2, (3, robot.n_joints)):
        assert_allclose(np.array(frame(q)), reference.frame(q, "tip", "l3"), atol=1e-12)
        assert_allclose(np.array(torque(q, np.zeros(0))).ravel(), reference.torque(q), atol=1e-10)


@pytest.mark.parametrize("seed", range(6))
def test_a_piece_on_a_positioner_is_the_base(seed: int, tmp_path: Path) -> None:
    """Fails if joints that carry what is measured against turn the wrong way, or gravity is not that of the floor.

    The piece weighs nothing: its own weight is no load of the model.
    """
    path = tmp_path / "cell.urdf"
    path.write_text(urdfs.cell(seed))
    robot = Robot.from_urdf(path, tip="tip", base_link="piece")
    assert [joint.name for joint in robot.joints][:4] == ["turn", "tilt", "rail", "j1"]
    assert robot.ground == 2
    reference = urdfs.Reference(path, [joint.name for joint in robot.joints])
    frame, torque = flange(robot), gravity_torque(robot)
    for q in np.random.default_rng(seed).uniform(-2, 2, (5, robot.n_joints)):
        assert_allclose(np.array(frame(q)), reference.frame(q, "tip", "piece"), atol=1e-12)
        assert_allclose(np.array(torque(q, np.zeros(0))).ravel(), reference.torque(q), atol=1e-10)
    robot.to_toml(tmp_path / "robot.toml")
    assert Robot.from_toml(tmp_path / "robot.toml") == robot


def test_what_is_read_of_a_joint(arm: Path) -> None:
    """Fails if limits, names, the marker at the tip, or what a joint follows are lost."""
    robot = Robot.from_urdf(arm, name="mine", base=Base(known=False))
    assert not robot.base.known
    assert (robot.name, [joint.name for joint in robot.joints]) == ("mine", ["shoulder", "elbow", "wrist"])
    assert [joint.limits for joint in robot.joints] == [(-2.0, 2.0), None, (-3.2, 2.8)]
    assert robot.markers == {"tool": Marker((0, 0, 0))}
    assert robot.couplings == (Coupling(3, 2, -0.5),)
    assert robot.joints[2].frame.turn.value == 0.2
    assert [joint.mass for joint in robot.joints] == [4.0, 2.0, 1.0]
    assert_allclose(robot.joints[2].com, (0, 0, -0.05), atol=1e-7)  # seen from the flange


CHANGES = {
    "<mass value=\"4\"/>": "<mass value=\"four\"/>",
    "type=\"continuous\"": "type=\"continous\"",
    "<origin xyz=\"0.4 0 0\"/>": "<origin xyz=\"0.4 0\"/>",
    "<limit lower=\"-3\" upper=\"3\"/>": "<limit lower=\"3\" upper=\"-3\"/>",
    "rpy=\"0 1.5707963 0\"": "quat=\"0 0 0 1\"",
    "<parent link=\"hand\"/>": "<parent link=\"hnd\"/>",
    "<origin xyz=\"0 0 0.1\"/>": "<orgin xyz=\"0 0 0.1\"/>",
    "mimic joint=\"elbow\"": "mimic joint=\"elbo\"",
}  # fmt: skip
TOLD = (
    "5: link 'upper': mass: value: expected a finite number, found 'four'",
    "9: joint 'stand': unknown element <orgin>, did you mean 'origin'?",
    "12: joint 'elbow': type: expected one of revolute, continuous, prismatic, fixed, floating, planar, found 'continous', did you "
    "mean 'continuous'?",
    "12: joint 'elbow': origin: xyz: expected 3 finite numbers, found '0.4 0'",
    "13: joint 'wrist': mimic: there is no joint 'elbo', did you mean 'elbow'?",
    "14: joint 'wrist': limit: expected lower < upper, found 3 and -3",
    "15: joint 'grip': origin: unknown attribute 'quat'; expected xyz, rpy",
    "15: joint 'grip': parent: there is no link 'hnd', did you mean 'hand'?",
)


def test_all_that_is_wrong_is_told_at_once_with_its_line(arm: Path) -> None:
    """Fails if a problem hides another, or has not the line in which it stands."""
    text = ARM
    for right, wrong in CHANGES.items():
        assert right in text
        text = text.replace(right, wrong)
    arm.write_text(text)
    with pytest.raises(InputError) as found:
        Robot.from_urdf(arm)
    told = [str(problem).removeprefix(f"{arm}:") for problem in found.value.problems]
    assert [one for one in told if "hangs on no joint" not in one] == list(TOLD)


@pytest.mark.parametrize(("old", "new", "said"), [
    ("</robot>", "", "not XML"),
    ("<robot name=\"arm\">", "<robot name=\"arm\"><xacro:include filename=\"a\"/>", "xacro"),
    ("<?xml version=\"1.0\"?>", "<!DOCTYPE robot [<!ENTITY a \"b\">]>", "entity"),
    ("<child link=\"upper\"/>", "<child link=\"fore\"/>", "hangs on joint 'shoulder' already"),
    ("<parent link=\"foot\"/>", "<parent link=\"tool\"/>", "hangs on itself"),
    ("name=\"elbow\" type", "name=\"shoulder\" type", "line 12: joint 'shoulder': is there twice, first in line 10"),
    ("type=\"continuous\"", "type=\"planar\"", "no joint of type 'planar' between base and tip"),
    ("<axis xyz=\"0 1 0\"/></joint>", "<axis xyz=\"0 0 0\"/></joint>", "without length"),
    ("<origin xyz=\"0.4 0 0\"/>", "<origin xyz=\"nan 0 0\"/>", "3 finite numbers"),
    ("<robot name=\"arm\">", "<sdf>", "not XML"),
    ("<limit lower=\"-3\" upper=\"3\"/>", "", "missing: expected <limit"),
    ("<link name=\"tool\"/>", "<link name=\"tool\"/><link name=\"lost\"/>", "one link that hangs on no joint"),
])  # fmt: skip
def test_what_is_no_robot_is_refused(old: str, new: str, said: str, arm: Path) -> None:
    """Fails if a file that means nothing, or something else than is read of it, is taken."""
    assert old in ARM
    arm.write_text(ARM.replace(old, new, 1))
    with pytest.raises(InputError) as found:
        Robot.from_urdf(arm)
    told = "\n".join(f"line {problem.line}: {problem.key}: {problem.message}" for problem in found.value.problems)
    assert said in told


def test_links_that_are_not_there_or_not_on_the_way(arm: Path) -> None:
    """Fails if base or tip are guessed."""
    for tip, base, said in (
        ("tol", None, "tip: there is no link 'tol', did you mean 'tool'?"),
        ("flansch", None, "tip: there is no link 'flansch'; its chains end in tool"),
        ("tool", "hand", "no joint moves between 'hand' and 'tool'"),
        ("tool", "fore", "mimic: expected a joint between base and tip, found 'elbow'"),
    ):
        with pytest.raises(InputError) as found:
            Robot.from_urdf(arm, tip, base)
        assert said in str(found.value)
    arm.write_text(ARM.replace("</robot>", '<link name="eye"/><joint name="e" type="fixed"><parent link="hand"/>'
                                           '<child link="eye"/></joint></robot>'))  # fmt: skip
    with pytest.raises(InputError, match="expected tip, one of the links tool, eye"):
        Robot.from_urdf(arm)
