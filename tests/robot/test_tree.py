"""Trees: joints that name what they are on, against pinocchio, and what stays as simple as in a chain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import calflow as cf
import robots
from calflow.effects.geometry import Geometry
from calflow.files.problems import InputError
from calflow.model import build
from calflow.robot.frames import LISTED, placement
from calflow.robot.mechanism import Deflection, gravity_torque, nominal_dimensions, pose, symbols_like
from calflow.robot.parts import Marker, Payload
from calflow.robot.robot import Robot
from calflow.simulation import simulate
from calflow.templates import write_study
from robot.formats import urdfs

TIPS = ["left_tip", "right_tip", "eye"]
TORSO = """
name = "two arms"
convention = "dh"
[markers.left]
point_mm = [10, 20, 30]
on = "left hand"
[markers.right]
point_mm = [0, 0, 50]
[payloads.pan]
mass_kg = 2
com_mm = [0, 0, 40]
on = "left hand"
[[joints]]
link = "torso"
d_mm = 500
alpha_deg = 90
mass_kg = 20
[[joints]]
a_mm = 300
mass_kg = 3
com_mm = [-100, 0, 0]
[[joints]]
link = "left hand"
a_mm = 200
mass_kg = 2
[[joints]]
parent = "torso"
origin_mm = [0, -100, 250]
rotation_deg = [0, 90, 30]
alpha_deg = -90
d_mm = 80
mass_kg = 4
[[joints]]
a_mm = 350
mass_kg = 1
"""


def arms(seed: int, folder: Path, tips: list[str] = TIPS) -> tuple[Robot, urdfs.Reference]:
    """A robot of several arms, and what pinocchio makes of it."""
    path = folder / "arms.urdf"
    path.write_text(urdfs.arms(seed))
    robot = Robot.from_urdf(path, tip=tips)
    return robot, urdfs.Reference(path, [joint.name for joint in robot.joints])


def frames(robot: Robot) -> ca.Function:
    """The frame (4, 4) of every link, by joint variables."""
    q = ca.SX.sym("q", robot.n_joints)
    at = pose(robot, nominal_dimensions(robot), q, Deflection.zero(robot.n_joints))
    return ca.Function("frames", [q], [at.frame(robot, link) for link in range(robot.n_joints + 1)])


def torso(folder: Path, text: str = TORSO) -> Robot:
    """The robot above, from its file."""
    (folder / "robot.toml").write_text(text)
    return Robot.from_toml(folder / "robot.toml")


@pytest.mark.parametrize("seed", range(9))
def test_every_link_stands_and_weighs_as_in_pinocchio(seed: int, tmp_path: Path) -> None:
    """Fails if a branch begins in the wrong frame, or gravity on a joint is not that of what is beyond it and what follows it."""
    robot, reference = arms(seed, tmp_path)
    at, torque = frames(robot), gravity_torque(robot)
    follower = next(i for i, joint in enumerate(robot.joints) if not joint.driven)
    for q in np.random.default_rng(seed).uniform(-2, 2, (4, robot.n_joints)):
        q[follower] = -0.7 * q[follower - 4]
        for name, frame in zip(robot.links[1:], at(q)[1:], strict=True):
            assert_allclose(np.array(frame), reference.frame(q, name), atol=1e-12)
        expected = reference.torque(q)
        expected[follower - 4] -= 0.7 * expected[follower]
        assert_allclose(np.array(torque(q, np.zeros(0))).ravel(), expected, atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_markers_are_seen_on_their_links(seed: int, tmp_path: Path) -> None:
    """Fails if a marker goes with the last link whatever it names, or what follows on another branch stays where it is."""
    robot, reference = arms(seed, tmp_path)
    places = {"left_tip": (0.1, 0.0, 0.2), "eye": (0.0, 0.3, 0.0), "torso": (0.2, -0.1, 0.0), "right_tip": (0, 0, 0.1)}
    robot = replace(robot, markers={f"on {on}": Marker(point, on=on) for on, point in places.items()})
    model = build(robot, [])
    readings = np.random.default_rng(seed).uniform(-1, 1, (5, robot.n_joints)) * [
        joint.driven for joint in robot.joints
    ]
    q = readings @ robot.reading_matrix.T
    for on, point in places.items():
        seen = model.position(model.nominal, robots.rows(model, readings, marker=f"on {on}"))
        expected = [(reference.frame(one, on) @ [*point, 1])[:3] for one in q]
        assert_allclose(seen, expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_parameters_span_all_errors_of_a_tree_and_none_is_there_twice(seed: int, tmp_path: Path) -> None:
    """Fails if an error of a branch's place is nobody's parameter, or a torso's zero is there for each arm again."""
    robot, _ = arms(seed, tmp_path)
    dims, q = symbols_like(nominal_dimensions(robot)), ca.SX.sym("q", robot.n_joints)
    at = pose(robot, dims, q, Deflection.zero(robot.n_joints))
    seen = [ca.vec((placement(dims.base) @ at.frame(robot, robot.link(tip)))[:3, :]) for tip in TIPS]
    moved = ca.jacobian(ca.vertcat(*seen), ca.vertcat(dims.base, dims.steps))
    slopes = ca.Function("slopes", [*vars(dims).values(), q], [ca.densify(moved)])
    nominal = [ca.DM(ca.evalf(one)) for one in vars(nominal_dimensions(robot)).values()]
    every = np.vstack(
        [np.array(slopes(*nominal, one)) for one in np.random.default_rng(4).uniform(-2, 2, (60, robot.n_joints))]
    )
    origins = [6 + k for k, step in enumerate(robot.steps) if step.symbol in LISTED]
    free = every[:, [*range(6), *(6 + error.index for error in Geometry(robot).errors if error.field == "steps")]]
    sizes = np.linalg.svd(free, compute_uv=False)
    assert sizes[-1] > 1e-4 * sizes[0]
    assert np.linalg.matrix_rank(every[:, [*range(6), *origins]], tol=1e-7 * sizes[0]) == free.shape[1]


