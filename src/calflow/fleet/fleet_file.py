"""Schema of the fleet file: types, robots, and file patterns such as `data/{robot}/measurements.csv`."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, field_validator

from calflow.files.toml import FileModel
from calflow.files.writing import is_within
from calflow.study import FolderName

ROBOT = "{robot}"  # placeholder of a robot's name


def named_file(pattern: str, robot: str) -> str:
    """Return a robot's file name by its type's pattern."""
    return pattern.replace(ROBOT, robot)


def robots_of(pattern: str, folder: Path) -> list[str]:
    """Return the sorted robot names for which a file matches the pattern, relative to a folder."""
    parts = pattern.split(ROBOT)
    first, *again = (re.escape(part) for part in parts)
    name = re.compile(f"{first}(?P<robot>[^/]+){'(?P=robot)'.join(again)}")
    there = glob.glob("*".join(map(glob.escape, parts)), root_dir=folder)
    return sorted(match["robot"] for path in there if (match := name.fullmatch(path)))


def beyond_reach(path: Path, folders: Iterable[Path]) -> str:
    """Return a message if a path, with links resolved, leads out of the allowed folders; empty if it does not."""
    if any(is_within(path, folder) for folder in folders):
        return ""
    return (
        f"leads out of the fleet file's folder, to {path.resolve()}, which is not read: move the file, or allow its folder "
        f"by --allow {path.resolve().parent}"
    )


Files = Annotated[  # one per series of the study, in order
    tuple[str, ...],
    BeforeValidator(
        lambda value: (value,) if isinstance(value, str) else value, json_schema_input_type=str | tuple[str, ...]
    ),
]


class Plant(FileModel):
    """The table `[fleet]`; a robot's run that takes longer than minutes_per_robot is stopped."""

    name: FolderName
    title: str = ""
    minutes_per_robot: float = Field(default=240.0, gt=0, allow_inf_nan=False)


class TypeTable(FileModel):
    """A table `[types.NAME]`: the study whose settings all robots of the type share, and the pattern of their measurements.

    robot: a robot file that replaces the study's; data: a pattern with {robot}, one per series of the study.
    """

    study: str
    robot: str = ""
    data: Files = ()

    @field_validator("data")
    @classmethod
    def _tells_robots_apart(cls, data: tuple[str, ...]) -> tuple[str, ...]:
        same = [pattern for pattern in data if ROBOT not in pattern]
        if same:
            raise ValueError(f"expected {ROBOT} where the robot's name stands, found {same[0]!r}")
        return data


class RobotTable(FileModel):
    """A table `[robots.NAME]`: its type, and its measurement files if they do not follow the type's pattern."""

    type: str
    data: Files = ()


class FleetFile(FileModel):
    """The content of a fleet file."""

    fleet: Plant
    types: dict[str, TypeTable] = Field(min_length=1)
    robots: dict[str, RobotTable] = {}
