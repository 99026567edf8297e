"""A rigid chain: a robot's joints as formats without a convention state them, each by its place in the one before and its axis.

JSON: a robot with all its figures, its rigid chain, and whatever else is said of it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from calflow.robot.frames import Motion, Step
from calflow.robot.robot import Robot
from calflow.robot.transforms import elementary, placement

AXES: dict[str, tuple[float, float, float]] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """A joint of a rigid chain.

    origin (4, 4) is where it stands in the frame of the joint before, which has moved, or in the base; axis (3,) is what its
    variable turns about, or slides along, where a reading counts as the robot's. limits are of that variable [rad, or m].
    mass [kg] and com (3,) [m], in the joint's frame, are of what it moves; None where nobody knows. leader is the joint that it
    follows, by name, and the factor by which: None where it is driven, or a coupling is more than that.
    """

    name: str
    kind: str
    origin: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float] | None
    mass: float | None
    com: np.ndarray
    rated: float | None
    leader: tuple[str, float] | None = None


@dataclass(frozen=True, eq=False)
class RigidChain:
    """A robot without loop and couplings: joints, base in the measuring frame, flange and tool (4, 4), markers (3,) in the flange.

    flange is in the last joint's frame, tool in the flange's. A variable is the joint's own angle, or a slide's place, counted
    as its reading is: where the robot has couplings or a loop, these lead from readings to it (see `said_of_variables`).
    """

    name: str
    joints: tuple[ChainJoint, ...]
    base: np.ndarray
    flange: np.ndarray
    tool: np.ndarray
    markers: dict[str, np.ndarray]


def rigid_chain(robot: Robot) -> RigidChain:
    """Return a robot's rigid chain."""
    joints, at = [], np.eye(4)
    names = plain_names((joint.name for joint in robot.joints), "joint")
    for i, joint in enumerate(robot.joints):
        frame = joint.frame
        moving = frame.turn if joint.kind == "revolute" else frame.slide
        assert moving is not None
        steps = frame.steps
        k = steps.index(moving)
        at = at @ along(steps[: k + 1])
        rest = along(steps[k + 1 :])
        limits = None
        if joint.limits:
            one, other = (joint.sign * limit for limit in joint.limits)
            limits = (min(one, other), max(one, other))
        joints.append(
            ChainJoint(
                names[i], joint.kind, at, joint.sign * np.array(AXES[moving.motion[1]]), limits,
                joint.mass, (rest @ [*joint.com, 1.0])[:3], joint.rated_torque, _leader(robot, i, names),
            )
        )  # fmt: skip
        at = rest
    base = matrix((*robot.base.origin, *robot.base.rotation))
    tool = matrix((0.0, 0.0, 0.0, *(robot.tool_rotation or (0.0, 0.0, 0.0))))
    markers = {name: np.array(marker.point) for name, marker in robot.markers.items()}
    return RigidChain(robot.name, tuple(joints), base, at, tool, markers)


def said_of_variables(robot: Robot) -> list[str]:
    """Say where a chain's variable is not the joint's reading."""
    said = [
        f"joint {coupling.joint}'s variable is its own angle: reading {coupling.joint} with {coupling.factor:+g} times reading "
        f"{coupling.source}, which this format cannot state"
        for coupling in robot.couplings
        if _leader(robot, coupling.joint - 1, [""] * robot.n_joints) is None
    ]  # fmt: skip
    if robot.ground:
        floor = robot.ground
        said.append(
            f"the chain begins at what joints 1 to {floor} carry: link {floor} stands on the floor, not the base"
        )
    if robot.loop:
        j = robot.loop.joint
        said.append(
            f"joint {j}'s variable is its own angle, which the four-bar loop makes of readings {j - 1} and {j}; this format "
            "cannot hold the loop"
        )
    return said


def _leader(robot: Robot, joint: int, names: Sequence[str]) -> tuple[str, float] | None:
    """The joint that one without drive (from 0) follows, where it follows one alone, whose variable is its own reading."""
    own = [coupling for coupling in robot.couplings if coupling.joint == joint + 1]
    if robot.joints[joint].driven or len(own) != 1:
        return None
    source = own[0].source - 1
    coupled = {coupling.joint - 1 for coupling in robot.couplings} | ({robot.loop.joint - 1} if robot.loop else set())
    return None if source in coupled else (names[source], robot.joints[joint].sign * own[0].factor)


def plain_names(names: Iterable[str], stem: str) -> list[str]:
    """Return names that every format takes: in letters, digits and _, or where that leaves nothing of its own stem and number."""
    own = [re.sub(r"\W+", "_", name, flags=re.ASCII) for name in names]
    usual = [f"{stem}{i + 1}" for i in range(len(own))]
    told = [bool(name.strip("_")) and own.count(name) == 1 and name not in usual for name in own]
    return [name if its_own else other for name, other, its_own in zip(own, usual, told, strict=True)]


def along(steps: Sequence[Step]) -> np.ndarray:
    """Return the transform (4, 4) of steps, one after another."""
    at = np.eye(4)
    for step in steps:
        at = at @ _elementary(step.motion, step.value)
    return at


def matrix(six: Sequence[float]) -> np.ndarray:
    """Return the transform (4, 4) of a shift [m] and turns about x, y and z in turn [rad]."""
    return np.array(ca.DM(ca.evalf(placement(ca.DM(list(six))))))


def _elementary(motion: Motion, value: float) -> np.ndarray:
    return np.array(ca.DM(ca.evalf(ca.SX(elementary(motion, value)))))


def json_text(chain: RigidChain, more: dict[str, Any]) -> str:
    """Return a rigid chain as JSON in SI units, every transform as four rows; more is said beside it."""
    joints = [
        {
            "name": joint.name,
            "kind": joint.kind,
            "origin": _rows(joint.origin),
            "axis": joint.axis.tolist(),
            "limits": joint.limits,
            **({"follows": {"joint": joint.leader[0], "multiplier": joint.leader[1]}} if joint.leader else {}),
        }
        for joint in chain.joints
    ]
    document = {
        "robot": chain.name,
        "units": "m, rad",
        "base_in_measuring_frame": _rows(chain.base),
        "joints": joints,
        "flange_in_last_joint": _rows(chain.flange),
        "tool_in_flange": _rows(chain.tool),
        "markers_in_flange": {name: point.tolist() for name, point in chain.markers.items()},
        **more,
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _rows(transform: np.ndarray) -> list[list[float]]:
    return transform.tolist()
