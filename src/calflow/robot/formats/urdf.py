"""URDF: links and joints as they stand in the file, and the chain from a base link to a tip link with the masses on it.

Fixed joints are joined to the next moving one, and what hangs on a link by fixed joints counts as part of it. The flange is
the tip link. Up is the root link's z. Efforts and transmissions are not read: most files hold numbers nobody meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from calflow.files.problems import InputError, Problem, nearest, refuse, refuse_any, shortened
from calflow.files.units import LARGEST
from calflow.files.words import listed
from calflow.files.xml import Element, read_xml
from calflow.robot.frames import Axis, FrameOrigin, Vector, joint_frame, vector
from calflow.robot.parts import STANDARD_GRAVITY, Coupling, Joint, Marker

MOVING = ("revolute", "continuous", "prismatic")
KINDS = (*MOVING, "fixed", "floating", "planar")
OF_A_JOINT = ("origin", "parent", "child", "axis", "calibration", "dynamics", "limit", "mimic", "safety_controller")
OF_A_LINK = ("inertial", "visual", "collision")
OF_A_MASS = ("origin", "mass", "inertia")
XACRO = "is a xacro file: expected the URDF that `xacro FILE > robot.urdf` writes"


@dataclass(frozen=True)
class Inertia:
    """A link's mass [kg] and its centre [m] in the link's frame."""

    mass: float
    com: Vector


@dataclass(frozen=True)
class Mimic:
    """Another joint that a joint follows: its variable is multiplier times the other's, and offset [rad or m] more."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Drive:
    """The most that moves a joint: its effort [Nm or N] and velocity [rad/s or m/s]; None where nobody says, or says 0."""

    effort: float | None = None
    velocity: float | None = None


@dataclass(frozen=True)
class UrdfJoint:
    """A joint: where it stands in its parent's frame, the direction of its axis in its own, its limits [rad or m] and drive."""

    name: str
    kind: str
    parent: str
    child: str
    line: int
    origin: FrameOrigin = field(default_factory=FrameOrigin)
    axis: Vector = (1.0, 0.0, 0.0)
    limits: tuple[float, float] | None = None
    mimic: Mimic | None = None
    drive: Drive = Drive()

    @property
    def moves(self) -> bool:
        """Whether it has a variable that calflow knows."""
        return self.kind in MOVING


@dataclass(frozen=True)
class Document:
    """A tree of links: the inertia of each, where it has one, and the joint that each hangs on."""

    path: Path
    name: str
    links: Mapping[str, Inertia | None]
    joints: Mapping[str, UrdfJoint]  # by name

    @property
    def root(self) -> str:
        """The link that hangs on no joint."""
        hung = {joint.child for joint in self.joints.values()}
        return next(link for link in self.links if link not in hung)

    @property
    def leaves(self) -> tuple[str, ...]:
        """The links on which no joint hangs."""
        bearing = {joint.parent for joint in self.joints.values()}
        return tuple(link for link in self.links if link not in bearing)

    def above(self, link: str) -> list[UrdfJoint]:
        """Return the joints on the way from the root to a link, in order."""
        hung = {joint.child: joint for joint in self.joints.values()}
        way: list[UrdfJoint] = []
        while link in hung:
            way.append(hung[link])
            link = hung[link].parent
        return way[::-1]


def read_document(path: Path) -> Document:
    """Read a URDF file.

    Raises:
        InputError: with all that is wrong in it.
    """
    root = read_xml(path)
    reader = _Reader(path)
    if root.tag != "robot":
        reader.tell(root, "", f"expected <robot>, found <{root.tag}>")
        raise InputError(reader.problems)
    if any(":" in one.tag and one.tag.startswith("xacro") for one in root.inside):
        reader.tell(root, "", XACRO)
        raise InputError(reader.problems)
    reader.misspelt(root, "robot", ("link", "joint", "material", "transmission", "gazebo"))
    links = reader.named(root, "link")
    joints = reader.named(root, "joint")
    read = {name: reader.inertia(element, f"link '{name}'") for name, element in links.items()}
    built = {name: reader.joint(element, name) for name, element in joints.items()}
    document = Document(path, root.attributes.get("name", path.stem), read, built)
    reader.problems.extend(_of_the_tree(document))
    if reader.problems:
        raise InputError(sorted(reader.problems, key=lambda one: one.line or 0))
    return document


