"""Followers: joints that only others move have no reading, and so need no columns in measurements."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from calflow.files.problems import Problem
from calflow.measurements.columns import STEMS
from calflow.robot.robot import Robot

AGREES = {"rad": np.deg2rad(0.5), "m": 1e-3}  # by how much what a file says of a follower may be off


def filled(table: pd.DataFrame, robot: Robot, path: Path | None) -> tuple[pd.DataFrame, list[Problem]]:
    """Return rows in which joints without a reading of their own stay where their couplings have them.

    What a file says of such a joint must be 0 throughout, or its variable, whatever that is counted from; told where it is not.
    """
    problems = []
    for joint in robot.followers:
        name = f"q{joint + 1}"
        if name in table and (wrong := _wrong(table, robot, joint, path)):
            problems.append(wrong)
        stems = [stem for stem in STEMS.values() if any(f"{stem}{i + 1}" in table for i in robot.driven)]
        table = table.assign(**{f"{stem}{joint + 1}": 0.0 for stem in stems})
    return table, problems


def _wrong(table: pd.DataFrame, robot: Robot, joint: int, path: Path | None) -> Problem | None:
    """What is wrong with what a table says of a follower, counted from 0."""
    said = table[f"q{joint + 1}"].to_numpy(dtype=float)
    computed = np.zeros(len(table))
    for coupling in robot.couplings:
        if coupling.joint == joint + 1 and f"q{coupling.source}" in table:
            computed += coupling.factor * table[f"q{coupling.source}"].to_numpy(dtype=float)
    off = said - computed
    known = np.isfinite(off)
    if not known.any() or not said[known].any():
        return None
    apart = np.abs(off - np.median(off[known]))
    bad = np.flatnonzero(known & (apart > AGREES[robot.joints[joint].unit]))
    if not len(bad):
        return None
    line = int(table["line"].iloc[bad[0]]) if "line" in table and path else None
    leaders = " and ".join(f"q{one.source}" for one in robot.couplings if one.joint == joint + 1)
    unit, factor = robot.joints[joint].shown
    return Problem(
        f"q{joint + 1}: joint {joint + 1} has no drive of its own, it follows {leaders}: expected no column q{joint + 1}, or the "
        f"joint's own {robot.joints[joint].noun}; {len(bad)} rows are off by up to {factor * float(apart[bad].max()):.3g} {unit}",
        path,
        line,
    )
