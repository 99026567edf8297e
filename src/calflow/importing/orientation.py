"""The convention of measured orientations, whose relative rotations agree with the robot's for any base and tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from calflow.files.deferred import Rotation
from calflow.importing.bag import QUATERNION
from calflow.importing.foreign_table import ForeignColumn
from calflow.robot.frames import angles

EULER = (("rx", "ry", "rz"), ("roll", "pitch", "yaw"))
AGREES = 0.02  # rad: largest median difference of relative rotation angles from the robot's
SURELY = 5.0  # factor by which every other convention must be worse
FULL_TURN = 2.1 * np.pi  # rad: larger values are in degrees


@dataclass(frozen=True, eq=False)
class Orientations:
    """Measured orientations, their columns and convention, and the tool's rotation (x, y, z) from the flange [rad]."""

    turns: Rotation
    columns: tuple[int, ...]
    convention: str
    tool: tuple[float, float, float]


def infer_orientations(
    columns: Sequence[ForeignColumn], members: Mapping[str, int], flange: np.ndarray
) -> Orientations | None:
    """Return orientations from columns, given the flange's rotations (n_rows, 3, 3); None if none fits uniquely.

    Between two rows, flange and measured frame rotate by the same angle, whatever the poses of base and tool.
    """
    robot = Rotation.from_matrix(flange)
    candidates = []
    for names in (QUATERNION, *EULER):
        if all(name in members for name in names):
            used = tuple(members[name] for name in names)
            figures = np.column_stack([columns[k].figures for k in used])
            if not np.isfinite(figures).all():
                continue
            for convention, turns in _read(names, figures, columns[used[0]].unit):
                candidates.append((_apart(turns, robot), convention, turns, used))
    candidates.sort(key=lambda candidate: candidate[0])
    if (
        not candidates
        or candidates[0][0] > AGREES
        or (len(candidates) > 1 and candidates[1][0] < SURELY * candidates[0][0])
    ):
        return None
    _, convention, turns, used = candidates[0]
    return Orientations(turns, used, convention, _tool(turns, robot))


def _read(names: Sequence[str], figures: np.ndarray, unit: str) -> list[tuple[str, Rotation]]:
    """Values (n_rows, 3 or 4) as rotations, in each possible convention."""
    if names == QUATERNION:
        norm = np.linalg.norm(figures, axis=1)
        return (
            [("a quaternion", Rotation.from_quat(figures))] if (norm > 0).all() and (abs(norm - 1) < 0.01).all() else []
        )
    degrees = unit == "deg" or (unit != "rad" and np.abs(figures).max() > FULL_TURN)
    rad = np.deg2rad(figures) if degrees else figures
    ways = []
    for order in permutations((0, 1, 2)):
        axes = "".join("XYZ"[k] for k in order)
        words = f"angles about moving {', '.join(axes[:2].lower())} and {axes[2].lower()} in turn"
        ways.append((words, Rotation.from_euler(axes, rad[:, order])))
    return [*ways, ("a rotation vector", Rotation.from_rotvec(rad))]


def _relative(turns: Rotation) -> np.ndarray:
    """Rotation vectors (n_rows, 3) of each row relative to the first."""
    return np.asarray((turns[0].inv() * turns).as_rotvec())


def _apart(measured: Rotation, robot: Rotation) -> float:
    """The median difference of both rotation angles relative to the first row [rad]."""
    mine, theirs = (np.linalg.norm(_relative(turns), axis=1)[1:] for turns in (measured, robot))
    return float(np.median(np.abs(mine - theirs)))


def _tool(measured: Rotation, robot: Rotation) -> tuple[float, float, float]:
    """The angles (x, y, z) [rad] from flange to measured frame, by alignment of rotation vectors (Kabsch 1976)."""
    mine, theirs = _relative(measured)[1:], _relative(robot)[1:]
    turn, _ = Rotation.align_vectors(theirs, mine)
    x, y, z = map(float, angles(turn))
    return x, y, z
