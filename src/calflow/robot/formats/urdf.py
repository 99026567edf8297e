"""URDF: the chain from a base link to a tip link, with the masses that hang on it.

Fixed joints are joined to the next moving one, and what hangs on a link by fixed joints counts as part of it. The flange is
the tip link. Up is the root link's z. Efforts and transmissions are not read: most files hold numbers nobody meant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from calflow.files.problems import InputError, Problem, nearest, refuse
from calflow.robot.formats.urdf_document import Document, Inertia, UrdfJoint, read_document
from calflow.robot.origins import Axis, Origin, joint_frame
from calflow.robot.parts import STANDARD_GRAVITY, Coupling, Joint, Marker, Vector, vector

SUFFIX = ".urdf"


@dataclass(frozen=True)
class Chain:
    """The joints from a base link to a tip link: up, against their direction, to the link of which both hang, and down."""

    document: Document
    base: str
    tip: str
    up: tuple[UrdfJoint, ...]
    down: tuple[UrdfJoint, ...]

    @property
    def joints(self) -> tuple[UrdfJoint, ...]:
        """All, in order."""
        return (*self.up, *self.down)

    @property
    def moving(self) -> tuple[UrdfJoint, ...]:
        """Those that move, in order."""
        return tuple(joint for joint in self.joints if joint.moves)

    @property
    def ground(self) -> int:
        """How many of those that move lead up: they carry what the base link is of, a work piece say."""
        return sum(joint.moves for joint in self.up)


def read_urdf(path: Path, tip: str | None = None, base: str | None = None) -> dict[str, Any]:
    """Read a URDF file into the fields of a robot, with a marker at the tip.

    tip may be left out where one link alone has no joint on it; base is the root link unless said otherwise.

    Raises:
        InputError: with all that is wrong in it.
    """
    chain = find_chain(read_document(path), tip, base)
    masses = _carried(chain)
    moving = chain.moving
    origins, tip_origin = _origins(chain)
    last = len(moving) - 1
    axes = [
        Axis(vector(-np.array(joint.axis)) if i < chain.ground else joint.axis, joint.kind == "prismatic")
        for i, joint in enumerate(moving)
    ]
    joints = []
    for i, (joint, origin, carried) in enumerate(zip(moving, origins, masses, strict=True)):
        frame = joint_frame(
            origin,
            axes[i],
            axes[i - 1] if i else None,
            zero=joint.mimic.offset if joint.mimic else 0.0,
            tip=tip_origin if i == last else None,
        )
        com = carried.com if carried else (0.0, 0.0, 0.0)
        joints.append(
            Joint(
                frame,
                kind="prismatic" if axes[i].slides else "revolute",
                limits=_own_limits(joint),
                mass=carried.mass
                if carried
                else 0.0
                if i == chain.ground - 1
                else None,  # the floor bears what stands on it
                com=_seen_from(tip_origin, com) if i == last else com,
                name=joint.name,
                driven=joint.mimic is None,
            )
        )
    return {
        "name": chain.document.name,
        "joints": tuple(joints),
        "gravity": _gravity(chain),
        "ground": chain.ground,
        "couplings": _couplings(chain),
        "markers": {chain.tip: Marker((0.0, 0.0, 0.0))},
    }


def find_chain(document: Document, tip: str | None, base: str | None) -> Chain:
    """Return the chain from a base link to a tip link.

    Raises:
        InputError: there are no such links, or no joints that calflow knows between them.
    """
    if tip is None:
        if len(document.leaves) > 1:
            raise refuse(f"expected tip, one of the links {', '.join(document.leaves)}", document.path)
        (tip,) = document.leaves
    start = document.root if base is None else base
    unknown = [
        Problem(f"{role}: there is no link '{link}'{nearest(link, document.links)}", document.path)
        for role, link in (("base", start), ("tip", tip))
        if link not in document.links
    ]
    if unknown:
        raise InputError(unknown)
    above_base, above_tip = document.above(start), document.above(tip)
    common = sum(1 for _ in takewhile(lambda both: both[0] == both[1], zip(above_base, above_tip, strict=False)))
    chain = Chain(document, start, tip, tuple(above_base[common:][::-1]), tuple(above_tip[common:]))
    problems = [_problem(chain, joint, f"calflow has no joint of type '{joint.kind}' between base and tip")
                for joint in chain.joints if joint.kind in ("floating", "planar")]  # fmt: skip
    names = [joint.name for joint in chain.moving]
    for joint in chain.moving:
        if joint.mimic and joint.mimic.joint not in names:
            said = f"mimic: expected a joint between base and tip, found '{joint.mimic.joint}'"
            problems.append(_problem(chain, joint, said))
        elif joint.mimic and document.joints[joint.mimic.joint].mimic:
            problems.append(_problem(chain, joint, f"mimic: joint '{joint.mimic.joint}' follows another itself"))
    if not names:
        problems.append(Problem(f"no joint moves between '{start}' and '{tip}'", document.path))
    if problems:
        raise InputError(problems)
    return chain


def _problem(chain: Chain, joint: UrdfJoint, message: str) -> Problem:
    return Problem(message, chain.document.path, joint.line, f"joint '{joint.name}'")


def _origins(chain: Chain) -> tuple[list[Origin], Origin]:
    """Each moving joint's origin in the frame of the one before (the first one's in the base), and the tip's in the last one's."""
    origins, at = [], Origin()
    for joint in chain.up:
        if joint.moves:
            origins.append(at)
            at = Origin()
        at = at.then(joint.origin.inverse)
    for joint in chain.down:
        at = at.then(joint.origin)
        if joint.moves:
            origins.append(at)
            at = Origin()
    return origins, at


def _couplings(chain: Chain) -> tuple[Coupling, ...]:
    """What joints that follow others have from those."""
    number = {joint.name: i + 1 for i, joint in enumerate(chain.moving)}
    return tuple(
        Coupling(number[joint.name], number[joint.mimic.joint], joint.mimic.multiplier)
        for joint in chain.moving
        if joint.mimic
    )


def _own_limits(joint: UrdfJoint) -> tuple[float, float] | None:
    """A joint's limits; what follows another counts from its offset, which is its zero."""
    if joint.limits is None or joint.mimic is None:
        return joint.limits
    low, high = joint.limits
    return low - joint.mimic.offset, high - joint.mimic.offset


