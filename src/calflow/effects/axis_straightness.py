"""Axis straightness: straightness and angular errors of a linear axis, as smooth curves over its travel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import NOTHING, Effect, Words, joint_variable
from calflow.effects.smooth_curve import Wave, different_positions, travel_ends, waves
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SHIFT_SD, TURN_SD = 1e-4, 5e-5  # m and rad rms, per axis, at which a curve is looked for
FACTORS = (0.25, 0.5, 2.0, 4.0)  # of these, to try around the best
LARGEST = 1e-2  # m and rad rms
BOUND = 0.02  # m and rad
LENGTHS = (0.3, 0.1)  # correlation lengths, as shares of the travel
RESOLVED = 0.5  # finest wavelength resolved, as a share of the correlation length
PLACES = 41  # on a travel, at which its size is taken
FREE = 0.5  # correlation lengths beyond the travel at which curves end
DENSE = 2  # distinct positions required per correlation length


@dataclass(frozen=True)
class AxisStraightness(Effect):
    """A prismatic joint's carriage is off by (x, y, z), and with turning by (rx, ry, rz), smooth curves of its position.

    z is along the rail, x and y across it, in the joint's frame; rotations are about the carriage. low and high [m] bound
    the travel that the data cover densely, equal for joints left out; length is the correlation length over the travel.
    shift [m] and turn [rad] are the rms per axis a priori: one much below what the rail has would pull its curve towards zero
    and let the arm's dimensions take up the rest, by more than the parameters' uncertainty says.
    """

    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    length: float = LENGTHS[0]
    turning: bool = False
    shift: float = SHIFT_SD
    turn: float = TURN_SD

    id = "axis-straightness"
    title = "straightness of an axis"
    words = Words(
        "straightness error",
        "the rail leads the carriage off a straight line, by a smooth curve over its travel",
        "rms",
    )
    needs = ("slide",)
    is_curve = True
    told_by = "move the carriage alone over all its travel, and measure closely on the way"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return curves of every densely covered rail at each correlation length, without and with rotations."""
        dense = {length: _dense(robot, data, length) for length in LENGTHS}
        return tuple(
            cls(robot, *travel_ends(data, rails), length, turning)
            for length, rails in dense.items() if rails.any() for turning in (False, True)
        )  # fmt: skip

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return larger and smaller curves, and smoother ones: of a large curve, the first size that is tried takes a rough one."""
        smoother = (replace(self, length=length) for length in LENGTHS if length > self.length)
        shifts = (replace(self, shift=self.shift * factor) for factor in FACTORS)
        turns = (replace(self, turn=self.turn * factor) for factor in FACTORS if self.turning)
        return tuple(form for form in (*smoother, *shifts, *turns) if max(form.shift, form.turn) <= LARGEST)

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return the number of positions required where every rail was measured at fewer."""
        few = f"at least {DENSE / max(LENGTHS):.0f} different positions of a prismatic joint"
        return "" if _dense(robot, data, max(LENGTHS)).any() else few

    @property
    def detail(self) -> str:
        """The correlation length, whether the carriage rotates, and the sizes looked for where they are not the usual ones."""
        usual = (self.shift, self.turn) == (SHIFT_SD, TURN_SD)
        shifted, turned = (
            ("", "") if usual else (f" by some {1e3 * self.shift:.2g} mm", f" by some {1e3 * self.turn:.2g} mrad")
        )
        return f"alike over {self.length:.0%} of the travel, shifted{shifted}{f' and turned{turned}' if self.turning else ''}"

    @property
    def variant(self) -> str:
        """Short name of the form, without the travels, which come from the data."""
        sizes = (("shift", self.shift, SHIFT_SD), ("turn", self.turn, TURN_SD))
        others = (f" {name} {size:.3g}" for name, size, usual in sizes if size != usual)
        return f"length {self.length:g}{' turning' if self.turning else ''}{''.join(others)}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the basis amplitudes of each rail's curves."""
        kinds = [("", "m", self.shift), *([("r", "rad", self.turn)] if self.turning else [])]
        return tuple(
            Parameter(self.id, f"joint{i + 1}", f"wave{wave.number}{symbol}{axis}", unit, sd * wave.sd, -BOUND, BOUND, joint=i + 1,
                      meaning=f"{self.in_words().name} of joint {i + 1}")
            for i in self._rails for wave in self._curve(ca.SX.sym("q"), i) for symbol, unit, sd in kinds for axis in "xyz"
        )  # fmt: skip

    @property
    def _rails(self) -> tuple[int, ...]:
        """Indices of the rails modelled."""
        travels = enumerate(zip(self.low, self.high, strict=True))
        return tuple(i for i, (low, high) in travels if high > low)

    def ends(self, joint: int) -> tuple[float, float]:
        """Return the ends of a rail's curves (joint from 0) [m], half a correlation length beyond its travel.

        Beyond its ends a curve is zero. Were these the travel's own, it would be nearly zero there too, and what a rail turns by
        from end to end would look like a base that tilts.
        """
        low, high = self.low[joint], self.high[joint]
        margin = FREE * self.length * (high - low)
        return low - margin, high + margin

    def _curve(self, position: ca.SX, joint: int) -> list[Wave]:
        length = self.length * (self.high[joint] - self.low[joint])
        return waves(position, *self.ends(joint), length, RESOLVED * length)

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the root mean square of the translation error over the travel, less its line, which the arm's place imitates."""
        joint, position = own[0].joint - 1, ca.SX.sym("position")
        curve = ca.vertcat(*(wave.value for wave in self._curve(position, joint)))
        places = np.linspace(self.low[joint], self.high[joint], PLACES)
        line = np.linalg.qr(np.vander(places, 2))[0]
        along = ca.Function("curve", [position], [curve])(places[None]) @ (np.eye(PLACES) - line @ line.T)
        shifts = [k for k, parameter in enumerate(own) if parameter.unit == "m"]
        off = ca.reshape(p[shifts], 3, curve.numel()) @ along
        return ca.sqrt(ca.sumsqr(off) / PLACES + NOTHING)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with the carriages displaced."""
        bearing = ca.SX(still.bearing)
        for i, columns in zip(self._rails, self.parts.values(), strict=True):
            curve = ca.vertcat(*(wave.value for wave in self._curve(state.q[i], i)))
            off = ca.reshape(p[columns], 6 if self.turning else 3, curve.numel()) @ curve
            bearing[: off.numel(), i] = about_carriage(self.robot, i, off, state)
        return replace(still, bearing=bearing)

    variable = joint_variable


def about_carriage(robot: Robot, joint: int, off: ca.SX, state: State) -> ca.SX:
    """Return the twist, referred to the rail's origin, of a carriage's shift (3,), or of it and a turn about the carriage (6,)."""
    slide = robot.frames[joint].slide
    if off.numel() == 3 or slide is None:
        return off
    carriage = ca.vertcat(0, 0, state.q[joint] + slide.value)
    return ca.vertcat(off[:3] - ca.cross(off[3:], carriage), off[3:])


def _dense(robot: Robot, data: Measurements, length: float) -> np.ndarray:
    """Return which joints are rails measured at enough positions for a correlation length (a share of the travel)."""
    slides = np.array([joint.kind == "prismatic" for joint in robot.joints])
    return slides & (different_positions(data) >= DENSE / length)
