"""Angles: a rotation as turns about three axes, in the order that files and makers have them."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


def angles(turn: Rotation, order: str = "XYZ") -> np.ndarray:
    """Return the turns [rad] that make up a rotation, about axes in an order that is named as SciPy does.

    Where the middle one is a right angle the other two turn about the same line: then all of that is said by the first.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # which is said above, and no trouble: tools often stand so
        return np.asarray(turn.as_euler(order))
