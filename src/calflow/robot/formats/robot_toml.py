"""robot.toml: the robot file, with units in its keys."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from calflow.files.problems import InputError, Problem, shortened
from calflow.files.toml import Angle, Angles3, FileModel, Length, Lengths3, Mass, Moment
from calflow.files.units import SUFFIXES, to_si
from calflow.robot.frames import CONVENTIONS, convention_of, follows
from calflow.robot.parts import STANDARD_GRAVITY, Bar, Base, Coupling, FourBar, Joint, Marker, Payload

UNKNOWN = "unknown"  # a payload's mass
UPRIGHT = 0.5  # cosine of a slide's angle to gravity from which it is no rail

Limits = tuple[float, float] | None


class DriveTable(FileModel):
    """What drives a joint, its limits and the mass of its link."""

    name: str = ""
    sign: Literal[1, -1] = 1
    limits_deg: Limits = None
    limits_mm: Limits = None
    limits_rad: Limits = None
    limits_m: Limits = None
    gear_ratio: float | None = Field(default=None, gt=0)
    rated_torque: Moment | None = Field(default=None, gt=0)
    mass: Mass | None = Field(default=None, ge=0)
    com: Lengths3 = (0.0, 0.0, 0.0)

    @field_validator("limits_deg", "limits_mm", "limits_rad", "limits_m")
    @classmethod
    def _in_order(cls, limits: Limits) -> Limits:
        if limits and not limits[0] < limits[1]:
            raise ValueError(f"expected lower < upper, found {limits[0]:g} and {limits[1]:g}")
        return limits

    @model_validator(mode="after")
    def _limits_once(self) -> Self:
        if (self.limits_deg and self.limits_rad) or (self.limits_mm and self.limits_m):
            raise ValueError("'limits' is given twice, in different units")
        return self

    @property
    def turns(self) -> Limits:
        """The limits of an angle, as they are given; None where none are."""
        return self.limits_deg or self.limits_rad

    @property
    def slides(self) -> Limits:
        """The limits of a position, as they are given; None where none are."""
        return self.limits_mm or self.limits_m

    @property
    def limits(self) -> Limits:
        """The limits in SI."""
        if self.limits_deg or self.limits_mm:
            low, high = self.limits_deg or self.limits_mm or (0.0, 0.0)
            return _in_si("deg" if self.limits_deg else "mm", low), _in_si("deg" if self.limits_deg else "mm", high)
        return self.limits_rad or self.limits_m


class JointTable(DriveTable):
    """One joint and the link it moves: five figures of its frame, and what drives it."""

    kind: Literal["revolute", "prismatic"] = "revolute"
    alpha: Angle = 0.0
    a: Length = 0.0
    d: Length = 0.0
    theta: Angle = 0.0
    beta: Angle = 0.0

    @model_validator(mode="after")
    def _limits_of_its_kind(self) -> Self:
        if self.kind == "prismatic" and (self.slides is None or self.turns is not None):
            raise ValueError("a prismatic joint needs limits_mm, and no limits_deg")
        if self.kind == "revolute" and self.slides is not None:
            raise ValueError("a revolute joint has limits_deg, not limits_mm")
        return self

    def part(self, convention: str) -> Joint:
        """Return the joint."""
        frame = CONVENTIONS[convention](alpha=self.alpha, a=self.a, d=self.d, theta=self.theta, beta=self.beta)
        same = ("kind", "limits", "sign", "gear_ratio", "rated_torque", "mass", "com", "name")
        return Joint(frame, **{name: getattr(self, name) for name in same})


class BarTable(FileModel):
    """A moving bar of the loop."""

    length: Length = Field(gt=0)
    mass: Mass | None = Field(default=None, ge=0)
    com: Lengths3 = (0.0, 0.0, 0.0)


class LoopTable(FileModel):
    """The four-bar loop."""

    joint: int = Field(ge=2)
    crank: BarTable
    rod: BarTable
    rocker: Length = Field(gt=0)
    offset: Angle = 0.0
    assembly: Literal["open", "crossed"] = "open"

    def part(self) -> FourBar:
        """Return the loop."""
        bars = {"crank": Bar(**vars(self.crank)), "rod": Bar(**vars(self.rod))}
        return FourBar(**{**vars(self), **bars})


class PayloadTable(FileModel):
    """A load on the flange."""

    mass: Mass | None = Field(ge=0)
    com: Lengths3 = (0.0, 0.0, 0.0)

    @field_validator("mass", mode="before")
    @classmethod
    def _or_unknown(cls, mass: Any) -> Any:
        if isinstance(mass, str) and mass != UNKNOWN:
            raise ValueError(f'expected a number or "{UNKNOWN}", found {shortened(repr(mass))}')
        return None if mass == UNKNOWN else mass


class MarkerTable(FileModel):
    """A measured point of the tool."""

    point: Lengths3
    relative_sd: Length | None = Field(default=None, gt=0)
    known: bool = True

    @model_validator(mode="after")
    def _one_or_the_other(self) -> MarkerTable:
        if self.relative_sd and not self.known:
            raise ValueError("a marker with relative_sd is known beside the first: expected known = true")
        return self


class BaseTable(FileModel):
    """Where the base stands."""

    origin: Lengths3 = (0.0, 0.0, 0.0)
    rotation: Angles3 = (0.0, 0.0, 0.0)
    known: bool = True


class CouplingTable(FileModel):
    """A reading that moves another joint too."""

    joint: int = Field(ge=1)
    source: int = Field(ge=1)
    factor: float


class Surroundings(FileModel):
    """What a robot file says besides the joints, whatever file states those."""

    name: str = ""
    notes: str = ""
    gravity: tuple[float, float, float] | None = None
    base: BaseTable = BaseTable()
    tool_rotation: Angles3 | None = None
    payloads: dict[str, PayloadTable] = {}
    markers: dict[str, MarkerTable] = Field(default={}, validate_default=True)

    @field_validator("markers")
    @classmethod
    def _one_marker(cls, markers: dict[str, MarkerTable]) -> dict[str, MarkerTable]:
        if not markers:
            raise ValueError("expected at least one marker, e.g. [markers.tool] with point_mm = [0, 0, 100]")
        if "base" in markers:
            raise ValueError("a marker cannot be called 'base': parameters are named by their part")
        if next(iter(markers.values())).relative_sd:
            raise ValueError("the first marker has no relative_sd: the others' places are relative to it")
        return markers

    def around(self) -> dict[str, Any]:
        """Return the fields of the robot that it states."""
        return {
            "notes": self.notes,
            "base": Base(**vars(self.base)),
            "tool_rotation": self.tool_rotation,
            "payloads": {name: Payload(**vars(payload)) for name, payload in self.payloads.items()},
            "markers": {name: Marker(**vars(marker)) for name, marker in self.markers.items()},
        }


class RobotFile(Surroundings):
    """A robot file as written."""

    name: str
    convention: Literal["dh", "modified-dh"]
    joints: tuple[JointTable, ...] = Field(min_length=1)
    couplings: tuple[CouplingTable, ...] = ()
    loop: LoopTable | None = None

    @field_validator("couplings")
    @classmethod
    def _coupled_joints_exist(
        cls, couplings: tuple[CouplingTable, ...], info: ValidationInfo
    ) -> tuple[CouplingTable, ...]:
        for coupling in couplings:
            _joint_exists(coupling.joint, info)
            _joint_exists(coupling.source, info)
        return couplings

    @field_validator("loop")
    @classmethod
    def _driven_joint_exists(cls, loop: LoopTable | None, info: ValidationInfo) -> LoopTable | None:
        if loop:
            _joint_exists(loop.joint, info)
        return loop

    @model_validator(mode="after")
    def _up_is_known(self) -> RobotFile:
        """A first joint that slides along the base's z is a lift, or a rail that takes what is said of no gravity along itself."""
        first = self.joints[0]
        upright = first.kind == "prismatic" and (
            self.convention == "dh" or abs(np.cos(first.alpha) * np.cos(first.beta)) > UPRIGHT
        )
        if upright and self.gravity is None:
            raise ValueError(
                "missing: expected gravity, in the base's axes: the first joint slides along the base's z, along which gravity "
                "acts where nothing is said; of a lift state [0, 0, -9.80665], of a rail e.g. [0, -9.80665, 0]"
            )
        return self

    def fields(self) -> dict[str, Any]:
        """Return the fields of the robot that the file states."""
        return {
            **self.around(),
            "name": self.name,
            "gravity": self.gravity or STANDARD_GRAVITY,
            "joints": tuple(joint.part(self.convention) for joint in self.joints),
            "couplings": tuple(Coupling(**vars(coupling)) for coupling in self.couplings),
            "loop": self.loop and self.loop.part(),
        }


