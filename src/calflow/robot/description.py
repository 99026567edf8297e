"""The robot file: a robot as its maker describes it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from calflow.files.toml import Angle, Angles3, FileModel, Length, Lengths3, Mass, Moment, read_toml

STANDARD_GRAVITY = 9.80665  # m/s²
PARALLEL = 0.1  # axes within this angle [rad] count as nearly parallel: their distance along z is not defined


class Joint(FileModel):
    """One joint and the link it moves: four DH figures, limits, drive and mass."""

    name: str = ""
    kind: Literal["revolute", "prismatic"] = "revolute"
    alpha: Angle = 0.0
    a: Length = 0.0
    d: Length = 0.0
    theta: Angle = 0.0
    beta: Angle = 0.0
    sign: Literal[1, -1] = 1
    limits_deg: tuple[float, float] | None = None
    limits_mm: tuple[float, float] | None = None
    gear_ratio: float | None = Field(default=None, gt=0)
    rated_torque: Moment | None = Field(default=None, gt=0)
    mass: Mass | None = Field(default=None, ge=0)
    com: Lengths3 = (0.0, 0.0, 0.0)

    @field_validator("limits_deg", "limits_mm")
    @classmethod
    def _in_order(cls, limits: tuple[float, float] | None) -> tuple[float, float] | None:
        if limits and not limits[0] < limits[1]:
            raise ValueError(f"expected lower < upper, found {limits[0]:g} and {limits[1]:g}")
        return limits

    @model_validator(mode="after")
    def _limits_of_its_kind(self) -> Joint:
        if self.kind == "prismatic" and (self.limits_mm is None or self.limits_deg is not None):
            raise ValueError("a prismatic joint needs limits_mm, and no limits_deg")
        if self.kind == "revolute" and self.limits_mm is not None:
            raise ValueError("a revolute joint has limits_deg, not limits_mm")
        return self

    @property
    def range(self) -> tuple[float, float]:
        """Lower and upper limit [rad, or m for a prismatic joint]; a full turn where none is given."""
        if self.limits_mm is not None:
            return self.limits_mm[0] / 1000, self.limits_mm[1] / 1000
        if self.limits_deg is not None:
            return float(np.deg2rad(self.limits_deg[0])), float(np.deg2rad(self.limits_deg[1]))
        return -np.pi, np.pi


class Bar(FileModel):
    """A moving bar of the loop: its length, and mass and centre along it and across it."""

    length: Length = Field(gt=0)
    mass: Mass | None = Field(default=None, ge=0)
    com: Lengths3 = (0.0, 0.0, 0.0)


class FourBar(FileModel):
    """A four-bar loop PQRS that drives a joint from a motor on the joint before it.

    P lies on the axis of the joint before, S on the driven joint's axis. The crank PQ turns with the motor, the rod QR
    pushes the rocker RS, which is part of the driven link. Angles are measured in the plane across the two axes.
    """

    joint: int = Field(ge=2)
    crank: Bar
    rod: Bar
    rocker: Length = Field(gt=0)
    offset: Angle = 0.0
    assembly: Literal["open", "crossed"] = "open"


class Payload(FileModel):
    """A named load on the flange; its centre in the flange's frame."""

    mass: Mass = Field(ge=0)
    com: Lengths3 = (0.0, 0.0, 0.0)


class Marker(FileModel):
    """A measured point of the tool, in the flange's frame.

    relative_sd [m] is how surely its place beside the first marker is known, where the tool was measured by itself.
    """

    point: Lengths3
    relative_sd: Length | None = Field(default=None, gt=0)


class Base(FileModel):
    """Where the robot's base stands in the measuring device's frame."""

    origin: Lengths3 = (0.0, 0.0, 0.0)
    rotation: Angles3 = (0.0, 0.0, 0.0)
    known: bool = True


class Coupling(FileModel):
    """A joint reading that moves another joint too: q[joint] += factor * reading[source]."""

    joint: int = Field(ge=1)
    source: int = Field(ge=1)
    factor: float


class Robot(FileModel):
    """A serial robot, possibly with one four-bar loop, as its robot file states it (SI units)."""

    name: str
    notes: str = ""
    convention: Literal["dh", "modified-dh"]
    gravity: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY)
    base: Base = Base()
    joints: tuple[Joint, ...] = Field(min_length=1)
    couplings: tuple[Coupling, ...] = ()
    loop: FourBar | None = None
    tool_rotation: Angles3 | None = None
    payloads: dict[str, Payload] = {}
    markers: dict[str, Marker] = Field(default={}, validate_default=True)

    @field_validator("markers")
    @classmethod
    def _one_marker(cls, markers: dict[str, Marker]) -> dict[str, Marker]:
        if not markers:
            raise ValueError("expected at least one marker, e.g. [markers.tool] with point_mm = [0, 0, 100]")
        if "base" in markers:
            raise ValueError("a marker cannot be called 'base': parameters are named by their part")
        if next(iter(markers.values())).relative_sd:
            raise ValueError("the first marker has no relative_sd: the others' places are relative to it")
        return markers

    @field_validator("couplings")
    @classmethod
    def _coupled_joints_exist(cls, couplings: tuple[Coupling, ...], info: ValidationInfo) -> tuple[Coupling, ...]:
        for coupling in couplings:
            _joint_exists(coupling.joint, info)
            _joint_exists(coupling.source, info)
        return couplings

    @field_validator("loop")
    @classmethod
    def _driven_joint_exists(cls, loop: FourBar | None, info: ValidationInfo) -> FourBar | None:
        if loop:
            _joint_exists(loop.joint, info)
        return loop

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def has_masses(self) -> bool:
        """Whether the file states the link masses, so that gravity torques can be computed."""
        return all(joint.mass is not None for joint in self.joints)

    @property
    def limits(self) -> np.ndarray:
        """Joint limits, shape (n_joints, 2) [rad, or m]."""
        return np.array([joint.range for joint in self.joints])

    @property
    def reading_matrix(self) -> np.ndarray:
        """Matrix C with q = C · reading: signs and linear couplings, shape (n_joints, n_joints)."""
        matrix = np.diag([float(joint.sign) for joint in self.joints])
        for coupling in self.couplings:
            matrix[coupling.joint - 1, coupling.source - 1] += coupling.factor
        return matrix

    def nearly_parallel(self, joint: int) -> bool:
        """Whether the two axes that joint's alpha lies between (index from 0) are nearly parallel."""
        return bool(abs(np.sin(self.joints[joint].alpha)) < PARALLEL)


def _joint_exists(joint: int, info: ValidationInfo) -> None:
    joints = info.data.get("joints")  # not there where they are wrong themselves
    if joints is not None and joint > len(joints):
        raise ValueError(f"there is no joint {joint}: this robot has joints 1 to {len(joints)}")


def read_robot(path: Path) -> Robot:
    """Read a robot file."""
    return read_toml(path, Robot)
