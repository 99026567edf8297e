"""The library: each robot against a second description of it, and as a study that runs."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from calflow.files.problems import InputError
from calflow.robot.chain import Deflection, pose
from calflow.robot.dimensions import nominal_dimensions
from calflow.robot.robot import Robot
from calflow.robot.statics import gravity_torque
from calflow.simulation import simulate
from calflow.study import load_study
from calflow.templates import library, write_study
from robot.formats import urdfs

# Where other descriptions have the flange [mm], its z and its x, at joint readings [deg]: computed by pinocchio from the
# makers' packages for ROS (UR, KUKA KR 210), ROS-Industrial's (ABB, FANUC), example-robot-data 6 (Panda) and pybotics 3.1 (iiwa).
FLANGES = pd.read_csv(Path(__file__).parent / "flanges.csv", sep=";").set_index("robot")
TORQUES = {  # the same descriptions' holding torques [Nm] at the first of these readings
    "franka-panda": (0.0, -49.1, -6.096, -8.738, -0.589, -1.228, -0.032),
    "kuka-kr210-r2700": (0.0, -3519.726, 390.817, 0.0, 7.417, 0.0),
    "ur10e": (0.0, 40.128, -34.153, -1.206, 0.046, 0.0),
    "ur5": (0.0, 20.967, -13.604, -0.491, 0.018, 0.0),
}


def robot(name: str, folder: Path) -> Robot:
    """A robot of the library."""
    path = folder / f"{name}.toml"
    path.write_text(library.text(name), encoding="utf-8")
    return Robot.from_toml(path)


def test_every_robot_is_compared() -> None:
    """Fails if a robot comes into the library without a second description."""
    assert sorted(set(FLANGES.index)) == library.names()


@pytest.mark.parametrize("name", FLANGES.index.unique())
def test_a_robot_is_where_another_description_has_it(name: str, tmp_path: Path) -> None:
    """Fails if a length, a sign, a zero or the flange of a robot of the library is not as others have it."""
    arm = robot(name, tmp_path)
    q = ca.SX.sym("q", arm.n_joints)
    flange = ca.Function("flange", [q], [pose(arm, nominal_dimensions(arm), q, Deflection.zero(arm.n_joints)).flange])
    for row in FLANGES.loc[name].itertuples(index=False):
        readings, point, z, x = (np.array(str(cell).split(), dtype=float) for cell in row)
        at = np.array(flange(arm.reading_matrix @ np.deg2rad(readings)))
        assert_allclose(1e3 * at[:3, 3], point, atol=1e-3)
        assert_allclose(np.array([at[:3, 2], at[:3, 0]]), [z, x], atol=1e-6)
    assert all(joint.limits for joint in arm.joints)
    assert len(arm.notes.splitlines()) > 1


@pytest.mark.parametrize("name", TORQUES)
def test_a_robot_weighs_what_another_description_says(name: str, tmp_path: Path) -> None:
    """Fails if a mass or centre is in another frame than the link's, or of another link."""
    arm = robot(name, tmp_path)
    readings = np.array(FLANGES.loc[name, "q_deg"].iloc[0].split(), dtype=float)
    q = arm.reading_matrix @ np.deg2rad(readings)
    found = arm.reading_matrix.T @ np.array(gravity_torque(arm)(q, np.zeros(0))).ravel()
    assert_allclose(found, TORQUES[name], atol=0.01)


@pytest.mark.parametrize("name", ["ur10e", "kuka-iiwa7"])
def test_a_study_of_a_robot_of_the_library(name: str, tmp_path: Path) -> None:
    """Fails if the files that `calflow new --robot` writes do not fit the robot."""
    write_study(tmp_path / "mine", name)
    study = load_study(tmp_path / "mine")
    assert study.name == "mine"
    assert study.file.effects == (("geometry", "joint-compliance") if study.robot.has_masses else ("geometry",))
    assert len(simulate(tmp_path / "mine" / "truth.toml")) == 180


def test_a_study_of_a_urdf(tmp_path: Path) -> None:
    """Fails if the URDF is not copied with the study, is changed on the way, or its tip is not asked for where it is needed."""
    text = urdfs.tree(3)
    (tmp_path / "tree.urdf").write_text(text)
    with pytest.raises(InputError, match="expected tip, one of the links"):
        write_study(tmp_path / "mine", str(tmp_path / "tree.urdf"))
    assert not (tmp_path / "mine").exists()
    written = write_study(tmp_path / "mine", str(tmp_path / "tree.urdf"), tip="tip")
    assert [path.name for path in written] == ["robot.toml", "tree.urdf", "study.toml", "truth.toml"]
    assert (tmp_path / "mine" / "tree.urdf").read_text() == text
    assert load_study(tmp_path / "mine").robot.joints == Robot.from_urdf(tmp_path / "tree.urdf", "tip").joints
    assert len(simulate(tmp_path / "mine" / "truth.toml")) == 180


def test_what_is_not_in_the_library(tmp_path: Path) -> None:
    """Fails if a misspelt robot is not told, or a tip is passed over where there is no URDF."""
    with pytest.raises(InputError, match="no robot 'ur11' in the library, did you mean 'ur10'"):
        write_study(tmp_path / "mine", "ur11")
    with pytest.raises(InputError, match="links of a URDF"):
        write_study(tmp_path / "mine", "ur10", tip="tool0")
    assert not (tmp_path / "mine").exists()


def test_the_library_is_listed() -> None:
    """Fails if a user does not see what there is."""
    said = dict(library.listing())
    assert list(said) == library.names()
    assert said["franka-panda"] == "Franka Emika Panda: 7 joints, with masses"
