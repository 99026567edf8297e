"""Series combined: the rows of several devices as one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from calflow.measurements.columns import condition_columns, numbered
from calflow.measurements.measurements import Measurements
from calflow.robot.conditions import OPTIONAL

DERIVED = ("order", "range", "session")  # conditions that a series may lack, or that are worked out anew
SAME = 0.02  # rad or m by which readings of one pose may differ


def combined(parts: Sequence[Measurements]) -> Measurements:
    """Return the rows of several series of one robot, one after the other, each part one series.

    A pose that several parts name is one where the joint readings agree. Conditions that not all parts state are left out,
    which a note says.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    origins = [part.time_origin for part in parts if part.time_origin is not None]
    origin = min(origins) if len(origins) == len(parts) else None
    shared = [name for name in OPTIONAL if all(name in part.given for part in parts)]
    notes = [f"{part.series[0].name or k + 1}: {note}" for k, part in enumerate(parts) for note in part.notes]
    tables = []
    for k, part in enumerate(parts):
        table = part.table.assign(
            series=k, pose=part.table["pose"].astype(str), repeat=part.table["repeat"].astype(str)
        )
        if origin is not None and part.time_origin is not None:
            table["time"] += part.time_origin - origin
        lost = [name for name in part.given if name not in (*shared, *DERIVED)]
        columns = [column for name in lost for column in condition_columns(name, part.robot)]
        tables.append(table.drop(columns=columns))
        if lost:
            notes.append(f"not all measurements state {', '.join(lost)}: left out")
    unsplit = [k for k, table in enumerate(tables) if "split" not in table]
    if len(unsplit) < len(tables):
        for k in unsplit:
            tables[k] = tables[k].assign(split="train")
            notes.append(
                f"{parts[k].series[0].name or k + 1}: no column 'split', as others have: all rows are to be fitted"
            )
    whole = pd.concat(_named_apart(tables, numbered("q", first.robot.n_joints)), ignore_index=True)
    for label in ["session", *(name for part in parts for name in part.series[0].labels)]:
        if label in whole:
            whole[label] = whole[label].fillna("")
    whole["order"] = whole["time"].rank(method="dense") if origin is not None else np.arange(1.0, len(whole) + 1)
    return replace(
        first, table=whole, notes=tuple(dict.fromkeys(notes)), series=tuple(part.series[0] for part in parts),
        time_origin=origin, units=tuple(sorted({unit for part in parts for unit in part.units})),
    )  # fmt: skip


def continued(parts: Sequence[Measurements]) -> Measurements:
    """Return the rows of several files of one series as if they stood in one file."""
    if len(parts) == 1:
        return parts[0]
    whole = combined(parts)
    return replace(whole, table=whole.table.drop(columns="series"), series=parts[0].series)


def _named_apart(tables: Sequence[pd.DataFrame], readings: list[str]) -> list[pd.DataFrame]:
    """Give poses of the same name but other readings names of their own, or those of the poses that they are."""
    found: list[pd.DataFrame] = []
    for k, table in enumerate(tables):
        for other in found:
            both = table.drop_duplicates("pose").merge(
                other.drop_duplicates("pose"), on="pose", suffixes=("", "_other")
            )
            apart = np.abs(both[readings].to_numpy() - both[[f"{name}_other" for name in readings]].to_numpy())
            if (apart > SAME).any():
                table = table.assign(pose=[f"{k + 1}:{pose}" for pose in table["pose"]])
                table = table.assign(pose=_met_again(table, found, readings))
                break
        found.append(table)
    return found


def _met_again(table: pd.DataFrame, others: Sequence[pd.DataFrame], readings: list[str]) -> list[str]:
    """Return the poses' names, those of other tables where the very same readings and payload are there."""
    keys = [*readings, "payload"]
    known = {tuple(row[:-1]): row[-1] for other in others for row in other[[*keys, "pose"]].to_numpy(dtype=object)}
    return [known.get(tuple(row[:-1]), row[-1]) for row in table[[*keys, "pose"]].to_numpy(dtype=object)]