@dataclass(frozen=True)
class _Reader:
    """Takes elements apart and gathers what is wrong with them; a wrong value counts as the one that URDF takes where none is."""

    path: Path
    problems: list[Problem] = field(default_factory=list)

    def tell(self, element: Element, key: str, message: str) -> None:
        """Add a problem."""
        self.problems.append(Problem(message, self.path, element.line, key or None))

    def misspelt(self, element: Element, key: str, tags: Sequence[str]) -> None:
        """Tell elements that look like a known one: what they state would be missed; others are extensions of other programs."""
        for child in element.inside:
            guess = nearest(child.tag, tags)
            if child.tag not in tags and guess:
                self.tell(child, key, f"unknown element <{shortened(child.tag)}>{guess}")

    def attributes(self, element: Element, key: str, names: Sequence[str]) -> None:
        """Tell attributes that are unknown: they would mean something that is not read."""
        for name in element.attributes:
            if name not in names:
                self.tell(
                    element,
                    key,
                    f"unknown attribute '{shortened(name)}'{nearest(name, names)}; expected {', '.join(names)}",
                )

    def named(self, root: Element, tag: str) -> dict[str, Element]:
        """The elements of a tag by their names; those of the same name are told."""
        elements: dict[str, Element] = {}
        for element in root.all(tag):
            name = element.attributes.get("name", "")
            if not name:
                self.tell(element, tag, "missing: expected name")
            elif name in elements:
                self.tell(element, f"{tag} '{name}'", f"is there twice, first in line {elements[name].line}")
            else:
                elements[name] = element
        return elements

    def numbers(self, element: Element, key: str, name: str, default: Vector, unit: str) -> Vector:
        """Three numbers of an attribute."""
        text = element.attributes.get(name)
        if text is None:
            return default
        values = [_number(word) for word in text.split()]
        if len(values) != 3 or None in values:
            self.tell(element, key, f"{name}: expected 3 finite numbers, found '{shortened(text)}'")
            return default
        if any(abs(value or 0.0) > LARGEST[unit] for value in values):
            self.tell(element, key, f"{name}: expected at most {LARGEST[unit]:g}, found '{shortened(text)}'")
            return default
        return vector(value or 0.0 for value in values)

    def number(self, element: Element, key: str, name: str, default: float | None = None) -> float | None:
        """One number of an attribute; None where there is none, or what is there is none, which is told."""
        text = element.attributes.get(name)
        if text is None:
            return default
        value = _number(text)
        if value is None:
            self.tell(element, key, f"{name}: expected a finite number, found '{shortened(text)}'")
        return value

    def origin(self, element: Element, key: str) -> FrameOrigin:
        """The origin inside an element; none is at the same place."""
        stated = self.once(element, key, "origin")
        if stated is None:
            return FrameOrigin()
        self.attributes(stated, f"{key}: origin", ("xyz", "rpy"))
        still = (0.0, 0.0, 0.0)
        xyz = self.numbers(stated, f"{key}: origin", "xyz", still, "length")
        return FrameOrigin(xyz, self.numbers(stated, f"{key}: origin", "rpy", still, "angle"))

    def once(self, element: Element, key: str, tag: str) -> Element | None:
        """The one element of a tag inside another."""
        elements = list(element.all(tag))
        for again in elements[1:]:
            self.tell(again, key, f"<{tag}> is there twice, first in line {elements[0].line}")
        return elements[0] if elements else None

    def inertia(self, element: Element, key: str) -> Inertia | None:
        """A link's inertia."""
        self.misspelt(element, key, OF_A_LINK)
        inertial = self.once(element, key, "inertial")
        if inertial is None:
            return None
        self.misspelt(inertial, key, OF_A_MASS)
        com = self.origin(inertial, f"{key}: inertial").xyz
        mass = self.once(inertial, key, "mass")
        if mass is None or "value" not in mass.attributes:
            self.tell(mass or inertial, f"{key}: inertial", "missing: expected <mass value=…/>")
            return None
        value = self.number(mass, f"{key}: mass", "value")
        if value is not None and not 0 <= value <= LARGEST["mass"]:
            self.tell(mass, f"{key}: mass", f"expected 0 to {LARGEST['mass']:g} kg, found {value:g}")
            return None
        return None if value is None else Inertia(value, com)

    def joint(self, element: Element, name: str) -> UrdfJoint:
        """A joint."""
        key = f"joint '{name}'"
        self.misspelt(element, key, OF_A_JOINT)
        kind = element.attributes.get("type", "")
        if kind not in KINDS:
            found = f"found '{shortened(kind)}'{nearest(kind, KINDS)}" if kind else "found none"
            self.tell(element, key, f"type: expected one of {', '.join(KINDS)}, {found}")
        parent, child = (self.link(element, key, tag) for tag in ("parent", "child"))
        joint = UrdfJoint(name, kind, parent, child, element.line, self.origin(element, key))
        if kind not in MOVING:
            return joint
        limits, mimic = self.limits(element, key, kind), self.mimic(element, key)
        return replace(joint, axis=self.axis(element, key), limits=limits, mimic=mimic, drive=_drive(element))

    def link(self, element: Element, key: str, tag: str) -> str:
        """The name of a joint's parent or child; empty where it has none."""
        stated = self.once(element, key, tag)
        name = stated.attributes.get("link", "") if stated else ""
        if not name:
            self.tell(stated or element, key, f"missing: expected <{tag} link=…/>")
        return name

    def axis(self, element: Element, key: str) -> Vector:
        """A joint's axis, of length 1."""
        stated = self.once(element, key, "axis")
        if stated is None:
            return (1.0, 0.0, 0.0)
        self.attributes(stated, f"{key}: axis", ("xyz",))
        direction = np.array(self.numbers(stated, f"{key}: axis", "xyz", (1.0, 0.0, 0.0), "length"))
        length = float(np.linalg.norm(direction))
        if length < 1e-6:
            self.tell(stated, f"{key}: axis", "xyz: expected a direction, found one without length")
            return (1.0, 0.0, 0.0)
        return vector(direction / length)

    def limits(self, element: Element, key: str, kind: str) -> tuple[float, float] | None:
        """A joint's limits; those of a continuous joint do not count."""
        stated = self.once(element, key, "limit")
        if kind == "continuous":
            return None
        if stated is None:
            self.tell(element, key, f"missing: expected <limit lower=… upper=…/> of a {kind} joint")
            return None
        low, high = (self.number(stated, f"{key}: limit", name, 0.0) for name in ("lower", "upper"))
        if low is None or high is None:
            return None
        if not low < high:
            self.tell(stated, f"{key}: limit", f"expected lower < upper, found {low:g} and {high:g}")
            return None
        return low, high

    def mimic(self, element: Element, key: str) -> Mimic | None:
        """The joint that a joint follows."""
        stated = self.once(element, key, "mimic")
        if stated is None:
            return None
        self.attributes(stated, f"{key}: mimic", ("joint", "multiplier", "offset"))
        source = stated.attributes.get("joint", "")
        if not source:
            self.tell(stated, f"{key}: mimic", "missing: expected joint")
            return None
        multiplier = self.number(stated, f"{key}: mimic", "multiplier", 1.0)
        offset = self.number(stated, f"{key}: mimic", "offset", 0.0)
        return Mimic(source, 1.0 if multiplier is None else multiplier, offset or 0.0)


