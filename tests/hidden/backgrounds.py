"""Backgrounds: what real robots do that no catalogue names, added to what is measured at exactly the size asked. SI units.

The size is the root mean square of the displacement per axis over all rows, as seen at the tool. Its mean over the rows is
left out before: wherever the robot stands is fitted anyway.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hidden.random_functions import random_function, random_walk
from hidden.simulator import Array, Frames, Motion, Robot, Rows, frames, moved, tool_point

TURNED = 4.0  # m from the device, where a turn of its frame moves points as far as a shift does
STEP = 1e-6  # rad, of differences


@dataclass(frozen=True)
class Background:
    """A kind of background, its size per axis [m], and its random figures' seed."""

    kind: str
    size: float
    seed: int

    @property
    def rng(self) -> np.random.Generator:
        """A generator that always draws the same background."""
        return np.random.default_rng(self.seed)


def displaced(background: Background, robot: Robot, rows: Rows) -> Array:
    """How far each row's marker is displaced, in the measuring frame (rows, 3) [m]."""
    shift = KINDS[background.kind](background.rng, robot, rows)
    shift = shift - shift.mean(axis=0)
    return background.size * shift / np.sqrt(np.mean(shift**2))


# --- Joints: an error that depends on other joints too -----------------------------------------------


@dataclass(frozen=True)
class Crossed:
    """A joint (index from 0) whose error is a smooth random function of several joints' angles, over a length [rad]."""

    driven: int
    inputs: tuple[int, ...]
    length: float


def crossed_joints(background: Background, n: int) -> tuple[Crossed, ...]:
    """Which joints of a robot of n err in a background of kind "joints", and with which angles."""
    return _crossed(background.rng, n)


def _crossed(rng: np.random.Generator, n: int) -> tuple[Crossed, ...]:
    drawn = []
    for driven in rng.choice(n, 2, replace=False):
        inputs = rng.choice(n, int(rng.choice([2, 3])), replace=False)
        drawn.append(Crossed(int(driven), tuple(map(int, inputs)), float(rng.uniform(0.7, 1.5))))
    return tuple(drawn)


def joint_errors(rng: np.random.Generator, robot: Robot, rows: Rows) -> Array:
    """Two joints err by smooth random functions of two or three joints' angles each."""
    error = np.zeros(rows.q.shape)
    for one in _crossed(rng, robot.n):
        smooth = random_function(rng, len(one.inputs), 1, one.length)
        error[:, one.driven] = smooth(rows.q[:, one.inputs])[:, 0]
    return _moved(robot, rows, error)


def _moved(robot: Robot, rows: Rows, error: Array) -> Array:
    """How small errors of driven joints (rows, n) [rad] move the tool, to first order."""
    step = STEP / np.abs(error).max()
    ahead, behind = (_points(robot, rows, sign * step * error) for sign in (1, -1))
    return (ahead - behind) / (2 * step)


def _points(robot: Robot, rows: Rows, error: Array) -> Array:
    motion, found = _at(robot, rows, error)
    return tool_point(robot, rows, motion, found.tips[-1])


def _at(robot: Robot, rows: Rows, error: Array) -> tuple[Motion, Frames]:
    motion = replace(Motion.none(len(rows), robot.n), joint=error)
    return motion, frames(robot, rows.q, motion)


# --- A hose from the arm to the flange ---------------------------------------------------------------

SOFT = (1.0, 1.0, 1.0, 3.0, 4.0, 5.0)  # how much softer the joints of the wrist are than those of the arm


def cable_drag(rng: np.random.Generator, robot: Robot, rows: Rows) -> Array:
    """A hose between the base or a link of the arm and the flange pulls when it is stretched, against the joints' springs.

    Joint i gives way by its compliance times -dU/dq_i, U the hose's energy: quadratic beyond a length at which it begins to
    pull, softly.
    """
    link = int(rng.integers(0, 3))  # 0: hung above the base
    anchor, fixed = rng.uniform([-0.3, -0.3, 0.2], [0.3, 0.3, 1.0]), rng.uniform(-0.2, 0.2, 3)
    if link == 0:
        anchor[2] += 1.5

    def length(error: Array) -> Array:
        _, found = _at(robot, rows, error)
        start = moved(found.links[link - 1], anchor) if link else anchor
        return np.linalg.norm(moved(found.tips[-1], fixed) - start, axis=1)

    rest = length(np.zeros(rows.q.shape))
    slack, softly = np.quantile(rest, rng.uniform(0.1, 0.5)), 0.1 * np.ptp(rest)
    tension = softly * np.logaddexp(0, (rest - slack) / softly)
    slope = np.empty(rows.q.shape)
    for i in range(robot.n):
        step = STEP * np.eye(robot.n)[i] + 0 * rows.q
        slope[:, i] = (length(step) - length(-step)) / (2 * STEP)
    return _moved(robot, rows, -np.array(SOFT) * tension[:, None] * slope)


# --- The measuring device and its markers ------------------------------------------------------------


def slow_drift(rng: np.random.Generator, robot: Robot, rows: Rows) -> Array:
    """The device's frame wanders in time: shift and turn, a smooth random function or an Ornstein-Uhlenbeck process."""
    memory = rng.uniform(0.1, 0.4) * np.ptp(rows.time)
    if rng.random() < 0.5:
        walk = random_function(rng, 1, 6, 1.0)(rows.time[:, None] / memory)
    else:
        walk = random_walk(rng, rows.time, 6, memory)
    point = _points(robot, rows, np.zeros(rows.q.shape))
    return walk[:, :3] + np.cross(walk[:, 3:], point) / TURNED


def shared_by_markers(rng: np.random.Generator, robot: Robot, rows: Rows) -> Array:
    """Each pose has an error that all its markers share; with one marker, each place has one, smoothly."""
    if len(robot.markers) > 1:
        poses, own = np.unique(rows.q, axis=0, return_inverse=True)
        return rng.standard_normal((len(poses), 3))[own.ravel()]
    return random_function(rng, 3, 3, 0.8)(_points(robot, rows, np.zeros(rows.q.shape)))


KINDS: dict[str, Callable[[np.random.Generator, Robot, Rows], Array]] = {
    "joints": joint_errors,
    "cable": cable_drag,
    "drift": slow_drift,
    "shared": shared_by_markers,
}
