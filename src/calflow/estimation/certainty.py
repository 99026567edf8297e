"""How sure a calibrated model is of the rows by which it is judged, and which poses are off by far more than it promises."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from calflow.estimation.accuracy import judged_unit
from calflow.estimation.calibrated_model import (
    CalibratedModel,
    distance_moved,
    parameter_variance,
    position_variance,
    promised_distance,
    promised_variance,
)
from calflow.estimation.noise import representative
from calflow.files.deferred import pd
from calflow.files.tables import column
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.model import Model

# mean length of so many unit normals
MEAN_OF_NOISE = np.sqrt(np.array([0, 2, np.pi / 2, 8]) / np.array([1, np.pi, 1, np.pi]))
PROMISED = 0.95  # share of errors that are promised to be below their limit
MISSED = 2  # times the limit of 95 % of errors: normal errors are beyond it once in ten thousand rows at most
WORST = 50  # poses, those of the largest errors, that are held against it


@dataclass(frozen=True, kw_only=True)
class MissedPose:
    """A pose that is off by far more than the calibrated model promises."""

    pose: str = column("its name")
    line: int = column("the line of the measurement file with its largest error")
    split: Literal["train", "holdout"] = column("whether it was fitted or held out")
    error: float = column(
        "its largest error, of images the root mean square over its points, in the unit by which the model is judged"
    )
    limit: float = column("what 95 % of such errors are promised to be below, in that unit")


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """How sure a calibrated model, without a residual field, is of the rows by which it is judged: held out, else fitted."""

    points: int = column("measured points that were used")
    markers: tuple[str, ...] = column("their markers")
    payloads: tuple[str, ...] = column("their payloads")
    split: Literal["train", "holdout"] = column("the rows by which it is judged, which have values in `unit`")
    unit: str = column("the unit by which it is judged: mm, mrad, px, …")
    left: float = column("mean error, in `unit`")
    noise: str = column("the noise of the rows, in words")
    noise_floor: float | None = column(
        "mean error that noise alone would give, in `unit`; null: only the fit tells the noise"
    )
    model_sd_mm: float = column("how sure its parameters make its positions: root mean square", "mm")
    prediction_sd_mm: float = column("the same with the choice of the model and its own error", "mm")
    rivals: bool = column("whether other models explain the data about as well")
    tested: int = column(
        "errors of rows that no fit has seen, held against their limits: what 95 % are to be below", default=0
    )
    within: int = column("how many of them are below it", default=0)
    within_chance: float = column("chance of so few where the limits are right; each pose counts once", default=1.0)
    reach_m: tuple[float, ...] = column(
        "the least and the largest horizontal distance from the first axis of the rows by which it is judged",
        "m",
        default=(),
    )
    heights_m: tuple[float, ...] = column(
        "the least and the largest height of them, z in the measuring frame", "m", default=()
    )
    no_gain: float = column(
        "share of the measured rows at which the tool is promised no closer than it was moved from the maker's figures",
        default=0.0,
    )
    missed: tuple[MissedPose, ...] = column(
        "poses that are off by far more than is promised: pose, line, split, error, limit", default=()
    )

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, residuals: pd.DataFrame) -> Certainty:
        """Return that of a model, its rows as they were fitted, and what it leaves of them (see `Residual`)."""
        calibrated, used = replace(calibrated, field=None), (data.train | data.held_out)
        data, residuals = data.only(used), residuals[used]
        units = [observation.units for observation in calibrated.model.observations]
        unit = judged_unit([kinds[0] for kinds in units])
        distance = errors_in(residuals, unit.label)
        there = np.isfinite(distance)
        held = bool((data.held_out & there).any())
        judged = (data.held_out if held else data.train) & there
        some = data.conditions[:, np.flatnonzero(judged)[representative(data.only(judged))]]
        variances = (of_rows(calibrated, some) for of_rows in (parameter_variance, position_variance))
        model_sd, prediction_sd = (1e3 * float(np.sqrt(variance.sum(axis=1).mean())) for variance in variances)
        noise = calibrated.noise(data)
        mean = MEAN_OF_NOISE[np.array([kinds.count(kinds[0]) for kinds in units])[data.series_number]]
        floor = float((mean * unit.scale * noise.sigma)[judged].mean())
        place = calibrated.model.point(calibrated.estimate, some)
        reach = np.linalg.norm(place[:, :2] - calibrated.model.robot.base.origin[:2], axis=1)
        tested = tested_rows(calibrated, data, distance)
        below = tested["error"] <= tested["limit"]
        beyond = float((~below).groupby(tested["pose"]).mean().sum())  # poses: their rows err alike
        poses = tested["pose"].nunique()
        named = ([str(name) for name in data.table[column].unique()] for column in ("marker", "payload"))
        markers, payloads = (tuple(name for name in names if name) for names in named)
        return Certainty(
            points=len(data), markers=markers, payloads=payloads, split="holdout" if held else "train", unit=unit.label,
            left=float(distance[judged].mean()), noise=noise.words, noise_floor=floor if calibrated.noise_known else None,
            model_sd_mm=model_sd, prediction_sd_mm=prediction_sd, rivals=bool(calibrated.alternatives),
            reach_m=(float(reach.min()), float(reach.max())),
            heights_m=(float(place[:, 2].min()), float(place[:, 2].max())), tested=len(tested), within=int(below.sum()),
            within_chance=float(scipy.special.betainc(beyond, poses - beyond + 1, 1 - PROMISED)) if beyond else 1.0,
            no_gain=_no_gain(calibrated, data), missed=missed_poses(calibrated, data, residuals, distance),
        )  # fmt: skip


def tested_rows(calibrated: CalibratedModel, data: Measurements, error: np.ndarray) -> pd.DataFrame:
    """Return pose, error and promised limit of the rows that no fit has seen, of very many such as tell as much.

    Args:
        calibrated: the calibrated model, without a residual field.
        data: rows that have the conditions that the model was stated for.
        error: size of what the model leaves of each, (n_rows,) in the unit by which it is judged; nan where there is none.
    """
    rows = data.held_out & np.isfinite(error)
    rows[rows] = representative(data.only(rows))
    held, unit = data.only(rows), judged_unit(_leading(calibrated.model))
    limit = promised_limits(calibrated, held, unit) if rows.any() else np.zeros(0)
    return pd.DataFrame({"pose": held.table["pose"].to_numpy(), "error": error[rows], "limit": limit})


def promised_limits(calibrated: CalibratedModel, data: Measurements, unit: MeasurementUnit) -> np.ndarray:
    """Return what 95 % of the errors of rows are promised to be below, shape (n_rows,) [unit].

    The squares' sum of normal errors along axes is taken for a gamma variable of its mean and variance (Satterthwaite 1946).
    """
    variance = promised_variance(calibrated, data, unit)
    total = variance.sum(axis=1)
    freedom = total**2 / (variance**2).sum(axis=1)
    return np.asarray(unit.shown(np.sqrt(total * scipy.special.chdtri(freedom, 1 - PROMISED) / freedom)))


def missed_poses(
    calibrated: CalibratedModel, data: Measurements, residuals: pd.DataFrame, error: np.ndarray
) -> tuple[MissedPose, ...]:
    """Return the poses, fitted or held out, that are off by many times what is promised, the worst first.

    Args:
        calibrated: the calibrated model, without a residual field.
        data: rows that have the conditions that the model was stated for.
        residuals: what the model leaves of them (see `Residual`).
        error: size of that, (n_rows,) in the unit by which the model is judged; nan where there is none.
    """
    there = np.flatnonzero(np.isfinite(error))
    by_pose = pd.Series(error[there], index=there).groupby(residuals["pose"].to_numpy()[there])
    largest = by_pose.idxmax().to_numpy(dtype=int)
    if data.in_images:  # of many points one may be seen badly, which is nothing of the pose
        error = np.full(len(error), np.nan)
        error[largest] = by_pose.agg(lambda sizes: np.sqrt(np.mean(sizes**2)))
    worst = np.sort(largest[np.argsort(-error[largest], kind="stable")][:WORST])
    rows, unit = data.only(np.isin(np.arange(len(data)), worst)), judged_unit(_leading(calibrated.model))
    limits, table = promised_limits(calibrated, rows, unit), residuals.iloc[worst]
    missed = [
        MissedPose(pose=str(pose), line=int(line), split=split, error=float(size), limit=float(limit))
        for pose, line, split, size, limit in zip(
            table["pose"], table["line"], table["split"], error[worst], limits, strict=True
        )
        if size > MISSED * limit
    ]
    return tuple(sorted(missed, key=lambda pose: -pose.error))


def errors_in(residuals: pd.DataFrame, label: str) -> np.ndarray:
    """Return the size of each row's error, shape (n_rows,), in the unit of a label; nan where its values are in another."""
    if label == METRE.label:
        return residuals["error_mm"].to_numpy(dtype=float)
    return residuals["error"].where(residuals["unit"] == label).to_numpy(dtype=float)


def _leading(model: Model) -> list[MeasurementUnit]:
    return [observation.units[0] for observation in model.observations]


def _no_gain(calibrated: CalibratedModel, data: Measurements) -> float:
    conditions = data.conditions[:, representative(data)]
    return float((promised_distance(calibrated, conditions) >= distance_moved(calibrated, conditions)).mean())
