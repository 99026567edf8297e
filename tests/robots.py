"""Robots to test with, and their mechanics in plain numpy, written apart from calflow's graph."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from calflow.design.candidates import packed_conditions
from calflow.files.toml import Origin
from calflow.model import Model
from calflow.robot.formats.robot_file import parts_of
from calflow.robot.parts import Base
from calflow.robot.robot import Robot

HH800 = Path(__file__).parents[1] / "studies" / "hh800" / "robot.toml"
ASKEW = Base(origin=(0.5, -1.2, 0.3), rotation=np.deg2rad((3.0, -8.0, 40.0)))  # in the measuring frame


def hh800(**changed: Any) -> Robot:
    """The paper's robot, with some fields of its file replaced."""
    return replace(Robot.from_toml(HH800), **changed)


def hh800_with_bars(crank: float = 0.8, rod: float = 1.6, rocker: float = 0.8, assembly: str = "open") -> Robot:
    """The HH800 with other bar lengths [m] in its loop."""
    loop = hh800().loop
    bars = {
        "crank": replace(loop.crank, length=crank),
        "rod": replace(loop.rod, length=rod),
        "rocker": rocker,
        "assembly": assembly,
    }
    return hh800(loop=replace(loop, **bars))


def robot(convention: str, joints: list[dict[str, Any]], **rest: Any) -> Robot:
    """A robot from what its file would say."""
    rest = {"markers": {"E": {"point_m": [0.05, -0.03, 0.12]}}} | rest
    file = {"name": "test", "convention": convention, "joints": joints} | rest
    return Robot(**parts_of(file, Origin(Path(), (), {})))


def ur10(**rest: Any) -> Robot:
    """A UR10 in standard DH with its usual masses and a 10 kg load."""
    columns = {
        "alpha_deg": (90, 0, 0, 90, -90, 0),
        "a_m": (0, -0.612, -0.5723, 0, 0, 0),
        "d_m": (0.1273, 0, 0, 0.163941, 0.1157, 0.0922),
        "mass_kg": (7.778, 12.93, 3.87, 1.96, 1.96, 0.202),
        "com_m": (
            (0.021, 0, 0.027),
            (0.38, 0, 0.158),
            (0.24, 0, 0.068),
            (0, 0.007, 0.018),
            (0, 0.007, 0.018),
            (0, 0, -0.026),
        ),
    }
    load = {"load": {"mass_kg": 10.0, "com_m": [0.02, -0.05, 0.08]}}
    return robot("dh", _joints(columns), **({"payloads": load} | rest))


def industrial(**rest: Any) -> Robot:
    """A serial 6R robot of the 210 kg class in modified DH, with its load."""
    columns = {
        "alpha_deg": (0, -90, 0, -90, 90, -90),
        "a_m": (0, 0.312, 1.075, 0.225, 0, 0),
        "d_m": (0.67, 0, 0, 1.28, 0, 0.215),
        "theta_deg": (0, -90, 0, 0, 0, 180),
        "mass_kg": (420, 260, 230, 85, 45, 12),
        "com_m": (
            (0.1, -0.02, -0.2),
            (0.5, 0.01, 0.1),
            (0.1, -0.05, 0.03),
            (0.01, 0.02, -0.4),
            (0, -0.03, 0.01),
            (0, 0.002, -0.03),
        ),
    }
    load = {"load": {"mass_kg": 210.0, "com_m": [0.09, -0.05, 0.2]}}
    return robot("modified-dh", _joints(columns), **({"payloads": load} | rest))


