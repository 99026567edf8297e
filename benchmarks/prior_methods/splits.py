"""Which rows a method is fitted to, and which judge it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from calflow.measurements.measurements import Measurements

INNER = 0.7  # share of the poses
JOINT = 2  # from 1: it carries the arm, and gravity acts on it


@dataclass(frozen=True)
class Split:
    """Rows to fit and rows to judge by; no pose is in both."""

    train: Measurements
    judge: Measurements


def held_out(data: Measurements) -> Split:
    """Return the study's own split."""
    return Split(data.only(data.train), data.only(data.held_out))


def outside(data: Measurements) -> Split:
    """Return the poses in the inner part of the second joint's readings to fit, and those beyond it to judge by.

    The inner part holds 70 % of the poses; as many lie below as above.
    """
    data = replace(data, table=data.table.assign(split="train"))
    reading = data.table.groupby("pose")[f"q{JOINT}"].mean()
    low, high = reading.quantile([(1 - INNER) / 2, (1 + INNER) / 2])
    inner = data.table["pose"].map(reading.between(low, high)).to_numpy(dtype=bool)
    return Split(data.only(inner), data.only(~inner))
