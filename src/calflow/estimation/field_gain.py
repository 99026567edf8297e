"""Gain of a residual field: block cross-validation over the fitted rows decides whether it is applied."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from calflow.estimation.accuracy import errors, mean_rms_max
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.leverage import halved
from calflow.estimation.noise import group_means
from calflow.estimation.progress import SAME, Draws
from calflow.estimation.residual_field import (
    NOT_PHYSICAL,
    POSES,
    STILL,
    SUMMARY,
    FieldAccuracy,
    FieldSummary,
    ResidualField,
    learnt,
    pose_table,
)
from calflow.files.deferred import pd
from calflow.files.tables import Results, to_document, to_frame
from calflow.files.units import METRE
from calflow.files.words import plural
from calflow.measurements.measurements import Measurements

MIN_POSES = 16  # poses, below which no field is learnt
MAX_POSES = 2000  # poses from which the field is learnt: time grows with the cube
ALIKE = 1e-6  # rad or m within which readings are the same
FOLDS = 8
HALVINGS = 5  # at most
LEAST_POSES = 4  # of a block
FALSE_GAIN = 0.01  # false-alarm rate: probability that a useless correction is applied
CERTAIN = 1.96  # standard deviations of a 95 % interval
CORRECTED = "residual field (not physical)"  # the correction of a row of `FieldAccuracy`


@dataclass(frozen=True, eq=False)
class FieldGain:
    """Cross-validated distances (n,) [m] from measured positions, without the field and corrected by it; block (n,) of each.

    poses is their number, n = 0 where it is too few. covered is the share of the coordinates within their 95 % intervals.
    """

    poses: int
    block: np.ndarray
    without: np.ndarray
    corrected: np.ndarray
    covered: float = float("nan")

    @property
    def blocks(self) -> int:
        """Number of blocks that were left out in turn."""
        return len(np.unique(self.block))

    @property
    def p(self) -> float:
        """p-value of the mean gain (one-sided t test), the gains of blocks being taken as independent."""
        if self.blocks < 2:
            return 1.0
        gained = np.bincount(self.block, self.without**2 - self.corrected**2) / np.bincount(self.block)
        sem = float(gained.std(ddof=1)) / np.sqrt(len(gained))
        return float(scipy.stats.t.sf(gained.mean() / sem, len(gained) - 1)) if sem > 0 else 1.0

    @property
    def gains(self) -> bool:
        """Whether the correction is to be applied."""
        return self.p < FALSE_GAIN

    @property
    def statement(self) -> str:
        if not self.blocks:
            return f"residual field ({NOT_PHYSICAL}) not applied: {plural(self.poses, 'pose')} with positions, too few for it"
        before, after = (mean_rms_max(1e3 * each)[1] for each in (self.without, self.corrected))
        were = f"the root mean square goes from {before:.3f} mm to {after:.3f} mm"
        if not self.gains:
            return (
                f"residual field ({NOT_PHYSICAL}) not applied: it gains nothing beyond chance at training poses left out of it "
                f"({were})"
            )
        return f"residual field ({NOT_PHYSICAL}) applied: at training poses left out of it {were}"


def training_poses(
    calibrated: CalibratedModel, data: Measurements, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the first arguments of `learnt`: means over rows of the same readings, of a random subset of very many poses."""
    train = data.only(data.train)
    left = -errors(calibrated.model, calibrated.estimate, train)
    whole = ~np.isnan(left).any(axis=1)
    train, left = train.only(whole), left[whole]
    pose = train.table.groupby("pose", sort=False).ngroup().to_numpy()
    joints = group_means(train.joints, pose)[pose]
    readings, inverse = np.unique(np.round(joints / ALIKE), axis=0, return_inverse=True)
    group = inverse.ravel()
    mean = group_means(left, group)
    sigma = np.nan_to_num(calibrated.device_sigma(train))
    noise = np.sqrt(np.mean(sigma**2 / np.bincount(group)[group])) if len(train) else 0.0
    some = np.sort(rng.permutation(len(readings))[:MAX_POSES])
    return ALIKE * readings[some], mean[some], float(noise)


