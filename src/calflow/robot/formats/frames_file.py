"""The file of frames in which targets may be stated: fixtures, work objects."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from calflow.files.problems import refuse
from calflow.files.toml import Angles3, FileModel, Lengths3, read_toml

MEASURING, BASE = "measuring", "base"


class TargetFrameTable(FileModel):
    """Where a frame stands, in the measuring frame or in the robot's base."""

    origin: Lengths3 = (0.0, 0.0, 0.0)
    rotation: Angles3 = (0.0, 0.0, 0.0)
    within: Literal["measuring", "base"] = "measuring"


class FramesFile(FileModel):
    """A file of frames by name: fixtures, work objects."""

    frames: dict[str, TargetFrameTable]


def read_frames(path: Path) -> dict[str, TargetFrameTable]:
    """Read a file of frames.

    Raises:
        InputError: with all that is wrong in it, or it states a frame that has its name already.
    """
    frames = read_toml(path, FramesFile).frames
    taken = [name for name in frames if name in ("", MEASURING, BASE)]
    if taken:
        raise refuse(f"frame '{taken[0]}' is known without being stated: expected another name", path)
    return frames
