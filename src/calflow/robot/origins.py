"""Origins: frames stated by a place and a turn in full, as URDF does, and which of their errors are parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from calflow.robot.frames import Frame, Motion, Place, Step
from calflow.robot.parts import Vector

AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
SHIFTS: tuple[Motion, ...] = ("tx", "ty", "tz")
TURNS: tuple[Motion, ...] = ("rx", "ry", "rz")
BEYOND: tuple[Place, ...] = ("middle", "last")
LISTED = ("x", "y", "z", "rx", "ry", "rz", "theta")
ZEROS_WEIGHT = 10.0  # how much rather a joint's zero is kept: where axes are parallel, from 0.1 m between them on
NO_TURN = 1e-12  # rad


@dataclass(frozen=True)
class FrameOrigin:
    """Where a frame stands in another: shifted by xyz [m], then turned by rpy [rad] about its fixed x, y and z in turn."""

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> np.ndarray:
        """The turn as a matrix (3, 3)."""
        roll, pitch, yaw = self.rpy
        return about(2, yaw) @ about(1, pitch) @ about(0, roll)

    def at(self, point: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return a point (3,) of the frame as the other frame sees it."""
        return np.array(self.xyz) + self.rotation @ np.array(point)

    @property
    def inverse(self) -> FrameOrigin:
        """Where the frame in which it stands is, seen from its own."""
        if self == FrameOrigin():
            return self
        x, y, z = map(float, -self.rotation.T @ np.array(self.xyz))
        return FrameOrigin((x, y, z), rpy_of(self.rotation.T))

    def then(self, inner: FrameOrigin) -> FrameOrigin:
        """Return the origin of a frame that stands in this one."""
        if self == FrameOrigin():
            return inner
        if inner == FrameOrigin():
            return self
        x, y, z = map(float, self.at(inner.xyz))
        return FrameOrigin((x, y, z), rpy_of(self.rotation @ inner.rotation))


def about(axis: int, angle: float) -> np.ndarray:
    """Return the turn (3, 3) about an axis (0: x, 1: y, 2: z)."""
    matrix, (i, j) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[j, i] = np.sin(angle)
    matrix[i, j] = -matrix[j, i]
    return matrix


def rpy_of(rotation: np.ndarray) -> Vector:
    """Return the turns about fixed x, y and z in turn [rad] that make up a rotation (3, 3)."""
    across = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    pitch = float(np.arctan2(-rotation[2, 0], across))
    # Near a right angle x and z turn about nearly the same line: x takes what rounding leaves of z, and at one all of it.
    yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0])) if across > NO_TURN else 0.0
    y = np.cos(yaw) * rotation[1] - np.sin(yaw) * rotation[0]
    return float(np.arctan2(-y[2], y[1])), pitch, yaw


@dataclass(frozen=True)
class Axis:
    """A joint's axis: its direction in the joint's own frame, of length 1, and whether it is turned about or slid along."""

    direction: Vector
    slides: bool = False

    @property
    def nearest(self) -> int:
        """The coordinate axis (0 to 2) that it is nearest to."""
        return int(np.argmax(np.abs(self.direction)))

    @property
    def turns(self) -> tuple[float, float]:
        """The turns about z and then y [rad] that lead from z to it."""
        x, y, z = self.direction
        across = np.hypot(x, y)
        around = float(np.arctan2(y, x)) if across > NO_TURN else 0.0
        return around, float(np.arctan2(across, z)) if across > NO_TURN else (0.0 if z > 0 else np.pi)


def joint_frame(
    origin: FrameOrigin, axis: Axis, before: Axis | None, zero: float = 0.0, tip: FrameOrigin | None = None
) -> Frame:
    """Return the frame of a joint that stands at an origin in the link before, and whose own axes its link has.

    before is the axis of the joint before, None for the first joint; zero [rad or m] is added to the joint's variable; tip is
    the flange in the last joint's frame. Parameters are x, y, z (its place), two turns about coordinate axes that tilt the
    axis, and the joint's zero, without those that the others do whatever the pose (see `left_out`).
    """
    around, tilt = axis.turns
    free = _free(origin, axis, before)

    def figure(motion: Motion, symbol: str, value: float = 0.0) -> Step:
        return Step(motion, symbol, float(value), BEYOND if symbol in free else ())

    aligned = (Step("rz", "around", around), Step("ry", "tilt", tilt))
    back = (Step("ry", "tilt_back", -tilt), Step("rz", "around_back", -around))
    roll, pitch, yaw = origin.rpy
    return Frame(
        reach=tuple(figure(SHIFTS[k], AXES[k], origin.xyz[k]) for k in range(3)),
        mount=(
            *_stated(Step("rz", "yaw", yaw), Step("ry", "pitch", pitch), Step("rx", "roll", roll)),
            *(figure(turn, turn) for turn in _tilts(axis)),
            *_stated(*aligned),
        ),
        turn=figure("rz", "theta", 0.0 if axis.slides else zero),
        body=(*((Step("tz", "s", zero),) if axis.slides else ()), *_stated(*back), *_to_tip(tip)),
        listed=LISTED,
    )


def origins_left_out(frame: Frame) -> tuple[str, ...]:
    """Return the figures of an origin's frame that are no parameters, since others do the same whatever the pose."""
    return tuple(step.symbol for step in frame.steps if step.symbol in LISTED and not step.free)


def _tilts(axis: Axis) -> tuple[Motion, ...]:
    """The two turns that tilt an axis: about the coordinate axes that it is not near to."""
    return tuple(turn for k, turn in enumerate(TURNS) if k != axis.nearest)


def _stated(*steps: Step) -> tuple[Step, ...]:
    """The steps that lead anywhere."""
    return tuple(step for step in steps if step.value)


def _to_tip(tip: FrameOrigin | None) -> tuple[Step, ...]:
    if tip is None:
        return ()
    (x, y, z), (roll, pitch, yaw) = tip.xyz, tip.rpy
    return _stated(
        Step("tx", "tip_x", x), Step("ty", "tip_y", y), Step("tz", "tip_z", z),
        Step("rz", "tip_yaw", yaw), Step("ry", "tip_pitch", pitch), Step("rx", "tip_roll", roll),
    )  # fmt: skip


def _free(origin: FrameOrigin, axis: Axis, before: Axis | None) -> frozenset[str]:
    """The figures whose errors are parameters of their own.

    What moves the joint along or about the axis before moves that joint's own frame and is counted there (of a slide every shift
    and the turn about it). The others kept are those that, with these motions, span all small motions best.
    """
    if before is None:
        return frozenset()  # the base has them
    turning, place = origin.rotation, np.array(origin.xyz)
    lines: dict[str, np.ndarray] = {turn: turning[:, TURNS.index(turn)] for turn in _tilts(axis)}
    lines["theta"] = turning @ np.array(axis.direction)
    twists: dict[str, np.ndarray] = {AXES[k]: np.concatenate([np.eye(3)[k], np.zeros(3)]) for k in range(3)}
    twists |= {name: np.concatenate([np.cross(place, line), line]) for name, line in lines.items()}
    shifts = np.eye(3) if before.slides else np.array([before.direction])
    same = [np.concatenate([shift, np.zeros(3)]) for shift in shifts]
    same.append(np.concatenate([np.zeros(3), before.direction]))

    def worth(kept: tuple[str, ...]) -> float:
        spanned = abs(float(np.linalg.det(np.array([*same, *(twists[name] for name in kept)]))))
        return round(spanned * (ZEROS_WEIGHT if "theta" in kept else 1.0), 6)

    best = max(combinations(twists, 6 - len(same)), key=worth)
    return frozenset(best)