def _joint_exists(joint: int, info: ValidationInfo) -> None:
    joints = info.data.get("joints")  # not there where they are wrong themselves
    if joints is not None and joint > len(joints):
        raise ValueError(f"there is no joint {joint}: this robot has joints 1 to {len(joints)}")


# --- Writing -----------------------------------------------------------------------------------------


def text(fields: Mapping[str, Any]) -> str:
    """Return the fields of a robot as the text of a robot file that reads back equal.

    Raises:
        InputError: its frames are not all of one convention.
    """
    return "\n".join(_lines(fields)) + "\n"


def _lines(fields: Mapping[str, Any]) -> Iterator[str]:
    """The file's lines; what is as it is where the file says nothing is left out."""
    joints: Sequence[Joint] = fields["joints"]
    yield from _entries({"name": fields["name"], "notes": fields["notes"] or None})
    yield f"convention = {json.dumps(_convention(fields['name'], joints))}"
    usual = fields["gravity"] == STANDARD_GRAVITY and joints[0].kind == "revolute"
    yield from _entries({"gravity": None if usual else fields["gravity"]})
    yield from _quantity("tool_rotation", fields["tool_rotation"], "angle")
    base: Base = fields["base"]
    if base != Base():
        yield from ("", "[base]")
        yield from _quantity("origin", base.origin, "length")
        yield from _quantity("rotation", base.rotation, "angle")
        yield from _entries({"known": None if base.known else False})
    for joint in joints:
        yield from ("", "[[joints]]", *_joint(joint))
    for coupling in fields["couplings"]:
        yield from ("", "[[couplings]]", *_entries(vars(coupling)))
    loop: FourBar | None = fields["loop"]
    if loop:
        yield from ("", "[loop]", *_entries({"joint": loop.joint, "assembly": loop.assembly}))
        yield from _quantity("rocker", loop.rocker, "length")
        yield from _quantity("offset", loop.offset or None, "angle")
        for name, bar in (("crank", loop.crank), ("rod", loop.rod)):
            yield from ("", f"[loop.{name}]", *_quantity("length", bar.length, "length"), *_mass(bar))
    for name, payload in fields["payloads"].items():
        yield from ("", f"[payloads.{_key(name)}]")
        yield from _entries({"mass_kg": UNKNOWN if payload.mass is None else None})
        yield from _mass(payload)
    for name, marker in fields["markers"].items():
        yield from ("", f"[markers.{_key(name)}]", *_quantity("point", marker.point, "length"))
        yield from _quantity("relative_sd", marker.relative_sd, "length")
        yield from _entries({"known": None if marker.known else False})


