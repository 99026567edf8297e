"""A factory calibration of Universal Robots is the same robot here, on the controller, and in the ROS driver."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.deployment.export import export
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.model import build
from calflow.robot.formats.rigid_chain import rigid_chain
from calflow.robot.formats.ur_calibration import LINKS, driver_yaml, with_factory_calibration
from calflow.robot.frames import placement_matrix
from calflow.templates import library_file
from conftest import in_process
from deployment.test_export import EXACT
from estimation.data import calibration

NOMINAL = {  # d, a, alpha of Universal Robots
    "ur10": ((0.1273, 0, 0, 0.163941, 0.1157, 0.0922), (0, -0.612, -0.5723, 0, 0, 0)),
    "ur10e": ((0.1807, 0, 0, 0.17415, 0.11985, 0.11655), (0, -0.6127, -0.57155, 0, 0, 0)),
}
ALPHA = np.array([np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0])
CALIBRATIONS = {  # of two robots, as Universal Robots' own tests of ur_calibration have them: d, a, theta, alpha
    "a UR10": ("ur10",
        (0.00065609212979853, 1.4442162376284788, 0.854147723854608,
         -2.2989425877563705, -1.573498686836816e-05, 1.9072435590711256e-05),
        (4.6311376834935676e-05, -0.00012568315331862312, 0.00186216581161458,
         9.918593870679266e-05, 4.215462720453189e-06, 0),
        (-7.290070070824746e-05, -0.01713897289704999, -0.03707159413492756,
         0.054279462160583214, 1.488984257025741e-07, 1.551499479707493e-05),
        (0.000211987863869334, -0.0072553625957652995, -0.013483226769541364,
         0.0013495820227329425, -0.001263136163679901, 0)),
    "a UR10e with joints 300 m away": ("ur10e",
        (-0.000144894975118076141, 303.469135666158195, -309.88394307789747,
         6.41459904397394975, -4.48232900190081995e-05, -0.00087071402790364627),
        (0.000108651068627930392, 0.240324175250532346, 0.00180628180213493472,
         2.63076149165684402e-05, 3.96638632500012715e-06, 0),
        (1.59613525316931737e-07, -0.917209621528830232, 7.12936131346499469,
         0.0710299029424392298, -1.64258976526054923e-06, 9.17286101034808787e-08),
        (-0.000444781952841921679, -0.00160215112531214153, 0.00631917793331091861,
         -0.00165055247340828437, 0.000763682515545038854, 0)),
}  # fmt: skip


def ur(name: str, folder: Path) -> cf.Robot:
    """A robot of the library, its flange the marker."""
    (folder / f"{name}.toml").write_text(library_file(name), encoding="utf-8")
    robot = cf.Robot.from_toml(folder / f"{name}.toml")
    return replace(
        robot, markers={"flange": cf.Marker((0, 0, 0))}, tool_rotation=(0, 0, 0), base=cf.Base(), payloads={}
    )


def conf(deltas: tuple[tuple[float, ...], ...]) -> str:
    """The controller's file."""
    names = ("delta_d", "delta_a", "delta_theta", "delta_alpha")
    lines = [f"{name} = [ {', '.join(map(repr, row))}]" for name, row in zip(names, deltas, strict=True)]
    return "[mounting]\n" + "\n".join(lines) + "\ncalibration_status = 2 # 0 == notInitialized / 2 == Linearised\n"


def controller(name: str, deltas: tuple[tuple[float, ...], ...], q: np.ndarray) -> np.ndarray:
    """The flange (4, 4) by the controller's own figures: Rz(theta + q) Tz(d) Tx(a) Rx(alpha)."""
    d, a, theta, alpha = (np.array(row) for row in deltas)
    at = np.eye(4)
    for i in range(6):
        one = np.eye(4)
        turn = Rotation.from_euler("z", theta[i] + q[i])
        one[:3, :3] = (turn * Rotation.from_euler("x", ALPHA[i] + alpha[i])).as_matrix()
        one[:3, 3] = turn.apply([NOMINAL[name][1][i] + a[i], 0, NOMINAL[name][0][i] + d[i]])
        at = at @ one
    return at


