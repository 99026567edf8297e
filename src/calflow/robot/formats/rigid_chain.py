"""A rigid chain: a robot's joints as formats without a convention state them, each by its place in the one it is on and its axis.

It is written as JSON, with all that is said beside it, and as URDF, a tree of links whose origins are stated in full.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np

from calflow.robot.formats.urdf import Drive
from calflow.robot.frames import Step, elementary, placement_matrix, rpy_of
from calflow.robot.robot import Robot

AXES: dict[str, tuple[float, float, float]] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
USUAL_DRIVE = Drive(1000.0, 1.0)  # what stands where URDF asks for a drive that nobody stated
BASE, FLANGE, TOOL, MEASURING = "base_link", "flange", "tool0", "measuring_frame"


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """A joint of a rigid chain.

    origin (4, 4) is where it stands in the frame of joint number `on`, which has moved, or in the base where that is 0; axis
    (3,) is what its variable turns about, or slides along, where a reading counts as the robot's. limits are of that variable
    [rad, or m]. mass [kg] and com (3,) [m], in the joint's frame, are of what it moves; None where nobody knows. leader is the
    joint that it follows, by name, and the factor by which: None where it is driven, or a coupling is more than that.
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
    on: int = 0


@dataclass(frozen=True, eq=False)
class RigidChain:
    """A robot without loop and couplings: joints, base in the measuring frame, flanges and tool (4, 4), markers.

    flanges has the links, by the number of the joint that moves each (0: none), that are tips or that markers are on: what their
    frames are called, and where they are in that joint's. The last joint's is `flange`, in whose frame the tool is. markers are
    each on a link, by its number, at a point (3,) of its frame. A variable is the joint's own angle, or a slide's place, counted
    as its reading is: where the robot has couplings or a loop, these lead from readings to it (see `said_of_variables`).
    """

    name: str
    joints: tuple[ChainJoint, ...]
    base: np.ndarray
    flanges: dict[int, tuple[str, np.ndarray]]
    tool: np.ndarray
    markers: dict[str, tuple[int, np.ndarray]]

    @property
    def flange(self) -> np.ndarray:
        """The last link's frame (4, 4) in its joint's."""
        return self.flanges[len(self.joints)][1]


def rigid_chain(robot: Robot) -> RigidChain:
    """Return a robot's rigid chain."""
    joints, frames = [], [np.eye(4)]  # each link's own frame in its joint's
    names = plain_names((joint.name for joint in robot.joints), "joint")
    for i, joint in enumerate(robot.joints):
        frame = joint.frame
        moving = joint.moving
        steps = frame.steps
        k = steps.index(moving)
        at = frames[robot.parents[i]] @ transform_of(steps[: k + 1])
        rest = transform_of(steps[k + 1 :])
        limits = None
        if joint.limits:
            first, other = (joint.sign * limit for limit in joint.limits)
            limits = (min(first, other), max(first, other))
        joints.append(
            ChainJoint(
                names[i], joint.kind, at, joint.sign * np.array(AXES[moving.motion[1]]), limits,
                joint.mass, (rest @ [*joint.com, 1.0])[:3], joint.rated_torque, _leader(robot, i, names), robot.parents[i],
            )
        )  # fmt: skip
        frames.append(rest)
    base = placement_matrix((*robot.base.origin, *robot.base.rotation))
    tool = placement_matrix((0.0, 0.0, 0.0, *(robot.tool_rotation or (0.0, 0.0, 0.0))))
    on = zip(robot.markers.items(), robot.marker_links, strict=True)
    markers = {name: (link, np.array(marker.point)) for (name, marker), link in on}
    called = [robot.links[0], *plain_names(robot.links[1:], "link")]
    flanges = {
        link: (FLANGE if link == robot.n_joints else f"{FLANGE}_{called[link]}", frames[link])
        for link in sorted({*robot.tips, *robot.marker_links})
    }
    return RigidChain(robot.name, tuple(joints), base, flanges, tool, markers)


def said_of_variables(robot: Robot) -> list[str]:
    """Say where a chain's variable is not the joint's reading."""
    notes = []
    for i, joint in enumerate(robot.joints):
        of_others = [
            f"{joint.sign * to.factor:+g} · reading {to.source}" for to in robot.couplings if to.joint == i + 1
        ]
        if of_others and _leader(robot, i, [""] * robot.n_joints) is None:
            made = " ".join([*[f"reading {i + 1}"] * joint.driven, *of_others])
            notes.append(f"joint {i + 1}'s variable is {made}, which this format cannot state")
    if robot.ground:
        floor = robot.ground
        notes.append(
            f"the chain begins at what joints 1 to {floor} carry: link {floor} stands on the floor, not the base"
        )
    if robot.loop:
        j = robot.loop.joint
        notes.append(
            f"joint {j}'s variable is its own angle, which the four-bar loop makes of readings {j - 1} and {j}; this format "
            "cannot hold the loop"
        )
    return notes