def _convention(name: str, joints: Sequence[Joint]) -> str:
    if found := convention_of([joint.frame for joint in joints]):
        return found
    own = [i for i, joint in enumerate(joints) if not any(follows(joint.frame, known) for known in CONVENTIONS)]
    reason = f"its frame is neither {' nor '.join(CONVENTIONS)}, which is all that a robot file can state"
    problems = [Problem(reason, key=f"robot '{name}': joints[{i + 1}]") for i in own]
    mixed = f"its joints follow different conventions ({', '.join(CONVENTIONS)}); a robot file states one"
    raise InputError(problems or [Problem(mixed, key=f"robot '{name}'")])


def _joint(joint: Joint) -> Iterator[str]:
    yield from _entries({"name": joint.name or None, "kind": None if joint.kind == "revolute" else joint.kind})
    for step in joint.frame.steps:
        yield from _quantity(step.symbol, step.value or None, "length" if step.is_length else "angle")
    yield from _quantity("limits", joint.limits, "angle" if joint.kind == "revolute" else "length")
    yield from _entries({"sign": None if joint.sign == 1 else joint.sign, "gear_ratio": joint.gear_ratio})
    yield from _quantity("rated_torque", joint.rated_torque, "moment")
    yield from _mass(joint)


def _mass(part: Joint | Bar | Payload) -> Iterator[str]:
    yield from _quantity("mass", part.mass, "mass")
    yield from _quantity("com", part.com if any(part.com) else None, "length")


def _entries(values: Mapping[str, Any]) -> Iterator[str]:
    return (f"{name} = {_value(value)}" for name, value in values.items() if value is not None)


def _quantity(name: str, value: Any, dimension: str) -> Iterator[str]:
    """A key with the unit that people use, where the figure in it reads back the same; else with the SI unit."""
    if value is None:
        return
    values = value if isinstance(value, tuple) else (value,)
    unit, figures = SUFFIXES[dimension][0], values
    everyday = {"length": "mm", "angle": "deg"}.get(dimension)
    if everyday:
        short = tuple(_short(v, everyday) for v in values)
        if all(_in_si(everyday, figure) == v for figure, v in zip(short, values, strict=True)):
            unit, figures = everyday, short
    yield f"{name}_{unit} = {_value(figures if isinstance(value, tuple) else figures[0])}"


def _short(value: float, unit: str) -> float:
    """The figure of fewest decimals that means an SI value in a unit, as near as one gets."""
    exact = value / to_si(unit)[0]
    shorter = (round(exact, digits) for digits in range(16))
    return next((figure for figure in shorter if _in_si(unit, figure) == value), exact)


def _in_si(unit: str, figure: float) -> float:
    factor, offset = to_si(unit)
    return factor * figure + offset


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value) if isinstance(value, bool | int) else repr(float(np.float64(value)))


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)
