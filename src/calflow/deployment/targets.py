"""Targets: where a tool is to be, and how it is to be turned.

Target frames: where the frames stand that targets are stated in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.files.problems import MOST_TOLD, InputError, Problem, nearest, refuse
from calflow.files.toml import Angles3, FileModel, Lengths3, read_toml
from calflow.model import over_rows
from calflow.robot.transforms import placement

SQUARE = 1e-3  # by which a rotation's columns may miss length 1 and right angles: digits that a file left out


@dataclass(frozen=True)
class Targets:
    """Where tools are to be in the measuring frame: position (n, 3) [m] and, where it counts, rotation (n, 3, 3)."""

    position: np.ndarray
    rotation: np.ndarray | None = None

    @classmethod
    def of(cls, targets: ArrayLike) -> Self:
        """Return what an array asks for: positions (n, 3) or (3,), poses (n, 4, 4) or (4, 4).

        Raises:
            InputError: it has another shape, or what is no number or no rotation.
        """
        array = np.asarray(targets, dtype=float)
        if array.shape == (3,) or array.shape == (4, 4):
            array = array[None]
        if array.shape[1:] not in ((3,), (4, 4)) or not np.isfinite(array).all():
            raise refuse(
                f"expected finite positions of shape (n, 3) or poses of shape (n, 4, 4), found shape {array.shape}",
                key="targets",
            )
        if array.ndim == 2:
            return cls(array)
        turn = array[:, :3, :3]
        wrong = np.abs(turn.transpose(0, 2, 1) @ turn - np.eye(3)).max(axis=(1, 2)) > SQUARE
        wrong |= np.linalg.det(turn) < 0
        if wrong.any():
            raise refuse(f"number {int(np.flatnonzero(wrong)[0])} (from 0) holds no rotation", key="targets")
        return cls(array[:, :3, 3], Rotation.from_matrix(turn).as_matrix())

    def __len__(self) -> int:
        return len(self.position)

    @cached_property
    def features(self) -> np.ndarray:
        """Coordinates (n, 3 or 12) whose distances are those of the targets, a radian counted as a metre."""
        return features(self.position, self.rotation)

    def only(self, which: np.ndarray) -> Self:
        """Return these of the targets."""
        return type(self)(self.position[which], None if self.rotation is None else self.rotation[which])

    def lacking(self, point: np.ndarray, rotation: np.ndarray | None) -> np.ndarray:
        """Return what takes tools to their targets, shape (n, 3 or 6).

        It is a shift in the measuring frame [m], then a turn about the tool's own axes [rad]; nan where the tool is nowhere.
        """
        shift = self.position - point
        if self.rotation is None or rotation is None:
            return shift
        there = np.isfinite(rotation).all(axis=(1, 2))
        turn = np.full(shift.shape, np.nan)
        if there.any():
            between = rotation[there].transpose(0, 2, 1) @ self.rotation[there]
            turn[there] = Rotation.from_matrix(between).as_rotvec()
        return np.hstack([shift, turn])


def features(position: np.ndarray, rotation: np.ndarray | None) -> np.ndarray:
    """Return coordinates of poses whose distances are metres, and about the radians between their rotations."""
    return position if rotation is None else np.hstack([position, rotation.reshape(-1, 9) / np.sqrt(2)])


MEASURING, BASE = "measuring", "base"


class FrameTable(FileModel):
    """Where a frame stands, in the measuring frame or in the robot's base."""

    origin: Lengths3 = (0.0, 0.0, 0.0)
    rotation: Angles3 = (0.0, 0.0, 0.0)
    within: Literal["measuring", "base"] = "measuring"


class FramesFile(FileModel):
    """A file of frames by name: fixtures, work objects."""

    frames: dict[str, FrameTable]


def read_frames(path: Path) -> dict[str, FrameTable]:
    """Read a file of frames.

    Raises:
        InputError: with all that is wrong in it, or it states a frame that has its name already.
    """
    frames = read_toml(path, FramesFile).frames
    taken = [name for name in frames if name in ("", MEASURING, BASE)]
    if taken:
        raise refuse(f"frame '{taken[0]}' is known without being stated: expected another name", path)
    return frames


def in_measuring_frame(
    targets: Targets, names: Sequence[str], frames: Mapping[str, FrameTable], known: CalibratedModel, rows: np.ndarray
) -> Targets:
    """Return targets, each stated in the frame of a name, in the measuring frame.

    The frame "base" is the robot's base where the calibration found it; "measuring" and "" are the measuring frame.

    Raises:
        InputError: a frame is unknown.
    """
    every = {"": FrameTable(), MEASURING: FrameTable(), BASE: FrameTable(within="base"), **frames}
    unknown = sorted(set(names) - set(every))
    if unknown:
        known_names = ", ".join(name for name in every if name)
        raise InputError(
            Problem(f"unknown frame '{name}': expected one of {known_names}{nearest(name, every)}", key="frame")
            for name in unknown[:MOST_TOLD]
        )
    stated = [every[name] for name in names]
    turn = Rotation.from_euler("XYZ", [frame.rotation for frame in stated]).as_matrix()
    placed = np.tile(np.eye(4), (len(targets), 1, 1))
    placed[:, :3, :3], placed[:, :3, 3] = turn, [frame.origin for frame in stated]
    of_base = np.array([frame.within == BASE for frame in stated])
    if of_base.any():
        placed[of_base] = base_placement(known, rows[:, of_base]) @ placed[of_base]
    turn, origin = placed[:, :3, :3], placed[:, :3, 3]
    position = np.einsum("nij,nj->ni", turn, targets.position) + origin
    return Targets(position, None if targets.rotation is None else turn @ targets.rotation)


def base_placement(known: CalibratedModel, rows: np.ndarray) -> np.ndarray:
    """Return where the calibration found the robot's base in the measuring frame, shape (n_rows, 4, 4)."""
    p, c, predicted = known.model.symbols
    base = known.model.robot.base
    stands = placement(ca.DM([*base.origin, *base.rotation])) @ placement(predicted.dims.base)
    function = ca.Function("base", [p, c], [ca.densify(ca.vec(stands))])
    return over_rows(function, known.estimate, rows)[0].T.reshape(-1, 4, 4).transpose(0, 2, 1)
