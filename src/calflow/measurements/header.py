"""The header of a measurement file: which columns are read, and as what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calflow.files.problems import InputError, Problem, nearest
from calflow.measurements.columns import split_column
from calflow.measurements.layout import Layout
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class ReadColumn:
    """A column that is read: calflow's name and unit for it, both as one word, the file's word, its marker ('': all)."""

    name: str
    unit: str
    ours: str
    theirs: str
    marker: str = ""

    def __str__(self) -> str:
        return f"column '{self.theirs}'" + (f" ({self.ours})" if self.ours != self.theirs else "")


def columns_read(there: Sequence[str], layout: Layout, robot: Robot, path: Path) -> list[ReadColumn]:
    """Return the columns that are read of those that are there: what the layout names, or else all.

    Raises:
        InputError: the layout names columns that are not there.
    """
    absent = [name for name in dict.fromkeys(layout.named) if name not in there]
    if absent:
        raise InputError(
            Problem(f"no column '{name}', which the study's mapping names{nearest(name, there)}", path, 1)
            for name in absent
        )
    pairs = [("", ours, theirs) for ours, theirs in layout.columns.items()]
    pairs += [(marker, ours, theirs) for marker, own in layout.markers.items() for ours, theirs in own.items()]
    if not pairs:
        pairs = [("", name, name) for name in there]
    return [
        ReadColumn(*split_column(ours, robot, layout.reports), ours, theirs, marker) for marker, ours, theirs in pairs
    ]