def _drive(element: Element) -> Drive:
    """A joint's drive, in which what is no number above 0 says nothing: calflow itself has no use for it."""
    attributes = next((limit.attributes for limit in element.all("limit")), {})
    effort, velocity = (_number(attributes.get(name, "")) for name in ("effort", "velocity"))
    return Drive(effort if (effort or 0) > 0 else None, velocity if (velocity or 0) > 0 else None)


def _number(word: str) -> float | None:
    """A finite number as XML Schema spells it."""
    try:
        value = float(word) if "_" not in word else math.nan
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _of_the_tree(document: Document) -> Iterator[Problem]:
    """Tell what keeps the links from being one tree."""
    joints = document.joints.values()
    if not joints:
        yield Problem("expected links and joints, found no joint", document.path, 1)
        return
    carriers: dict[str, UrdfJoint] = {}
    for joint in joints:
        key = f"joint '{joint.name}'"
        for tag, link in (("parent", joint.parent), ("child", joint.child)):
            if link and link not in document.links:
                message = f"{tag}: there is no link '{shortened(link)}'{nearest(link, document.links)}"
                yield Problem(message, document.path, joint.line, key)
        if joint.child in carriers:
            message = f"child: link '{joint.child}' hangs on joint '{carriers[joint.child].name}' already"
            yield Problem(message, document.path, joint.line, key)
        elif joint.child:
            carriers[joint.child] = joint
        if joint.mimic and joint.mimic.joint not in document.joints:
            message = f"mimic: there is no joint '{shortened(joint.mimic.joint)}'{nearest(joint.mimic.joint, document.joints)}"
            yield Problem(message, document.path, joint.line, key)
    yield from _circles(document, carriers)
    roots = [link for link in document.links if link not in carriers]
    if len(roots) > 1:
        yield Problem(f"expected one link that hangs on no joint, found {_several(roots)}", document.path, 1, "robot")


def _circles(document: Document, carriers: Mapping[str, UrdfJoint]) -> Iterator[Problem]:
    """Tell each circle of joints once."""
    done: set[str] = set()
    for start in carriers:
        way: list[str] = []
        link = start
        while link in carriers and link not in done:
            done.add(link)
            way.append(link)
            link = carriers[link].parent
        if link in way:
            circle = way[way.index(link) :]
            joint = carriers[circle[0]]
            message = f"hangs on itself, by way of links {_several(circle)}"
            yield Problem(message, document.path, joint.line, f"joint '{joint.name}'")


