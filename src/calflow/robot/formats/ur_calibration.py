"""Universal Robots' factory calibration: `calibration.conf` of the controller, and the YAML that the ROS driver loads.

The controller adds its deltas to the nominal figures of Denavit and Hartenberg (1955). Axes 2, 3 and 4 are nearly parallel, so
these put joints hundreds of metres away; here they are where the arm is, with Hayati's (1983) angle in the place of the distance.
The YAML has each joint's origin in the one before, its turn as URDF states it: about fixed x, y and z.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calflow.files.problems import Problem, refuse, refuse_any
from calflow.files.toml import read_text
from calflow.robot.formats.rigid_chain import RigidChain, transform_of
from calflow.robot.frames import Frame, Step, dh, follows, rpy_of
from calflow.robot.robot import Robot

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
DELTAS = {"delta_theta": "theta", "delta_a": "a", "delta_d": "d", "delta_alpha": "alpha"}
PLACE = ("x", "y", "z", "roll", "pitch", "yaw")
NEARLY = 1e-6  # m and rad by which a joint may be beside what a figure says
UNKNOWN_HASH = "calib_unknown"


def with_factory_calibration(robot: Robot, path: Path) -> Robot:
    """Return a nominal robot with the figures of its factory calibration, a `calibration.conf` or the driver's YAML.

    Raises:
        InputError: the file is neither, or the robot is none of theirs.
    """
    frames = [joint.frame for joint in robot.joints]
    if (
        robot.n_joints != 6
        or not all(follows(frame, "dh") for frame in frames)
        or any(abs(frame.figures["alpha"] - alpha) > 0.1 for frame, alpha in zip(frames, ALPHA, strict=True))
    ):
        raise refuse(f"is of a robot of Universal Robots: robot '{robot.name}' has other axes", path)
    text = read_text(path)
    origins = _of_deltas(frames, _deltas(text, path)) if "delta_theta" in text else _of_yaml(text, path)
    joints = [
        replace(joint, frame=frame) for joint, frame in zip(robot.joints, _near(origins, frames, path), strict=True)
    ]
    notes = f"{robot.notes.rstrip()}\nFigures of the factory calibration in {path.name}.\n".lstrip()
    return replace(robot, joints=tuple(joints), notes=notes)


def _deltas(text: str, path: Path) -> dict[str, list[float]]:
    """What is added to each figure of the six joints."""
    deltas: dict[str, list[float]] = {}
    problems = []
    for number, line in enumerate(text.splitlines(), start=1):
        key, _, value = line.partition("=")
        if key.strip() not in DELTAS:
            continue
        words = value.split("#")[0].strip(" []\t").split(",")
        try:
            deltas[DELTAS[key.strip()]] = [float(word) for word in words]
        except ValueError:
            words = []
        if len(words) != len(LINKS):
            problems.append(Problem(f"{key.strip()}: expected six numbers in brackets", path, number))
    problems += [Problem(f"lacks {key}", path) for key, name in DELTAS.items() if name not in deltas and not problems]
    refuse_any(problems)
    return deltas


def _of_deltas(frames: Sequence[Frame], deltas: Mapping[str, Sequence[float]]) -> list[np.ndarray]:
    """Each joint's origin in the one before, and the flange's in the last, of DH figures with these added."""
    origins, rest = [], np.eye(4)
    for i, frame in enumerate(frames):
        figures = {name: frame.figures[name] + deltas[name][i] for name in ("theta", "d", "a", "alpha")}
        origins.append(rest @ transform_of([Step("rz", "theta", figures["theta"]), Step("tz", "d", figures["d"])]))
        rest = transform_of([Step("tx", "a", figures["a"]), Step("rx", "alpha", figures["alpha"])])
    return [*origins, rest]


def _of_yaml(text: str, path: Path) -> list[np.ndarray]:
    """The same of the driver's YAML, whose last joint is the flange."""
    try:
        import yaml
    except ImportError:
        raise refuse("is read by the extra 'ur': pip install calflow[ur]", path) from None
    try:
        stated = yaml.safe_load(text)["kinematics"]
        places = [[float(stated[link][key]) for key in PLACE] for link in LINKS]
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise refuse(
            f"is neither a calibration.conf nor what ur_calibration writes: expected 'kinematics' with x, y, z, roll, pitch and "
            f"yaw of {', '.join(LINKS)} ({type(error).__name__}: {error})",
            path,
        ) from None
    origins = []
    for x, y, z, roll, pitch, yaw in places:
        turn = [Step("rz", "yaw", yaw), Step("ry", "pitch", pitch), Step("rx", "roll", roll)]
        origins.append(transform_of([Step("tx", "x", x), Step("ty", "y", y), Step("tz", "z", z), *turn]))
    return [*origins, np.eye(4)]