def palletiser() -> Robot:
    """A robot with a loop in standard DH, its bars no parallelogram."""
    columns = {
        "alpha_deg": (90, 0, 90, -90, 90, 0),
        "a_m": (0.3, 1.25, 0.2, 0, 0, 0),
        "d_m": (0.8, 0, 0, 1.3, 0, 0.2),
        "theta_deg": (0, 5, -3, 0, 0, 0),
        "limits_deg": ((-180, 180), (40, 140), (115, 225), (-180, 180), (-110, 110), (-180, 180)),
        "mass_kg": (400, 200, 180, 70, 40, 10),
        "com_m": (
            (-0.1, 0.02, 0.03),
            (-0.6, 0.02, 0.1),
            (-0.1, 0.1, 0.04),
            (0.0, 0.4, 0.02),
            (0, 0, 0.03),
            (0, 0.01, -0.02),
        ),
    }
    loop = {
        "joint": 3,
        "crank": {"length_m": 0.5, "mass_kg": 30, "com_m": [0.2, 0.01, 0.05]},
        "rod": {"length_m": 1.2, "mass_kg": 25, "com_m": [0.6, -0.02, 0.1]},
        "rocker_m": 0.55,
        "offset_deg": -80,
    }
    load = {"load": {"mass_kg": 180.0, "com_m": [0.05, 0.1, 0.25]}}
    return robot("dh", _joints(columns), loop=loop, payloads=load)


def _joints(columns: dict[str, tuple[Any, ...]]) -> list[dict[str, Any]]:
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def poses(of: Robot, number: int, seed: int = 1) -> np.ndarray:
    """Random driven joint angles (number, n_joints) within limits, a loop well off its dead points."""
    drawn = np.random.default_rng(seed).uniform(*of.limits.T, (40 * number, of.n_joints))
    if of.loop:
        drawn = drawn[np.sin(drawn[:, 2] - drawn[:, 1]) > 0.3]
    return drawn[:number]


def rows(model: Model, q: np.ndarray, payload: str = "", marker: str = "E") -> np.ndarray:
    """Packed conditions of joint readings q (n_rows, n_joints); given optional conditions stay zero."""
    return packed_conditions(model, q, payload, marker)


def pinocchio_model(of: Robot, payload: str) -> pin.Model:
    """The same robot in pinocchio, with frames `flange` and `E`; its inertia tensors are arbitrary."""

    def inertia(mass: float, com: tuple[float, ...]) -> pin.Inertia:
        return pin.Inertia(mass, np.array(com), 0.1 * np.eye(3))

    def se3(rotation: np.ndarray, *vector: float) -> pin.SE3:
        return pin.SE3(rotation, np.array(vector))

    model = pin.Model()
    model.gravity.linear = np.array(of.gravity)
    parent, to_next = 0, pin.SE3.Identity()
    for joint in of.joints:
        figs = joint.frame.figures
        aside = se3(pin.rpy.rpyToMatrix(figs["alpha"], 0, 0), figs["a"], 0, 0)
        turn = se3(pin.rpy.rpyToMatrix(0, 0, figs["theta"]), 0, 0, figs["d"])
        before = to_next * aside * turn if of.kinematics == "modified-dh" else to_next * turn
        to_next = pin.SE3.Identity() if of.kinematics == "modified-dh" else aside
        parent = model.addJoint(parent, pin.JointModelRZ(), before, f"joint{parent + 1}")
        model.appendBodyToJoint(parent, inertia(joint.mass, joint.com), to_next)
    load = of.payloads[payload]
    model.appendBodyToJoint(parent, inertia(load.mass, load.com), to_next)
    tool = to_next * se3(np.eye(3), *of.markers["E"].point)
    for name, placement in (("flange", to_next), ("E", tool)):
        model.addFrame(pin.Frame(name, parent, placement, pin.FrameType.OP_FRAME))
    return model


# --- The same mechanics in numpy ---------------------------------------------------------------------


class Frames(NamedTuple):
    """Frames (..., 4, 4): of each joint after its turn, each link, each link's far end, crank and rod."""

    joints: list[np.ndarray]
    links: list[np.ndarray]
    ends: list[np.ndarray]
    bars: list[np.ndarray]


