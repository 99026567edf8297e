"""Gravity deflection: joint compliance of a robot whose link masses are unknown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import casadi as ca
import numpy as np

from calflow.effects.base import NOTHING, WINDUP_BOUND, WINDUP_SD, Effect, Words, joint_variable
from calflow.effects.base_tilt import Arm
from calflow.measurements.measurements import Measurements
from calflow.robot.frames import apply
from calflow.robot.mechanism import (
    Deflection,
    Posture,
    Row,
    State,
    nominal_dimensions,
    nominal_loads,
    nominal_posture,
    pose,
    potential_energy,
    rated_torques,
)
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

# Deflections [rad] by the first moments of the links next to the joint, and by those of the links beyond.
NEAR_SD, FAR_SD, BOUND = 2e-3, 3e-4, 20e-3

CENTRE_SD, CENTRE_BOUND = 0.1, 0.8  # m: of an unweighed payload's centre from where the robot file states it

Shape = Literal["", "rule"]


@dataclass(frozen=True)
class GravityDeflection(Effect):
    """dq_i = Y_i(q) phi_i: torque is linear in the links' first moments, whatever the masses (Khalil and Dombre 2002).

    phi_i holds the first moments of link i and those beyond it, times gravity and the joint's compliance [rad]; the masses
    beyond a link are lumped at its end, so that the two components across the joint's axis suffice. Payloads of known mass
    add s_i times their torque; one of unknown mass adds its moment arm times a parameter of its own [rad/m], its weight times
    the joint's compliance. Who did not weigh a payload seldom knows its centre: its three coordinates, the same for all joints,
    are parameters too. By the rule of `base_tilt`, each link half as heavy as the one before, a single parameter stands for
    all first moments.
    """

    shape: Shape = ""

    id = "gravity-deflection"
    title = "gravity deflection (joint compliance, masses unknown)"
    stands_in = "joint-compliance"
    forms = {"": "by link", "rule": "each link half as heavy as the one before"}
    words = Words("gravity deflection", "the joint sags under the robot's own weight", "size")

    @classmethod
    def springs(cls, robot: Robot) -> bool:
        """Whether the masses are unknown, so that this effect is the joint compliance."""
        return not robot.has_masses

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the lumped first moments that load each joint, and its compliance under payloads."""
        joints = [i for i, joint in enumerate(self.robot.joints) if joint.kind != "prismatic" and self._loaded(i)]
        words = "gravity deflection of joint"
        forms = [
            Parameter(self.id, f"joint{i + 1}", symbol, unit, sd, low, bound, meaning=f"{words} {i + 1}{by}", joint=i + 1)
            for i in joints for symbol, unit, sd, low, bound, by in self._loads_of(i)
        ]  # fmt: skip
        forms += [
            Parameter(self.id, f"payload {name}", axis, "m", CENTRE_SD, -CENTRE_BOUND, CENTRE_BOUND,
                      meaning=f"{axis} of the centre of payload {name}")
            for name in self.robot.unweighed for axis in "xyz"
        ]  # fmt: skip
        return tuple(forms)

    def _loads_of(self, joint: int) -> Iterator[tuple[str, str, float, float, float, str]]:
        """Yield symbol, unit, standard deviation, bounds and words of a joint's deflection (index from 0) by each of its loads."""
        robot = self.robot
        if self.shape == "rule":
            yield "t", "rad", NEAR_SD, 0.0, BOUND, ""
        else:
            for k in robot.carried[joint]:
                sd = NEAR_SD if joint in (k, robot.parents[k] - 1) else FAR_SD
                yield from (
                    (f"phi{k + 1}{axis}", "rad", sd, -BOUND, BOUND, f", link {k + 1} along {axis}") for axis in "xy"
                )
        if any(load.mass for load in robot.payloads.values()):
            rated = rated_torques(robot)[joint]
            yield "s", "rad/Nm", WINDUP_SD / rated, 0.0, WINDUP_BOUND / rated, ", payload"
        yield from ((f"s_{name}", "rad/m", NEAR_SD, 0.0, BOUND, f", payload {name}") for name in robot.unweighed)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return each joint's deflection by its lumped moments and the payload's torque, in nominal frames."""
        robot, n = self.robot, self.robot.n_joints
        turn = ca.SX.sym("dq", n)
        at = pose(robot, nominal_dimensions(robot), row.q, replace(Deflection.zero(n), joint=turn))
        pulled = self._pulled(at, row, p)
        slopes = ca.substitute(ca.jacobian(ca.vertcat(*pulled.values()), turn), turn, ca.SX.zeros(n, 1))
        rows = {symbol: k for k, symbol in enumerate(pulled)}
        turned = [ca.SX(0)] * n
        for k, parameter in enumerate(self.declared):
            if parameter.joint:
                i = parameter.joint - 1
                turned[i] += p[k] * slopes[rows[parameter.symbol], i]
        return replace(still, joint=ca.vertcat(*turned))

    def _pulled(self, at: Posture, row: Row, p: ca.SX) -> dict[str, ca.SX]:
        """Return, by parameter symbol, the negative potential energy per unit of it: its joint gradient is the regressor."""
        down, loads = at.down(self.robot), nominal_loads(self.robot)
        centres = self._centres(p, loads.payload_com)
        none = replace(loads, mass=0 * loads.mass, bar_mass=0 * loads.bar_mass)
        moments = {
            f"phi{k + 1}{'xy'[axis]}": ca.dot(down, frame[:3, axis])
            for k, frame in enumerate(at.links)
            for axis in (0, 1)
        }
        heavy = {
            f"s_{name}": row.payload[k]
            * ca.dot(down, apply(at.frame(self.robot, self.robot.payload_links[k]), centres[:, k]))
            for name, k in self.robot.unweighed.items()
        }
        by_rule = {"t": ca.dot(down, Arm.of(self.robot).first_moment(at))} if self.shape else {}
        return moments | by_rule | {"s": -potential_energy(self.robot, none, row, at)} | heavy

    def _centres(self, p: ca.SX, stated: ca.SX) -> ca.SX:
        """Return the payloads' centres, those of unknown mass shifted from where the robot file states them."""
        centres = ca.SX(stated)
        for name, k in self.robot.unweighed.items():
            centres[:, k] += p[self.parts[f"payload {name}"]]
        return centres

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the norm [rad] of the deflections by the links' moments and by a payload's rated torque."""
        rated = rated_torques(self.robot)
        turned = [p[k] * (rated[parameter.joint - 1] if parameter.symbol == "s" else 1.0)
                  for k, parameter in enumerate(own) if parameter.unit in ("rad", "rad/Nm")]  # fmt: skip
        return ca.sqrt(ca.sumsqr(ca.vertcat(*turned)) + NOTHING)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return the form without the rule, which may prove better beside other causes."""
        return (replace(self, shape=""),) if self.shape else ()

    def _loaded(self, joint: int) -> bool:
        """Return whether gravity can load a joint: not if its axis is vertical in every pose, as joint 1's often is."""
        before = (k for k in self.robot.chain(joint + 1) if self.robot.joints[k].kind == "revolute")
        return not all(self._upright[k] for k in before)

    @cached_property
    def _upright(self) -> tuple[bool, ...]:
        """Whether each joint's axis is vertical with all joints at zero."""
        at = nominal_posture(self.robot)
        axes = [np.array(ca.DM(ca.evalf(frame[:3, 2]))).ravel() for frame in at.joints]
        down = np.array(ca.DM(ca.evalf(at.down(self.robot)))).ravel()
        return tuple(bool(np.linalg.norm(np.cross(axis, down)) < 1e-6) for axis in axes)

    variable = joint_variable