def driver(text: str, q: np.ndarray) -> np.ndarray:
    """The flange (4, 4) by the URDF that the driver makes of its YAML: fixed x, y and z, then the joint about z."""
    figures, at = yaml.safe_load(text)["kinematics"], np.eye(4)
    for link, angle in zip(LINKS, q, strict=True):
        own, one = figures[link], np.eye(4)
        turn = Rotation.from_euler("xyz", [own["roll"], own["pitch"], own["yaw"]])
        one[:3, :3], one[:3, 3] = (turn * Rotation.from_euler("z", angle)).as_matrix(), [own["x"], own["y"], own["z"]]
        at = at @ one
    return at


def flange(robot: cf.Robot, q: np.ndarray) -> np.ndarray:
    """The flange (4, 4) here."""
    model, at = build(robot, ()), np.eye(4)
    row = np.r_[q, 1.0][:, None]
    at[:3, :3], at[:3, 3] = model.rotation(model.nominal, row)[0], model.point(model.nominal, row)[0]
    return at


POSES = np.random.default_rng(1).uniform(-3, 3, (20, 6))
NOTES = ("a note; of two halves", "another")


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_the_factory_calibration_is_the_controllers_robot(tmp_path, name):
    """Fails if a delta is added to another figure, or lost where the joints are brought back to the arm."""
    of, *deltas = CALIBRATIONS[name]
    (tmp_path / "calibration.conf").write_text(conf(tuple(deltas)))
    robot = with_factory_calibration(ur(of, tmp_path), tmp_path / "calibration.conf")
    for q in POSES:
        np.testing.assert_allclose(flange(robot, q), controller(of, tuple(deltas), q), atol=1e-10)
    figures = np.array([[joint.frame.figures[k] for k in ("d", "a")] for joint in robot.joints])
    assert np.abs(figures).max() < 0.7
    robot.to_toml(tmp_path / "again.toml")
    assert cf.Robot.from_toml(tmp_path / "again.toml").joints == robot.joints


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_what_the_driver_loads_is_the_same_robot(tmp_path, name):
    """Fails if the driver's URDF has the flange, or the tool's turn, elsewhere, the file reads back as another robot, or a note is
    broken where it has a semicolon.
    """
    of, *deltas = CALIBRATIONS[name]
    (tmp_path / "calibration.conf").write_text(conf(tuple(deltas)))
    robot = with_factory_calibration(ur(of, tmp_path), tmp_path / "calibration.conf")
    text = driver_yaml(rigid_chain(robot), [joint.frame.figures["d"] for joint in robot.joints], NOTES)
    assert text.splitlines()[:2] == [f"# {note}" for note in NOTES]
    for q in POSES:
        np.testing.assert_allclose(driver(text, q), flange(robot, q), atol=1e-12)
    (tmp_path / "my_robot.yaml").write_text(text)
    again = with_factory_calibration(ur(of, tmp_path), tmp_path / "my_robot.yaml")
    for q in POSES:
        np.testing.assert_allclose(flange(again, q), flange(robot, q), atol=1e-12)


def test_the_nominal_robot_is_as_the_description_package_has_it(tmp_path):
    """Fails if joints' frames are others than those to which the package's meshes belong."""
    robot = ur("ur10e", tmp_path)
    text = driver_yaml(rigid_chain(robot), [joint.frame.figures["d"] for joint in robot.joints], ())
    found = yaml.safe_load(text)["kinematics"]
    expected = {  # ur_description, config/ur10e/default_kinematics.yaml
        "shoulder": (0, 0, 0.1807), "upper_arm": (0, 0, 0), "forearm": (-0.6127, 0, 0), "wrist_1": (-0.57155, 0, 0.17415),
        "wrist_2": (0, -0.11985, 0), "wrist_3": (0, 0.11655, 0),
    }  # fmt: skip
    for link, place in expected.items():
        np.testing.assert_allclose([found[link][axis] for axis in "xyz"], place, atol=1e-10)


