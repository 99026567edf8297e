"""Check poses: a D-optimal choice of few measured poses that best reveal what has moved since the calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calflow.deployment.drift import Drift, check_positions, drift
from calflow.deployment.movements import movements
from calflow.design.optimality import ParameterCriterion
from calflow.design.search import exchange, greedy
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.files.deferred import pd
from calflow.files.problems import refuse
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import POSITION
from calflow.robot.mechanism import reading_columns, shown_readings

FEWEST_CHECK_POSES = 3  # poses: with fewer, movements cannot be distinguished
LABELS = ("pose", "payload", "marker")


@dataclass(frozen=True)
class ChosenPoses:
    """Check poses as a table for `calflow drift`, and the result foreseen for noise-free rows where nothing moved."""

    table: pd.DataFrame
    foreseen: Drift


def choose_check_poses(calibrated: CalibratedModel, data: Measurements, number: int = 8) -> ChosenPoses:
    """Choose, from measured poses, those that best reveal what has moved since the calibration.

    Args:
        calibrated: the calibrated model.
        data: measurements, of the calibration or others; their poses are known to be reachable and visible.
        number: number of poses.

    Raises:
        InputError: rows have no positions, or fewer poses carry the most common payload.
    """
    check_positions(data)
    load, there = _commonest_load(data)
    if not FEWEST_CHECK_POSES <= number <= there:
        carrying = f" with payload '{load}', which most carry" if data.table["payload"].nunique() > 1 else ""
        raise refuse(
            f"expected {FEWEST_CHECK_POSES} to {there}, the number of poses measured{carrying}, found {number}",
            key="number",
        )
    calibrated = calibrated.later(data.given)
    chosen = check_poses(calibrated, data, number)
    readings = shown_readings(data.robot, chosen.joints)
    columns = dict(zip(reading_columns(data.robot), readings.T.round(4), strict=True))
    foreseen = drift(calibrated, unmoved(calibrated, chosen), station="known")
    return ChosenPoses(chosen.table[[*LABELS]].assign(**columns), foreseen)


def check_poses(calibrated: CalibratedModel, data: Measurements, number: int) -> Measurements:
    """Return the first rows of check poses, with the most common payload and each marker once.

    They are D-optimal for all movements, each scaled by its prior standard deviation (Fedorov's exchange), given the
    device's noise and the model's errors. Poses optimal for joint zeros alone would detect shifts smaller by a tenth,
    but hardly distinguish them from link dimensions. Poses that were measured once are reachable and visible.
    """
    loaded = data.only((data.table["payload"] == _commonest_load(data)[0]).to_numpy())
    there = loaded.only((~loaded.table.duplicated(["pose", "marker"])).to_numpy())
    pose = there.table.groupby("pose", sort=False).ngroup().to_numpy()
    slopes = [movement.slope * movement.sd for movement in movements(calibrated, there, False)]
    sigma = np.sqrt(calibrated.device_sigma(there) ** 2 + calibrated.errors.rest[METRE] ** 2)
    slope = _by_pose(np.concatenate(slopes, axis=2) / sigma[:, None, None], pose)
    prior, criterion = np.eye(slope.shape[2]), ParameterCriterion(slope.shape[2])
    chosen = exchange(slope, prior, greedy(slope, prior, number, criterion), criterion)
    return there.only(np.isin(pose, chosen))


def _commonest_load(data: Measurements) -> tuple[str, int]:
    """Return the most common payload and the number of its poses."""
    poses = data.table.groupby("payload", sort=False)["pose"].nunique()
    return str(poses.idxmax()), int(poses.max())


def unmoved(calibrated: CalibratedModel, data: Measurements) -> Measurements:
    """Return the rows with the positions that the calibrated model predicts, in one session and without noise.

    A drift check of them shows how much it could detect.
    """
    at_once = {name: data.table[name].iloc[0] for name in ("session", "time") if name in data.table}
    data = replace(data, table=data.table.assign(**at_once))
    there = calibrated.model.point(calibrated.estimate, calibrated.conditions_of(data))
    return replace(data, table=data.table.assign(**dict(zip(POSITION, there.T, strict=True))))


def _by_pose(slope: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return the Jacobians of each pose's rows, stacked (n_poses, 3 most, k); zero for rows that a pose lacks."""
    place = pd.Series(pose).groupby(pose).cumcount().to_numpy()
    whole = np.zeros((pose.max() + 1, place.max() + 1, *slope.shape[1:]))
    whole[pose, place] = slope
    return whole.reshape(len(whole), -1, slope.shape[2])
