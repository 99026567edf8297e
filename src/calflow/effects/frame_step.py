"""Frame step: a measuring device, or a robot's foot, that was moved once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import OF_THE_FRAME, Words
from calflow.effects.displacement import Rigid
from calflow.effects.step_change import FEWEST, PointStep
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Dimensions, Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

FOOT = "the robot's foot"


@dataclass(frozen=True)
class FrameStep(Rigid, PointStep):
    """Reported position - (x, y, z), and with turning - r x position (about the measuring frame's origin), up to a row.

    A change between two sessions is the frame of a session instead (see `session_frame`). Where there are several devices it is
    of one of them, or of the robot's foot, which moves it in its base's axes: all that are in use see that.
    """

    of: str = ""

    id = "frame-step"
    title = "step of the measuring set-up"
    words = Words(
        "step of the measuring set-up", "the device, what is touched or the robot's foot was moved once", "step"
    )
    whole = "device"
    family = OF_THE_FRAME
    imaged = False
    told_by = "measure points fixed to the floor from time to time"

    @classmethod
    def kinds(cls, robot: Robot) -> tuple[Self, ...]:
        """Return the step without and with rotation."""
        return cls(robot), cls(robot, turning=True)

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return each form at moments between rows, of whatever may have moved then."""
        steps = super().variants(robot, data)
        return tuple(replace(each, of=name) for each in steps for name in _movable(data, each.moment))

    def concerns(self, device: str) -> bool:
        """Whether it is of this device, or of the foot, which all devices see."""
        return self.of in ("", FOOT, device)

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the dimensions with the foot where it stood before the moment."""
        before = self.before(row)
        if self.of != FOOT or not before.nnz():
            return dims
        return replace(dims, base=dims.base - before * ca.vertcat(p, ca.SX(6 - p.numel(), 1)))

    def undecided(self, data: Measurements) -> np.ndarray:
        """Return the rows of which the fitted ones do not tell whether they are of the device before the step."""
        about = np.array([self.concerns(name) for name in data.device], dtype=bool)
        about[about] = super().undecided(data.only(about))
        return about

    @property
    def detail(self) -> str:
        """The row after which it moved, whether it rotated, and which device it was."""
        return f"{super().detail}{self.of and f', of {self.of}'}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the shift, and the rotation."""
        return self.of_part(self.whole)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, as it was reported before the moment."""
        return point if self.of == FOOT else self.undone(p, point, row)


def _movable(data: Measurements, moment: float) -> Iterator[str]:
    """Yield what may have moved at a moment: the only device, or each that is used before and after, and the foot.

    The foot is left out where one of several devices is used: the others stand as they did, and only its rows tell.
    """
    if len(data.devices) == 1:
        yield ""
        return
    before, device = data.table["order"].to_numpy(float) < moment, data.device
    used = [
        name
        for name in data.devices
        if min((before & (device == name)).sum(), (~before & (device == name)).sum()) >= FEWEST
    ]
    yield from used
    if len(used) != 1:
        yield FOOT
