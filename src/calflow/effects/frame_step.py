"""Frame step: a measuring device, or a robot's foot, that was moved once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import OF_THE_FRAME, Effect, Words, displaced
from calflow.measurements.measurements import Measurements, borders
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

MOMENTS, TURNING_MOMENTS = 120, 40  # most moments searched, without and with rotation
BOUND = 300.0  # standard deviations
FEWEST = 3  # rows, or images, required before the first moment and after the last


@dataclass(frozen=True)
class FrameStep(Effect):
    """Reported position + (x, y, z), and with turning + r x position (about the measuring frame's origin), from a row on.

    A change between two sessions is the frame of a session instead (see `session_frame`).
    """

    moment: float = 0.5
    turning: bool = False

    id = "frame-step"
    title = "step of the measuring device"
    words = Words(
        "step of the measuring device", "the device or the robot's foot was moved once, or joint 1's zero", "step"
    )
    whole = "device"
    family = OF_THE_FRAME
    needs = ("order",)
    told_by = "measure points fixed to the floor from time to time"
    shift_sd: ClassVar[float] = 3e-4  # m
    turn_sd: ClassVar[float] = 1e-4  # rad
    most: ClassVar[tuple[tuple[bool, int], ...]] = ((False, MOMENTS), (True, TURNING_MOMENTS))  # by turning

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return the kind of device required where the rows are images; empty otherwise."""
        return "a device that measures positions: what a camera does is camera-slip" if data.in_images else ""

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return moments between rows, or images, without and with rotation; none for an unsuitable device."""
        if cls.lacking(robot, data):
            return ()
        between = cls._moments(data)
        return tuple(
            cls(robot, float(moment), turning) for turning, most in cls.most for moment in _spread(between, most)
        )

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return the moments about this one that the coarse search left out."""
        between = self._moments(data)
        tried = _spread(between, dict(self.most)[self.turning])
        reach = float(np.diff(tried).max(initial=1.0))
        return tuple(replace(self, moment=float(m)) for m in between[np.abs(between - self.moment) <= reach])

    def same_as(self, other: Self) -> bool:
        """Whether the moments are too close for two separate steps."""
        return abs(other.moment - self.moment) < FEWEST

    @property
    def detail(self) -> str:
        """The row after which it moved, and whether it rotated."""
        return f"after row {int(np.floor(self.moment))} in measuring order{', turned too' if self.turning else ''}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the shift, and the rotation."""
        kinds = [
            ("", "m", self.shift_sd, "step along"),
            *([("r", "rad", self.turn_sd, "turn about")] if self.turning else []),
        ]
        return tuple(
            Parameter(self.id, self.whole, symbol + axis, unit, sd, -BOUND * sd, BOUND * sd, meaning=f"{meaning} {axis}")
            for symbol, unit, sd, meaning in kinds for axis in "xyz"
        )  # fmt: skip

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, displaced after the moment."""
        if not row.order.nnz():
            return point
        return point + displaced(p, point) * (row.order > self.moment)

    @classmethod
    def spans(cls, data: Measurements) -> np.ndarray:
        """Return the first and last position in measuring order of each unit that no step divides, (n, 2): here each row."""
        return np.repeat(np.unique(data.table["order"].to_numpy(float))[:, None], 2, axis=1)

    @classmethod
    def _moments(cls, data: Measurements) -> np.ndarray:
        """Return all moments within a session with at least FEWEST rows before and after."""
        first, last = cls.spans(data).T
        between = ((first[1:] + last[:-1]) / 2)[FEWEST - 1 : len(first) - FEWEST]
        return np.asarray(between[~np.isin(between, borders(data))])


def _spread(moments: np.ndarray, most: int) -> np.ndarray:
    """Return an evenly spaced subset of the moments, at most so many."""
    return moments[np.unique(np.linspace(0, len(moments) - 1, most).astype(int))] if len(moments) else moments
