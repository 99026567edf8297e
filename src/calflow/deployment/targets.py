"""Targets: where a tool is to be, and how it is to be turned."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calflow.files.problems import refuse

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
