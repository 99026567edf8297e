"""What every effect is: one physical cause, its parameters, and the places where it may act."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Self

import casadi as ca
import numpy as np

from calflow.robot.chain import Deflection
from calflow.robot.conditions import Row
from calflow.robot.dimensions import Dimensions, Loads
from calflow.robot.parameter import Parameter
from calflow.robot.robot import Robot
from calflow.robot.statics import State

if TYPE_CHECKING:
    from calflow.measurements.measurements import Measurements


NOTHING = 1e-300  # keeps the slope of a length finite where the length is zero


@dataclass(frozen=True)
class Variable:
    """What a cause's error is drawn against: its label, the unit drawn in, and its value times factor in that unit."""

    label: str
    unit: str
    value: Callable[[State, Row], ca.SX]
    factor: float = 1.0


def joint_variable(robot: Robot, joint: int) -> Variable:
    """Return a joint's (from 1) own angle, or a slide's position, as what an error is drawn against."""
    of = robot.joints[joint - 1]
    unit, factor = of.shown
    return Variable(f"{of.noun} of joint {joint}", unit, lambda state, row: state.q[joint - 1], factor)


def torque_variable(robot: Robot, joint: int) -> Variable:
    """Return the torque on a joint (from 1), or the force on a slide, as what an error is drawn against."""
    unit = robot.joints[joint - 1].load_unit
    noun = "torque" if unit == "Nm" else "force"
    return Variable(f"{noun} of joint {joint}", unit, lambda state, row: state.torque[joint - 1])


def around(value: float, reach: float) -> list[float]:
    """Return values about one as far as reach on either side, the denser the nearer: for `Effect.finer`."""
    steps = reach * np.geomspace(1 / 1024, 1.0, 21)
    return [float(value + step) for step in (*-steps[::-1], 0.0, *steps)]


def displaced(p: ca.SX, point: ca.SX) -> ca.SX:
    """Return by how much a shift p (3,), or a shift and a small turn about the origin (6,), moves a point."""
    return p[:3] + (ca.cross(p[3:], point) if p.numel() == 6 else 0)


@dataclass(frozen=True)
class Effect(ABC):
    """One physical cause. A subclass declares its parameters and overrides the one place where it acts.

    p is the column of this effect's parameters in the order declared; every default below means "does not act here".
    Fields besides the robot are what cannot be a decision variable, such as the order of a periodic error: `variants`
    says which values to try.
    """

    robot: Robot

    id: ClassVar[str]
    title: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()  # what it cannot do without: see `unmet`
    family: ClassVar[str] = ""  # what to call it when the data do not tell it from others of its family
    alike: ClassVar[tuple[str, ...]] = ()  # ids that no pose tells from it: only another sensor or load would
    told_by: ClassVar[str] = ""  # what to do at the robot to tell it from its rivals where no pose does

    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters for this robot."""

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The parameters, worked out once."""
        return self.parameters()

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return the forms in which to look for it in these data; none where the data cannot show it (see `lacking`)."""
        return (cls(robot),)

    @classmethod
    def lacking(cls, robot: Robot, data: Measurements) -> str:
        """Say what these data lack for a test of it; empty where nothing."""
        return ", ".join(unmet(cls.needs, robot, data.given))

    @classmethod
    def is_noise(cls) -> bool:
        """Whether it widens the noise and shifts nothing, so that it is tested by what the fit leaves."""
        return cls.scatter is not Effect.scatter

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return variants between this one and its neighbours."""
        return ()

    def same_as(self, other: Self) -> bool:
        """Whether another variant at the same place is another form of the same thing, so that they cannot both act."""
        return True

    def variable(self, joint: int) -> Variable:
        """Return what explains it at a joint (0 for none): the row's place in measuring order unless it knows better."""
        return Variable("place in measuring order", "", lambda state, row: row.order)

    def size(self, p: ca.SX) -> ca.SX:
        """Return one figure for the parameters (n,) of one part: their length, of those with the first one's unit."""
        unit = self.declared[0].unit
        same = [k for k, parameter in enumerate(self.declared[: p.numel()]) if parameter.unit == unit]
        return ca.sqrt(ca.sumsqr(p[same]) + NOTHING)

    @property
    def detail(self) -> str:
        """Say which variant it is, e.g. `order 7`."""
        return ""

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Change lengths and angles."""
        return dims

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Change masses."""
        return loads

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Add torques to the driven joints, (n_joints,) [Nm]."""
        return 0.0

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Move joints, bearings or link ends; still is no motion, to be replaced in part."""
        return still

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Change the position that the measuring device reports, (3,) [m]."""
        return point

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Add to the standard deviation of the reported position, per axis [m]."""
        return 0.0


def unmet(needs: tuple[str, ...], robot: Robot, given: tuple[str, ...]) -> list[str]:
    """Return in words which needs robot file and data leave unmet.

    A need is a condition of the data (`conditions.OPTIONAL`), or of the robot file: masses, torques (computed from
    masses, or measured), payload, gear_ratio, distances (between markers).
    """
    said = {
        "masses": ("mass_kg and com_mm of every link in the robot file", robot.has_masses),
        "torques": ("mass_kg and com_mm of every link in the robot file, or measured torques tau1_Nm …",
                    robot.has_masses or "torque" in given),
        "payload": ("a payload with a mass in the robot file", any(load.mass for load in robot.payloads.values())),
        "gear_ratio": ("gear_ratio of a joint in the robot file", any(joint.gear_ratio for joint in robot.joints)),
        "distances": ("relative_sd_mm of a marker in the robot file (its place beside the first, measured apart)",
                      any(marker.relative_sd for marker in robot.markers.values())),
        "approach": ("columns approach1 … (or in_order = true in the study's [measurements])", "approach" in given),
        "travel": ("columns travel1_deg … (or in_order = true in the study's [measurements])", "travel" in given),
        "wrench": ("columns fx_N … mz_Nm", "wrench" in given),
        "torque": ("columns tau1_Nm …", "torque" in given),
        "time": ("a column time_s", "time" in given),
        "temperature": ("a column temperature_degC", "temperature" in given),
        "order": ("rows in measuring order", "order" in given),
        "range": ("the device's place, tracker_mm in the study's [measurements]", "range" in given),
    }  # fmt: skip
    return [said[need][0] for need in needs if not said[need][1]]
