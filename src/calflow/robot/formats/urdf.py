"""URDF: links and joints as they stand in the file, and the chain from a base link to a tip link with the masses on it.

With several tips it is a tree. Fixed joints are joined to the next moving one, and what hangs on a link by fixed joints counts
as part of it. The flange is the tip link. Up is the root link's z. Efforts and transmissions are not read: most files hold
numbers nobody meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from calflow.files.problems import InputError, Problem, nearest, refuse, refuse_any, truncated
from calflow.files.units import LARGEST
from calflow.files.words import listed
from calflow.files.xml import Element, read_xml
from calflow.robot.frames import Axis, FrameOrigin, Vector, joint_frame, vector
from calflow.robot.parts import BASE, STANDARD_GRAVITY, Coupling, Joint, Marker

MOVING = ("revolute", "continuous", "prismatic")
JOINT_TYPES = (*MOVING, "fixed", "floating", "planar")
OF_A_JOINT = ("origin", "parent", "child", "axis", "calibration", "dynamics", "limit", "mimic", "safety_controller")
OF_A_LINK = ("inertial", "visual", "collision")
OF_A_MASS = ("origin", "mass", "inertia")
XACRO = "is a xacro file: expected the URDF that `xacro FILE > robot.urdf` writes"
SUFFIX = ".urdf"


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
    if any(":" in element.tag and element.tag.startswith("xacro") for element in root.inside):
        reader.tell(root, "", XACRO)
        raise InputError(reader.problems)
    reader.misspelt(root, "robot", ("link", "joint", "material", "transmission", "gazebo"))
    links = reader.named(root, "link")
    joints = reader.named(root, "joint")
    read = {name: reader.inertia(element, f"link '{name}'") for name, element in links.items()}
    built = {name: reader.joint(element, name) for name, element in joints.items()}
    document = Document(path, root.attributes.get("name", path.stem), read, built)
    reader.problems.extend(_of_the_tree(document))
    refuse_any(sorted(reader.problems, key=lambda problem: problem.line or 0))
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
                self.tell(child, key, f"unknown element <{truncated(child.tag)}>{guess}")

    def attributes(self, element: Element, key: str, names: Sequence[str]) -> None:
        """Tell attributes that are unknown: they would mean something that is not read."""
        for name in element.attributes:
            if name not in names:
                self.tell(
                    element,
                    key,
                    f"unknown attribute '{truncated(name)}'{nearest(name, names)}; expected {', '.join(names)}",
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
            self.tell(element, key, f"{name}: expected 3 finite numbers, found '{truncated(text)}'")
            return default
        if any(abs(value or 0.0) > LARGEST[unit] for value in values):
            self.tell(element, key, f"{name}: expected at most {LARGEST[unit]:g}, found '{truncated(text)}'")
            return default
        return vector(value or 0.0 for value in values)

    def number(self, element: Element, key: str, name: str, default: float | None = None) -> float | None:
        """One number of an attribute; None where there is none, or what is there is none, which is told."""
        text = element.attributes.get(name)
        if text is None:
            return default
        value = _number(text)
        if value is None:
            self.tell(element, key, f"{name}: expected a finite number, found '{truncated(text)}'")
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
        if kind not in JOINT_TYPES:
            actual = f"found '{truncated(kind)}'{nearest(kind, JOINT_TYPES)}" if kind else "found none"
            self.tell(element, key, f"type: expected one of {', '.join(JOINT_TYPES)}, {actual}")
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
                message = f"{tag}: there is no link '{truncated(link)}'{nearest(link, document.links)}"
                yield Problem(message, document.path, joint.line, key)
        if joint.child in carriers:
            message = f"child: link '{joint.child}' hangs on joint '{carriers[joint.child].name}' already"
            yield Problem(message, document.path, joint.line, key)
        elif joint.child:
            carriers[joint.child] = joint
        if joint.mimic and joint.mimic.joint not in document.joints:
            message = f"mimic: there is no joint '{truncated(joint.mimic.joint)}'{nearest(joint.mimic.joint, document.joints)}"
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
    return listed([f"'{truncated(name)}'" for name in names], 10)


@dataclass(frozen=True)
class Way:
    """The joints from a base link to a tip link: up, against their direction, to the link of which both hang, and down."""

    tip: str
    up: tuple[UrdfJoint, ...]
    down: tuple[UrdfJoint, ...]

    @property
    def joints(self) -> tuple[UrdfJoint, ...]:
        """All, in order."""
        return (*self.up, *self.down)


@dataclass(frozen=True)
class UrdfTree:
    """The ways from a base link to one tip link or several, one that leads up the furthest first."""

    document: Document
    base: str
    ways: tuple[Way, ...]

    @property
    def joints(self) -> tuple[UrdfJoint, ...]:
        """All, way by way."""
        return tuple(dict.fromkeys(joint for way in self.ways for joint in way.joints))

    @property
    def moving(self) -> tuple[UrdfJoint, ...]:
        """Those that move, in order."""
        return tuple(joint for joint in self.joints if joint.moves)

    @property
    def up(self) -> tuple[UrdfJoint, ...]:
        """The joints against whose direction ways lead."""
        return self.ways[0].up

    @property
    def ground(self) -> int:
        """How many of those that move lead up: they carry what the base link is of, a work piece say."""
        return sum(joint.moves for joint in self.up)


Tips = str | Sequence[str] | None  # a link, or several


def read_urdf(path: Path, tip: Tips = None, base: str | None = None) -> dict[str, Any]:
    """Read a URDF file into the fields of a robot, with a marker at each tip.

    tip is a link or several, and may be left out where one link alone has no joint on it; base is the root link unless said
    otherwise.

    Raises:
        InputError: with all that is wrong in it.
    """
    tree = find_tree(read_document(path), tip, base)
    moving = tree.moving
    number = {joint.name: i for i, joint in enumerate(moving)}
    stands, tips = _stands(tree)
    before = [stands[joint.name][0] for joint in moving]
    # By a tip that is its flange.
    ended = {name: ends[0] for name, ends in tips.items() if len(ends) == 1 and name not in before}
    links = {joint.name: _link_name(tree, joint, ended) for joint in moving}
    axes = [
        Axis(vector(-np.array(joint.axis)) if i < tree.ground else joint.axis, joint.kind == "prismatic")
        for i, joint in enumerate(moving)
    ]
    joints = []
    for i, (joint, carried) in enumerate(zip(moving, _carried(tree), strict=True)):
        on, origin = stands[joint.name]
        parent = number[on] if on else -1
        flange = ended[joint.name][1] if joint.name in ended else None
        zero, axis_on = joint.mimic.offset if joint.mimic else 0.0, axes[parent] if on else None
        frame = joint_frame(origin, axes[i], axis_on, zero=zero, tip=flange, beside=on in before[:i])
        bare = 0.0 if i == tree.ground - 1 else None  # the floor bears what stands on it
        joints.append(
            Joint(
                frame, kind="prismatic" if axes[i].slides else "revolute", link=links[joint.name],
                parent="" if parent == i - 1 else links.get(on, BASE), limits=_own_limits(joint),
                mass=carried.mass if carried else bare, com=_centre(carried, flange), name=joint.name,
                driven=joint.mimic is None,
            )
        )  # fmt: skip
    markers = {
        tip: Marker((0.0, 0.0, 0.0) if name in ended else origin.xyz,
                    on="" if name == moving[-1].name else links.get(name, BASE))
        for name, ends in tips.items() for tip, origin in ends
    }  # fmt: skip
    return {
        "name": tree.document.name,
        "joints": tuple(joints),
        "gravity": _gravity(tree),
        "ground": tree.ground,
        "couplings": _couplings(tree),
        "markers": {way.tip: markers[way.tip] for way in tree.ways},
    }


def _centre(carried: Inertia | None, flange: FrameOrigin | None) -> Vector:
    """The centre of what a joint carries, in the frame of its flange if it has one."""
    com = carried.com if carried else (0.0, 0.0, 0.0)
    return vector(flange.rotation.T @ (np.array(com) - np.array(flange.xyz))) if flange else com


def _link_name(tree: UrdfTree, joint: UrdfJoint, ended: Mapping[str, tuple[str, FrameOrigin]]) -> str:
    """The name of the link that a joint moves: the tip's that is its flange, else its own."""
    link = joint.parent if joint in tree.up else joint.child
    name = ended[joint.name][0] if joint.name in ended else link
    return f"{name}_link" if name == BASE else name


