"""Faults of the data: each gives the table as it is written, and which of its rows are wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from hidden.random_functions import direction
from hidden.simulator import Array, Robot

if TYPE_CHECKING:
    from hidden.causes import Hidden

XYZ = ["x_mm", "y_mm", "z_mm"]


def _some_poses(h: Hidden, table: pd.DataFrame, share: float = 0.03) -> Array:
    poses = table["pose"].unique()
    return table["pose"].isin(h.rng.choice(poses, max(2, round(share * len(poses))), replace=False)).to_numpy()


def outlier(h: Hidden, table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, Array]:
    """A share of the rows (size, or 2 %) is off by 2 to 20 mm."""
    rng = h.rng
    rows = rng.choice(len(table), max(1, round((h.size or 0.02) * len(table))), replace=False)
    for row in rows:
        table.loc[row, XYZ] += rng.uniform(2, 20) * direction(rng)
    return table, np.isin(np.arange(len(table)), rows)


def marker_swap(h: Hidden, table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, Array]:
    """Two markers were taken for each other in a few poses."""
    poses, markers = _some_poses(h, table), table["marker"].unique()
    first, second = (poses & (table["marker"] == marker).to_numpy() for marker in markers[:2])
    table.loc[first, XYZ], table.loc[second, XYZ] = table.loc[second, XYZ].to_numpy(), table.loc[first, XYZ].to_numpy()
    return table, first | second


def joint_sign(h: Hidden, table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, Array]:
    """One joint's readings have the opposite sign, throughout."""
    table[f"q{h.joint}_deg"] *= -1
    return table, np.ones(len(table), dtype=bool)


def encoder_turn(h: Hidden, table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, Array]:
    """A reading is off by a turn in a few poses, or with extra "gear" by a turn of the motor in a block of poses."""
    wrong, turn = _some_poses(h, table), 360.0
    if h.extra == "gear":
        first = h.rng.integers(1, table["pose"].max() * 2 // 3)
        wrong = table["pose"].between(first, first + max(3, table["pose"].max() // 6)).to_numpy()
        turn = round(360 / robot.gears[h.joint - 1], 4)
    table.loc[wrong, f"q{h.joint}_deg"] += h.rng.choice([-1, 1]) * turn
    return table, wrong


def unit_mistake(h: Hidden, table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, Array]:
    """In a few poses positions are in m, or where a joint is named its reading is in rad."""
    wrong = _some_poses(h, table)
    columns, factor = ([f"q{h.joint}_deg"], np.pi / 180) if h.joint else (XYZ, 1e-3)
    table.loc[wrong, columns] *= factor
    return table, wrong


def row_misalignment(h: Hidden, table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, Array]:
    """From some row on, positions stand one row too early, as if one had been missed; the last row is lost."""
    first = int(h.rng.uniform(0.3, 0.7) * len(table))
    table.loc[first : len(table) - 2, XYZ] = table.loc[first + 1 :, XYZ].to_numpy()
    return table[:-1], np.arange(len(table) - 1) >= first


ON_TABLE = {
    "outlier": outlier,
    "marker-swap": marker_swap,
    "joint-sign": joint_sign,
    "encoder-turn": encoder_turn,
    "unit-mistake": unit_mistake,
    "row-misalignment": row_misalignment,
}
