"""The stage report: figures, one PDF and one page from the tables of the stages before it."""

from __future__ import annotations

from calflow.files.results import Results
from calflow.files.toml import FileModel
from calflow.stages.stage import Context, Stage


class ReportSettings(FileModel):
    """Settings of report: there are none."""


def _run(context: Context) -> Results:
    """Write report.pdf, report.html and figures/*.svg into the stage's folder; the report has no tables of its own."""
    from calflow.reporting.document import write_report
    from calflow.reporting.material import Material  # drawing and typesetting are loaded only where a report is made

    material = Material.of(context.study, context.results, context.run_folder)
    write_report(material, context.folder, context.say, context.advance)
    return Results()


STAGE = Stage(
    "report",
    "write the report",
    ReportSettings,
    _run,
    bases=("identify", "select"),
    uses=("select", "diagnose", "residual_field", "sample"),
    titled=True,
)