def find_tree(document: Document, tip: Tips, base: str | None) -> UrdfTree:
    """Return the ways from a base link to a tip link, or to several.

    Raises:
        InputError: there are no such links, or no joints that calflow knows between them.
    """
    if not tip:
        if len(document.leaves) > 1:
            raise refuse(f"expected tip, one of the links {', '.join(document.leaves)}, or several", document.path)
        tip = document.leaves
    tips = (tip,) if isinstance(tip, str) else tuple(dict.fromkeys(tip))
    start = document.root if base is None else base
    refuse_any(
        Problem(f"{role}: there is no link '{link}'{nearest(link, document.links) or others}", document.path)
        for role, link, others in (
            ("base", start, f"; its root is '{document.root}'"),
            *(("tip", tip, f"; its chains end in {listed(document.leaves)}") for tip in tips),
        )
        if link not in document.links
    )
    ways = sorted((_way(document, start, tip) for tip in tips), key=lambda way: -len(way.up))
    tree = UrdfTree(document, start, tuple(ways))
    problems = [_problem(tree, joint, f"calflow has no joint of type '{joint.kind}' between base and tip")
                for joint in tree.joints if joint.kind in ("floating", "planar")]  # fmt: skip
    names = [joint.name for joint in tree.moving]
    for joint in tree.moving:
        if joint.mimic and joint.mimic.joint not in names:
            message = f"mimic: expected a joint between base and tip, found '{joint.mimic.joint}'"
            problems.append(_problem(tree, joint, message))
        elif joint.mimic and document.joints[joint.mimic.joint].mimic:
            problems.append(_problem(tree, joint, f"mimic: joint '{joint.mimic.joint}' follows another itself"))
    if not names:
        problems.append(Problem(f"no joint moves between '{start}' and '{', '.join(tips)}'", document.path))
    refuse_any(problems)
    return tree