def _gravity(chain: Chain) -> Vector:
    """Gravity in the frame of what stands on the floor: along the root's z, all joints between them at zero.

    That frame is the base's, or that of the last of the joints that lead up.
    """
    last = next((joint for joint in reversed(chain.up) if joint.moves), None)
    turn = np.eye(3)
    for joint in chain.document.above(last.child if last else chain.base):
        turn = turn @ joint.origin.rotation
    return STANDARD_GRAVITY if np.array_equal(turn, np.eye(3)) else vector(turn.T @ np.array(STANDARD_GRAVITY))


def _carried(chain: Chain) -> list[Inertia | None]:
    """What each moving joint's link weighs, with all that hangs on it by joints that are not of the chain, at their zero.

    In the joint's frame; None where no link of it has a mass.
    """
    beside: dict[str, list[tuple[str, Origin]]] = {}
    names = {joint.name for joint in chain.moving}
    for joint in chain.document.joints.values():
        if joint.name not in names:
            beside.setdefault(joint.parent, []).append((joint.child, joint.origin))
            beside.setdefault(joint.child, []).append((joint.parent, joint.origin.inverse))
    starts = [
        (joint.parent, joint.origin.inverse) if i < chain.ground else (joint.child, Origin())
        for i, joint in enumerate(chain.moving)
    ]
    return [_lumped(chain.document.links, beside, link, at) for link, at in starts]


def _lumped(
    links: Mapping[str, Inertia | None], beside: Mapping[str, Sequence[tuple[str, Origin]]], link: str, at: Origin
) -> Inertia | None:
    """The inertia of a link that stands at an origin, and of all that is joined to it but by the joints of the chain."""
    mass, moment, weighed = 0.0, np.zeros(3), False
    to_do, done = [(link, at)], {link}
    while to_do:
        here, at = to_do.pop()
        inertia = links[here]
        if inertia:
            weighed = True
            mass += inertia.mass
            moment += inertia.mass * at.at(inertia.com)
        further = [(other, at.then(origin)) for other, origin in beside.get(here, ()) if other not in done]
        to_do += further
        done |= {other for other, _ in further}
    if not weighed:
        return None
    return Inertia(mass, vector(moment / mass) if mass else (0.0, 0.0, 0.0))


def _seen_from(origin: Origin, point: Vector) -> Vector:
    """A point in the frame that stands at an origin."""
    return vector(origin.rotation.T @ (np.array(point) - np.array(origin.xyz)))