def gainful_field(
    calibrated: CalibratedModel, data: Measurements, rng: Draws = SAME
) -> tuple[ResidualField | None, FieldGain]:
    """Return the residual field of a model's training rows, None where it gains nothing, and its gain."""
    poses = training_poses(calibrated, data, rng("nodes"))
    gain = gain_of(*poses, rng("blocks"))
    return (learnt(*poses, rng("field")) if gain.gains else None), gain


def gain_of(readings: np.ndarray, left: np.ndarray, noise: float, rng: np.random.Generator) -> FieldGain:
    """Return the gain at blocks left out in turn, with hyperparameters and field learnt (see `learnt`) from the other blocks alone.

    Blocks are contiguous in joint space, so that a left-out pose has no near duplicate among the others.
    """
    n = len(readings)
    if n < MIN_POSES:
        return FieldGain(n, np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    block = blocks(readings)
    fold = block % min(FOLDS, block.max() + 1)
    mean, variance = np.zeros_like(left), np.zeros(n)
    for k in range(fold.max() + 1):
        out = fold == k
        field = learnt(readings[~out], left[~out], noise, rng)
        mean[out] = field.correction(readings[out])
        variance[out] = field.size**2 + field.rest**2 - field.explained(readings[out])
    off = left - mean
    covered = float((np.abs(off) < CERTAIN * np.sqrt(variance)[:, None]).mean())
    return FieldGain(n, block, np.linalg.norm(left, axis=1), np.linalg.norm(off, axis=1), covered)


def blocks(readings: np.ndarray) -> np.ndarray:
    """Return each pose's block (n,), from 0, by halving the readings (n, n_joints) repeatedly along their widest axis."""
    scaled = readings / np.maximum(np.ptp(readings, axis=0), STILL)
    return halved(scaled, min(HALVINGS, int(np.log2(len(readings) / LEAST_POSES))))


def field_results(
    calibrated: CalibratedModel, field: ResidualField | None, gain: FieldGain, data: Measurements
) -> Results:
    """Return the field learnt from a model without one, and its gain, as the run folder keeps them."""
    tables = {
        POSES: pose_table(field, calibrated.model.robot),
        "residual_field/accuracy.csv": _accuracy(calibrated, field, gain, data),
    }
    return Results(tables, {SUMMARY: to_document(field_summary(field, gain))})


def field_summary(field: ResidualField | None, gain: FieldGain) -> FieldSummary:
    """Return the hyperparameters of a field, and its gain."""
    return FieldSummary(
        kind="not physical", applied=field is not None, statement=gain.statement, poses=gain.poses, blocks=gain.blocks,
        p=gain.p,
        size_mm=1e3 * field.size if field else None, rest_mm=1e3 * field.rest if field else None,
        own_mm=1e3 * field.own if field else None, lengths=tuple(map(float, field.length)) if field else (),
    )  # fmt: skip


def _accuracy(
    calibrated: CalibratedModel, field: ResidualField | None, gain: FieldGain, data: Measurements
) -> pd.DataFrame:
    """Return the table of `FieldAccuracy`: of left-out blocks, and of held-out rows where the field is applied."""
    rows = []
    if gain.blocks:
        rows = [_row("none", "left-out blocks", gain.without, None)]
        rows.append(_row(CORRECTED, "left-out blocks", gain.corrected, gain.covered))
    unseen = data.only(data.held_out)
    error = errors(calibrated.model, calibrated.estimate, unseen)
    whole = ~np.isnan(error).any(axis=1)
    if field is not None and whole.any():
        unseen, error = unseen.only(whole), error[whole]
        for correction, model in (("none", calibrated), (CORRECTED, replace(calibrated, field=field))):
            off = error + model.field_correction(unseen.conditions)
            covered = np.abs(off) < CERTAIN * np.sqrt(model.promised_variance(unseen, METRE))
            rows.append(_row(correction, "holdout", np.linalg.norm(off, axis=1), float(covered.mean())))
    return to_frame(rows, FieldAccuracy)


def _row(correction: str, where: str, distance: np.ndarray, covered: float | None) -> FieldAccuracy:
    mean, rms, most = mean_rms_max(1e3 * distance)
    return FieldAccuracy(
        correction=correction, where=where, n=len(distance), mean_mm=mean, rms_mm=rms, max_mm=most, covered=covered  # type: ignore[arg-type]
    )  # fmt: skip