def _way(document: Document, base: str, tip: str) -> Way:
    """The way from a base link to a tip link."""
    above_base, above_tip = document.above(base), document.above(tip)
    common = sum(1 for _ in takewhile(lambda both: both[0] == both[1], zip(above_base, above_tip, strict=False)))
    return Way(tip, tuple(above_base[common:][::-1]), tuple(above_tip[common:]))


def _problem(tree: UrdfTree, joint: UrdfJoint, message: str) -> Problem:
    return Problem(message, tree.document.path, joint.line, f"joint '{joint.name}'")


# By a joint's name: the moving joint that it is on, or "", and where it is in that one.
Stands = dict[str, tuple[str, FrameOrigin]]


def _stands(tree: UrdfTree) -> tuple[Stands, dict[str, list[tuple[str, FrameOrigin]]]]:
    """Where each moving joint is in the frame of the one that it is on, and by these the tips on each (by "" those on the base)."""
    stands: Stands = {}
    tips: dict[str, list[tuple[str, FrameOrigin]]] = {}
    for way in tree.ways:
        on, at = "", FrameOrigin()
        for joint in way.joints:
            up = joint in way.up
            at = at if up else at.then(joint.origin)
            if joint.moves:
                stands[joint.name] = on, at
                on, at = joint.name, FrameOrigin()
            at = at.then(joint.origin.inverse) if up else at
        tips.setdefault(on, []).append((way.tip, at))
    return stands, tips


def _couplings(tree: UrdfTree) -> tuple[Coupling, ...]:
    """What joints that follow others have from those."""
    number = {joint.name: i + 1 for i, joint in enumerate(tree.moving)}
    return tuple(
        Coupling(number[joint.name], number[joint.mimic.joint], joint.mimic.multiplier)
        for joint in tree.moving
        if joint.mimic
    )


def _own_limits(joint: UrdfJoint) -> tuple[float, float] | None:
    """A joint's limits; what follows another counts from its offset, which is its zero."""
    if joint.limits is None or joint.mimic is None:
        return joint.limits
    low, high = joint.limits
    return low - joint.mimic.offset, high - joint.mimic.offset


def _gravity(tree: UrdfTree) -> Vector:
    """Gravity in the frame of what stands on the floor: along the root's z, all joints between them at zero.

    That frame is the base's, or that of the last of the joints that lead up.
    """
    last = next((joint for joint in reversed(tree.up) if joint.moves), None)
    turn = np.eye(3)
    for joint in tree.document.above(last.child if last else tree.base):
        turn = turn @ joint.origin.rotation
    return STANDARD_GRAVITY if np.array_equal(turn, np.eye(3)) else vector(turn.T @ np.array(STANDARD_GRAVITY))


def _carried(tree: UrdfTree) -> list[Inertia | None]:
    """What each moving joint's link weighs, with all that hangs on it by joints that are not of the tree, at their zero.

    In the joint's frame; None where no link of it has a mass.
    """
    beside: dict[str, list[tuple[str, FrameOrigin]]] = {}
    names = {joint.name for joint in tree.moving}
    for joint in tree.document.joints.values():
        if joint.name not in names:
            beside.setdefault(joint.parent, []).append((joint.child, joint.origin))
            beside.setdefault(joint.child, []).append((joint.parent, joint.origin.inverse))
    starts = [
        (joint.parent, joint.origin.inverse) if i < tree.ground else (joint.child, FrameOrigin())
        for i, joint in enumerate(tree.moving)
    ]
    return [_lumped(tree.document.links, beside, link, at) for link, at in starts]


def _lumped(
    links: Mapping[str, Inertia | None],
    beside: Mapping[str, Sequence[tuple[str, FrameOrigin]]],
    link: str,
    at: FrameOrigin,
) -> Inertia | None:
    """The inertia of a link that stands at an origin, and of all that is joined to it but by the joints of the tree."""
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
