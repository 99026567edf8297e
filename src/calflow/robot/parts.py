"""The parts of a robot, in SI: joints with links, the loop, payloads, markers, base and couplings, with their checks.

Errors of the nominal values, and effects of a real robot, are parameters: bounded decision variables of the graph.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Generic, Literal, Protocol, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, InstanceOf, ValidationInfo, field_validator, model_validator
from pydantic import Field as Rule
from pydantic.functional_validators import ModelWrapValidatorHandler
from pydantic_core import PydanticCustomError

from calflow.files.problems import nearest, truncated
from calflow.files.toml import (
    UNKNOWN,
    Angle,
    Angles3,
    Length,
    Lengths3,
    LinkLength,
    LinkPoint,
    Mass,
    Message,
    Moment,
    Record,
    Unit,
    refuse_all,
)
from calflow.robot.frames import Frame, Step, Vector

STANDARD_GRAVITY: Vector = (0.0, 0.0, -9.80665)  # m/s²
# Prior standard deviations and bounds [m and rad] of what stands at a stated place, and of what is placed by measurements.
PLACED_SD, PLACED_BOUND = 20e-3, 0.2
UNKNOWN_SD, UNKNOWN_BOUND = 0.5, 3.0
MOST_EXTERNAL = 6  # largest number of an external axis
BASE = "base"  # the link that no joint moves
Thing = TypeVar("Thing")
IN_FILES = {"revolute": ("limits_deg", "limits_rad"), "prismatic": ("limits_mm", "limits_m")}


class Named(Mapping[str, Thing], Generic[Thing]):
    """An immutable mapping from names to things, in significant order."""

    def __init__(self, things: Mapping[str, Thing] | Iterable[tuple[str, Thing]] = ()) -> None:
        self._things = dict(things)

    def __getitem__(self, name: str) -> Thing:
        return self._things[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._things)

    def __len__(self) -> int:
        return len(self._things)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mapping) and list(self.items()) == list(other.items())

    def __hash__(self) -> int:
        return hash(tuple(self.items()))

    def __repr__(self) -> str:
        return repr(self._things)


def _or_unknown(schema: dict[str, Any]) -> None:
    """Extend the JSON schema of a number by the marker of an unknown value."""
    number = {key: schema.pop(key) for key in ("type", "minimum")}
    schema["anyOf"] = [number, {"const": UNKNOWN}]


def _of_the_robot(joint: int, info: ValidationInfo) -> int:
    """Reject the number of a joint or link beyond the last, when a whole robot is validated."""
    last = (info.context or {}).get("n_joints", joint)
    if joint > last:
        what = "link" if info.field_name == "ground" else "joint"
        first = 0 if what == "link" else 1
        raise ValueError(f"there is no {what} {joint}: this robot has {what}s {first} to {last}")
    return joint


def _whole(value: Any) -> Any:
    """Reject floats and booleans, which may equal integers."""
    if isinstance(value, float | bool):
        raise PydanticCustomError("int_type", "expected a whole number")
    return value


def _link_of_the_robot(link: str, info: ValidationInfo) -> str:
    """Reject an unknown link, when a whole robot is validated."""
    links = (info.context or {}).get("links", ())
    if link and links and link not in links:
        raise ValueError(f"there is no link '{truncated(link)}'{nearest(link, links)}; there are {', '.join(links)}")
    return link


def link_names(stated: Iterable[str]) -> tuple[str, ...]:
    """Return the names of all links, the base first, from those stated by joints for the links that they move."""
    return (BASE, *(name or f"link{i}" for i, name in enumerate(stated, start=1)))


LinkName = Annotated[str, AfterValidator(_link_of_the_robot)]
JointNumber = Annotated[int, Rule(ge=1), AfterValidator(_of_the_robot)]
Weight = Annotated[Mass | None, Rule(ge=0)]
MaybeLength = Annotated[Length | None, Rule(gt=0)]
Limits = tuple[float, float] | None


@dataclass(frozen=True, kw_only=True)
class JointProperties(Record):
    """A joint's drive and limits, and the mass of its link, without the joint's frame.

    limits: of the joint variable, after sign and couplings [rad, or m if prismatic]; rated_torque [Nm, or N]; mass
    [kg]; com [m]: centre of mass in the link's frame; sign: the factor of readings. A joint that is not driven has no
    reading: it follows others by couplings. external: its number as an external axis of the controller (a rail, a
    turntable), which corrections leave where it is commanded.
    """

    limits: Annotated[Limits, Unit("joint variable")] = None
    sign: Annotated[Literal[1, -1], BeforeValidator(_whole)] = 1
    gear_ratio: Annotated[float | None, Rule(gt=0)] = None
    rated_torque: Annotated[Moment | None, Rule(gt=0)] = None
    mass: Weight = None
    com: LinkPoint = (0.0, 0.0, 0.0)
    name: str = ""
    driven: bool = True
    external: Annotated[int | None, Rule(ge=1, le=MOST_EXTERNAL)] = None

    @field_validator("limits")
    @classmethod
    def _in_order(cls, limits: Limits) -> Limits:
        if limits and not limits[0] < limits[1]:
            raise PydanticCustomError("order", "expected lower < upper")
        return limits

    @model_validator(mode="wrap")
    @classmethod
    def _limits_of_its_kind(cls, raw: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        made = handler(raw)
        kind = getattr(made, "kind", None) or (info.context or {}).get("kinds", {}).get(made.name)
        keys = raw if isinstance(raw, dict) else {}
        if kind == "revolute" and any(key in keys for key in IN_FILES["prismatic"]):
            raise ValueError("a revolute joint has limits_deg, not limits_mm")
        if kind == "prismatic" and any(key in keys for key in IN_FILES["revolute"]):
            raise ValueError("a prismatic joint needs limits_mm, and no limits_deg")
        if kind == "prismatic" and hasattr(made, "kind") and made.limits is None:
            raise ValueError(f"a prismatic joint needs {'limits_mm' if keys else 'limits [m]'}")
        return made


@dataclass(frozen=True)
class Joint(JointProperties):
    """One joint and the link that it moves.

    link: that link's name, by default `link1` … by the joint's number; parent: the link that carries the joint, by
    default that of the previous joint, or `base` for the first.
    """

    kind: Literal["revolute", "prismatic"] = field(default="revolute", kw_only=True)
    link: str = field(default="", kw_only=True)
    parent: LinkName = field(default="", kw_only=True)
    frame: InstanceOf[Frame]

    @field_validator("frame")
    @classmethod
    def _can_be_moved(cls, frame: Frame) -> Frame:
        refuse_all(_frame_messages(frame))
        return frame

    @model_validator(mode="after")
    def _can_slide(self) -> Self:
        if self.kind == "prismatic" and self.frame.slide is None:
            refuse_all([(("frame",), "expected a shift along z in its body, along which a prismatic joint moves")])
        return self

    @property
    def moving(self) -> Step:
        """The step of its frame to which the joint variable is added."""
        return self.frame.turn if self.kind == "revolute" or self.frame.slide is None else self.frame.slide

    @property
    def range(self) -> tuple[float, float]:
        """Lower and upper limit [rad, or m for a prismatic joint]; a full turn if not stated."""
        return self.limits or (-np.pi, np.pi)

    @property
    def unit(self) -> Literal["rad", "m"]:
        """The unit of the joint's variable and of its errors."""
        return "rad" if self.kind == "revolute" else "m"

    @property
    def load_unit(self) -> Literal["Nm", "N"]:
        """The unit of its torque or force."""
        return "Nm" if self.kind == "revolute" else "N"

    @property
    def shown(self) -> tuple[Literal["deg", "mm"], float]:
        """The display unit of the joint's variable, and the factor from rad or m to it."""
        return ("deg", float(np.rad2deg(1.0))) if self.kind == "revolute" else ("mm", 1e3)

    @property
    def noun(self) -> Literal["angle", "position"]:
        """The name of the joint's variable."""
        return "angle" if self.kind == "revolute" else "position"


