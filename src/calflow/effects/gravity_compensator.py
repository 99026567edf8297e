"""Gravity compensator: a spring or gas cylinder that carries part of the gravity torque on joint 2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words, around, joint_variable
from calflow.effects.warming import REFERENCE
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State, nominal_posture, rated_torques
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SD, BOUND = 0.3, 2.0  # times joint 2's rated torque
RATIO = 0.3  # crank radius on the arm over the hinge's distance, of a short cylinder
HINGES = (-90.0, 0.0, 90.0)  # deg from straight below the joint
RATIOS = (0.15, 0.2, 0.25, 0.35, 0.4, 0.5, 0.6)  # tried when refining the best variant
TURN = 90.0  # deg from a hinge direction to its neighbours


@dataclass(frozen=True)
class GravityCompensator(Effect):
    """Torque on joint 2 = (Tc cos q2 + Ts sin q2) / l, of a spring + Kc cos q2 + Ks sin q2; l² = 1 + r² + 2 r cos(q2 - q0 - hinge).

    A cylinder of constant force between a point of the arm and a hinge on the column has the moment arm sin(…) / l: r is
    the point's distance from the joint over the hinge's (0: hinge at infinity), q0 the angle at which the arm is upright,
    hinge [deg] the hinge's direction from straight below, l the cylinder's length over the hinge's distance. A spring's force
    is linear in l, which adds a torque independent of l; a gas's force is proportional to its absolute temperature. The
    torque is observable by the wind-up of joint 2 that it relieves.
    """

    ratio: float = 0.0
    hinge: float = 0.0
    spring: bool = False
    gas: bool = False

    id = "gravity-compensator"
    title = "gravity compensator"
    words = Words("gravity compensator torque", "a spring or gas cylinder carries a part of the arm's weight", "torque")
    needs = ("masses",)
    told_by = "measure some poses again with the compensator's pressure released or its spring unhooked"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return a hinge at infinity, near hinges below the joint and on either side, and a spring to one below."""
        near = (cls(robot, RATIO, hinge) for hinge in HINGES)
        return (cls(robot), *near, cls(robot, RATIO, spring=True))

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return neighbouring hinge directions and distances, a spring, and a gas where temperatures are known."""
        variants = [replace(self, spring=not self.spring)] if self.ratio else []
        if self.ratio:
            variants += [replace(self, hinge=hinge) for hinge in around(self.hinge, TURN)[::2] if abs(hinge) <= 180]
            variants += [replace(self, ratio=ratio) for ratio in (*RATIOS, RATIO) if ratio != self.ratio]
        if data.temperature_changes:
            variants.append(replace(self, gas=not self.gas))
        return tuple(variants)

    @property
    def detail(self) -> str:
        """The hinge's distance and direction, and what drives the cylinder."""
        what = ", spring" * self.spring + ", gas" * self.gas
        if not self.ratio:
            return f"far hinge{what}"
        side = f", {self.hinge:+.0f} deg from below" if self.hinge else " below"
        return f"hinge {1 / self.ratio:.3g} levers away{side}{what}"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is required where the robot has several arms."""
        return "" if robot.is_one_arm else "an arm alone"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the torque's cosine and sine amplitudes, and those of the spring's length-dependent part."""
        if not self._has_arm:
            return ()
        rated = float(rated_torques(self.robot)[self._carried])
        of = {"T": "torque"} | ({"K": "torque by the spring's rate"} if self.spring else {})
        return tuple(
            Parameter(self.id, f"joint{self._carried + 1}", f"{letter}{phase}", "Nm", SD * rated, -BOUND * rated, BOUND * rated,
                      meaning=f"compensator's {what}, {wave} part", joint=self._carried + 1)
            for letter, what in of.items() for phase, wave in (("c", "cosine"), ("s", "sine"))
        )  # fmt: skip

    @property
    def _has_arm(self) -> bool:
        """Whether the robot is one arm with a revolute joint 2, which a cylinder can relieve."""
        return self.robot.is_one_arm and len(self.robot.arm) > 1 and self.robot.joints[self._carried].kind == "revolute"

    @property
    def _carried(self) -> int:
        """Index of the arm's joint 2, not counting external axes."""
        return self.robot.arm[1]

    @cached_property
    def upright(self) -> float:
        """The angle of joint 2 [rad] at which the arm points against gravity, the others at zero."""
        robot = self.robot
        at = nominal_posture(robot)
        frame, end = (
            np.array(ca.DM(ca.evalf(frame))) for frame in (at.joints[self._carried], at.ends[self._carried + 1])
        )
        axis, arm, up = frame[:3, 2], end[:3, 3] - frame[:3, 3], -np.array(ca.DM(ca.evalf(at.down(robot)))).ravel()
        across = up - axis * (axis @ up)
        return float(np.arctan2(axis @ np.cross(arm, across), arm @ across))

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Return the cylinder's torque on joint 2."""
        if not self._has_arm:
            return 0.0
        q = state.q[self._carried]
        length = ca.SX(1)
        if self.ratio:
            angle = q - self.upright - np.deg2rad(self.hinge)
            length = ca.sqrt(1 + self.ratio**2 + 2 * self.ratio * ca.cos(angle))
        wave = ca.vertcat(ca.cos(q), ca.sin(q))
        push = ca.dot(p[:2], wave) / length + (ca.dot(p[2:], wave) if self.spring else 0)
        if self.gas and row.temperature.nnz():
            push *= row.temperature / REFERENCE
        torque = ca.SX(self.robot.n_joints, 1)
        torque[self._carried] = push
        return torque

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the amplitude of the torque at l = 1, the cylinder's length being its hinge's distance."""
        return super().size(p[:2] + p[2:] if self.spring else p, own[:2])

    def variable(self, joint: int) -> Variable:
        """Return the angle of joint 2."""
        return joint_variable(self, self._carried + 1)
