"""Certainty: predictive standard deviations of a calibrated model against its errors, and poses far beyond their limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from calflow.estimation.calibrated_model import MOST_UNTOLD, CalibratedModel
from calflow.estimation.noise import representative
from calflow.files.deferred import pd
from calflow.files.tables import column
from calflow.measurements.measurements import Measurements
from calflow.model import Model

# Mean length of a vector of 0 to 3 standard normals.
MEAN_OF_NOISE = np.sqrt(np.array([0, 2, np.pi / 2, 8]) / np.array([1, np.pi, 1, np.pi]))
LATER = (3600.0, 86400.0)  # s, after the last row
PROMISED = 0.95  # probability that an error is below its limit
SURPRISE = 0.01  # p-value of so few below their limits, from which these are too narrow
MISSED = 2  # times the 95 % limit, which normal errors exceed once in ten thousand rows at most
WORST = 50  # poses, those with the largest errors, that are compared with it


@dataclass(frozen=True, kw_only=True)
class MissedPose:
    """A pose whose error is far beyond its 95 % limit."""

    pose: str = column("its name")
    line: int = column("the line of the measurement file with its largest error")
    split: Literal["train", "holdout"] = column("whether it was fitted or held out")
    error: float = column(
        "its largest error, of images the root mean square over its points, in the unit by which the model is judged"
    )
    limit: float = column("the limit that 95 % of such errors should be below, in that unit")


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """Certainty of a calibrated model without residual field at the rows by which it is judged: held-out rows, else fitted."""

    points: int = column("measured points that were used")
    markers: tuple[str, ...] = column("their markers")
    payloads: tuple[str, ...] = column("their payloads")
    joints_low: tuple[float, ...] = column("the least fitted reading of each joint", "rad; of a slide m", default=())
    joints_high: tuple[float, ...] = column("the largest", "rad; of a slide m", default=())
    split: Literal["train", "holdout"] = column("the rows by which it is judged, which have values in `unit`")
    unit: str = column("the unit by which it is judged: mm, mrad, px, …")
    left: float = column("mean error, in `unit`")
    noise: str = column("the noise of the rows, in words")
    noise_floor: float | None = column(
        "mean error that noise alone would give, in `unit`; null: the noise was estimated from the fit"
    )
    model_sd_mm: float = column("standard deviation of positions by the parameters alone: root mean square", "mm")
    prediction_sd_mm: float = column("the same with the choice of the model and its smooth errors", "mm")
    rivals: bool = column("whether other models explain the data about as well")
    tested: int = column("number of errors of held-out rows that were compared with their 95 % limits", default=0)
    within: int = column("number of them below their limit", default=0)
    within_chance: float = column("p-value of so few if the limits are right; each pose counts once", default=1.0)
    reach_m: tuple[float, ...] = column(
        "the least and the largest horizontal distance from the first axis of the rows by which it is judged",
        "m",
        default=(),
    )
    heights_m: tuple[float, ...] = column(
        "the least and the largest height of them, z in the measuring frame", "m", default=()
    )
    no_gain: float = column(
        "share of the measured rows at which an error smaller than the nominal robot's is not certain (95 %)",
        default=0.0,
    )
    untold: tuple[str, ...] = column(
        "axes of the measuring frame along which the larger part of a position's variance is left to the priors",
        default=(),
    )
    expected_mm: tuple[float, ...] = column(
        "root mean square error expected at the fitted poses: then, an hour later and a day later; empty without times",
        "mm",
        default=(),
    )
    missed: tuple[MissedPose, ...] = column(
        "poses whose error is far beyond its 95 % limit: pose, line, split, error, limit", default=()
    )

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, residuals: pd.DataFrame) -> Certainty:
        """Return the certainty of a model, given its rows as they were fitted and their residuals (see `Residual`)."""
        calibrated, used = replace(calibrated, field=None), (data.train | data.held_out)
        data, residuals = data.only(used), residuals[used]
        fitted = data.joints[data.train]
        units = [observation.units for observation in calibrated.model.observations]
        unit = calibrated.unit
        distance = np.where(calibrated.model.undecided(data), np.nan, errors_in(residuals, unit.label))
        there = np.isfinite(distance)
        held = bool((data.held_out & there).any())
        judged = (data.held_out if held else data.train) & there
        some = data.conditions[:, np.flatnonzero(judged)[representative(data.only(judged))]]
        every = data.conditions[:, representative(data)]
        gained = calibrated.gain_is_certain(every)
        variances = (calibrated.parameter_variance(some), calibrated.position_variance(some))
        model_sd, prediction_sd = (1e3 * float(np.sqrt(variance.sum(axis=1).mean())) for variance in variances)
        noise = calibrated.noise(data)
        mean = MEAN_OF_NOISE[np.array([kinds.count(kinds[0]) for kinds in units])[data.series_number]]
        floor = float((mean * unit.scale * noise.sigma)[judged].mean())
        place = calibrated.model.point(calibrated.estimate, some)
        reach = np.linalg.norm(place[:, :2] - calibrated.model.robot.base.origin[:2], axis=1)
        tested = tested_rows(calibrated, data, distance)
        below = tested["error"] <= tested["limit"]
        # Rows of one pose share errors: the number beyond is counted in poses.
        beyond = float((~below).groupby(tested["pose"]).mean().sum())
        poses = tested["pose"].nunique()
        markers = tuple(str(name) for name in data.table["marker"].unique() if name)
        return Certainty(
            points=len(data), markers=markers, payloads=calibrated.payloads,
            joints_low=tuple(fitted.min(axis=0).tolist()), joints_high=tuple(fitted.max(axis=0).tolist()),
            split="holdout" if held else "train", unit=unit.label,
            left=float(distance[judged].mean()), noise=noise.words, noise_floor=floor if calibrated.noise_known else None,
            model_sd_mm=model_sd, prediction_sd_mm=prediction_sd, rivals=bool(calibrated.alternatives),
            reach_m=(float(reach.min()), float(reach.max())),
            heights_m=(float(place[:, 2].min()), float(place[:, 2].max())), tested=len(tested), within=int(below.sum()),
            within_chance=float(scipy.special.betainc(beyond, poses - beyond + 1, 1 - PROMISED)) if beyond else 1.0,
            no_gain=float(1.0 - gained.mean()), expected_mm=then_and_later(calibrated, data),
            untold=tuple("xyz"[k] for k in np.flatnonzero(calibrated.untold(Model.point_jacobian, some) > MOST_UNTOLD)),
            missed=missed_poses(calibrated, data, residuals, distance),
        )  # fmt: skip


def then_and_later(calibrated: CalibratedModel, data: Measurements) -> tuple[float, ...]:
    """Return the expected errors [mm] at fitted rows: then, an hour and a day after the last; none without times."""
    if "time" not in calibrated.model.given:
        return ()
    fitted = data.only(data.train)
    rows = fitted.only(representative(fitted)).stating(calibrated.model.given)
    end = float(fitted.table["time"].max())
    moments = (rows, *(replace(rows, table=rows.table.assign(time=end + seconds)) for seconds in LATER))
    errors = (calibrated.promised_distance(moment.conditions) for moment in moments)
    return tuple(1e3 * float(np.sqrt((error**2).mean())) for error in errors)


def tested_rows(calibrated: CalibratedModel, data: Measurements, error: np.ndarray) -> pd.DataFrame:
    """Return pose, error and limit of held-out rows, of very many a `representative` subset; arguments as of `missed_poses`."""
    rows = data.held_out & np.isfinite(error)
    rows[rows] = representative(data.only(rows))
    held = data.only(rows)
    limit = promised_limits(calibrated, held) if rows.any() else np.zeros(0)
    every = pd.DataFrame({"pose": held.table["pose"].to_numpy(), "error": error[rows], "limit": limit})
    return every.dropna()


def promised_limits(calibrated: CalibratedModel, data: Measurements) -> np.ndarray:
    """Return the limit below which 95 % of a row's errors should lie, (n_rows,) in the unit by which the model is judged, or nan.

    The sum of squared normal errors along axes is approximated by a gamma variable of equal mean and variance (Satterthwaite 1946).
    """
    unit = calibrated.unit
    variance = calibrated.promised_variance(data, unit)
    total = variance.sum(axis=1)
    freedom = total**2 / np.where(total > 0, (variance**2).sum(axis=1), np.nan)
    return np.asarray(unit.shown(np.sqrt(total * scipy.special.chdtri(freedom, 1 - PROMISED) / freedom)))


def missed_poses(
    calibrated: CalibratedModel, data: Measurements, residuals: pd.DataFrame, error: np.ndarray
) -> tuple[MissedPose, ...]:
    """Return the poses whose error is more than MISSED times its limit, the worst first.

    calibrated has no residual field, data the conditions that it needs; residuals is the table of their `Residual`s, and error
    (n_rows,) the size of each in the unit by which the model is judged, or nan.
    """
    there = np.flatnonzero(np.isfinite(error))
    by_pose = pd.Series(error[there], index=there).groupby(residuals["pose"].to_numpy()[there])
    largest = by_pose.idxmax().to_numpy(dtype=int)
    if data.in_images:  # a single badly seen point of many does not speak against the pose
        error = np.full(len(error), np.nan)
        error[largest] = by_pose.agg(lambda sizes: np.sqrt(np.mean(sizes**2)))
    worst = np.sort(largest[np.argsort(-error[largest], kind="stable")][:WORST])
    rows = data.only(np.isin(np.arange(len(data)), worst))
    limits, table = promised_limits(calibrated, rows), residuals.iloc[worst]
    missed = [
        MissedPose(pose=str(pose), line=int(line), split=split, error=float(size), limit=float(limit))
        for pose, line, split, size, limit in zip(
            table["pose"], table["line"], table["split"], error[worst], limits, strict=True
        )
        if size > MISSED * limit
    ]
    return tuple(sorted(missed, key=lambda pose: -pose.error))


def errors_in(residuals: pd.DataFrame, label: str) -> np.ndarray:
    """Return the size of each row's error, shape (n_rows,), in the unit with a label; nan where its values are in another."""
    return residuals["error"].where(residuals["unit"] == label).to_numpy(dtype=float)