def _frame_messages(frame: Frame) -> Iterator[Message]:
    symbols = [step.symbol for step in frame.steps]
    for step in frame.steps:
        if isinstance(step.value, bool) or not isinstance(step.value, int | float) or not math.isfinite(step.value):
            yield (step.symbol,), f"expected a finite number, found {step.value!r}"
    for symbol in {symbol for symbol in symbols if symbols.count(symbol) > 1}:
        yield (), f"expected each symbol once in a frame, found '{symbol}' again"
    if frame.turn.motion != "rz":
        yield ("turn",), f"expected a turn about z, found {frame.turn.motion}"


@dataclass(frozen=True)
class Bar(Record):
    """A moving bar of the loop: its length [m], and mass [kg] and centre along it and across it [m]."""

    length: Annotated[LinkLength, Rule(gt=0)]
    mass: Weight = None
    com: LinkPoint = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class FourBar(Record):
    """A four-bar loop PQRS that drives a joint (counted from 1) from a motor on the joint before it; m and rad.

    P lies on the axis of the joint before, S on the driven joint's axis. The crank PQ turns with the motor, the rod QR
    pushes the rocker RS, which is part of the driven link. Angles are measured in the plane across the two axes.
    """

    joint: Annotated[int, Rule(ge=2), AfterValidator(_of_the_robot)]
    crank: Bar
    rod: Bar
    rocker: Annotated[LinkLength, Rule(gt=0)]
    offset: Angle = 0.0
    assembly: Literal["open", "crossed"] = "open"


