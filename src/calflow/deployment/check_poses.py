"""Check poses: a few of the poses of a calibration that show best what has moved, and tell it from what else may have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from calflow.deployment.movements import movements
from calflow.design.exchange import exchange, greedy
from calflow.design.optimality import Parameters
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.certainty import unexplained
from calflow.measurements.columns import POSITION
from calflow.measurements.measurements import Measurements

FEWEST = 3  # poses, of fewer nothing can be told apart


def check_poses(known: CalibratedModel, data: Measurements, number: int) -> Measurements:
    """Return the first rows of so many of data's poses: with the load that most poses carry, every marker seen there once.

    They are D-optimal for all that may move, each thing by its usual size (Fedorov's exchange), told of the device's noise and of
    what the model errs by. Poses for the zeros of the joints alone would see shifts a tenth smaller, and hardly tell them from
    the dimensions beside them. Poses that were measured once can be reached, and seen, again.
    """
    load = data.table.groupby("payload", sort=False)["pose"].nunique().idxmax()
    loaded = data.only((data.table["payload"] == load).to_numpy())
    there = loaded.only((~loaded.table.duplicated(["pose", "marker"])).to_numpy())
    pose = there.table.groupby("pose", sort=False).ngroup().to_numpy()
    slope = _by_pose(_slopes(known, there), pose)
    prior, criterion = np.eye(slope.shape[2]), Parameters(slope.shape[2])
    chosen = exchange(slope, prior, greedy(slope, prior, min(number, len(slope)), criterion), criterion)
    return there.only(np.isin(pose, chosen))


def unmoved(known: CalibratedModel, data: Measurements) -> Measurements:
    """Return rows as they would be measured where nothing has moved, all in one go and without noise.

    What a check of them says is how much it would see.
    """
    at_once = {name: data.table[name].iloc[0] for name in ("session", "time") if name in data.table}
    data = replace(data, table=data.table.assign(**at_once))
    rows = data.stating(known.model.given).on(known.model.robot).rows
    there = known.model.point(known.estimate, rows)
    return replace(data, table=data.table.assign(**dict(zip(POSITION, there.T, strict=True))))


def _slopes(known: CalibratedModel, data: Measurements) -> np.ndarray:
    """What everything that may move does to rows by its usual size, over what they err by of themselves (n, 3, k)."""
    noise = known.noise(data).sigma if known.noise_known else np.zeros(len(data))
    slopes = [one.slope * one.sd for one in movements(known, data, False)]
    sigma = np.sqrt(noise**2 + unexplained(known) ** 2)
    return np.concatenate(slopes, axis=2) / sigma[:, None, None]


def _by_pose(slope: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The slopes of all rows of each pose under one another (n_poses, 3 most, k); rows that a pose lacks tell nothing."""
    place = pd.Series(pose).groupby(pose).cumcount().to_numpy()
    whole = np.zeros((pose.max() + 1, place.max() + 1, *slope.shape[1:]))
    whole[pose, place] = slope
    return whole.reshape(len(whole), -1, slope.shape[2])