def test_a_new_study_begins_with_the_factory_figures(tmp_path, monkeypatch):
    """Fails if the command takes the nominal figures all the same."""
    monkeypatch.chdir(tmp_path)
    _, *deltas = CALIBRATIONS["a UR10"]
    Path("calibration.conf").write_text(conf(tuple(deltas)))
    assert in_process("new", "mine", "--robot", "ur10", "--factory", "calibration.conf").code == 0
    robot = cf.Robot.from_toml("mine/robot.toml")
    assert robot.joints[1].frame.figures["beta"] != 0
    assert "calibration.conf" in robot.notes
    assert "no such measurement file" in in_process("check", "mine").err


REFUSED = {
    "no number": ("delta_a = [0, 0, 0, 0, 0, x]\ndelta_theta = [0,0,0,0,0,0]", "calibration.conf:1: delta_a: expected six numbers"),
    "five": ("delta_theta = [0,0,0,0,0]", "calibration.conf:1: delta_theta: expected six numbers in brackets"),
    "lacking": ("delta_theta = [0,0,0,0,0,0]", "lacks delta_a"),
    "something else": ("hello: 1", "is neither a calibration.conf nor what ur_calibration writes"),
    "no yaml": ("{", "is neither a calibration.conf"),
    "tilted": ("kinematics:\n" + "".join(f"  {link}: {{x: 0, y: 0.1, z: 0, roll: 0.1, pitch: 0, yaw: 0}}\n" for link in LINKS),
               "first axis is not the base's z"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_factory_calibration_is_refused(tmp_path, monkeypatch, content, expected):
    """Fails if such a file ends in a traceback, or in a robot with the nominal figures."""
    monkeypatch.chdir(tmp_path)
    Path("calibration.conf").write_text(content)
    answer = in_process("new", "mine", "--robot", "ur5e", "--factory", "calibration.conf")
    assert answer.code == 2
    assert expected in answer.err
    assert not Path("mine").exists()


@pytest.mark.parametrize("robot", ["kuka-iiwa7", "abb-irb120", ""])
def test_other_robots_have_none(tmp_path, monkeypatch, robot):
    """Fails if deltas of a UR are added to another maker's figures."""
    monkeypatch.chdir(tmp_path)
    Path("calibration.conf").write_text(conf(CALIBRATIONS["a UR10"][1:]))
    answer = in_process("new", "mine", *(["--robot", robot] if robot else []), "--factory", "calibration.conf")
    assert answer.code == 2
    assert "Universal Robots" in answer.err


def test_a_calibrated_robot_is_what_the_driver_loads(tmp_path):
    """Fails if a calibrated figure is not in what is exported, or a robot that the driver cannot state is written all the same."""
    known = replace(ur("ur10e", tmp_path), markers={"tool": cf.Marker((0.02, 0.03, 0.1))}, tool_rotation=None)
    model = build(known, ("geometry",))
    off = 0.3 * model.prior_sd * np.random.default_rng(3).standard_normal(len(model.nominal))
    calibrated = calibration(model, model.nominal + off, 1e-12 * np.eye(len(off)), sigma=1e-5)
    found = export(calibrated, "ur-calibration", EXACT)
    assert any("hash" in note for note in found.notes)
    robot = export_robot(calibrated, tmp_path)
    base = placement_matrix((*robot.base.origin, *robot.base.rotation))
    for q in POSES:
        row = np.r_[q, 1.0][:, None]
        tool = np.r_[robot.markers["tool"].point, 1.0]
        np.testing.assert_allclose(
            (base @ driver(found.text, q) @ tool)[:3], model.point(calibrated.estimate, row)[0], atol=1e-9
        )
    turned = [replace(joint, sign=-1) if i == 2 else joint for i, joint in enumerate(known.joints)]
    other = build(replace(known, joints=tuple(turned)), ("geometry",))
    with pytest.raises(cf.InputError, match="six joints that turn about z, and count as the controller does"):
        export(calibration(other, other.nominal, 1e-12 * np.eye(len(off)), sigma=1e-5), "ur-calibration", EXACT)


def export_robot(calibrated: CalibratedModel, folder: Path) -> cf.Robot:
    """The calibrated robot, as its exported robot file has it."""
    (folder / "calibrated.toml").write_text(export(calibrated, "dh", EXACT).text, encoding="utf-8")
    return cf.Robot.from_toml(folder / "calibrated.toml")
