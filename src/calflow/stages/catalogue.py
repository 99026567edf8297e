"""The catalogue of all stages, by name, in the order in which they can run; and the stage residual_field."""

from __future__ import annotations

from collections.abc import Mapping

from calflow.calibration import Calibration
from calflow.deployment.run_outcome import TABLES
from calflow.estimation.residual_field import SUMMARY, FieldSummary
from calflow.files.tables import Results
from calflow.stage_settings import NoStageSettings
from calflow.stages import diagnose, identify, report, sample, select
from calflow.stages.stage import Context, Stage


def _learn_field(context: Context) -> Results:
    """Fit the residual field to the training rows, and report its gain on held-out rows."""
    study = context.study
    calibration = Calibration.of(study.robot, study.file, context.results, study.measurements)
    return calibration.with_residual_field(say=context.say).results.of({"residual_field"})


_RESIDUAL_FIELD = Stage(
    "residual_field",
    "correct what no cause explains (not physical)",
    NoStageSettings,
    _learn_field,
    needs=("identify",),
    uses=("diagnose",),
    tables={name: row_type for name, row_type in TABLES.items() if name.startswith("residual_field/")},
    documents={SUMMARY: FieldSummary},
)

STAGES: Mapping[str, Stage] = {
    stage.name: stage
    for stage in (select.STAGE, identify.STAGE, diagnose.STAGE, _RESIDUAL_FIELD, sample.STAGE, report.STAGE)
}
