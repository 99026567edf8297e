"""Gravity deflection: joint compliance of a robot whose masses nobody knows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words, joint_variable
from calflow.effects.joint_compliance import WINDUP_BOUND, WINDUP_SD
from calflow.robot.chain import Deflection, pose
from calflow.robot.conditions import Row
from calflow.robot.dimensions import nominal_dimensions, nominal_loads
from calflow.robot.links import to_axis
from calflow.robot.parameter import Parameter
from calflow.robot.robot import Robot
from calflow.robot.statics import State, potential_energy, rated_torques

NEAR_SD, FAR_SD, BOUND = (
    2e-3,
    3e-4,
    20e-3,
)  # rad, by the first moment of the links next to the joint and of those beyond


@dataclass(frozen=True)
class GravityDeflection(Effect):
    """dq_i = Y_i(q) phi_i: torque is linear in the links' first moments, whatever the masses are (Khalil and Dombre 2002).

    phi_i holds the first moments of link i and those beyond it, times gravity and the joint's compliance [rad]; a link's
    end carries all that is beyond it, so that its own two directions across the joint's axis are enough. Payloads whose
    masses the robot file states add s_i times their known torque.
    """

    id: ClassVar[str] = "gravity-deflection"
    title: ClassVar[str] = "gravity deflection (joint compliance, masses unknown)"
    words: ClassVar[Words] = Words("gravity deflection", "the joint sags under the robot's own weight", "size")

    @classmethod
    def superseded(cls, robot: Robot) -> str:
        """Say that it is not needed where torques are known."""
        return "the masses are known, so joint-compliance stands for it" if robot.has_masses else ""

    @classmethod
    def springs(cls, robot: Robot) -> bool:
        """Return whether the masses are unknown."""
        return not robot.has_masses

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the lumped first moments that load each joint, and its compliance under known payloads."""
        robot = self.robot
        found = []
        loaded = [load for load in robot.payloads.values() if load.mass]
        rated = rated_torques(robot) if loaded else np.ones(robot.n_joints)
        for i, joint in enumerate(robot.joints):
            part, words = f"joint{i + 1}", f"gravity deflection of joint {i + 1}"
            if joint.kind == "prismatic" or not self._loaded(i):
                continue
            found += [
                Parameter(self.id, part, f"phi{k + 1}{axis}", "rad", NEAR_SD if k <= i + 1 else FAR_SD, -BOUND, BOUND,
                          meaning=f"{words}, link {k + 1} along {axis}", joint=i + 1)
                for k in range(i, robot.n_joints) for axis in "xy"
            ]  # fmt: skip
            if loaded:
                found.append(Parameter(self.id, part, "s", "rad/Nm", WINDUP_SD / rated[i], 0.0, WINDUP_BOUND / rated[i],
                                       meaning=f"{words}, payload", joint=i + 1))  # fmt: skip
        return tuple(found)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Turn each joint by its lumped moments and the payload's torque, in the nominal robot's frames."""
        robot, n = self.robot, self.robot.n_joints
        turn = ca.SX.sym("dq", n)
        at = pose(robot, nominal_dimensions(robot), row.q, replace(Deflection.zero(n), joint=turn))
        down = ca.DM(robot.gravity) / np.linalg.norm(robot.gravity)
        own = [ca.dot(down, frame[:3, axis]) for frame in at.links for axis in (0, 1)]
        loads = nominal_loads(robot)
        none = replace(loads, mass=0 * loads.mass, bar_mass=0 * loads.bar_mass)
        pulled = ca.vertcat(*own, -potential_energy(robot, none, row, at))
        slopes = ca.substitute(ca.jacobian(pulled, turn), turn, ca.SX.zeros(n, 1))
        index = {(int(parameter.joint), parameter.symbol): k for k, parameter in enumerate(self.declared)}
        turned = []
        for i in range(n):
            terms = ca.SX(0)
            for k in range(i, n):
                for a, axis in enumerate("xy"):
                    at_p = index.get((i + 1, f"phi{k + 1}{axis}"))
                    terms += 0 if at_p is None else p[at_p] * slopes[2 * k + a, i]
            at_p = index.get((i + 1, "s"))
            turned.append(terms if at_p is None else terms + p[at_p] * slopes[2 * n, i])
        return replace(still, joint=ca.vertcat(*turned))

    def _loaded(self, joint: int) -> bool:
        """Whether gravity can load a joint: not where its axis is vertical in every pose, as the first one's is."""
        return joint > 0 or not self._upright

    @property
    def _upright(self) -> bool:
        robot = self.robot
        axis = np.array(ca.DM(ca.evalf(to_axis(ca.SX.eye(4), robot, nominal_dimensions(robot), 0)[:3, 2]))).ravel()
        return bool(np.linalg.norm(np.cross(axis, robot.gravity)) < 1e-6)

    def variable(self, joint: int) -> Variable:
        """Return the joint's angle."""
        return joint_variable(self.robot, joint)