@dataclass(frozen=True)
class Payload(Record):
    """A payload on a link (by default the flange): mass [kg], None if unknown, and centre in the link's frame [m]."""

    mass: Annotated[Mass | None, Rule(ge=0, json_schema_extra=_or_unknown)]
    com: LinkPoint = (0.0, 0.0, 0.0)
    on: LinkName = ""

    @field_validator("mass", mode="before")
    @classmethod
    def _may_be_unknown(cls, mass: Any) -> Any:
        if isinstance(mass, str) and mass != UNKNOWN:
            raise ValueError(f'expected a number or "{UNKNOWN}", found {truncated(repr(mass))}')
        return None if mass == UNKNOWN else mass


@dataclass(frozen=True)
class Marker(Record):
    """A measured point of the tool, in the frame of the link that carries it [m], by default the flange.

    relative_sd [m]: standard deviation of its position relative to the first marker, if the tool was measured by itself;
    known: if false, its position is estimated from the training poses alone.
    """

    point: LinkPoint
    relative_sd: MaybeLength = None
    known: bool = True
    on: LinkName = ""

    @model_validator(mode="after")
    def _known_one_way(self) -> Self:
        if self.relative_sd and not self.known:
            raise ValueError("a marker with relative_sd is known beside the first: expected known = true")
        return self


@dataclass(frozen=True)
class StatedBase(Record):
    """The base's pose in the measuring device's frame [m and rad, about x, y and z in turn], as stated in files."""

    origin: Lengths3 = (0.0, 0.0, 0.0)
    rotation: Angles3 = (0.0, 0.0, 0.0)
    known: bool = True


@dataclass(frozen=True)
class Base(StatedBase):
    """The base's pose in the measuring device's frame [m and rad, about x, y and z in turn].

    fixed: whether it is the measuring frame itself, because no device observes the robot from outside: it has no
    errors.
    """

    fixed: bool = False


