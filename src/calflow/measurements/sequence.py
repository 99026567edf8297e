"""What follows from when and where rows were measured: their order, the joints' approach and travel, the range."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calflow.measurements.columns import POSITION, numbered
from calflow.robot.robot import Robot

IN_ORDER = "in_order = true: approach directions and travel follow from the order of the rows"


def ordered(table: pd.DataFrame, robot: Robot, in_order: bool) -> tuple[pd.DataFrame, list[str]]:
    """Return the rows with their place in measuring order and, where they stand in it, approach and travel; and a note.

    Approach columns of the file's own stay as they are, and no travel is added to them.
    """
    table = table.copy()
    table["order"] = table["time"].rank(method="dense") if "time" in table else np.arange(1.0, len(table) + 1)
    if not in_order or "approach1" in table:
        return table, []
    came, far = approach_and_travel(table, numbered("q", robot.n_joints))
    table[numbered("approach", robot.n_joints)] = came
    table[numbered("travel", robot.n_joints)] = far
    return table, [IN_ORDER]


def ranged(table: pd.DataFrame, robot: Robot, tracker: tuple[float, float, float] | None) -> pd.DataFrame:
    """Return the rows with their range [m], where it is known where the device stands (tracker, in its own frame)."""
    at_origin = robot.base.known and not np.any(robot.base.origin)
    if "x" not in table or (tracker is None and at_origin):
        return table
    return table.assign(range=np.linalg.norm(table[[*POSITION]] - np.array(tracker or (0.0, 0.0, 0.0)), axis=1))


def approach_and_travel(table: pd.DataFrame, readings: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return each row's approach directions and its travel since the joints last turned back, (n_rows, n_joints) each."""
    came, far = sides_and_travel(table.sort_values("order", kind="stable")[readings].to_numpy())
    back = np.argsort(np.argsort(table["order"].to_numpy(), kind="stable"), kind="stable")
    return came[back], far[back]


def sides_and_travel(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the side that each joint comes from and its travel since it last turned back, of readings (n, n_joints) in order."""
    step = np.diff(q, axis=0, prepend=q[:1])
    row = np.arange(len(q))[:, None]
    moved = np.maximum.accumulate(
        np.where(step != 0, row, 0), axis=0
    )  # the last row at which a joint moved; it then keeps its side
    came = np.take_along_axis(np.sign(step), moved, axis=0)
    turned = np.diff(came, axis=0, prepend=came[:1]) != 0
    way = np.cumsum(np.abs(step), axis=0)
    before = np.take_along_axis(way - np.abs(step), np.maximum.accumulate(np.where(turned, row, 0), axis=0), axis=0)
    return came, way - before
