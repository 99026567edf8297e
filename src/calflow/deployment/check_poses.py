"""Check poses: which few of the poses measured show best what has moved since."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calflow.deployment.drift import Drift, drift
from calflow.deployment.movements import movements
from calflow.deployment.prediction import on_conditions_of
from calflow.design.optimality import ParameterCriterion
from calflow.design.search import exchange, greedy
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.files.deferred import pd
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import POSITION
from calflow.robot.mechanism import reading_columns, shown_readings

FEWEST_CHECK_POSES = 3  # poses, of fewer nothing can be told apart
LABELS = ("pose", "payload", "marker")


@dataclass(frozen=True)
class ChosenPoses:
    """Poses to check a robot by, as a table for `calflow drift`, and what that would say where nothing moved, without noise."""

    table: pd.DataFrame
    foreseen: Drift


def choose_check_poses(calibrated: CalibratedModel, data: Measurements, number: int = 8) -> ChosenPoses:
    """Choose poses to check a robot by, of those of measurements: the ones that tell best what has moved.

    Args:
        calibrated: the calibrated model.
        data: measurements, those of the calibration or others, which say what can be reached and seen.
        number: how many to choose.

    Raises:
        InputError: there are fewer poses with the load that most poses carry.
    """
    load, there = _commonest_load(data)
    if not FEWEST_CHECK_POSES <= number <= there:
        carrying = f" with payload '{load}', which most carry" if data.table["payload"].nunique() > 1 else ""
        raise refuse(
            f"expected {FEWEST_CHECK_POSES} to {there}, the number of poses measured{carrying}, found {number}",
            key="number",
        )
    calibrated = on_conditions_of(calibrated, data)
    chosen = check_poses(calibrated, data, number)
    readings = shown_readings(data.robot, chosen.joints)
    columns = dict(zip(reading_columns(data.robot), readings.T.round(4), strict=True))
    foreseen = drift(calibrated, unmoved(calibrated, chosen), station="known")
    return ChosenPoses(chosen.table[[*LABELS]].assign(**columns), foreseen)


def check_poses(calibrated: CalibratedModel, data: Measurements, number: int) -> Measurements:
    """Return the first rows of so many of data's poses: with the load that most poses carry, every marker seen there once.

    They are D-optimal for all that may move, each thing by its usual size (Fedorov's exchange), told of the device's noise and of
    what the model errs by. Poses for the zeros of the joints alone would see shifts a tenth smaller, and hardly tell them from
    the dimensions beside them. Poses that were measured once can be reached, and seen, again.
    """
    loaded = data.only((data.table["payload"] == _commonest_load(data)[0]).to_numpy())
    there = loaded.only((~loaded.table.duplicated(["pose", "marker"])).to_numpy())
    pose = there.table.groupby("pose", sort=False).ngroup().to_numpy()
    slope = _by_pose(_slopes(calibrated, there), pose)
    prior, criterion = np.eye(slope.shape[2]), ParameterCriterion(slope.shape[2])
    chosen = exchange(slope, prior, greedy(slope, prior, number, criterion), criterion)
    return there.only(np.isin(pose, chosen))


def _commonest_load(data: Measurements) -> tuple[str, int]:
    """Return the payload that most poses carry, and how many do."""
    poses = data.table.groupby("payload", sort=False)["pose"].nunique()
    return str(poses.idxmax()), int(poses.max())


def unmoved(calibrated: CalibratedModel, data: Measurements) -> Measurements:
    """Return rows as they would be measured where nothing has moved, all in one go and without noise.

    What a check of them says is how much it would see.
    """
    at_once = {name: data.table[name].iloc[0] for name in ("session", "time") if name in data.table}
    data = replace(data, table=data.table.assign(**at_once))
    conditions = data.stating(calibrated.model.given).on(calibrated.model.robot).conditions
    there = calibrated.model.point(calibrated.estimate, conditions)
    return replace(data, table=data.table.assign(**dict(zip(POSITION, there.T, strict=True))))


def _slopes(calibrated: CalibratedModel, data: Measurements) -> np.ndarray:
    """What everything that may move does to rows by its usual size, over what they err by of themselves (n, 3, k)."""
    noise = calibrated.noise(data).sigma if calibrated.noise_known else np.zeros(len(data))
    slopes = [movement.slope * movement.sd for movement in movements(calibrated, data, False)]
    sigma = np.sqrt(noise**2 + calibrated.errors.rest**2)
    return np.concatenate(slopes, axis=2) / sigma[:, None, None]


def _by_pose(slope: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The slopes of all rows of each pose under one another (n_poses, 3 most, k); rows that a pose lacks tell nothing."""
    place = pd.Series(pose).groupby(pose).cumcount().to_numpy()
    whole = np.zeros((pose.max() + 1, place.max() + 1, *slope.shape[1:]))
    whole[pose, place] = slope
    return whole.reshape(len(whole), -1, slope.shape[2])
