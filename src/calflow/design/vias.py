"""Vias: poses on the way, so that each joint comes from a known side, from both sides equally often.

Play and friction show by the side that a joint comes from. In the order of a tour that side hangs together with the joint's place,
since who goes far out comes from inside; from a via it does not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from calflow.design.candidates import allowed
from calflow.design.cell.cell import Cell
from calflow.measurements.sequence import sides_and_travel
from calflow.model import Model
from calflow.robot.robot import Robot

TURNS = (np.deg2rad(2.0), np.deg2rad(10.0))  # least and largest way of a joint from its via
SLIDES = (0.01, 0.05)  # m: the same of one that slides
TRIES = 20  # sides that are drawn for a pose before it is left to the order


def vias(
    model: Model, readings: np.ndarray, payload: str, marker: str, cell: Cell | None, rng: np.random.Generator
) -> np.ndarray:
    """Return for each pose (n, n_joints) the readings from which every joint comes straight to it, (n, n_joints).

    Each joint comes up and down in equal numbers, but where limits, loop or cell leave one side alone; where they leave none the
    via is the pose itself, and how it is reached is left to the order.
    """
    robot, (n, n_joints) = model.robot, readings.shape
    sides = np.stack([rng.permutation(np.where(np.arange(n) % 2, 1.0, -1.0)) for _ in range(n_joints)], axis=1)
    least, most = np.array([SLIDES if joint.kind == "prismatic" else TURNS for joint in robot.joints]).T
    ways = rng.uniform(least, most, readings.shape) * np.isin(np.arange(n_joints), robot.driven)
    found, left = readings.copy(), np.arange(n)
    for _ in range(TRIES):
        via = readings[left] - _within(robot, readings[left], sides, ways[left])
        good = allowed(model, via, payload, marker, None, cell)
        found[left[good]] = via[good]
        left = left[~good]
        if not len(left):
            break
        sides = rng.choice([-1.0, 1.0], (len(left), n_joints))
    return found


def reached(readings: np.ndarray, reached_from: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the side that each joint comes from and its travel since it turned back, (n, n_joints) each, poses in order.

    reached_from (n, n_joints) are the vias before the poses, if there are any.
    """
    if reached_from is None:
        return sides_and_travel(readings)
    whole = np.stack([reached_from, readings], axis=1).reshape(-1, readings.shape[1])
    came, travel = sides_and_travel(whole)
    return came[1::2], travel[1::2]


def sides_words(poses: pd.DataFrame, effects: Sequence[str]) -> list[str]:
    """Say from which sides joints come in poses.csv, where there are effects that show by that."""
    if not effects:
        return []
    up = (poses[[name for name in poses if str(name).startswith("approach")]] > 0).sum()
    return [
        f"for {', '.join(effects)} each joint comes from a via: {up.min()} to {up.max()} times of {len(poses)} upwards, by joint"
    ]


def _within(robot: Robot, readings: np.ndarray, sides: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """The ways (n, n_joints) on these sides, on the other one where that is the way out of a joint's limits."""
    angles = (readings - sides * ways) @ robot.reading_matrix.T
    low, high = robot.stops.T
    return np.asarray(np.where((angles < low) | (angles > high), -sides, sides) * ways)
