"""The stage residual_field: a smooth correction of what the final model leaves. No cause explains it: it is not physical."""

from __future__ import annotations

from calflow.calibration import TABLES, Calibration
from calflow.estimation.residual_field import SUMMARY, FieldSummary
from calflow.files.tables import Results
from calflow.files.toml import FileModel
from calflow.stages.stage import Context, Stage


class ResidualFieldSettings(FileModel):
    """Settings of residual_field: there are none."""


def _run(context: Context) -> Results:
    """Learn the field from training rows alone, and say what it gains on rows that it has not seen."""
    study = context.study
    calibration = Calibration.of(study.robot, study.file, context.results, study.measurements)
    return calibration.with_residual_field(say=context.say).results.of({"residual_field"})


STAGE = Stage(
    "residual_field",
    "correct what no cause explains (not physical)",
    ResidualFieldSettings,
    _run,
    needs=("identify",),
    uses=("diagnose",),
    tables={name: row_type for name, row_type in TABLES.items() if name.startswith("residual_field/")},
    documents={SUMMARY: FieldSummary},
)
