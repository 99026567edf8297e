"""Orientation conventions: poses as robot makers write them, and as transforms (4, 4) in SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calflow.files.deferred import Rotation

Turn = Literal["quaternion", "zyx", "xyz", "vector"]
NOWHERE = np.eye(4)
MILLIMETRES, DEGREES = (1e-3,) * 3, (np.pi / 180,) * 3
UNIT_LENGTH = 1e-3  # tolerance of a quaternion's norm, as makers allow
EULER = {"zyx": "ZYX", "xyz": "xyz"}
LOCKED = 1e-9  # cosine of the middle angle below which the other two turn about the same axis


def pose_matrix(values: Sequence[float] | np.ndarray, turn: Turn) -> np.ndarray:
    """Return the transform of a position [m] and an orientation, as in `Target`; a quaternion is normalised."""
    matrix = np.eye(4)
    matrix[:3, 3] = values[:3]
    figures = np.asarray(values[3:], dtype=float)
    if turn == "quaternion":
        matrix[:3, :3] = Rotation.from_quat(figures, scalar_first=True).as_matrix()
    elif turn == "vector":
        matrix[:3, :3] = Rotation.from_rotvec(figures).as_matrix()
    else:
        matrix[:3, :3] = Rotation.from_euler(EULER[turn], figures).as_matrix()
    return matrix


@dataclass(frozen=True)
class Notation:
    """A maker's notation of a pose: rotation parameters, factor of each number to SI, and the order in words."""

    turn: Turn
    scales: tuple[float, ...]
    words: str

    def pose(self, numbers: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the transform (4, 4) of the numbers of a pose."""
        return pose_matrix(np.multiply(numbers, self.scales), self.turn)


NOTATIONS: Mapping[str, Notation] = {
    "rapid": Notation("quaternion", (*MILLIMETRES, 1.0, 1.0, 1.0, 1.0), "x,y,z,q1,q2,q3,q4 in mm"),
    "krl": Notation("zyx", (*MILLIMETRES, *DEGREES), "X,Y,Z,A,B,C in mm and degrees"),
    "fanuc": Notation("xyz", (*MILLIMETRES, *DEGREES), "X,Y,Z,W,P,R in mm and degrees"),
    "urscript": Notation("vector", (1.0,) * 6, "x,y,z,rx,ry,rz in m and radians"),
}


def pose_values(matrix: np.ndarray, turn: Turn, like: np.ndarray) -> np.ndarray:
    """Return position and orientation of a transform in a convention, in the equivalent form nearest to like."""
    before = like[3:]
    if turn == "quaternion":
        figures = Rotation.from_matrix(matrix[:3, :3]).as_quat(scalar_first=True)
        figures = figures if figures @ before >= 0 else -figures
    elif turn == "vector":
        figures = nearest_vector(Rotation.from_matrix(matrix[:3, :3]).as_rotvec(), before)
    else:
        figures = _nearest_angles(matrix[:3, :3], turn, before)
    return np.concatenate([matrix[:3, 3], figures])


def angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angle [rad] by which the orientations of transforms (..., 4, 4) differ."""
    turned = np.swapaxes(first[..., :3, :3], -1, -2) @ second[..., :3, :3]
    return np.asarray(Rotation.from_matrix(turned.reshape(-1, 3, 3)).magnitude().reshape(turned.shape[:-2]))


def nearest_vector(vector: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the rotation vector of the same rotation, modulo full turns, that is nearest to another."""
    length = np.linalg.norm(vector)
    axis = vector / length if length > LOCKED else before / max(np.linalg.norm(before), LOCKED)
    turns = np.round((axis @ before - length) / (2 * np.pi)) if np.linalg.norm(axis) > 0.5 else 0.0
    return np.asarray(axis * (length + 2 * np.pi * turns) if turns else vector)


def _nearest_angles(matrix: np.ndarray, turn: Turn, before: np.ndarray) -> np.ndarray:
    """Return the Euler angles of an orientation nearest to others: of both solutions, modulo full turns.

    In the order first, middle, last of the figures; at gimbal lock the first is kept.
    """
    fixed = turn == "xyz"  # rotations about fixed x, y, z are those about moving z, y, x in reverse order
    b = np.arctan2(-matrix[2, 0], np.hypot(matrix[0, 0], matrix[1, 0]))
    if np.hypot(matrix[0, 0], matrix[1, 0]) < LOCKED:
        a = before[2] if fixed else before[0]
        sign = np.sign(-matrix[2, 0])
        # R = Rz(a) Ry(±90°) Rx(c) depends on c ∓ a alone
        c = sign * a + np.arctan2(sign * matrix[0, 1], matrix[1, 1])
        angles = [(a, b, c)]
    else:
        a, c = np.arctan2(matrix[1, 0], matrix[0, 0]), np.arctan2(matrix[2, 1], matrix[2, 2])
        angles = [(a, b, c), (a + np.pi, np.pi - b, c + np.pi)]
    ways = [np.array(triple[::-1] if fixed else triple) for triple in angles]
    ways = [way + 2 * np.pi * np.round((before - way) / (2 * np.pi)) for way in ways]
    return min(ways, key=lambda way: float(np.abs(way - before).sum()))
