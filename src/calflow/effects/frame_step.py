"""Frame step: a measuring device, or a robot's foot, that was moved once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import OF_THE_FRAME, Words
from calflow.effects.step_change import StepChange, between_fitted
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class FrameStep(StepChange):
    """Reported position - (x, y, z), and with turning - r x position (about the measuring frame's origin), up to a row.

    A change between two sessions is the frame of a session instead (see `session_frame`). Rows up to one in measuring order
    (since) are not concerned: those of other devices, used before.
    """

    turning: bool = False
    since: float = 0.0

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

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return each form at moments between rows, of the device then in use."""
        return tuple(replace(each, since=_begun(data, each.moment)) for each in super().variants(robot, data))

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return the moments about this one that the coarse search left out, of the device then in use."""
        return tuple(replace(each, since=_begun(data, each.moment)) for each in super().finer(data))

    def before(self, row: Row) -> ca.SX:
        """Return 1 for a row of the device before the step, else 0 (see `StepChange.before`)."""
        return super().before(row) * (row.order > self.since) if self.since else super().before(row)

    def undecided(self, data: Measurements) -> np.ndarray:
        """Return the rows of which the fitted ones do not tell whether they are of the device before the step."""
        about = super().undecided(data)
        return about | between_fitted(data, self.since) if self.since else about

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


def _begun(data: Measurements, moment: float) -> float:
    """Return the place in measuring order after which the device in use at a moment was: 0 where it is used from the start.

    Positions from one station are of one device, and so is every other series. Devices used in turn move together: it is the
    robot's foot then.
    """
    positions = data.table["x"].notna().to_numpy() if "x" in data.table else np.zeros(len(data), dtype=bool)
    names = [one.station.name if positions[data.of_series(k)].any() else k for k, one in enumerate(data.series)]
    device = np.array([names.index(name) for name in names])[data.series_number]
    order = data.table["order"].to_numpy(float)
    own = device == device[np.abs(order - moment).argmin()]
    first, last = order[own].min(), order[own].max()
    alone = first < moment < last and own[(order >= first) & (order <= last)].all()
    return float(first - 0.5) if alone and (order < first).any() else 0.0