def _leader(robot: Robot, joint: int, names: Sequence[str]) -> tuple[str, float] | None:
    """The joint that one without drive (from 0) follows, where it follows one alone, whose variable is its own reading."""
    couplings = [coupling for coupling in robot.couplings if coupling.joint == joint + 1]
    if robot.joints[joint].driven or len(couplings) != 1:
        return None
    source = couplings[0].source - 1
    coupled = {coupling.joint - 1 for coupling in robot.couplings} | ({robot.loop.joint - 1} if robot.loop else set())
    return None if source in coupled else (names[source], robot.joints[joint].sign * couplings[0].factor)


def plain_names(names: Iterable[str], stem: str) -> list[str]:
    """Return names that every format takes: in letters, digits and _, or where that leaves nothing of its own stem and number."""
    plain = [re.sub(r"\W+", "_", name, flags=re.ASCII) for name in names]
    usual = [f"{stem}{i + 1}" for i in range(len(plain))]
    speaking = [bool(name.strip("_")) and plain.count(name) == 1 and name not in usual for name in plain]
    return [name if speaks else other for name, other, speaks in zip(plain, usual, speaking, strict=True)]


def transform_of(steps: Sequence[Step]) -> np.ndarray:
    """Return the transform (4, 4) of steps, one after another."""
    at = np.eye(4)
    for step in steps:
        at = at @ np.array(ca.DM(ca.evalf(ca.SX(elementary(step.motion, step.value)))))
    return at


