"""Homogeneous transforms as CasADi expressions (4x4, lengths in m, angles in rad).

Angles: a rotation as turns about three axes, in the order that files and makers have them.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from calflow.robot.frames import Motion

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Scalar = ca.SX | ca.DM | float


def _rotation(axis: int, angle: Scalar) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    matrix = ca.SX.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def rot_x(angle: Scalar) -> ca.SX:
    """Rotation about x."""
    return _rotation(0, angle)


def rot_y(angle: Scalar) -> ca.SX:
    """Rotation about y."""
    return _rotation(1, angle)


def rot_z(angle: Scalar) -> ca.SX:
    """Rotation about z."""
    return _rotation(2, angle)


def translation(x: Scalar, y: Scalar, z: Scalar) -> ca.SX:
    """Translation by (x, y, z)."""
    matrix = ca.SX.eye(4)
    matrix[0, 3], matrix[1, 3], matrix[2, 3] = x, y, z
    return matrix


def elementary(motion: Motion, value: Scalar) -> ca.SX:
    """Turn about an axis, or shift along it."""
    kind, axis = motion
    if kind == "r":
        return _rotation("xyz".index(axis), value)
    return translation(*(value if axis == other else 0 for other in "xyz"))


def placement(v: ca.SX | ca.DM) -> ca.SX:
    """Translation by v[0:3], then rotations about x, y and z by v[3:6], each about the axis already turned."""
    return translation(v[0], v[1], v[2]) @ rot_x(v[3]) @ rot_y(v[4]) @ rot_z(v[5])


def turning(rotation: ca.SX, by: ca.SX) -> ca.SX:
    """Return how a rotation (3, 3) turns about its own axes by each symbol, shape (3, n) [rad per unit]."""
    x, y, z = (rotation[:, k] for k in range(3))
    slope = ca.jacobian(ca.vec(rotation), by)
    return ca.vertcat(z.T @ slope[3:6, :], x.T @ slope[6:, :], y.T @ slope[:3, :])


def apply(transform: ca.SX, point: ca.SX) -> ca.SX:
    """Return the point (3,) moved by the transform."""
    return transform[:3, :3] @ point + transform[:3, 3]


def angles(turn: Rotation, order: str = "XYZ") -> np.ndarray:
    """Return the turns [rad] that make up a rotation, about axes in an order that is named as SciPy does.

    Where the middle one is a right angle the other two turn about the same line: then all of that is said by the first.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # which is said above, and no trouble: tools often stand so
        return np.asarray(turn.as_euler(order))
