"""Where a hidden robot really goes when it is commanded, and targets for it, apart from calflow's graph."""

from __future__ import annotations

import numpy as np
import pandas as pd

from hidden.case import Case, World, draw_poses
from hidden.causes import PAYLOADS, measured_points
from hidden.simulator import Array, Motion, Rows, frames, tool_point


def targets(world: World, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """Where the robot that the file states would be at case's number of poses, with its readings there: what a program asks for."""
    q = draw_poses(world.stated, case, rng)
    rows = _rows(q, 0 * q, case.payloads[-1])
    still = Motion.none(len(q), world.stated.n)
    place = tool_point(world.stated, rows, still, frames(world.stated, q, still).tips[-1])
    table = pd.DataFrame({"pose": [f"P{k + 1}" for k in range(len(q))], "payload": case.payloads[-1]})
    table[[f"q{i + 1}_deg" for i in range(world.stated.n)]] = np.rad2deg(q)
    table[["x_mm", "y_mm", "z_mm"]] = 1e3 * place
    return table


def missed(world: World, q_deg: pd.DataFrame, asked: pd.DataFrame) -> Array:
    """How far [mm] the real robot misses its targets when it goes from row to row, from the second row on."""
    q = np.deg2rad(q_deg.to_numpy())
    came = np.sign(np.diff(q, axis=0))
    rows = _rows(q[1:], came, asked["payload"].iloc[0])
    there = 1e3 * measured_points(world.real, rows, world.hidden)
    return np.linalg.norm(there - asked[["x_mm", "y_mm", "z_mm"]].to_numpy()[1:], axis=1)


def _rows(q: Array, approach: Array, payload: str) -> Rows:
    """Rows at one time, after every moment at which something changes while measuring."""
    n = len(q)
    carried, first = np.full(n, PAYLOADS.index(payload)), np.zeros(n, dtype=int)
    return Rows(q, carried, first, approach, 0 * q, 0 * q, np.ones(n), np.full(n, 20.0))
