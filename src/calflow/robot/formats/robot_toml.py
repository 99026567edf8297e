"""robot.toml: the robot file, with units in its keys."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from calflow.files.problems import shortened
from calflow.files.toml import Angle, Angles3, FileModel, Length, Lengths3, Mass, Moment
from calflow.files.units import in_si
from calflow.robot.frames import CONVENTIONS, Frame, Motion, Place, Step
from calflow.robot.parts import STANDARD_GRAVITY, Bar, Base, Coupling, Expected, FourBar, Joint, Marker, Payload

UNKNOWN = "unknown"  # a payload's mass
OWN_FRAMES = "frames"  # the convention of a robot whose frames follow none
PARTS = ("reach", "mount", "turn", "body")  # of a frame, in order
CONVENTIONAL = ("alpha", "a", "d", "theta", "beta")
UPRIGHT = 0.5  # cosine of a slide's angle to gravity from which it is no rail

Limits = tuple[float, float] | None


def _whole(value: Any) -> Any:
    """Return a value that is no number with a point, nor true, which are equal to whole ones."""
    if isinstance(value, float | bool):
        raise PydanticCustomError("int_type", "expected a whole number")
    return value


Sign = Annotated[Literal[1, -1], BeforeValidator(_whole)]


class DriveTable(FileModel):
    """What drives a joint, its limits and the mass of its link."""

    name: str = ""
    sign: Sign = 1
    limits_deg: Limits = None
    limits_mm: Limits = None
    limits_rad: Limits = None
    limits_m: Limits = None
    gear_ratio: float | None = Field(default=None, gt=0)
    rated_torque: Moment | None = Field(default=None, gt=0)
    mass: Mass | None = Field(default=None, ge=0)
    com: Lengths3 = (0.0, 0.0, 0.0)
    driven: bool = True
    external: int | None = Field(default=None, ge=1)

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
            return in_si("deg" if self.limits_deg else "mm", low), in_si("deg" if self.limits_deg else "mm", high)
        return self.limits_rad or self.limits_m


class StepTable(FileModel):
    """An elementary transform of a frame that follows no convention: a shift along an axis or a turn about it."""

    part: Literal["reach", "mount", "turn", "body"]
    motion: Motion
    symbol: str
    shift: Length | None = None
    turn: Angle | None = None
    free: tuple[Place, ...] = ()

    @model_validator(mode="after")
    def _of_its_motion(self) -> Self:
        own, other = ("shift", self.turn) if self.motion[0] == "t" else ("turn", self.shift)
        if other is not None:
            raise ValueError(f"a motion {self.motion} has {own}_{'mm' if own == 'shift' else 'deg'}, nothing else")
        return self

    @property
    def step(self) -> Step:
        """The step."""
        return Step(self.motion, self.symbol, self.shift or self.turn or 0.0, self.free)


class JointTable(DriveTable):
    """One joint and the link it moves: five figures of its frame, or all steps of it, and what drives it."""

    kind: Literal["revolute", "prismatic"] = "revolute"
    alpha: Angle = 0.0
    a: Length = 0.0
    d: Length = 0.0
    theta: Angle = 0.0
    beta: Angle = 0.0
    steps: tuple[StepTable, ...] = ()
    listed: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _one_frame(self) -> Self:
        if not self.steps:
            return self
        if figures := sorted({*CONVENTIONAL} & self.model_fields_set):
            raise ValueError(f"'{figures[0]}' is of a convention: a joint stated by its steps has none")
        parts = [step.part for step in self.steps]
        if parts != sorted(parts, key=PARTS.index) or parts.count("turn") != 1:
            raise ValueError("steps: expected those of reach, then of mount, one of turn, then those of body")
        return self

    @model_validator(mode="after")
    def _limits_of_its_kind(self) -> Self:
        if self.kind == "prismatic" and (self.slides is None or self.turns is not None):
            raise ValueError("a prismatic joint needs limits_mm, and no limits_deg")
        if self.kind == "revolute" and self.slides is not None:
            raise ValueError("a revolute joint has limits_deg, not limits_mm")
        return self

    def part(self, convention: str) -> Joint:
        """Return the joint."""
        if convention == OWN_FRAMES:
            frame = self._own_frame()
        else:
            frame = CONVENTIONS[convention](**{name: getattr(self, name) for name in CONVENTIONAL})
        same = ("kind", "limits", "sign", "gear_ratio", "rated_torque", "mass", "com", "name", "driven", "external")
        return Joint(frame, **{name: getattr(self, name) for name in same})

    def _own_frame(self) -> Frame:
        own = {part: tuple(one.step for one in self.steps if one.part == part) for part in PARTS}
        (turn,) = own["turn"]
        return Frame(turn, own["reach"], own["mount"], own["body"], self.listed)


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


def _or_unknown(schema: dict[str, Any]) -> None:
    """Have the schema of a number allow what stands for one that nobody knows."""
    number = {key: schema.pop(key) for key in ("type", "minimum")}
    schema["anyOf"] = [number, {"const": UNKNOWN}]


class PayloadTable(FileModel):
    """A load on the flange."""

    mass: Mass | None = Field(ge=0, json_schema_extra=_or_unknown)
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


class ExpectedTable(FileModel):
    """What is stated of a parameter before the robot is measured; figures are in SI, as `unit` says."""

    name: str = ""
    effect: str = ""
    part: str = ""
    symbol: str = ""
    unit: str
    mean: float | None = None
    sd: float | None = Field(default=None, gt=0)
    lower: float | None = None
    upper: float | None = None
    fixed: bool = False
    value: float | None = None

    @model_validator(mode="after")
    def _of_one_parameter(self) -> ExpectedTable:
        identity = (self.effect, self.part, self.symbol)
        if not (self.name or all(identity)) or (self.name and any(identity)):
            raise ValueError("missing: expected effect, part and symbol of a parameter, or its name")
        if (self.mean is None) != (self.sd is None):
            raise ValueError("expected mean and sd together")
        if self.value is not None and not self.fixed:
            raise ValueError("value is where a parameter is held: expected fixed = true beside it")
        if not self.fixed and self.mean is self.lower is self.upper is None:
            raise ValueError("missing: expected mean and sd, lower, upper, or fixed = true")
        return self


class Surroundings(FileModel):
    """What a robot file says besides the joints, whatever file states those."""

    name: str = ""
    notes: str = ""
    gravity: tuple[float, float, float] | None = None
    base: BaseTable = BaseTable()
    tool_rotation: Angles3 | None = None
    payloads: dict[str, PayloadTable] = {}
    markers: dict[str, MarkerTable] = Field(default={}, validate_default=True)
    expected: tuple[ExpectedTable, ...] = ()

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
            "expected": tuple(Expected(**vars(one)) for one in self.expected),
        }


class RobotFile(Surroundings):
    """A robot file as written."""

    name: str
    convention: Literal["dh", "modified-dh", "frames"]
    ground: int = Field(default=0, ge=0)
    joints: tuple[JointTable, ...] = Field(min_length=1)
    couplings: tuple[CouplingTable, ...] = ()
    loop: LoopTable | None = None

    @field_validator("joints")
    @classmethod
    def _stated_alike(cls, joints: tuple[JointTable, ...], info: ValidationInfo) -> tuple[JointTable, ...]:
        own = info.data.get("convention") == OWN_FRAMES
        for i, joint in enumerate(joints, start=1):
            if own != bool(joint.steps):
                expected = f'with convention = "{OWN_FRAMES}"'
                raise ValueError(
                    f"joint {i}: missing: expected steps, {expected}" if own else f"joint {i}: steps go {expected}"
                )
        return joints

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
        if self.ground > len(self.joints):
            raise ValueError(f"ground: there is no link {self.ground}: this robot has links 0 to {len(self.joints)}")
        if self.ground and self.gravity is None:
            raise ValueError(f"missing: expected gravity, in the axes of link {self.ground}, which stands on the floor")
        first = self.joints[0]
        if first.steps and self.gravity is None:
            raise ValueError("missing: expected gravity, in the base's axes, of a robot stated by its frames' steps")
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
            "ground": self.ground,
            "joints": tuple(joint.part(self.convention) for joint in self.joints),
            "couplings": tuple(Coupling(**vars(coupling)) for coupling in self.couplings),
            "loop": self.loop and self.loop.part(),
        }


def _joint_exists(joint: int, info: ValidationInfo) -> None:
    joints = info.data.get("joints")  # not there where they are wrong themselves
    if joints is not None and joint > len(joints):
        raise ValueError(f"there is no joint {joint}: this robot has joints 1 to {len(joints)}")
