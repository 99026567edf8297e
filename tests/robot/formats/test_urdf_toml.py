"""robot.toml that names a URDF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow.effects.geometry import Geometry
from calflow.files.problems import InputError
from calflow.robot.formats import robot_file
from calflow.robot.parts import Coupling, Payload
from calflow.robot.robot import Robot
from robot.formats import urdfs
from robot.formats.test_urdf import ARM

FILE = """name = "mine"
[urdf]
file = "arm.urdf"
tip = "tool"
[base]
known = false
[[joints]]
name = "elbow"
sign = -1
limits_deg = [-90, 120]
gear_ratio = 101
mass_kg = 2.5
[[couplings]]
joint = 2
source = 1
factor = 1.0
[payloads.load]
mass_kg = 3
[markers.ball]
point_mm = [0, 0, 80]
"""


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """The robot file, with its URDF beside it."""
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "robot.toml").write_text(FILE)
    return tmp_path / "robot.toml"


def test_the_file_adds_to_the_urdf_what_that_does_not_say(written: Path) -> None:
    """Fails if what the robot file says of a joint, load, marker or the base does not reach the robot, or changes more."""
    robot, plain = Robot.from_toml(written), Robot.from_urdf(written.parent / "arm.urdf")
    elbow = robot.joints[1]
    assert (elbow.sign, elbow.gear_ratio, elbow.mass, elbow.com) == (-1, 101.0, 2.5, plain.joints[1].com)
    assert_allclose(elbow.limits, np.deg2rad([-90, 120]))
    assert (robot.joints[0], robot.joints[2]) == (plain.joints[0], plain.joints[2])
    assert robot.couplings == (*plain.couplings, Coupling(2, 1, 1.0))
    assert (robot.name, robot.base.known, dict(robot.payloads)) == ("mine", False, {"load": Payload(3.0)})
    assert list(robot.markers) == ["ball"]
    assert robot_file.files(written) == (written, written.parent / "arm.urdf")


@pytest.mark.parametrize(("old", "new", "said"), [
    ('"elbow"', '"elbo"', "robot.toml:8: joints[1].name: there is no joint 'elbo' that moves between base and tip, did you mean "
                          "'elbow'?; there are shoulder, elbow, wrist"),
    ("limits_deg", "limits_mm", "robot.toml:7: joints[1]: a revolute joint has limits_deg, not limits_mm"),
    ("joint = 2", "joint = 4", "robot.toml:14: couplings[1].joint: there is no joint 4: this robot has joints 1 to 3"),
    ('"arm.urdf"', '"../arm.urdf"', "robot.toml:3: urdf.file: expected the name of a .urdf file that lies beside this one"),
    ('"arm.urdf"', '"leg.urdf"', "leg.urdf: no such file"),
    ("sign", "alpha_deg = 3\nsign", "robot.toml:9: joints[1].alpha_deg: unknown key"),
    ('"tool"', '"tol"', "arm.urdf: tip: there is no link 'tol', did you mean 'tool'?"),
])  # fmt: skip
def test_what_does_not_fit_the_urdf_is_told(old: str, new: str, said: str, written: Path) -> None:
    """Fails if a name or limit that the URDF has no joint for is passed over, or told without its line."""
    written.write_text(FILE.replace(old, new, 1))
    with pytest.raises(InputError) as found:
        Robot.from_toml(written)
    assert said in str(found.value)


def test_a_urdf_in_the_place_of_a_robot_file_is_told_how(written: Path) -> None:
    """Fails if a URDF is read as TOML."""
    with pytest.raises(InputError, match=r"expected a robot file with \[urdf\] file"):
        Robot.from_toml(written.parent / "arm.urdf")


@pytest.mark.parametrize("seed", range(6))
def test_a_robot_of_a_urdf_is_written_without_it(seed: int, tmp_path: Path) -> None:
    """Fails if a frame stated by full origins does not read back equal, or its parameters are others."""
    (tmp_path / "tree.urdf").write_text(urdfs.tree(seed))
    robot = Robot.from_urdf(tmp_path / "tree.urdf", tip="tip", tool_rotation=(0.1, 0.2, 0.3))
    robot.to_toml(tmp_path / "robot.toml")
    read = Robot.from_toml(tmp_path / "robot.toml")
    assert read == robot
    assert Geometry(read).parameters() == Geometry(robot).parameters()