def _several(names: Sequence[str]) -> str:
    return listed([f"'{shortened(name)}'" for name in names], 10)


SUFFIX = ".urdf"


@dataclass(frozen=True)
class UrdfChain:
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
        bare = 0.0 if i == chain.ground - 1 else None  # the floor bears what stands on it
        joints.append(
            Joint(
                frame,
                kind="prismatic" if axes[i].slides else "revolute",
                limits=_own_limits(joint),
                mass=carried.mass if carried else bare,
                com=vector(tip_origin.rotation.T @ (np.array(com) - np.array(tip_origin.xyz))) if i == last else com,
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


def find_chain(document: Document, tip: str | None, base: str | None) -> UrdfChain:
    """Return the chain from a base link to a tip link.

    Raises:
        InputError: there are no such links, or no joints that calflow knows between them.
    """
    if tip is None:
        if len(document.leaves) > 1:
            raise refuse(f"expected tip, one of the links {', '.join(document.leaves)}", document.path)
        (tip,) = document.leaves
    start = document.root if base is None else base
    refuse_any(
        Problem(f"{role}: there is no link '{link}'{nearest(link, document.links)}", document.path)
        for role, link in (("base", start), ("tip", tip))
        if link not in document.links
    )
    above_base, above_tip = document.above(start), document.above(tip)
    common = sum(1 for _ in takewhile(lambda both: both[0] == both[1], zip(above_base, above_tip, strict=False)))
    chain = UrdfChain(document, start, tip, tuple(above_base[common:][::-1]), tuple(above_tip[common:]))
    problems = [_problem(chain, joint, f"calflow has no joint of type '{joint.kind}' between base and tip")
                for joint in chain.joints if joint.kind in ("floating", "planar")]  # fmt: skip
    names = [joint.name for joint in chain.moving]
    for joint in chain.moving:
        if joint.mimic and joint.mimic.joint not in names:
            message = f"mimic: expected a joint between base and tip, found '{joint.mimic.joint}'"
            problems.append(_problem(chain, joint, message))
        elif joint.mimic and document.joints[joint.mimic.joint].mimic:
            problems.append(_problem(chain, joint, f"mimic: joint '{joint.mimic.joint}' follows another itself"))
    if not names:
        problems.append(Problem(f"no joint moves between '{start}' and '{tip}'", document.path))
    refuse_any(problems)
    return chain


def _problem(chain: UrdfChain, joint: UrdfJoint, message: str) -> Problem:
    return Problem(message, chain.document.path, joint.line, f"joint '{joint.name}'")


def _origins(chain: UrdfChain) -> tuple[list[FrameOrigin], FrameOrigin]:
    """Each moving joint's origin in the frame of the one before (the first one's in the base), and the tip's in the last one's."""
    origins, at = [], FrameOrigin()
    for joint in chain.up:
        if joint.moves:
            origins.append(at)
            at = FrameOrigin()
        at = at.then(joint.origin.inverse)
    for joint in chain.down:
        at = at.then(joint.origin)
        if joint.moves:
            origins.append(at)
            at = FrameOrigin()
    return origins, at


def _couplings(chain: UrdfChain) -> tuple[Coupling, ...]:
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


def _gravity(chain: UrdfChain) -> Vector:
    """Gravity in the frame of what stands on the floor: along the root's z, all joints between them at zero.

    That frame is the base's, or that of the last of the joints that lead up.
    """
    last = next((joint for joint in reversed(chain.up) if joint.moves), None)
    turn = np.eye(3)
    for joint in chain.document.above(last.child if last else chain.base):
        turn = turn @ joint.origin.rotation
    return STANDARD_GRAVITY if np.array_equal(turn, np.eye(3)) else vector(turn.T @ np.array(STANDARD_GRAVITY))


def _carried(chain: UrdfChain) -> list[Inertia | None]:
    """What each moving joint's link weighs, with all that hangs on it by joints that are not of the chain, at their zero.

    In the joint's frame; None where no link of it has a mass.
    """
    beside: dict[str, list[tuple[str, FrameOrigin]]] = {}
    names = {joint.name for joint in chain.moving}
    for joint in chain.document.joints.values():
        if joint.name not in names:
            beside.setdefault(joint.parent, []).append((joint.child, joint.origin))
            beside.setdefault(joint.child, []).append((joint.parent, joint.origin.inverse))
    starts = [
        (joint.parent, joint.origin.inverse) if i < chain.ground else (joint.child, FrameOrigin())
        for i, joint in enumerate(chain.moving)
    ]
    return [_lumped(chain.document.links, beside, link, at) for link, at in starts]


def _lumped(
    links: Mapping[str, Inertia | None],
    beside: Mapping[str, Sequence[tuple[str, FrameOrigin]]],
    link: str,
    at: FrameOrigin,
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