def test_a_tree_by_dh_figures_equals_pinocchio(tmp_path: Path) -> None:
    """Fails if an arm's origin on its link, or the frame that a payload and a marker name, is taken otherwise than stated."""
    robot = torso(tmp_path)
    model = pin.Model()
    model.gravity.linear = np.array(robot.gravity)
    ends = {0: pin.SE3.Identity()}
    for i, (joint, parent) in enumerate(zip(robot.joints, (0, 1, 2, 1, 4), strict=True), start=1):
        figures = joint.frame.figures
        stands = pin.SE3.Identity()
        if i == 4:
            turn = pin.utils.rotate("x", 0) @ pin.utils.rotate("y", np.pi / 2) @ pin.utils.rotate("z", np.pi / 6)
            stands = pin.SE3(turn, np.array([0, -0.1, 0.25]))
        model.addJoint(parent, pin.JointModelRZ(), ends[parent] * stands, f"joint{i}")
        along = pin.SE3(np.eye(3), np.array([0, 0, figures["d"]]))
        ends[i] = along * pin.SE3(pin.utils.rotate("x", figures["alpha"]), np.array([figures["a"], 0, 0]))
        model.appendBodyToJoint(i, pin.Inertia(joint.mass, np.array(joint.com), 0.1 * np.eye(3)), ends[i])
    model.appendBodyToJoint(3, pin.Inertia(2.0, np.array([0, 0, 0.04]), np.eye(3)), ends[3])
    data, at, torque = model.createData(), frames(robot), gravity_torque(robot)
    for q in np.random.default_rng(1).uniform(-2, 2, (5, 5)):
        pin.forwardKinematics(model, data, q)
        for i in range(1, 6):
            assert_allclose(np.array(at(q)[i]), (data.oMi[i] * ends[i]).homogeneous, atol=1e-12)
        assert_allclose(np.array(torque(q, [1.0])).ravel(), pin.computeGeneralizedGravity(model, data, q), atol=1e-10)


def test_an_arm_beside_another_has_errors_of_its_place(tmp_path: Path) -> None:
    """Fails if the place of the second arm on its link is no parameter, or its first joint's zero is there beside that."""
    names = {error.parameter.name for error in Geometry(torso(tmp_path)).errors}
    assert {f"joint4.{symbol}" for symbol in ("x", "y", "z", "rx", "ry", "rz", "a", "alpha")} <= names
    assert {"joint4.theta", "joint4.d"}.isdisjoint(names)
    meanings = {error.parameter.name: error.parameter.meaning for error in Geometry(torso(tmp_path)).errors}
    assert meanings["joint4.x"] == "place of joint 4 along x of link 1"