def _near(origins: Sequence[np.ndarray], nominal: Sequence[Frame], path: Path) -> list[Frame]:
    """The frames of joints that stand at origins (4, 4) in the one before and turn about z: DH, with beta where axes are parallel.

    What turns about a joint's axis, or slides along it, is the next frame's to make up for.
    """
    left = origins[0]
    frames: list[Frame] = []
    for frame, following in zip(nominal, origins[1:], strict=True):
        along = _along_axis(left)
        if along is None:
            raise refuse("its first axis is not the base's z: expected the shoulder to be turned about z alone", path)
        theta, d = along
        if len(frames) == len(nominal) - 1:
            frames.append(_last(theta, d, following))
            break
        there = left @ following
        figures = _parallel(there, frame) if frame.figures["alpha"] == 0 else _crossing(there, frame)
        left = np.linalg.inv(transform_of(dh(**figures).steps)) @ there
        frames.append(dh(**figures))
    return frames


def _parallel(there: np.ndarray, nominal: Frame) -> dict[str, float]:
    """The figures whose frame has its z on that of a place (4, 4), and its origin where that crosses the xy-plane."""
    origin, z = there[:3, 3], there[:3, 2]
    x, y, _ = origin - z * origin[2] / z[2]
    side = np.sign(nominal.figures["a"])
    theta = float(np.arctan2(side * y, side * x))
    across = transform_of([Step("rz", "theta", -theta)])[:3, :3] @ z
    beta, alpha = float(np.arcsin(across[0])), float(np.arctan2(-across[1], across[2]))
    return {"theta": theta, "d": 0.0, "a": float(side * np.hypot(x, y)), "alpha": alpha, "beta": beta}


def _crossing(there: np.ndarray, nominal: Frame) -> dict[str, float]:
    """The figures whose frame has its z on that of a place (4, 4), and its origin where their common normal meets that."""
    origin, z = there[:3, 3], there[:3, 2]
    normal = np.array([-z[1], z[0], 0.0]) / np.hypot(z[0], z[1])
    alpha = float(np.arctan2(np.hypot(z[0], z[1]), z[2]))
    if nominal.figures["alpha"] < 0:
        normal, alpha = -normal, -alpha
    theta = float(np.arctan2(normal[1], normal[0]))
    foot = np.linalg.solve(np.column_stack([normal, [0.0, 0.0, 1.0], -z]), origin)
    return {"theta": theta, "d": float(foot[1]), "a": float(foot[0]), "alpha": alpha}


def _last(theta: float, d: float, flange: np.ndarray) -> Frame:
    """The last frame: what is left, and the flange's a and alpha."""
    alpha = float(np.arctan2(flange[2, 1], flange[1, 1]))
    return dh(theta=theta, d=d, a=float(flange[0, 3]), alpha=alpha)


def _along_axis(transform: np.ndarray) -> tuple[float, float] | None:
    """The turn about z and the shift along it that make up a transform (4, 4); None where it is more than that."""
    theta, d = float(np.arctan2(transform[1, 0], transform[0, 0])), float(transform[2, 3])
    same = np.allclose(transform, transform_of([Step("rz", "theta", theta), Step("tz", "d", d)]), atol=NEARLY)
    return (theta, d) if same else None


def driver_yaml(chain: RigidChain, along: Sequence[float], notes: Sequence[str]) -> str:
    """Return a rigid chain as the YAML that Universal Robots' driver loads, each joint's frame moved along its axis [m].

    Each note is a line of comment.

    Raises:
        InputError: it is no chain of six joints about z whose flange is on the last one's axis.
    """
    title = f"robot '{chain.name}'"
    if len(chain.joints) != len(LINKS) or any(
        not np.allclose(joint.axis, (0, 0, 1)) or joint.kind != "revolute" for joint in chain.joints
    ):
        raise refuse(
            "this format is of Universal Robots: it has six joints that turn about z, and count as the controller does",
            key=title,
        )
    last = _along_axis(chain.flange)
    if last is None:
        raise refuse(
            "this format has the flange on the last joint's axis: expected no a, alpha or beta of joint 6", key=title
        )
    before, lines = np.eye(4), ["kinematics:"]
    for k, (link, joint) in enumerate(zip(LINKS, chain.joints, strict=True)):
        moved = chain.flange if k == len(LINKS) - 1 else transform_of([Step("tz", "d", along[k])])
        place = before @ joint.origin @ moved
        figures = (*place[:3, 3], *rpy_of(place[:3, :3]))
        lines += [f"  {link}:", *(f"    {key}: {float(v) + 0.0!r}" for key, v in zip(PLACE, figures, strict=True))]
        before = np.linalg.inv(moved)
    comments = [f"# {line}" for note in notes for line in note.splitlines()]
    return "\n".join([*comments, *lines, f"  hash: {UNKNOWN_HASH}", ""])