def figures(of: Robot) -> dict[str, np.ndarray]:
    """Every length and angle that the robot's file states; `base` is an error of the stated base."""
    lengths = [of.loop.crank.length, of.loop.rod.length, of.loop.rocker] if of.loop else []
    table = {
        name: np.array([j.frame.figures[name] for j in of.joints]) for name in ("alpha", "a", "d", "theta", "beta")
    }
    return table | {
        "base": np.zeros(6),
        "bars": np.array(lengths),
        "tool": np.zeros(3),
        "markers": np.array([marker.point for marker in of.markers.values()]).T,
    }


def turned(axis: int, angle: Any) -> np.ndarray:
    """Rotation (..., 4, 4) about one axis."""
    angle = np.asarray(angle, dtype=float)
    matrix = np.zeros((*angle.shape, 4, 4)) + np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[..., i, i] = matrix[..., j, j] = np.cos(angle)
    matrix[..., j, i] = np.sin(angle)
    matrix[..., i, j] = -np.sin(angle)
    return matrix


def shifted(x: Any, y: Any, z: Any) -> np.ndarray:
    """Translation (..., 4, 4)."""
    vector = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    matrix = np.zeros((*vector.shape[:-1], 4, 4)) + np.eye(4)
    matrix[..., :3, 3] = vector
    return matrix


def placed(twist: np.ndarray) -> np.ndarray:
    """Translation, then turns about the moving x, y and z axes (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("XYZ", twist[3:]).as_matrix()
    matrix[:3, 3] = twist[:3]
    return matrix


def moved(frame: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Points (..., 3) given in a frame."""
    return frame[..., :3, :3] @ np.asarray(point) + frame[..., :3, 3]


def closed_loop(
    link: float, crank: float, rod: float, rocker: float, link_angle: Any, crank_angle: Any, assembly: str = "open"
) -> tuple[np.ndarray, np.ndarray]:
    """Directions of rocker and rod: R is where circles about Q and S meet, on P's side if crossed."""
    q, s = crank * np.exp(1j * np.asarray(crank_angle)), link * np.exp(1j * np.asarray(link_angle))
    distance = np.abs(s - q)
    along = (s - q) / distance
    foot = (rod**2 - rocker**2 + distance**2) / (2 * distance)
    with np.errstate(invalid="ignore"):
        height = np.sqrt(rod**2 - foot**2)
    side_of_p = np.sign(np.imag((0 - q) / along))
    r = q + along * (foot + 1j * height * side_of_p * (-1 if assembly == "open" else 1))
    return np.angle(r - s), np.angle(r - q)


def frames(
    of: Robot,
    q: np.ndarray,
    figs: dict[str, np.ndarray] | None = None,
    bearing: np.ndarray | None = None,
    link: np.ndarray | None = None,
) -> Frames:
    """All frames at driven joint angles q (..., n); bearing and link are motions as in `Deflection`."""
    figs = figs or figures(of)
    n, bars = of.n_joints, []
    bearing = np.zeros((6, n)) if bearing is None else bearing
    link = np.zeros((6, n + 1)) if link is None else link
    angle = [q[..., i] for i in range(n)]
    k = of.loop.joint - 1 if of.loop else n
    at = ground = placed(link[:, 0])
    result = Frames([], [], [at], bars)
    for i, joint in enumerate(of.joints):
        alpha, a, d, theta, beta = (figs[name][i] for name in ("alpha", "a", "d", "theta", "beta"))
        if i == k:
            angle[k], bars[:] = _driven_by_loop(of, figs, ground, at, q[..., k])
        theta, d = (theta + angle[i], d) if joint.kind == "revolute" else (theta, d + angle[i])
        if of.kinematics == "modified-dh":  # a link's far end is at the next joint, the base's where the base is
            at = at @ turned(0, alpha) @ shifted(0 if i else a, 0, 0) @ turned(1, beta)
        if i == k - 1:
            ground = at
        at = at @ turned(2, theta) @ placed(bearing[:, i])
        result.joints.append(at)
        at = at @ shifted(0, 0, d)
        if of.kinematics == "dh":
            at = at @ shifted(a, 0, 0) @ turned(0, alpha) @ turned(1, beta)
        result.links.append(at)
        if of.kinematics == "modified-dh" and i + 1 < n:
            at = at @ shifted(figs["a"][i + 1], 0, 0)
        at = at @ placed(link[:, i + 1])
        result.ends.append(at)
    return result