def test_a_tree_is_written_and_read_back(tmp_path: Path) -> None:
    """Fails if a file loses what a joint is on, where it stands, or what a marker or a payload is on."""
    for robot in (torso(tmp_path), arms(1, tmp_path)[0]):
        robot.to_toml(tmp_path / "again.toml")
        assert Robot.from_toml(tmp_path / "again.toml") == robot


def test_a_tree_in_python_says_what_is_on_what() -> None:
    """Fails if an arm on the base is not one, or a notebook does not show it."""
    arm = cf.modified_dh(a=0.3)
    robot = cf.Robot(
        joints=[
            cf.Joint(arm),
            cf.Joint(arm, link="left"),
            cf.Joint(cf.at_origin(arm, (0, 1, 0)), parent="base"),
            cf.Joint(arm),
        ],
        markers={"a": cf.Marker((0, 0, 0), on="left"), "b": cf.Marker((0, 0, 0))},
        payloads={"box": Payload(1.0, on="left")},
    )
    assert robot.parents == (0, 1, 0, 3)
    assert robot.tips == [2, 4]
    assert robot.places == ("first", "last", "first", "last")
    assert "3 on base" in repr(robot)
    assert "on left" in repr(robot)


def test_two_tips_of_one_link_are_markers_on_it(tmp_path: Path) -> None:
    """Fails if one of two frames that are fixed to the same link is taken for the flange, and the other is lost."""
    path = tmp_path / "fork.urdf"
    path.write_text(urdfs.arms(0).replace("</robot>", '<link name="probe"/><joint name="to_probe" type="fixed">'
                    '<parent link="left_link4"/><child link="probe"/><origin xyz="0.1 0.2 0.3"/></joint></robot>'))  # fmt: skip
    robot = Robot.from_urdf(path, tip=["left_tip", "probe", "right_tip"])
    assert robot.markers["probe"] == Marker((0.1, 0.2, 0.3), on="left_link4")
    assert robot.markers["left_tip"].on == "left_link4"
    assert "left_link4" in robot.links
    assert robot.markers["right_tip"] == Marker((0.0, 0.0, 0.0))


@pytest.mark.parametrize(("was", "becomes", "said"), [
    ('parent = "torso"', 'parent = "torzo"', "there is no link 'torzo', did you mean 'torso'?"),
    ('parent = "torso"', 'parent = "link5"', "there is no link 'link5' before joint 4"),
    ("a_mm = 300", 'a_mm = 300\nlink = "torso"', "several links are called 'torso'"),
    ('on = "left hand"\n[markers.right]', 'on = "left"\n[markers.right]', "there is no link 'left'"),
    ('on = "left hand"\n[[joints]]', 'on = "hand"\n[[joints]]', "there is no link 'hand'"),
    ('link = "left hand"\na_mm = 200', 'link = "left hand"\na_mm = 200\norigin_mm = [0, 0, 1]', "goes on from the joint before"),
    ("[markers.right]", '[markers.right]\nrelative_sd_mm = 0.1', "is on the first one's link"),
])  # fmt: skip
def test_what_keeps_it_from_being_a_tree_is_told_with_its_line(
    was: str, becomes: str, said: str, tmp_path: Path
) -> None:
    """Fails if a robot with a link that is not there is accepted, or told without the place in the file."""
    with pytest.raises(InputError) as refused:
        torso(tmp_path, TORSO.replace(was, becomes, 1))
    assert said in str(refused.value)
    assert refused.value.problems[0].line


def test_a_new_study_of_several_tips_can_be_tried(tmp_path):
    """Fails if what is simulated names a marker or a link that such a robot does not have."""
    (tmp_path / "arms.urdf").write_text(urdfs.arms(2))
    write_study(tmp_path / "arms", str(tmp_path / "arms.urdf"), TIPS)
    robot = Robot.from_toml(tmp_path / "arms" / "robot.toml")
    assert {name: marker.on for name, marker in robot.markers.items()} == {tip: tip for tip in TIPS}
    assert set(simulate(tmp_path / "arms" / "truth.toml")["marker"]) == {*TIPS}
