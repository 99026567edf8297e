"""What a URDF says, read by ElementTree and worked out in numpy apart from calflow, and where calflow's robot differs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.robot.robot import Robot

MOVING = ("revolute", "continuous", "prismatic")
POINTS = 3  # random places of the joints at which the marker is compared


def differences(path: Path, tip: str, robot: Robot, rng: np.random.Generator) -> Iterator[str]:
    """Say where a robot's marker, limits or masses are not the file's."""
    root = ElementTree.fromstring(path.read_text(encoding="utf-8-sig").lstrip("\ufeff"))
    chain = _chain(root, tip)
    moving = [joint for joint in chain if joint.get("type") in MOVING]
    if len(moving) != robot.n_joints:
        yield f"{len(moving)} joints became {robot.n_joints}"
        return
    for joint, own in zip(moving, robot.joints, strict=True):
        limit = joint.find("limit")
        if joint.get("type") != "continuous" and limit is not None:
            said = tuple(float(limit.get(name, "0")) for name in ("lower", "upper"))
            if own.limits is None or not np.allclose(said, own.limits, rtol=1e-12, atol=0):
                yield f"limits {said} became {own.limits}"
    stands = chain[0].find("parent").get("link")  # what does not move weighs on nothing
    weighing = [link.find("inertial/mass") for link in root.findall("link") if link.get("name") != stands]
    masses = sum(float(mass.get("value", "nan")) for mass in weighing if mass is not None)
    if not np.isclose(masses, sum(joint.mass or 0.0 for joint in robot.joints), rtol=1e-9):
        yield f"{masses} kg became others"
    point = np.array(next(iter(robot.markers.values())).point)
    q = rng.uniform(-1, 1, (POINTS, robot.n_joints))
    places = np.array([_frame(chain, row) @ np.append(point, 1) for row in q])[:, :3]
    if robot.base.known and not any(robot.base.origin):
        model = build(robot, ())
        conditions = Measurements.from_arrays(robot, q, None, payload="").conditions
        off = np.abs(model.position(model.nominal, conditions) - places).max() / max(1.0, np.abs(places).max())
        if off > 1e-9:
            yield f"the marker is {off:g} m off"


def _chain(root: ElementTree.Element, tip: str) -> list[ElementTree.Element]:
    hung = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    way: list[ElementTree.Element] = []
    while tip in hung:
        way.append(hung[tip])
        tip = hung[tip].find("parent").get("link")
    return way[::-1]


def _frame(chain: list[ElementTree.Element], q: np.ndarray) -> np.ndarray:
    whole, values = np.eye(4), iter(q)
    for joint in chain:
        origin, axis = joint.find("origin"), joint.find("axis")
        xyz, rpy = ((origin.get(name, "0 0 0") if origin is not None else "0 0 0") for name in ("xyz", "rpy"))
        whole = whole @ _placed(_three(xyz), _about_fixed(_three(rpy)))
        if joint.get("type") in MOVING:
            along = _three(axis.get("xyz", "1 0 0") if axis is not None else "1 0 0")
            along = along / np.linalg.norm(along)
            value = next(values)
            slides = joint.get("type") == "prismatic"
            whole = whole @ (_placed(value * along, np.eye(3)) if slides else _placed(np.zeros(3), _turn(along, value)))
    return whole


def _three(text: str) -> np.ndarray:
    return np.array([float(word) for word in text.split()])


def _placed(xyz: np.ndarray, turn: np.ndarray) -> np.ndarray:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = turn, xyz
    return frame


def _about_fixed(rpy: np.ndarray) -> np.ndarray:
    x, y, z = (_turn(axis, angle) for axis, angle in zip(np.eye(3), rpy, strict=True))
    return z @ y @ x


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula."""
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
