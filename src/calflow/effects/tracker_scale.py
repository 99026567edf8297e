"""Tracker scale: a scale error of a measuring device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import casadi as ca

from calflow.effects.base import Effect, Words
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SD = {"distance": 1e-3}  # of a wire's drum, whose scale the study states; of any other device SD_OF_OTHERS
SD_OF_OTHERS = 3e-5
SCALED = ("", "position", "pose", *SD)  # kinds of series whose device has a scale of its own


@dataclass(frozen=True)
class TrackerScale(Effect):
    """Reported position times 1 + s; indistinguishable from a scale of all links and the tool without known distances.

    Of several devices it is one's (of), whose lengths the others contradict, about the place from which it measures.
    """

    of: str = ""
    about: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sd: float = SD_OF_OTHERS

    id = "tracker-scale"
    title = "scale of the measuring device"
    words = Words("scale error of the measuring device", "the device's metre is too long or too short", "error")
    readable = {"1": (1e6, "µm/m")}
    whole = "device"
    needs = ("distances",)
    told_by = "measure a known length with each device"

    @classmethod
    def asks(cls, robot: Robot, data: Measurements) -> tuple[str, ...]:
        """Return what is unmet of its needs; nothing where one device's lengths are held against another's."""
        return super().asks(robot, data) if len({series.device for series in data.series}) == 1 else ()

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return the scale of the only device, or of each that has one which the study takes for known."""
        if len({series.device for series in data.series}) == 1:
            return (cls(robot),)
        known = {
            series.device: cls(
                robot, series.device, series.triple("anchor") or cls.about, SD.get(series.kind, SD_OF_OTHERS)
            )
            for series in data.series
            if series.kind in SCALED and (series.kind != "distance" or series.setting("scale") is not None)
        }
        return tuple(known.values())

    @property
    def variant(self) -> str:
        """The device of several."""
        return self.of

    @property
    def detail(self) -> str:
        """The device of several."""
        return self.of and f"of {self.of}"

    def concerns(self, device: str) -> bool:
        """Whether it is of this device."""
        return self.of in ("", device)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the scale error."""
        bound = max(1e-3, 10 * self.sd)
        return (Parameter(self.id, "device", "s", "1", self.sd, -bound, bound, meaning="scale error"),)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, scaled."""
        return point + p * (point - ca.DM(self.about))
