"""The library: each robot against a second description of it, and as a study that runs."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from calflow.files.problems import InputError
from calflow.robot.mechanism import Deflection, gravity_torque, nominal_dimensions, pose
from calflow.robot.robot import Robot
from calflow.simulation import simulate
from calflow.study import load_study
from calflow.templates import library_file, library_listing, library_names, write_study
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

# The lengths [mm] that robotkinematicscatalogue 1.1.2 of PyPI takes from the makers' data sheets, and by how much those here
# differ: it rounds some of UR's, and counts FANUC's from its world frame; its iiwa has another flange, and pybotics has this one.
LENGTHS = {
    "abb-irb120": ((70, 72, 270, 290, 302), 0.0),
    "abb-irb1600": ((65, 150, 486.5, 600, 700), 0.0),
    "abb-irb6640": ((200, 200, 320, 780, 1075, 1392), 0.0),
    "fanuc-r2000ic-165f": ((215, 225, 312, 670, 1075, 1280), 0.0),
    "franka-panda": ((82.5, 82.5, 88, 107, 316, 333, 384), 0.0),
    "kuka-iiwa7": ((130, 340, 400, 400), 4.0),
    "kuka-kr210-r2700": ((115, 215, 330, 645, 1150, 1220), 0.0),
    "ur5": ((82.5, 89.2, 94.75, 109.3, 392, 425), 0.25),
    "ur5e": ((99.6, 99.7, 133.3, 162.5, 392.25, 425), 0.05),
    "ur10": ((92.2, 115.7, 128, 163.9, 571.6, 612.7), 0.7),
    "ur10e": ((116.55, 119.85, 174.15, 180.7, 571.335, 612.6), 0.22),
}
DATA = "example-robot-data"  # 130 MB: compared where it is installed
FILES = {"ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0"), "ur10": ("ur_description/urdf/ur10_robot.urdf", "tool0"),
         "franka-panda": ("panda_description/urdf/panda.urdf", "panda_link8")}  # fmt: skip


def robot(name: str, folder: Path) -> Robot:
    """A robot of the library."""
    path = folder / f"{name}.toml"
    path.write_text(library_file(name), encoding="utf-8")
    return Robot.from_toml(path)


def test_every_robot_is_compared() -> None:
    """Fails if a robot comes into the library without a second description."""
    assert sorted(set(FLANGES.index)) == library_names()
    assert sorted(LENGTHS) == library_names()


@pytest.mark.parametrize("name", LENGTHS)
def test_a_robot_has_the_lengths_of_a_catalogue(name: str, tmp_path: Path) -> None:
    """Fails if a length is not as another collection has it from the maker's data sheet, or is another model's."""
    stated, differ = LENGTHS[name]
    arm = robot(name, tmp_path)
    own = sorted(1e3 * abs(step.value) for step in arm.steps if step.is_length and step.value)
    assert_allclose(own, stated, rtol=0, atol=differ + 1e-9)


@pytest.mark.parametrize("name", FILES)
def test_a_robot_is_where_an_installed_description_has_it(name: str, tmp_path: Path) -> None:
    """Fails if the flange is elsewhere than in the URDF of example-robot-data, by pinocchio; UR's base there is turned by half."""
    try:
        files = metadata.files(DATA) or []
    except metadata.PackageNotFoundError:
        pytest.skip(f"{DATA} is not installed")
    file, tip = FILES[name]
    arm = robot(name, tmp_path)
    names = [joint.name for joint in arm.joints]
    reference = urdfs.Reference(Path(next(str(one.locate()) for one in files if str(one).endswith(file))), [])
    reference.joints = list(reference.model.joints[1 : 1 + len(names)])
    turned = np.diag([1.0, 1.0, 1.0, 1.0] if name == "franka-panda" else [-1.0, -1.0, 1.0, 1.0])
    q = ca.SX.sym("q", arm.n_joints)
    flange = ca.Function("flange", [q], [pose(arm, nominal_dimensions(arm), q, Deflection.zero(arm.n_joints)).flange])
    for angles in np.random.default_rng(1).uniform(-1.5, 1.5, (20, arm.n_joints)):
        assert_allclose(np.array(flange(angles)), turned @ reference.frame(angles, tip), atol=1e-9)


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
    said = dict(library_listing())
    assert list(said) == library_names()
    assert said["franka-panda"] == "Franka Emika Panda: 7 joints, with masses"
