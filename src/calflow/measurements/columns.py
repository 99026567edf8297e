"""The columns of measurements: their names, dimensions and conditions, and how a file writes and calls them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import pandas as pd

from calflow.files.units import split_unit
from calflow.robot.robot import Robot

LABELS = ("pose", "repeat", "marker", "payload", "session", "split")
BLOCKS = ("payload", "session")  # what poses are held out, and resampled, within
POSITION = ("x", "y", "z")
ANGLES, QUATERNION = ("rx", "ry", "rz"), ("qw", "qx", "qy", "qz")
SIGMAS = ("sigma", "sigma_rotation")
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
STEMS = {"reading": "q", "approach": "approach", "travel": "travel", "torque": "tau"}  # of columns, one a joint


@dataclass(frozen=True)
class Reported:
    """The columns that a kind of measurement reports in, with their dimensions ('' for a plain number), and names it is told.

    needed ones must be there, and labels that are needed; of the others any. Where nothing was measured yet they say where a
    tool is to be: such rows need no joint readings, no orders and no noise. sigma is the dimension of a value's noise.
    """

    needed: Mapping[str, str]
    optional: Mapping[str, str] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    measured: bool = True
    sigma: str = "length"

    @property
    def values(self) -> tuple[str, ...]:
        """The columns that hold a measured value."""
        return (*self.needed, *self.optional)


FRAME = "frame"  # the name of the frame that a target is in
POSES = Reported(dict.fromkeys(POSITION, "length"), dict.fromkeys(ANGLES, "angle") | dict.fromkeys(QUATERNION, ""))

TARGETS = replace(POSES, labels=(FRAME,), measured=False)


def blocks_of(table: pd.DataFrame) -> list[str]:
    """Return the columns that say under which payload and in which session a pose was measured."""
    return [name for name in BLOCKS if name in table]


def condition_columns(condition: str, robot: Robot) -> list[str]:
    """Return the columns of a table that hold a condition."""
    if condition == "wrench":
        return list(WRENCH)
    return numbered(STEMS[condition], robot.n_joints) if condition in STEMS else [condition]


def column_names(robot: Robot, reported: Reported = POSES) -> dict[str, str]:
    """Return every column a measurement file may have, without its unit, and the column's dimension ('' for none)."""
    n = robot.n_joints
    names = dict.fromkeys((*LABELS, *reported.labels, *numbered("approach", n)), "")
    for stem in ("q", "travel"):
        names |= {f"{stem}{i + 1}": "angle" if j.kind == "revolute" else "length" for i, j in enumerate(robot.joints)}
    names |= {"sigma": reported.sigma, **reported.needed, **reported.optional}
    names |= dict.fromkeys(("nominal_x", "nominal_y", "nominal_z"), "length")  # of select/poses.csv, filled in
    names |= {f"via{i + 1}": names[f"q{i + 1}"] for i in range(n)}  # of the same
    names |= dict.fromkeys(("target_x", "target_y", "target_z"), "length")  # where compensated commands were to land
    names |= {"sigma_rotation": "angle"}
    names |= dict.fromkeys(WRENCH[:3], "force") | dict.fromkeys(WRENCH[3:], "moment")
    names |= dict.fromkeys(numbered("tau", n), "moment")
    return names | {"time": "time", "temperature": "temperature"}


def numbered(stem: str, n: int) -> list[str]:
    """Return names with the numbers 1 to n."""
    return [f"{stem}{i + 1}" for i in range(n)]


def split_column(spelled: str, robot: Robot, reported: Reported = POSES) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit."""
    return (spelled, "") if column_names(robot, reported).get(spelled) == "" else split_unit(spelled) or (spelled, "")


Missing = Literal["whole", "refuse", "skip"]


@dataclass(frozen=True)
class Layout:
    """How a measurement file is to be read, in SI units.

    columns maps calflow's names to a foreign file's; markers does so for files with several markers side by side.
    sigma [m] and sigma_rotation [rad] are one number for all rows. in_order says that the rows stand in the order of
    measuring, so that each pose's approach is known from the one before. tracker [m] is where the device stands in the
    measuring frame, if not at its origin. missing says which rows are left out and counted: "whole", those without any
    measured value, while one that lacks some is at fault; "skip", those that lack any; "refuse", none. reports says which
    columns hold measured values.

    Raises:
        ValueError: separator or decimal cannot be.
    """

    separator: str = ","
    decimal: Literal[".", ","] = "."
    columns: Mapping[str, str] = field(default_factory=dict)
    markers: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    sigma: float | None = None
    sigma_rotation: float | None = None
    in_order: bool = False
    tracker: tuple[float, float, float] | None = None
    missing: Missing = "whole"
    reports: Reported = POSES

    def __post_init__(self) -> None:
        if len(self.separator) != 1:
            raise ValueError(f"separator: expected one character, found {self.separator!r}")
        if self.separator == self.decimal:
            raise ValueError(
                f"separator and decimal are both {self.decimal!r}; columns are usually separated by ';' then"
            )

    @property
    def named(self) -> list[str]:
        """The foreign file's columns that columns and markers name."""
        return [*self.columns.values(), *(name for marker in self.markers.values() for name in marker.values())]