@dataclass(frozen=True)
class Expected(Record):
    """A prior stated for a parameter before this robot is measured, in SI; None keeps the effect's default.

    The parameter is identified by name, or by effect, part and symbol as in tables of parameters (for effects without
    variants). mean, sd: of its prior, as from other robots of the type; lower, upper: its bounds; fixed: whether it is
    held at value, by default at nominal.
    """

    effect: str = ""
    part: str = ""
    symbol: str = ""
    unit: str = ""
    mean: float | None = None
    sd: float | None = None
    name: str = ""
    lower: float | None = None
    upper: float | None = None
    fixed: bool = False
    value: float | None = None

    @model_validator(mode="wrap")
    @classmethod
    def _as_tables_state_it(cls, raw: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Validate a table; statements from Python or a study are validated against the existing parameters."""
        made = handler(raw)
        if isinstance(raw, dict):
            refuse_all(_table_messages(made, raw))
        return made

    @property
    def key(self) -> str | tuple[str, str, str, str]:
        """The parameter's key: its name, or its identity."""
        return self.name or (self.effect, "", self.part, self.symbol)


def _table_messages(expected: Expected, keys: Mapping[str, Any]) -> Iterator[Message]:
    identity = (expected.effect, expected.part, expected.symbol)
    if "unit" not in keys:
        yield (), "missing: expected 'unit'"
    if not (expected.name or all(identity)) or (expected.name and any(identity)):
        yield (), "missing: expected effect, part and symbol of a parameter, or its name"
    if expected.sd is not None and expected.sd <= 0:
        yield ("sd",), f"expected a number greater than 0, found {expected.sd:g}"
    if (expected.mean is None) != (expected.sd is None):
        yield (), "expected mean and sd together"
    if expected.value is not None and not expected.fixed:
        yield (), "value is where a parameter is held: expected fixed = true beside it"
    if not expected.fixed and expected.mean is expected.lower is expected.upper is None:
        yield (), "missing: expected mean and sd, lower, upper, or fixed = true"


@dataclass(frozen=True)
class Coupling(Record):
    """A joint reading that also moves another joint: q[joint] += factor * reading[source]; joints count from 1."""

    joint: JointNumber
    source: JointNumber
    factor: float


@dataclass(frozen=True, kw_only=True)
class Surroundings(Record):
    """The parts of a robot besides its joints, shared by all ways to state these."""

    name: str = ""
    notes: str = ""
    gravity: Vector | None = None
    base: StatedBase = StatedBase()
    tool_rotation: Angles3 | None = None
    couplings: tuple[Coupling, ...] = ()
    payloads: Mapping[str, Payload] = field(default_factory=Named)
    markers: Annotated[Mapping[str, Marker], Rule(validate_default=True)] = field(default_factory=Named)
    expected: tuple[Expected, ...] = ()

    @field_validator("payloads", "markers")
    @classmethod
    def _named(cls, things: Mapping[str, Any]) -> Named[Any]:
        return Named(things)

    @field_validator("markers")
    @classmethod
    def _markers_have_a_first(cls, markers: Mapping[str, Marker]) -> Mapping[str, Marker]:
        refuse_all(_marker_messages(markers))
        return markers


def _marker_messages(markers: Mapping[str, Marker]) -> Iterator[Message]:
    if not markers:
        yield (
            (),
            "expected at least one marker, the point that is measured: [markers.tool] with point_mm = [0, 0, 100], say",
        )
    if "base" in markers:
        yield (), "a marker cannot be called 'base': parameters are named by their part"
    first = next(iter(markers.values()), None)
    if first and first.relative_sd:
        yield (), "the first marker has no relative_sd: the others' places are relative to it"
    for name, marker in markers.items():
        if first and marker.relative_sd and marker.on != first.on:
            yield (name, "on"), "a marker with relative_sd is on the first one's link"


@dataclass(frozen=True)
class RobotParts(Surroundings):
    """All parts of a robot."""

    joints: tuple[Joint, ...]
    name: str = field(default="robot", kw_only=True)
    gravity: Vector = field(default=STANDARD_GRAVITY, kw_only=True)
    ground: Annotated[int, Rule(ge=0), AfterValidator(_of_the_robot)] = field(default=0, kw_only=True)
    base: Base = field(default=Base(), kw_only=True)
    loop: FourBar | None = field(default=None, kw_only=True)

    @field_validator("joints", mode="before")
    @classmethod
    def _has_joints(cls, joints: Any) -> Any:
        if not isinstance(joints, tuple) or not joints:
            raise ValueError(f"expected at least one Joint, found {joints!r}")
        return joints

    @model_validator(mode="after")
    def _driven(self) -> Self:
        refuse_all(tree_messages(self.joints, self.loop))
        refuse_all(_drive_messages(self))
        return self


class OnALink(Protocol):
    """A joint with the stated names of its own and its parent link."""

    @property
    def link(self) -> str: ...
    @property
    def parent(self) -> str: ...


def parent_links(joints: Sequence[OnALink]) -> tuple[int, ...]:
    """Return the number of each joint's parent link, 0 for the base; ValueError for an unknown name."""
    names = link_names(joint.link for joint in joints)
    return tuple(names.index(joint.parent) if joint.parent else i for i, joint in enumerate(joints))


def tree_messages(joints: Sequence[OnALink], loop: FourBar | None) -> Iterator[Message]:
    """Yield why joints do not form a tree in which each joint comes after its parent."""
    names = link_names(joint.link for joint in joints)
    for i, joint in enumerate(joints):
        if names.index(names[i + 1]) <= i:
            yield ("joints", i, "link"), f"several links are called '{truncated(names[i + 1])}'"
        if joint.parent and joint.parent not in names[: i + 1]:
            there = f"there is no link '{truncated(joint.parent)}' before joint {i + 1}"
            yield (
                ("joints", i, "parent"),
                f"{there}{nearest(joint.parent, names)}; there are {', '.join(names[: i + 1])}",
            )
            return
    if loop and loop.joint <= len(joints):
        on = parent_links(joints)
        if on[loop.joint - 1] != loop.joint - 1 or on.count(loop.joint - 1) > 1:
            yield ("loop", "joint"), f"expected a joint that is on the link of joint {loop.joint - 1}, alone"


def _drive_messages(robot: RobotParts) -> Iterator[Message]:
    """Yield problems of joints that follow others, and of external axes."""
    external = [joint.external for joint in robot.joints if joint.external is not None]
    for number in sorted({axis for axis in external if external.count(axis) > 1}):
        yield ("joints",), f"several joints are external axis {number}"
    if len(external) == len(robot.joints):
        yield ("joints",), "all joints are external axes: expected an arm"
    followers = {i for i, joint in enumerate(robot.joints, start=1) if not joint.driven}
    for joint in sorted(followers - {coupling.joint for coupling in robot.couplings}):
        yield ("joints", joint - 1), "is not driven, and no coupling moves it: expected one"
    for i, coupling in enumerate(robot.couplings):
        if coupling.source in followers:
            yield ("couplings", i, "source"), f"joint {coupling.source} follows another itself: expected a driven joint"
    if robot.loop and followers & {robot.loop.joint, robot.loop.joint - 1}:
        yield ("loop", "joint"), "a joint of the loop is not driven: expected one with a motor"


@dataclass(frozen=True)
class Parameter:
    """A bounded decision variable (SI units); at its nominal value the effect is absent.

    The prior is a normal distribution with mean prior_mean (nominal unless the robot file states another) and standard
    deviation prior_sd, truncated at the bounds. Parameters of one part are included or excluded together; joint: number
    of its joint or link, 0 for none; figure: the maker's value to which it is added, for tables that show the sum;
    meaning: in words; of_size: whether it is the relative error of the size of what is measured, such as a board's; held:
    its value if it is constant and no variable. Effect, variant, part and symbol are its
    identity, unique in a model like its name; variant and tag, which stands between part and symbol in the name, are
    set by the declaring part.
    """

    effect: str
    part: str
    symbol: str
    unit: str
    prior_sd: float
    lower: float
    upper: float
    nominal: float = 0.0
    figure: float = 0.0
    meaning: str = ""
    joint: int = 0
    variant: str = ""
    tag: str = ""
    prior_mean: float = 0.0
    held: float | None = None
    of_size: bool = False

    @property
    def identity(self) -> tuple[str, str, str, str]:
        """Its unique key: effect, variant, part and symbol."""
        return self.effect, self.variant, self.part, self.symbol

    @property
    def name(self) -> str:
        """The name in tables, e.g. `joint2.alpha` or `joint3.joint-eccentricity[order 2].cos`."""
        return ".".join(filter(None, (self.part, self.tag, self.symbol)))

    def as_expected(self, expected: Mapping[str | tuple[str, str, str, str], Expected]) -> Parameter:
        """Return the parameter with the prior stated for its identity, if any, and then for its name."""
        parameter = self
        for key in (self.identity, self.name) if expected else ():
            if stated := expected.get(key):
                parameter = parameter._stated(stated)
        return parameter

    def _stated(self, by: Expected) -> Parameter:
        return replace(
            self,
            prior_mean=_either(by.mean, self.prior_mean),
            prior_sd=_either(by.sd, self.prior_sd),
            lower=_either(by.lower, self.lower),
            upper=_either(by.upper, self.upper),
            held=_either(by.value, self.nominal) if by.fixed else None,
        )

    def contradiction(self, by: Expected) -> str:
        """Return why a stated prior contradicts the parameter; empty if it does not."""
        after = self._stated(by)
        lower, upper = after.lower, after.upper
        if by.unit not in ("", self.unit):
            return f"parameter '{self.name}' is in {self.unit}, not {by.unit}"
        if lower >= upper:
            return f"parameter '{self.name}': expected lower < upper, found {lower:g} and {upper:g} {self.unit}"
        for value in (by.mean, after.held):
            if value is not None and not lower <= value <= upper:
                return f"parameter '{self.name}' is between {lower:g} and {upper:g} {self.unit}, expected {value:g}"
        if by.mean is None and after.held is None and not lower <= after.prior_mean <= upper:
            return (
                f"parameter '{self.name}' is expected about {after.prior_mean:g} {self.unit}, which is not between "
                f"{lower:g} and {upper:g}: expected a prior's mean that is"
            )
        return ""


def _either(stated: float | None, otherwise: float) -> float:
    return otherwise if stated is None else stated
