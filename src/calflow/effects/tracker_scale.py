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

SD, WIRE_SD = 3e-5, 1e-3  # of a device's scale, and of that which a study states of a wire's drum
ZERO_SD = 1e-3  # m, of a wire's zero that a study states


@dataclass(frozen=True)
class TrackerScale(Effect):
    """Reported position times 1 + s; indistinguishable from a scale of all links and the tool without known distances.

    Of several devices it is one's (of), whose lengths the others contradict, about the place from which it measures. Of a wire it
    is also an error of its zero: a reported length + z.
    """

    of: str = ""
    about: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sd: float = SD
    zero: bool = False

    id = "tracker-scale"
    title = "scale of the measuring device"
    words = Words(
        "scale or zero of the measuring device", "the device's metre, or its zero, is not the stated one", "error"
    )
    readable = {"1": (1e6, "µm/m")}
    whole = "device"
    needs = ("distances",)
    told_by = "measure a known length with each device"

    @classmethod
    def asks(cls, robot: Robot, data: Measurements) -> tuple[str, ...]:
        """Return what is unmet of its needs; nothing where one device's lengths are held against another's."""
        return super().asks(robot, data) if len(data.devices) == 1 else ()

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return the scale of the only device, or scale and zero of each so far as the study takes them for known."""
        if len(data.devices) == 1:
            return (cls(robot),)
        forms = {}
        for series in data.series:
            about, wire = series.triple("anchor") or cls.about, series.kind == "distance"
            if series.has_positions:
                forms[series.device] = cls(robot, series.device)
            if wire and series.setting("scale") is not None:
                forms[series.device] = cls(robot, series.device, about, WIRE_SD)
            if wire and series.setting("offset") is not None:
                forms[f"zero {series.device}"] = cls(robot, series.device, about, ZERO_SD, zero=True)
        return tuple(forms.values())

    @property
    def variant(self) -> str:
        """The device of several, and whether it is its zero."""
        return f"{'zero ' * self.zero}{self.of}"

    @property
    def detail(self) -> str:
        """The device of several, and whether it is its zero."""
        return self.of and f"{'zero ' * self.zero}of {self.of}"

    def concerns(self, device: str) -> bool:
        """Whether it is of this device."""
        return self.of in ("", device)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the scale error, or that of the zero."""
        scale, zero = ("s", "1", 1e-3, "scale error"), ("z", "m", 0.0, "error of the zero")
        symbol, unit, least, meaning = zero if self.zero else scale
        bound = max(least, 10 * self.sd)
        return (Parameter(self.id, "device", symbol, unit, self.sd, -bound, bound, meaning=meaning),)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, scaled, or further along the wire."""
        along = point - ca.DM(self.about)
        return point + p * (along / ca.norm_2(along) if self.zero else along)
