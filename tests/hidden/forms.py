"""Causes in other forms than textbooks draw them: skew, off-centre, with rates and lengths of their own. SI units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hidden.beams import bent, round_tube
from hidden.simulator import WEIGHT, Array, Motion, Robot, Rows, State, carried

if TYPE_CHECKING:
    from hidden.causes import Hidden

COLUMN, ARM = 0.6, 0.15  # m: a compensator's hinges from joint 2


# --- A bracket between flange and tool ---------------------------------------------------------------


def cantilever_bracket(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A slanting bracket carries the payload and all markers, and bends and twists under it; size is its end's shift [m/N]."""
    rng = h.rng
    length = rng.uniform(0.15, 0.5)
    end = length * slanting(rng, np.array([0.0, 0.0, 1.0]), np.deg2rad(60))
    flange = state.frames.tips[-1][:, :3, :3]
    force = (WEIGHT @ flange) * carried(robot, rows)[:, None]
    moment = np.cross(robot.payload_com[rows.payload] - end, force)
    soft = 3 * h.size / length**3 * round_tube(end)
    shift, turn = bent(np.array([np.zeros(3), end]), [soft], force, moment)
    motion = Motion.none(len(rows), robot.n)
    motion.tip[:, -1] = np.concatenate([shift - np.cross(turn, end), turn], axis=1)
    return motion


# --- Bearings and links ------------------------------------------------------------------------------


def offset_bearing(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A bearing (not the first) tilts about a pivot beside its joint's origin, by size [rad/Nm] times the moment about it.

    extra is how far the pivot lies from the joint's origin [m], in a drawn direction; all that the joint carries is shifted
    with the end of the link before.
    """
    i = h.joint - 1
    pivot = float(h.extra or 0.2) * slanting(h.rng, np.array([0.0, 0.0, 1.0]), np.pi)
    before, joint = (frames[:, :3, :3] for frames in (state.frames.tips[i - 1], state.frames.joints[i]))
    from_joint = np.swapaxes(before, 1, 2) @ joint
    force = np.einsum("nji,nj->ni", from_joint, state.tip_force[:, i - 1])
    tilt = h.size * (state.moment[:, i] - np.cross(pivot, force)) * np.array([1.0, 1.0, 0.0])
    motion = Motion.none(len(rows), robot.n)
    motion.bearing[:, i] = tilt
    motion.tip[:, i - 1, :3] = np.einsum("nij,nj->ni", from_joint, -np.cross(tilt, pivot))
    return motion


def warm_link(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """One link alone grows, in the end by size, as it warms up over a time of its own; with extra "cooling" it shrinks back."""
    cooled = np.exp(-rows.time / h.rng.uniform(1200, 6000))
    grown = 1 + h.size * (cooled if h.extra == "cooling" else 1 - cooled)
    a, d = (np.array(np.broadcast_to(lengths, (len(rows), robot.n))) for lengths in (robot.a, robot.d))
    d[:, h.joint - 1] *= grown
    if h.joint < robot.n:
        a[:, h.joint] *= grown
    return replace(robot, a=a, d=d)


# --- A compensator with a spring ---------------------------------------------------------------------


def spring_compensator(h: Hidden, state: State) -> Array:
    """Torque [Nm] on joint 2 of a spring between the column and the arm that pulls with size [N] when it is as long as COLUMN.

    Its rate and the directions of both hinges, oblique, are drawn.
    """
    spring = Spring.drawn(h)
    arm, line = spring.line(state)
    length = np.linalg.norm(line, axis=1)
    pull = -(spring.force(length) / length)[:, None] * line
    return (np.cross(arm, pull) * state.frames.joints[1][:, :3, 2]).sum(axis=1)


@dataclass(frozen=True)
class Spring:
    """A spring's force [N] at COLUMN's length, how much of it a change by ARM adds, and both hinges' angles [rad]."""

    size: float
    rate: float
    column: float
    arm: float

    @staticmethod
    def drawn(h: Hidden) -> Spring:
        """The same spring for the same seed; the column's hinge is 20 to 80 degrees from below, to either side."""
        rng = h.rng
        column = rng.choice([-1, 1]) * rng.uniform(np.deg2rad(20), np.deg2rad(80))
        return Spring(h.size, rng.uniform(0.4, 0.9), column, rng.uniform(-0.7, 0.7))

    def force(self, length: Array) -> Array:
        """Its tension [N]."""
        return self.size * (1 + self.rate * (length - COLUMN) / ARM)

    def line(self, state: State) -> tuple[Array, Array]:
        """From joint 2 to the arm's hinge, and from the column's hinge to the arm's (rows, 3)."""
        joint, below = state.frames.joints[1], -state.frames.tips[0][:, :3, 2]
        aside = np.cross(joint[:, :3, 2], below)
        arm = ARM * (np.cos(self.arm) * joint[:, :3, 0] + np.sin(self.arm) * joint[:, :3, 1])
        return arm, arm - COLUMN * (np.cos(self.column) * below + np.sin(self.column) * aside)


def slanting(rng: np.random.Generator, axis: Array, most: float) -> Array:
    """A random unit vector, slanting from an axis by an angle up to most [rad]."""
    across = np.cross(axis, rng.normal(size=3))
    angle = rng.uniform(0, most)
    return np.cos(angle) * axis + np.sin(angle) * across / np.linalg.norm(across)


ON_MOTION = {"cantilever-bracket": cantilever_bracket, "offset-bearing": offset_bearing}
ON_ROBOT = {"warm-link": warm_link}
ON_TORQUE = {"spring-compensator": spring_compensator}
