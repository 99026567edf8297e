"""The stage report: figures, a PDF and an HTML page from the results of earlier stages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from calflow.files.tables import Results
from calflow.run_folder import read_manifest
from calflow.stage_settings import NoStageSettings
from calflow.stages.stage import Context, Stage
from calflow.study import Study

if TYPE_CHECKING:
    from calflow.estimation.calibrated_model import CalibratedModel
    from calflow.measurements.measurements import Measurements
    from calflow.reporting.material import Material


def _run(context: Context) -> Results:
    """Write report.pdf, report.html and figures/*.svg."""
    # imported here, since drawing and typesetting take long to load
    from calflow.reporting.document import write_report

    material = report_material(context.study, context.results, context.run_folder)
    write_report(material, context.folder, context.say, context.advance)
    return Results()


def report_material(study: Study, results: Results, run_folder: Path) -> Material:
    """Return the material of a study's report: its request and its results."""
    from calflow.calibration import Calibration
    from calflow.reporting.material import Material

    settings, chain = {stage: study.settings(stage) for stage in study.stages}, run_folder / "sample" / "chain.h5"
    workflow, sampled = study.workflow.name, chain if chain.exists() else None

    def load() -> tuple[CalibratedModel, Measurements]:
        calibration = Calibration.of(study.robot, study.file, results, study.measurements)
        return calibration, calibration.data

    manifest = read_manifest(run_folder)
    stopped = {name: entry.stopped for name, entry in manifest.stages.items()} if manifest else {}
    return Material(results, study.robot, study.file, workflow, settings, load, sampled, stopped)


STAGE = Stage(
    "report",
    "write the report",
    NoStageSettings,
    _run,
    bases=("identify", "select"),
    uses=("select", "diagnose", "residual_field", "sample"),
    titled=True,
)