def json_text(chain: RigidChain, more: dict[str, Any]) -> str:
    """Return a rigid chain as JSON in SI units, every transform as four rows; more is said beside it."""
    last = len(chain.joints)
    joints = [
        {
            "name": joint.name,
            "on": chain.joints[joint.on - 1].name if joint.on else None,
            "kind": joint.kind,
            "origin": joint.origin.tolist(),
            "axis": joint.axis.tolist(),
            "limits": joint.limits,
            **({"follows": {"joint": joint.leader[0], "multiplier": joint.leader[1]}} if joint.leader else {}),
        }
        for joint in chain.joints
    ]
    document = {
        "robot": chain.name,
        "units": "m, rad",
        "base_in_measuring_frame": chain.base.tolist(),
        "joints": joints,
        "flange_in_last_joint": chain.flange.tolist(),
        "tool_in_flange": chain.tool.tolist(),
        "markers_in_flange": {name: point.tolist() for name, (link, point) in chain.markers.items() if link == last},
        "further_flanges": [
            {
                "name": called,
                "joint": chain.joints[link - 1].name if link else None,
                "in_joint": at.tolist(),
                "markers": {name: point.tolist() for name, (on, point) in chain.markers.items() if on == link},
            }
            for link, (called, at) in chain.flanges.items()
            if link != last
        ],
        **more,
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def urdf_text(chain: RigidChain, notes: str, drives: Sequence[Drive] = ()) -> str:
    """Return a rigid chain as URDF: links `base_link`, `link1` …, `flange`, `tool0`, `measuring_frame` and one a marker.

    Further flanges are `flange_NAME`.

    notes stand in a comment; drives are each joint's. What calflow does not know (shapes, inertia) is not in it, or zero where
    URDF asks for it; of drives USUAL_DRIVE stands there, as planners take 0 for a joint that cannot move.
    """
    robot = ElementTree.Element("robot", name=chain.name)
    robot.append(ElementTree.Comment(commented(notes)))
    urdf_link(robot, BASE)
    _fixed(robot, BASE, MEASURING, np.linalg.inv(chain.base))
    for i, (joint, drive) in enumerate(zip(chain.joints, drives or [Drive()] * len(chain.joints), strict=True)):
        link = urdf_link(robot, f"link{i + 1}")
        if joint.mass is not None:
            urdf_mass(link, joint.mass, joint.com)
        turns = "revolute" if joint.limits else "continuous"
        kind = turns if joint.kind == "revolute" else "prismatic"
        made = urdf_joint(robot, joint.name, kind, _moved_by(joint.on), f"link{i + 1}", joint.origin)
        ElementTree.SubElement(made, "axis", xyz=figures_text(joint.axis))
        if kind != "continuous":
            low, high = map(float, joint.limits or (-np.pi, np.pi))
            ElementTree.SubElement(made, "limit", {"lower": repr(low), "upper": repr(high), **_most(joint, drive)})
        elif drive.effort and drive.velocity:
            ElementTree.SubElement(made, "limit", _most(joint, drive))
        if joint.leader:
            leader, factor = joint.leader
            ElementTree.SubElement(made, "mimic", joint=leader, multiplier=repr(float(factor)), offset="0")
    for number, (name, at) in chain.flanges.items():
        _fixed(robot, _moved_by(number), name, at)
    _fixed(robot, FLANGE, TOOL, chain.tool)
    for name, (number, point) in marked(chain):
        _fixed(robot, chain.flanges[number][0], f"marker_{name}", shift(point))
    return xml_text(robot)


def _moved_by(joint: int) -> str:
    """The link of the URDF that a joint of a number moves."""
    return f"link{joint}" if joint else BASE


def _most(joint: ChainJoint, drive: Drive) -> dict[str, str]:
    effort, velocity = drive.effort or joint.rated or USUAL_DRIVE.effort, drive.velocity or USUAL_DRIVE.velocity
    return {"effort": repr(float(effort or 0)), "velocity": repr(float(velocity or 0))}


def said_of_drives(chain: RigidChain, drives: Sequence[Drive]) -> list[str]:
    """Say which joints' effort and velocity are only placeholders."""
    limited = [
        (joint, drive)
        for joint, drive in zip(chain.joints, drives, strict=True)
        if joint.limits or joint.kind != "revolute"
    ]
    lacking = {
        f"effort {USUAL_DRIVE.effort:g} (Nm or N)": [
            joint.name for joint, drive in limited if not (drive.effort or joint.rated)
        ],
        f"velocity {USUAL_DRIVE.velocity:g} (rad/s or m/s)": [
            joint.name for joint, drive in limited if not drive.velocity
        ],
    }
    return [
        f"{what} of {', '.join(names)} is a placeholder, as nobody stated it: put the maker's there before a planner reads it"
        for what, names in lacking.items()
        if names
    ]


def properties_text(chain: RigidChain, notes: str) -> str:
    """Return a rigid chain as properties of xacro, to be included where a robot's own xacro states its origins.

    Joint 1 has `joint1_xyz` and `joint1_rpy`, its origin in the joint that it is on, and `joint1_axis`, and so on; flanges,
    tool0 and measuring_frame have their places likewise, and each marker: by its name in letters, digits and _, or else its
    number.
    """
    robot = ElementTree.Element("robot", {"xmlns:xacro": "http://www.ros.org/wiki/xacro"})
    robot.append(ElementTree.Comment(commented(notes)))
    places = {f"joint{i + 1}": joint.origin for i, joint in enumerate(chain.joints)}
    places |= {**dict(chain.flanges.values()), TOOL: chain.tool, MEASURING: np.linalg.inv(chain.base)}
    for name, place in places.items():
        _property(robot, f"{name}_xyz", place[:3, 3])
        _property(robot, f"{name}_rpy", rpy_of(place[:3, :3]))
    for i, joint in enumerate(chain.joints):
        _property(robot, f"joint{i + 1}_axis", joint.axis)
    for name, (_, point) in marked(chain):
        _property(robot, f"marker_{name}_xyz", point)
    return xml_text(robot)


def xml_text(root: ElementTree.Element) -> str:
    """Return a document as it is written."""
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def shift(by: np.ndarray) -> np.ndarray:
    """Return the transform (4, 4) of a shift (3,)."""
    at = np.eye(4)
    at[:3, 3] = by
    return at


def marked(chain: RigidChain) -> Iterable[tuple[str, tuple[int, np.ndarray]]]:
    """Return the markers by names that every format takes."""
    return zip(plain_names(chain.markers, ""), chain.markers.values(), strict=True)


def commented(notes: str) -> str:
    """Return what stands in a comment, in which XML allows no two hyphens in a row."""
    return f" {re.sub('-(?=-)', '- ', notes)} "


def _property(robot: ElementTree.Element, name: str, figures: Sequence[float] | np.ndarray) -> None:
    ElementTree.SubElement(robot, "xacro:property", name=name, value=figures_text(figures))


def urdf_link(robot: ElementTree.Element, name: str) -> ElementTree.Element:
    """Add a link to a URDF."""
    return ElementTree.SubElement(robot, "link", name=name)


def urdf_mass(link: ElementTree.Element, mass: float, com: np.ndarray) -> None:
    """Add a mass [kg] at a centre (3,) [m] to a link of a URDF, its inertia not known."""
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=figures_text(com))
    ElementTree.SubElement(inertial, "mass", value=repr(float(mass)))
    ElementTree.SubElement(inertial, "inertia", dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0"))


def urdf_joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, place: np.ndarray
) -> ElementTree.Element:
    """Add a joint between two links to a URDF, at a place (4, 4) in the first."""
    made = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(made, "origin", xyz=figures_text(place[:3, 3]), rpy=figures_text(rpy_of(place[:3, :3])))
    ElementTree.SubElement(made, "parent", link=parent)
    ElementTree.SubElement(made, "child", link=child)
    return made


def _fixed(robot: ElementTree.Element, parent: str, child: str, place: np.ndarray) -> None:
    urdf_link(robot, child)
    urdf_joint(robot, f"{parent}-{child}", "fixed", parent, child, place)


def figures_text(values: Sequence[float] | np.ndarray) -> str:
    """Return figures as attributes of XML have them, to the last bit."""
    return " ".join(repr(float(value) + 0.0) for value in values)
