"""Demand: the memory and the time that a stage will take, foreseen from its largest array, and what the machine has."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from calflow.files.problems import refuse

BYTES = 8  # of a number
GIGA = 1e9
MUCH = 0.5  # of the machine's memory, from which it is told
LONG = 15 * 60.0  # s, from which it is told
LITTLE, SHORT = 1e9, 120.0  # bytes and s, below which nothing is said
PROGRAM = 0.2e9  # bytes that the program takes for itself
LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container


@dataclass(frozen=True)
class Demand:
    """What a stage will take: an array of so many rows and columns, as many copies of it at once, and so many seconds of one core.

    besides are further bytes, remedy says how to need less, of what the rows are.
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
        """What cannot be done without [bytes]."""
        return float(BYTES * self.rows * self.columns)

    @property
    def memory(self) -> float:
        """What is taken together [bytes]; nothing where nothing is foreseen."""
        return PROGRAM + self.besides + self.copies * self.certain if self.rows else 0.0

    @property
    def words(self) -> str:
        """What is taken, in words; empty where nobody needs to know, since any machine has it at once."""
        if self.memory <= LITTLE and self.seconds <= SHORT:
            return ""
        return f"about {self.memory / GIGA:.1f} GB and {duration(self.seconds)} of one core"


def duration(seconds: float) -> str:
    """Return a time that is roughly known in words."""
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return "less than 2 minutes"


def warned(stage: str, demand: Demand, there: float | None) -> str:
    """Return what to say before a stage begins that will take much of the memory that is there [bytes], or long; or nothing.

    Raises:
        InputError: its largest array alone does not fit.
    """
    has = f"this machine has {there / GIGA:.0f} GB" if there else "what this machine has is not known"
    if there and demand.certain > there:
        raise refuse(
            f"{stage} cannot be done here: one array of {demand.rows:,} {demand.of} by {demand.columns:,} columns takes "
            f"{demand.certain / GIGA:.1f} GB, {has}; {demand.remedy}"
        )
    if (not there or demand.memory <= MUCH * there) and demand.seconds <= LONG:
        return ""
    return (
        f"warning: {stage} is foreseen to take some {demand.memory / GIGA:.1f} GB ({has}) and at least "
        f"{duration(demand.seconds)} of one core, for {demand.rows:,} {demand.of} by {demand.columns:,} columns; to take less, "
        f"{demand.remedy}"
    )


def memory_there() -> float | None:
    """Return the memory [bytes] that this process may have; None where the system does not tell."""
    names = getattr(os, "sysconf_names", {})
    if "SC_PHYS_PAGES" not in names:
        return None
    physical = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    try:
        return min(physical, float(LIMIT.read_text()))
    except (OSError, ValueError):  # no container, or one without a limit
        return physical
