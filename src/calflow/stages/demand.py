"""The memory and time that a stage will need, estimated from its largest array, and the memory of the machine."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from calflow.files.problems import refuse

BYTES = 8  # of a number
GIGA = 1e9
MUCH = 0.5  # share of the machine's memory above which a warning is given
LONG = 15 * 60.0  # s, above which a warning is given
LITTLE, SHORT = 1e9, 120.0  # bytes and s, below which the demand is not mentioned
PROGRAM = 0.2e9  # bytes of the program itself
LIMIT = Path("/sys/fs/cgroup/memory.max")  # memory limit of a container


@dataclass(frozen=True)
class Demand:
    """The demand of a stage: size of its largest array, number of simultaneous copies, and seconds of one core.

    besides: further bytes; remedy: advice how to need less; of: what the rows of the array are.
    """

    rows: int = 0
    columns: int = 0
    copies: float = 0.0
    seconds: float = 0.0
    remedy: str = ""
    of: str = "residuals"
    besides: float = 0.0

    @property
    def certain(self) -> float:
        """The size of the largest array [bytes], which is the least memory needed."""
        return float(BYTES * self.rows * self.columns)

    @property
    def memory(self) -> float:
        """The total memory [bytes]; 0 if there is no estimate."""
        return PROGRAM + self.besides + self.copies * self.certain if self.rows else 0.0

    @property
    def words(self) -> str:
        """The demand in words; empty if it is so small that any machine meets it."""
        if self.memory <= LITTLE and self.seconds <= SHORT:
            return ""
        return f"about {self.memory / GIGA:.1f} GB and {duration(self.seconds)} of one core"


def duration(seconds: float) -> str:
    """Return an approximate time in words."""
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return "less than 2 minutes"


def warned(stage: str, demand: Demand, available: float | None) -> str:
    """Return a warning if a stage will need much of the available memory [bytes] or a long time, else an empty text.

    Raises:
        InputError: its largest array alone does not fit.
    """
    has = f"this machine has {available / GIGA:.0f} GB" if available else "what this machine has is not known"
    if available and demand.certain > available:
        raise refuse(
            f"{stage} cannot be done here: one array of {demand.rows:,} {demand.of} by {demand.columns:,} columns takes "
            f"{demand.certain / GIGA:.1f} GB, {has}; {demand.remedy}"
        )
    if (not available or demand.memory <= MUCH * available) and demand.seconds <= LONG:
        return ""
    return (
        f"warning: {stage} is foreseen to take some {demand.memory / GIGA:.1f} GB ({has}) and at least "
        f"{duration(demand.seconds)} of one core, for {demand.rows:,} {demand.of} by {demand.columns:,} columns; to take less, "
        f"{demand.remedy}"
    )


def memory_available() -> float | None:
    """Return the memory [bytes] available to this process; None if the system does not report it."""
    names = getattr(os, "sysconf_names", {})
    if "SC_PHYS_PAGES" not in names:
        return None
    physical = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    try:
        return min(physical, float(LIMIT.read_text()))
    except (OSError, ValueError):  # no container, or one without a limit
        return physical
