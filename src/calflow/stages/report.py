"""The stage report: figures and one PDF from the tables of the stages before it."""

from __future__ import annotations

from calflow.files.results import Results
from calflow.files.toml import FileModel
from calflow.stages.stage import Context, Stage


class ReportSettings(FileModel):
    """Settings of report: there are none."""


def run(context: Context) -> Results:
    """Write report.pdf and figures/*.svg into the stage's folder; the report has no tables of its own."""
    from calflow.report.document import (
        write,
    )  # drawing and typesetting are loaded only where a report is made
    from calflow.report.material import Material
    from calflow.report.section import chosen, sections
    from calflow.report.style import style

    material = Material.of(context.study, context.results, context.run_folder)
    with style():
        parts = []
        there = chosen(sections(), material)
        for k, section in enumerate(there):
            parts.append((section.title, section.write(material)))
            context.advance(0.7 * (k + 1) / len(there))
        n_figures = write(material.title, parts, context.folder)
    context.say(f"report.pdf: {n_figures} figures, {len(parts)} sections")
    return Results()


STAGE = Stage(
    "report",
    "write the report",
    ReportSettings,
    run,
    needs=("identify",),
    uses=("select", "diagnose", "sample"),
    titled=True,
)
