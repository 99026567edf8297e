"""Sessions: the blocks in which rows were measured, each with the device and the robot set up as they were."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from calflow.measurements.measurements import Measurements


def sessions_of(data: Measurements) -> tuple[str, ...]:
    """Return the names of the sessions in measuring order; none where no row names one."""
    if "session" not in data.table:
        return ()
    table = data.table.sort_values("order", kind="stable") if "order" in data.table else data.table
    return tuple(dict.fromkeys(table["session"].astype(str)))


def borders(data: Measurements) -> np.ndarray:
    """Return the places in measuring order between sessions; none where sessions are not one after the other."""
    sessions = sessions_of(data)
    if len(sessions) < 2 or "order" not in data.table:
        return np.array([])
    spans = data.table.groupby(data.table["session"].astype(str))["order"].agg(["min", "max"]).loc[list(sessions)]
    last, first = spans["max"].to_numpy(float)[:-1], spans["min"].to_numpy(float)[1:]
    return (last + first) / 2 if (last < first).all() else np.array([])
