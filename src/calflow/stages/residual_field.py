"""The stage residual_field: a smooth correction of what the final model leaves. No cause explains it: it is not physical."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from calflow.estimation.accuracy import errors
from calflow.estimation.calibrated_model import CalibratedModel, calibrated
from calflow.estimation.certainty import field_correction, position_variance
from calflow.estimation.field_gain import CERTAIN, FieldGain, gainful_field
from calflow.estimation.residual_field import (
    POSES,
    SUMMARY,
    FieldAccuracy,
    FieldPose,
    FieldSummary,
    ResidualField,
    pose_table,
)
from calflow.faults import corrected
from calflow.files.results import Results, to_document
from calflow.files.tables import to_frame
from calflow.files.toml import FileModel
from calflow.measurements.measurements import Measurements
from calflow.stages.stage import Context, Stage


class ResidualFieldSettings(FileModel):
    """Settings of residual_field: there are none."""


def run(context: Context) -> Results:
    """Learn the field from training rows alone, and say what it gains on rows that it has not seen."""
    study = context.study
    data = corrected(study.measurements(), context.tables["identify/faults.csv"])
    known = replace(calibrated(study.robot, context.results, data.given), field=None)
    data = data.on(known.model.robot)
    field, gain = gainful_field(known, data, context.rng)
    context.say(gain.statement)
    tables = {
        POSES: pose_table(field, known.model.robot),
        "residual_field/accuracy.csv": accuracy(known, field, gain, data),
    }
    return Results(tables, {SUMMARY: to_document(summary(field, gain))})


def summary(field: ResidualField | None, gain: FieldGain) -> FieldSummary:
    """Return the figures of a field, and what it gains."""
    judged = gain.blocks > 0
    return FieldSummary(
        kind="not physical", applied=field is not None, statement=gain.statement, poses=gain.poses, blocks=gain.blocks,
        rms_without_mm=_rms(gain.without) if judged else None, rms_corrected_mm=_rms(gain.corrected) if judged else None,
        p=gain.p, covered=gain.covered if judged else None,
        size_mm=1e3 * field.size if field else None, rest_mm=1e3 * field.rest if field else None,
        own_mm=1e3 * field.own if field else None, lengths=tuple(map(float, field.length)) if field else (),
    )  # fmt: skip


def accuracy(known: CalibratedModel, field: ResidualField | None, gain: FieldGain, data: Measurements) -> pd.DataFrame:
    """Return the table of `FieldAccuracy`: of left-out blocks, and of held-out rows where the field is applied."""
    rows = []
    if gain.blocks:
        rows = [_row("none", "left-out blocks", gain.without, None)]
        rows.append(_row("residual field (not physical)", "left-out blocks", gain.corrected, gain.covered))
    unseen = data.only(data.held_out)
    error = errors(known.model, known.estimate, unseen)
    whole = ~np.isnan(error).any(axis=1)
    if field is not None and whole.any():
        unseen, error = unseen.only(whole), error[whole]
        rows.append(_judged("none", known, unseen, error))
        rows.append(_judged("residual field (not physical)", replace(known, field=field), unseen, error))
    return to_frame(rows, FieldAccuracy)


def _judged(correction: str, known: CalibratedModel, data: Measurements, error: np.ndarray) -> FieldAccuracy:
    """How far a model with or without its field is from held-out rows; error (n, 3) [m] is the model's alone."""
    off = error + field_correction(known, data.rows)
    noise = known.noise(data).sigma if known.noise_known else np.zeros(len(data))
    sd = np.sqrt(position_variance(known, data.rows) + np.nan_to_num(noise)[:, None] ** 2)
    covered = float((np.abs(off) < CERTAIN * sd).mean())
    return _row(correction, "holdout", np.linalg.norm(off, axis=1), covered)


def _row(correction: str, where: str, distance: np.ndarray, covered: float | None) -> FieldAccuracy:
    return FieldAccuracy(
        correction=correction, where=where, n=len(distance), mean_mm=1e3 * float(distance.mean()),  # type: ignore[arg-type]
        rms_mm=_rms(distance), max_mm=1e3 * float(distance.max()), covered=covered,
    )  # fmt: skip


def _rms(distance: np.ndarray) -> float:
    return 1e3 * float(np.sqrt((distance**2).mean()))


STAGE = Stage(
    "residual_field",
    "correct what no cause explains (not physical)",
    ResidualFieldSettings,
    run,
    needs=("identify",),
    uses=("diagnose",),
    tables={POSES: FieldPose, "residual_field/accuracy.csv": FieldAccuracy},
    documents={SUMMARY: FieldSummary},
)
