"""What a fleet has as a whole: fleet.csv, one page as a PDF, and a page with a table of all robots for a browser."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.files.results import Results
from calflow.files.tables import to_frame
from calflow.fleet.fleet_folder import TABLE, FleetFolder
from calflow.fleet.outcome import Outcome, worst_first
from calflow.runs.kept import write_results

TABLES = {TABLE: Outcome}


def write_summary(folder: FleetFolder, title: str, found: Sequence[Outcome]) -> None:
    """Write the table and the reports of a fleet from what came of its robots."""
    from calflow.fleet.fleet_report import fleet_report
    from calflow.reporting import document
    from calflow.reporting.html import writing
    from calflow.reporting.style import style

    write_results(folder.path, Results({TABLE: to_frame(worst_first(found), Outcome)}), TABLES)
    with style():
        page, *tables = fleet_report(title, found)
        document.write(title, [page], folder.path)
        writing.write(title, [page, *tables], folder.path)
