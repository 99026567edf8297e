"""The layout of a measurement file: how its cells are written and what its columns are called."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from calflow.measurements.columns import POSES, Reported

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
