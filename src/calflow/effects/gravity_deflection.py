"""Gravity deflection: joint compliance of a robot whose link masses are unknown."""

from __future__ import annotations

from collections.abc import Sequence
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
        robot = self.robot
        forms = []
        loaded = [load for load in robot.payloads.values() if load.mass]
        unknown = [name for name, load in robot.payloads.items() if load.mass is None]
        rated = rated_torques(robot) if loaded else np.ones(robot.n_joints)
        for i, joint in enumerate(robot.joints):
            part, words = f"joint{i + 1}", f"gravity deflection of joint {i + 1}"
            if joint.kind == "prismatic" or not self._loaded(i):
                continue
            if self.shape == "rule":
                forms.append(Parameter(self.id, part, "t", "rad", NEAR_SD, 0.0, BOUND, meaning=words, joint=i + 1))
            else:
                forms += [
                    Parameter(self.id, part, f"phi{k + 1}{axis}", "rad",
                              NEAR_SD if i in (k, robot.parents[k] - 1) else FAR_SD, -BOUND, BOUND,
                              meaning=f"{words}, link {k + 1} along {axis}", joint=i + 1)
                    for k in robot.carried[i] for axis in "xy"
                ]  # fmt: skip
            if loaded:
                forms.append(Parameter(self.id, part, "s", "rad/Nm", WINDUP_SD / rated[i], 0.0, WINDUP_BOUND / rated[i],
                                       meaning=f"{words}, payload", joint=i + 1))  # fmt: skip
            forms += [
                Parameter(
                    self.id, part, symbol, "rad/m", NEAR_SD, 0.0, BOUND, meaning=f"{words}, payload {load}", joint=i + 1
                )
                for symbol, load in zip(self._unknown, unknown, strict=True)
            ]
        forms += [
            Parameter(self.id, f"payload {name}", axis, "m", CENTRE_SD, -CENTRE_BOUND, CENTRE_BOUND,
                      meaning=f"{axis} of the centre of payload {name}")
            for name in unknown for axis in "xyz"
        ]  # fmt: skip
        return tuple(forms)

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
            symbol: row.payload[k]
            * ca.dot(down, apply(at.frame(self.robot, self.robot.payload_links[k]), centres[:, k]))
            for symbol, k in self._unknown.items()
        }
        by_rule = {"t": ca.dot(down, Arm.of(self.robot).first_moment(at))} if self.shape else {}
        return moments | by_rule | {"s": -potential_energy(self.robot, none, row, at)} | heavy

    def _centres(self, p: ca.SX, stated: ca.SX) -> ca.SX:
        """Return the payloads' centres, those of unknown mass shifted from where the robot file states them."""
        centres, names = ca.SX(stated), list(self.robot.payloads)
        for k in self._unknown.values():
            centres[:, k] += p[self.parts[f"payload {names[k]}"]]
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

    @property
    def _unknown(self) -> dict[str, int]:
        """The symbols of the payloads of unknown mass, with their indices among all payloads."""
        return {f"s_{name}": k for k, (name, load) in enumerate(self.robot.payloads.items()) if load.mass is None}

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
