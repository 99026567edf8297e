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
    q = table.sort_values("order", kind="stable")[readings].to_numpy()
    came, far = np.zeros_like(q), np.zeros_like(q)
    for k in range(1, len(q)):
        step = q[k] - q[k - 1]
        same = (np.sign(step) == came[k - 1]) | (step == 0)
        came[k] = np.where(step == 0, came[k - 1], np.sign(step))
        far[k] = np.where(same, far[k - 1], 0.0) + np.abs(step)
    back = np.argsort(np.argsort(table["order"].to_numpy(), kind="stable"), kind="stable")
    return came[back], far[back]
