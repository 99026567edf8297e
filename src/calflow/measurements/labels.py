"""The labels that may be left out of measurements: marker, payload, pose and repeat."""

from __future__ import annotations

import pandas as pd

from calflow.measurements.columns import numbered
from calflow.robot.robot import Robot


def labelled(table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, list[str]]:
    """Return the rows with every label, and notes of what was assumed."""
    table = table.copy()
    notes = []
    if "marker" not in table:
        table["marker"] = next(iter(robot.markers))
    if "payload" not in table:
        table["payload"] = ""
        if robot.payloads:
            notes.append(f"no column 'payload': no row counts as carrying {' or '.join(robot.payloads)}")
    if "pose" not in table:
        keys = [*numbered("q", robot.n_joints), "payload"]
        table["pose"] = table.groupby(keys, sort=False, dropna=False).ngroup() + 1
        notes.append(
            f"no column 'pose': rows with equal joint readings and payload count as one pose ({table['pose'].nunique()})"
        )
    if "repeat" not in table:
        table["repeat"] = table.groupby(["pose", "marker"]).cumcount() + 1
    return table, notes
