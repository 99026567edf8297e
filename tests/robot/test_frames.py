"""Frames: what the two conventions make of their figures, and which errors of them are parameters of their own."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow.effects.geometry import Geometry
from calflow.model import build
from calflow.robot.frames import CONVENTIONS, Frame, Step, convention_of, dh, modified_dh
from calflow.robot.mechanism import Deflection, assembly_side, nominal_dimensions, pose, reachable, span
from calflow.robot.parts import Bar, FourBar, Joint, Marker
from calflow.robot.robot import Robot

QUARTER = np.pi / 2
FIGURES = [
    {"alpha": 0.3, "a": 0.1, "d": 0.7, "theta": 0.2, "beta": 0.0},
    {"alpha": -1.5, "a": 0.9, "d": -0.2, "theta": -0.4, "beta": 0.05},
    {"alpha": 0.02, "a": -0.8, "d": 0.1, "theta": 1.1, "beta": -0.03},
    {"alpha": 1.6, "a": 0.0, "d": 0.4, "theta": 0.0, "beta": 0.0},
]


def turn(axis: str, angle: float) -> np.ndarray:
    """A turn about one axis, written out."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array({
        "x": [[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]],
        "y": [[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]],
        "z": [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    }[axis])  # fmt: skip


def shift(x: float, y: float, z: float) -> np.ndarray:
    """A translation, written out."""
    return np.array([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def flange(convention: str, kinds: list[str], q: np.ndarray) -> np.ndarray:
    """The flange by the product that the convention's name stands for."""
    at = np.eye(4)
    for f, kind, angle in zip(FIGURES, kinds, q, strict=True):
        theta, d = (f["theta"] + angle, f["d"]) if kind == "revolute" else (f["theta"], f["d"] + angle)
        screw = turn("z", theta) @ shift(0, 0, d)
        aside = turn("x", f["alpha"]) @ shift(f["a"], 0, 0) @ turn("y", f["beta"])
        at = at @ (screw @ aside if convention == "dh" else aside @ screw)
    return at


def chain(convention: str, kinds: list[str]) -> Robot:
    """The robot of these figures."""
    frames = [CONVENTIONS[convention](**figures) for figures in FIGURES]
    joints = [Joint(frame, kind=kind, limits=(-0.5, 0.5)) for frame, kind in zip(frames, kinds, strict=True)]
    return Robot(joints, markers={"tool": Marker((0, 0, 0))})


@pytest.mark.parametrize("kinds", [["revolute"] * 4, ["prismatic", "revolute", "prismatic", "revolute"]])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_chain_of_frames_is_the_conventions_product(convention, kinds):
    """Fails if a convention's order, a sign, or the step that a joint's variable belongs to is wrong."""
    robot, q = chain(convention, kinds), ca.SX.sym("q", 4)
    at = pose(robot, nominal_dimensions(robot), q, Deflection.zero(4)).flange
    function = ca.Function("flange", [q], [at])
    for values in np.random.default_rng(1).uniform(-1, 1, (5, 4)):
        assert_allclose(np.array(function(values)), flange(convention, kinds, values), atol=1e-14)


def listed(robot: Robot) -> list[str]:
    """The frames' parameters as geometry lists them."""
    return [p.name for p in Geometry(robot).parameters() if p.part.startswith("joint")]


MODIFIED = {
    "skew": ["joint2.alpha", "joint2.a", "joint2.d", "joint2.theta", "joint3.alpha", "joint3.a", "joint3.d", "joint3.theta"],
    "parallel": ["joint2.alpha", "joint2.a", "joint2.beta", "joint2.theta",
                 "joint3.alpha", "joint3.a", "joint3.beta", "joint3.theta"],
}  # fmt: skip
DH = {
    "skew": ["joint1.a", "joint1.alpha", "joint2.theta", "joint2.d", "joint2.a", "joint2.alpha", "joint3.theta", "joint3.d"],
    "parallel": ["joint1.beta", "joint1.a", "joint1.alpha", "joint2.theta", "joint2.beta", "joint2.a", "joint2.alpha",
                 "joint3.theta", "joint3.d"],
}  # fmt: skip


@pytest.mark.parametrize(("make", "expected"), [(modified_dh, MODIFIED), (dh, DH)], ids=["modified-dh", "dh"])
@pytest.mark.parametrize(("name", "alpha"), [("skew", QUARTER), ("parallel", 0.05), ("parallel", np.pi - 0.05)])
def test_which_errors_are_free(make, expected, name, alpha):
    """Fails if a figure that the base, the tool or a parallel axis has already is a parameter too, or one is forgotten."""
    joint = Joint(make(alpha=alpha, a=0.3, d=0.1))
    assert listed(Robot([joint] * 3, markers={"tool": Marker((0, 0, 0.1))})) == expected[name]
    assert listed(Robot([joint], markers={"tool": Marker((0, 0, 0.1))})) == []


def test_the_last_prismatic_joint_and_units():
    """Fails if a slide's length is called an angle, or its turn a length."""
    slide = Joint(modified_dh(alpha=QUARTER), kind="prismatic", limits=(0, 1))
    robot = Robot([Joint(modified_dh()), slide], markers={"tool": Marker((0, 0, 0.1))})
    units = {p.symbol: p.unit for p in Geometry(robot).parameters() if p.part == "joint2"}
    assert units == {"alpha": "rad", "a": "m", "d": "m", "theta": "rad"}


def test_frames_of_ones_own():
    """Fails if a chain takes frames of the two conventions only, or a free step of another is no parameter."""
    everywhere = ("first", "middle", "last", "alone")
    mount = tuple(
        Step(motion, symbol, value, everywhere)
        for motion, symbol, value in (("tx", "x", 0.1), ("ty", "y", -0.2), ("tz", "z", 0.3), ("rx", "roll", 0.4),
                                      ("ry", "pitch", -0.5), ("rz", "yaw", 0.6))
    )  # fmt: skip
    frame = Frame(turn=Step("rz", "zero"), mount=mount)
    robot = Robot([Joint(frame), Joint(frame)], markers={"tool": Marker((0, 0, 0))})
    assert convention_of(robot.frames) is None
    assert listed(robot)[:6] == ["joint1.x", "joint1.y", "joint1.z", "joint1.roll", "joint1.pitch", "joint1.yaw"]
    model = build(robot, ["geometry"])
    fixed = shift(0.1, -0.2, 0.3) @ turn("x", 0.4) @ turn("y", -0.5) @ turn("z", 0.6)
    q = np.array([0.7, -0.3])
    rows = np.concatenate([q, [1.0]])[:, None]
    wanted = fixed @ turn("z", q[0]) @ fixed @ turn("z", q[1])
    assert_allclose(model.position(np.zeros(len(model.parameters)), rows)[0], wanted[:3, 3], atol=1e-15)
    longer = np.array([0.01 * (p.name == "joint2.y") for p in model.parameters])
    moved = fixed @ turn("z", q[0]) @ shift(0, 0.01, 0) @ fixed @ turn("z", q[1])
    assert_allclose(model.position(longer, rows)[0], moved[:3, 3], atol=1e-15)


def test_a_links_end_is_where_the_next_joint_is():
    """Fails if a modified-DH link ends at its own axis, or a DH link's end is not in the next joint's axes."""
    for make, end in ((modified_dh, shift(0.6, 0, 0.1)), (dh, shift(0.5, 0, 0.1) @ turn("x", 0.3))):
        robot = Robot([Joint(make(a=0.5, d=0.1, alpha=0.3)), Joint(make(a=0.6))], markers={"tool": Marker((0, 0, 0))})
        assert_allclose(np.array(ca.DM(ca.evalf(span(robot, nominal_dimensions(robot), 0)))), end, atol=1e-15)


def test_a_loop_stands_on_its_side_whatever_way_the_arm_is_stated():
    """Fails if an arm that is stated as a negative length along x puts the loop on its other side, or out of reach."""
    loop = FourBar(2, Bar(0.5), Bar(1.2), 0.55)
    sides = []
    for length, zero in ((1.25, 0.0), (-1.25, np.pi)):
        arm = Joint(dh(a=length, theta=zero), limits=(0.7, 2.4))
        driven = Joint(dh(a=0.2), limits=(2.0, 3.9))
        robot = Robot([arm, driven], loop=loop, markers={"tool": Marker((0, 0, 0))})
        q = np.random.default_rng(2).uniform(*robot.limits.T, (200, 2))
        sides.append((assembly_side(robot), reachable(robot, q)))
    assert sides[0][0] == sides[1][0]
    assert (sides[0][1] == sides[1][1]).all()
    assert 0 < sides[0][1].sum() < 200
