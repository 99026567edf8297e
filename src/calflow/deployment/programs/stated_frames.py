"""Stated frames: tools and frames that a user gives for a program, in the way of its maker."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from calflow.deployment.programs.orientation import pose_matrix
from calflow.deployment.programs.target import Maker, Turn
from calflow.files.problems import refuse

# What six or seven numbers are to each maker: of which turn, and how much one of a length and of an angle is in SI.
WAYS: Mapping[Maker, tuple[Turn, float, float, str]] = {
    "rapid": ("quaternion", 1e-3, 1.0, "x,y,z,q1,q2,q3,q4 in mm"),
    "krl": ("zyx", 1e-3, np.pi / 180, "X,Y,Z,A,B,C in mm and degrees"),
    "fanuc": ("xyz", 1e-3, np.pi / 180, "X,Y,Z,W,P,R in mm and degrees"),
    "urscript": ("vector", 1.0, 1.0, "x,y,z,rx,ry,rz in m and radians"),
}
UNIT_LENGTH = 1e-3


def stated_frames(maker: Maker, options: Iterable[str], option: str) -> tuple[dict[str, np.ndarray], str | None]:
    """Return the frames of `NAME=numbers` by name, and the name that stands alone: of what the program does not name.

    Args:
        maker: whose numbers they are.
        options: the user's words.
        option: how the option is called, for what is told.

    Raises:
        InputError: they cannot be understood.
    """
    frames: dict[str, np.ndarray] = {}
    usual = None
    for text in options:
        name, equals, numbers = text.partition("=")
        name = name.strip().lower() if maker == "rapid" else name.strip()
        if not name:
            raise refuse(f"expected NAME or NAME=numbers, found '{text}'", key=option)
        if equals:
            frames[name] = stated_frame(maker, numbers, f"{option} {name}")
        else:
            usual = name
    return frames, usual


def stated_frame(maker: Maker, text: str, key: str) -> np.ndarray:
    """Return the transform (4, 4) that numbers in a maker's way mean; key says where they are from.

    Raises:
        InputError: they are none.
    """
    turn, length, angle, way = WAYS[maker]
    words = [word for word in re.split(r"[\s,;\[\]{}()]+", text) if word]
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([np.nan])
    wanted = 7 if turn == "quaternion" else 6
    if len(values) != wanted or not np.isfinite(values).all():
        raise refuse(f"expected {way}, found '{text.strip()}'", key=key)
    if turn == "quaternion" and abs(np.linalg.norm(values[3:]) - 1) > UNIT_LENGTH:
        raise refuse(f"expected a quaternion of length 1, found one of {np.linalg.norm(values[3:]):.4g}", key=key)
    return pose_matrix(values * np.array([length] * 3 + [angle] * (wanted - 3)), turn)