def _driven_by_loop(
    of: Robot, figs: dict[str, np.ndarray], ground: np.ndarray, end: np.ndarray, crank_angle: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Angle of the driven joint on the deflected end of the arm PS, and the frames of crank and rod.

    P and the crank stand on the ground, before the arm's joint. S is where the arm's end is in the ground's plane, and the
    rocker points to where the loop closes there, whatever way the arm's end points.
    """
    k = of.loop.joint - 1
    arm = np.linalg.inv(ground) @ end
    if of.kinematics == "dh":
        arm = arm @ turned(1, -figs["beta"][k - 1]) @ turned(0, -figs["alpha"][k - 1])
    s, along = (arm[..., 0, column] + 1j * arm[..., 1, column] for column in (3, 0))
    crank, rod, rocker = figs["bars"]
    to_r, rod_direction = closed_loop(np.abs(s), crank, rod, rocker, np.angle(s), crank_angle, of.loop.assembly)
    at_p = ground @ turned(2, crank_angle)
    at_q = at_p @ shifted(crank, 0, 0) @ turned(2, rod_direction - crank_angle)
    return to_r - np.angle(along) + of.loop.offset, [at_p, at_q]


def base_frame(of: Robot, figs: dict[str, np.ndarray] | None = None) -> np.ndarray:
    """The robot's base in the measuring frame."""
    return placed(np.array([*of.base.origin, *of.base.rotation])) @ placed((figs or figures(of))["base"])


def marker_position(of: Robot, q: np.ndarray, figs: dict[str, np.ndarray] | None = None, marker: int = 0) -> np.ndarray:
    """A marker's position (..., 3) in the measuring frame."""
    figs = figs or figures(of)
    return moved(base_frame(of, figs) @ frames(of, q, figs).ends[-1], figs["markers"][:, marker])


def tool_rotation(of: Robot, q: np.ndarray, figs: dict[str, np.ndarray] | None = None) -> np.ndarray:
    """The tool's rotation (..., 3, 3) in the measuring frame."""
    figs = figs or figures(of)
    stated = placed(np.array([0.0, 0.0, 0.0, *(of.tool_rotation or (0.0, 0.0, 0.0))]))
    tool = stated @ placed(np.concatenate([np.zeros(3), figs["tool"]]))
    return (base_frame(of, figs) @ frames(of, q, figs).ends[-1] @ tool)[..., :3, :3]


def masses(of: Robot, at: Frames, payload: str = "") -> list[tuple[float, np.ndarray, int]]:
    """Mass, place of its centre, and index of the link that carries it (-1 for the loop's bars)."""
    carried = [(j.mass, moved(frame, j.com), i) for i, (j, frame) in enumerate(zip(of.joints, at.links, strict=True))]
    if of.loop:
        for bar, frame in zip((of.loop.crank, of.loop.rod), at.bars, strict=True):
            carried.append((bar.mass, moved(frame, bar.com), -1))
    if payload:
        load = of.payloads[payload]
        carried.append((load.mass, moved(at.ends[-1], load.com), of.n_joints))
    return carried


def energy(of: Robot, q: np.ndarray, payload: str = "", **motion: np.ndarray) -> np.ndarray:
    """Potential energy [J] in gravity, bearings and links moved as in `frames`."""
    carried = masses(of, frames(of, q, **motion), payload)
    return -sum(mass * centre @ np.array(of.gravity) for mass, centre, _ in carried)


def holding_torque(of: Robot, q: np.ndarray, payload: str = "", step: float = 1e-5) -> np.ndarray:
    """What the motors hold against gravity (..., n): the energy's central differences."""
    steps = step * np.eye(of.n_joints)
    return np.stack([(energy(of, q + h, payload) - energy(of, q - h, payload)) / (2 * step) for h in steps], axis=-1)
