"""Dress pack: hoses and cables, or a tool balancer, that pull a link towards a place above or beside the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import NOTHING, Effect, Variable, Words, joint_variable
from calflow.effects.beam import beams
from calflow.measurements.measurements import Measurements
from calflow.robot.frames import elementary
from calflow.robot.mechanism import Row, State, nominal_posture, rated_torques, spread
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

# Times the force at the arm's length that loads joint 2 as rated: about a tool's weight, of which the pull of its hoses is a part.
SD, BOUND = 0.1, 1.0
HEIGHTS = (0.4, 0.8, 1.6)  # of the hook h above joint 2, in lengths of the arm
SLACK = 0.6  # length of a hose that is taut beyond it alone, in lengths of the arm
NEAR = 0.1  # lengths of the arm from the hook within which a pull turns about: a hose does not end in a point
# Times a height or length, tried when refining the best variant.
STEPS = 2 ** (np.array([-6, -4, -2, -1, 1, 2, 4, 6]) / 8)
ASIDE = (-0.2, -0.1, -0.05, 0.05, 0.1, 0.2)  # lengths of the arm, tried likewise
POSES = 64  # over which the size of a pull is its root mean square


@dataclass(frozen=True)
class DressPack(Effect):
    """Force (s (h - o) + L f) / l on a link's end o, turned into torques; l² = |h - o|² + (L / 10)² = d², of a spring l = L.

    A spring may be slack up to a length: times 1 - slack L / d, which is 0 where negative. The hook h is on joint 1's axis at
    joint 2's height, or `height`, x and y times the arm's length L above and beside that; x and y are joint 1's at zero. The pull
    comes from h + L f / s; a spring's (height 0, or slack) grows with the distance from there. The torques are observable by the
    wind-up of the joints.
    """

    slack: float = 0.0
    height: float = 0.0
    x: float = 0.0
    y: float = 0.0

    id = "dress-pack"
    title = "pull of hoses and cables"
    words = Words("pull of hoses", "hoses, cables or a balancer pull the link towards where they are hung up", "force")
    place_word = "link"
    needs = ("masses",)
    told_by = "measure some poses again with the hoses and cables taken off the arm"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return a spring, slack ones from two heights, a constant pull from three; none where no link is long enough."""
        slack = (cls(robot, SLACK, height) for height in (0.0, HEIGHTS[0]))
        forms = (cls(robot), *slack, *(cls(robot, height=height) for height in HEIGHTS))
        return tuple(form for form in forms if form.declared)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return heights, or lengths that are slack, between this one and its neighbours, and places aside."""
        if not self.slack and not self.height:
            return ()
        near = [replace(self, x=self.x + aside) for aside in ASIDE]
        near += [replace(self, y=self.y + aside) for aside in ASIDE]
        if not self.slack:
            return (*near, *(replace(self, height=float(self.height * step)) for step in STEPS))
        near += [replace(self, height=self.height + aside) for aside in ASIDE]
        return (*near, *(replace(self, slack=float(self.slack * step)) for step in STEPS))

    @property
    def detail(self) -> str:
        """What pulls, and from where."""
        aside = f", {self.x:.3g} and {self.y:.3g} aside" if self.x or self.y else ""
        hung = f"from {self.height:.3g} arm's lengths above joint 2{aside}" if self.height or aside else ""
        if self.slack:
            return f"slack up to {self.slack:.3g} arm's lengths{hung and ' '}{hung}"
        return f"constant, {hung}" if self.height else "spring"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is required of the robot."""
        able = cls(robot).declared
        return "" if able else "an arm alone that turns about joint 1, with a link over 0.2 m beyond joint 2"

    @property
    def _links(self) -> list[int]:
        """The links beyond joint 2 (from 0) at whose ends hoses are held: those of short ones are about where others are."""
        arm = self.robot.arm if self.robot.is_one_arm else []
        turns = bool(arm) and self.robot.joints[arm[0]].kind == "revolute"
        return [beam.link for beam in beams(self.robot) if turns and beam.link in arm[2:]]

    @property
    def _length(self) -> float:
        """Length of the arm beyond joint 2's axis [m]."""
        return sum(beam.length for beam in beams(self.robot) if beam.link in self.robot.arm[1:])

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each link's pull towards h, and what displaces its aim."""
        rated = rated_torques(self.robot)
        return tuple(
            Parameter(self.id, f"link{link + 1}", symbol, "N", SD * most, -BOUND * most, BOUND * most,
                      meaning=f"pull of hoses on link {link + 1} {way}", joint=link + 1)
            for link in self._links for most in [float(rated[self.robot.arm[1]]) / self._length]
            for symbol, way in (("s", "towards h"), ("fx", "along x"), ("fy", "along y"), ("fz", "upwards"))
        )  # fmt: skip

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Return the torques of the pulls on the driven joints."""
        return ca.sparsify(_torque(self)(state.q, p)[0]) if self.declared else 0.0

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the root mean square of the force over the joints' ranges."""
        return ca.sqrt(ca.bilin(ca.DM(_squares(self)[own[0].joint - 1]), p, p) + NOTHING)

    def variable(self, joint: int) -> Variable:
        """Return the angle of joint 2, which lifts the link."""
        return joint_variable(self, self.robot.arm[1] + 1)


@lru_cache(maxsize=64)
def _torque(effect: DressPack) -> ca.Function:
    """Return the function (q, p) -> torques of the pulls on the nominal robot's driven joints, and their forces by link."""
    robot, reach = effect.robot, effect._length
    q, p = ca.SX.sym("q", robot.n_joints), ca.SX.sym("p", len(effect.declared))
    at, torque, forces = nominal_posture(robot, q), ca.SX(robot.n_joints, 1), list[ca.SX]()
    first, second = (at.joints[joint] for joint in robot.arm[:2])
    # Some makers' joint 1 counts about a downward axis.
    upwards = ca.if_else(ca.dot(at.down(robot), first[:3, 2]) > 0, -1, 1)
    turned = ca.diag(ca.vertcat(1, 1, upwards)) @ elementary("rz", q[robot.arm[0]])[:3, :3] @ first[:3, :3].T
    frames = second, *(at.ends[link + 1] for link in effect._links)
    shoulder, *ends = (turned @ (frame[:3, 3] - first[:3, 3]) for frame in frames)
    hook = reach * ca.vertcat(effect.x, effect.y, shoulder[2] / reach + effect.height)
    for end, own in zip(ends, ca.vertsplit(p, 4), strict=True):
        away = ca.sqrt(ca.sumsqr(hook - end) + (NEAR * reach) ** 2)
        pull = (own[0] * (hook - end) + own[1:] * reach) / (away if effect.height and not effect.slack else reach)
        forces.append(pull * ca.fmax(0, 1 - effect.slack * reach / away) if effect.slack else pull)
        torque += ca.jtimes(end, q, forces[-1], True)
    return ca.Function("torque", [q, p], [torque, *forces])


@lru_cache(maxsize=64)
def _squares(effect: DressPack) -> dict[int, np.ndarray]:
    """Return for each link the matrix (4, 4) of the mean square of its force over the joints' ranges."""
    of, q, ones = _torque(effect), spread(effect.robot, POSES).T, np.ones((len(effect.declared), POSES))
    each = [of.map(POSES)(q, one[:, None] * ones)[1:] for one in np.eye(len(effect.declared))]
    forces = np.array([[np.array(force).ravel() for force in by_link] for by_link in each])
    own = {link: forces[4 * k : 4 * k + 4, k] for k, link in enumerate(effect._links)}
    return {link: force @ force.T / POSES for link, force in own.items()}
