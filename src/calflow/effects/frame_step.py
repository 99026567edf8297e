"""Frame step: a measuring device, or a robot's foot, that was moved once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import casadi as ca

from calflow.effects.base import OF_THE_FRAME, Words
from calflow.effects.step_change import StepChange
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class FrameStep(StepChange):
    """Reported position - (x, y, z), and with turning - r x position (about the measuring frame's origin), up to a row.

    A change between two sessions is the frame of a session instead (see `session_frame`).
    """

    turning: bool = False

    id = "frame-step"
    title = "step of the measuring device"
    words = Words("step of the measuring device", "the device, or the robot's foot, was moved once", "step")
    whole = "device"
    family = OF_THE_FRAME
    imaged = False
    told_by = "measure points fixed to the floor from time to time"

    @classmethod
    def kinds(cls, robot: Robot) -> tuple[Self, ...]:
        """Return the step without and with rotation."""
        return cls(robot), cls(robot, turning=True)

    @property
    def detail(self) -> str:
        """The row after which it moved, and whether it rotated."""
        return f"{super().detail}{', turned too' if self.turning else ''}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the shift, and the rotation."""
        return self.along_axes(self.whole, self.turning)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, as it was reported before the moment."""
        return self.undone(p, point, row)
