"""Target frames: where the frames stand that targets are stated in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from calflow.deployment.targets import Targets
from calflow.estimation.calibrated import Identified
from calflow.files.problems import MOST_TOLD, InputError, Problem, nearest, refuse
from calflow.files.toml import Angles3, FileModel, Lengths3, read_toml
from calflow.model import over_rows
from calflow.robot.transforms import placement

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
    targets: Targets, names: Sequence[str], frames: Mapping[str, FrameTable], known: Identified, rows: np.ndarray
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


def base_placement(known: Identified, rows: np.ndarray) -> np.ndarray:
    """Return where the calibration found the robot's base in the measuring frame, shape (n_rows, 4, 4)."""
    p, c, predicted = known.model.symbols
    base = known.model.robot.base
    stands = placement(ca.DM([*base.origin, *base.rotation])) @ placement(predicted.dims.base)
    function = ca.Function("base", [p, c], [ca.densify(ca.vec(stands))])
    return over_rows(function, known.estimate, rows)[0].T.reshape(-1, 4, 4).transpose(0, 2, 1)
