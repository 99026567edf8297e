"""URDF, written: a robot's rigid chain as a tree of links, whose origins are stated in full."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree

import numpy as np

from calflow.robot.formats.rigid_chain import ChainJoint, RigidChain, plain_names
from calflow.robot.formats.urdf_document import Drive
from calflow.robot.origins import rpy_of

USUAL = Drive(1000.0, 1.0)  # what stands where URDF asks for a drive that nobody stated
BASE, FLANGE, TOOL, MEASURING = "base_link", "flange", "tool0", "measuring_frame"


def urdf_text(chain: RigidChain, notes: str, drives: Sequence[Drive] = ()) -> str:
    """Return a rigid chain as URDF: links `base_link`, `link1` …, `flange`, `tool0`, `measuring_frame` and one a marker.

    notes stand in a comment; drives are each joint's. What calflow does not know (shapes, inertia) is not in it, or zero where
    URDF asks for it; of drives USUAL stands there, as planners take 0 for a joint that cannot move.
    """
    robot = ElementTree.Element("robot", name=chain.name)
    robot.append(ElementTree.Comment(_commented(notes)))
    _link(robot, BASE)
    _fixed(robot, BASE, MEASURING, np.linalg.inv(chain.base))
    before = BASE
    for i, (joint, drive) in enumerate(zip(chain.joints, drives or [Drive()] * len(chain.joints), strict=True)):
        link = _link(robot, f"link{i + 1}")
        if joint.mass is not None:
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "origin", xyz=_figures(joint.com))
            ElementTree.SubElement(inertial, "mass", value=repr(joint.mass))
            ElementTree.SubElement(inertial, "inertia", dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0"))
        turns = "revolute" if joint.limits else "continuous"
        kind = turns if joint.kind == "revolute" else "prismatic"
        made = _joint(robot, joint.name, kind, before, f"link{i + 1}", joint.origin)
        ElementTree.SubElement(made, "axis", xyz=_figures(joint.axis))
        if kind != "continuous":
            low, high = map(float, joint.limits or (-np.pi, np.pi))
            ElementTree.SubElement(made, "limit", {"lower": repr(low), "upper": repr(high), **_most(joint, drive)})
        elif drive.effort and drive.velocity:
            ElementTree.SubElement(made, "limit", _most(joint, drive))
        if joint.leader:
            leader, factor = joint.leader
            ElementTree.SubElement(made, "mimic", joint=leader, multiplier=repr(float(factor)), offset="0")
        before = f"link{i + 1}"
    _fixed(robot, before, FLANGE, chain.flange)
    _fixed(robot, FLANGE, TOOL, chain.tool)
    for name, point in _markers(chain):
        place = np.eye(4)
        place[:3, 3] = point
        _fixed(robot, FLANGE, f"marker_{name}", place)
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def _most(joint: ChainJoint, drive: Drive) -> dict[str, str]:
    effort, velocity = drive.effort or joint.rated or USUAL.effort, drive.velocity or USUAL.velocity
    return {"effort": repr(float(effort or 0)), "velocity": repr(float(velocity or 0))}


def said_of_drives(chain: RigidChain, drives: Sequence[Drive]) -> list[str]:
    """Say which joints' effort and velocity are only placeholders."""
    limited = [
        (joint, drive)
        for joint, drive in zip(chain.joints, drives, strict=True)
        if joint.limits or joint.kind != "revolute"
    ]
    lacking = {
        f"effort {USUAL.effort:g} (Nm or N)": [one.name for one, drive in limited if not (drive.effort or one.rated)],
        f"velocity {USUAL.velocity:g} (rad/s or m/s)": [one.name for one, drive in limited if not drive.velocity],
    }
    return [
        f"{what} of {', '.join(names)} is a placeholder, as nobody stated it: put the maker's there before a planner reads it"
        for what, names in lacking.items() if names
    ]  # fmt: skip


def properties_text(chain: RigidChain, notes: str) -> str:
    """Return a rigid chain as properties of xacro, to be included where a robot's own xacro states its origins.

    Joint 1 has `joint1_xyz` and `joint1_rpy`, its origin in the joint before, and `joint1_axis`, and so on; flange, tool0 and
    measuring_frame have their places likewise, and each marker: by its name in letters, digits and _, or else its number.
    """
    robot = ElementTree.Element("robot", {"xmlns:xacro": "http://www.ros.org/wiki/xacro"})
    robot.append(ElementTree.Comment(_commented(notes)))
    places = {f"joint{i + 1}": joint.origin for i, joint in enumerate(chain.joints)}
    places |= {FLANGE: chain.flange, TOOL: chain.tool, MEASURING: np.linalg.inv(chain.base)}
    for name, place in places.items():
        _property(robot, f"{name}_xyz", place[:3, 3])
        _property(robot, f"{name}_rpy", rpy_of(place[:3, :3]))
    for i, joint in enumerate(chain.joints):
        _property(robot, f"joint{i + 1}_axis", joint.axis)
    for name, point in _markers(chain):
        _property(robot, f"marker_{name}_xyz", point)
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def _markers(chain: RigidChain) -> Iterable[tuple[str, np.ndarray]]:
    """The markers by names that xacro takes."""
    return zip(plain_names(chain.markers, ""), chain.markers.values(), strict=True)


def _commented(notes: str) -> str:
    """What stands in a comment, in which XML allows no two hyphens in a row."""
    return f" {re.sub('-(?=-)', '- ', notes)} "


def _property(robot: ElementTree.Element, name: str, figures: Sequence[float] | np.ndarray) -> None:
    ElementTree.SubElement(robot, "xacro:property", name=name, value=_figures(figures))


def _link(robot: ElementTree.Element, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(robot, "link", name=name)


def _joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, place: np.ndarray
) -> ElementTree.Element:
    made = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(made, "origin", xyz=_figures(place[:3, 3]), rpy=_figures(rpy_of(place[:3, :3])))
    ElementTree.SubElement(made, "parent", link=parent)
    ElementTree.SubElement(made, "child", link=child)
    return made


def _fixed(robot: ElementTree.Element, parent: str, child: str, place: np.ndarray) -> None:
    _link(robot, child)
    _joint(robot, f"{parent}-{child}", "fixed", parent, child, place)


def _figures(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
