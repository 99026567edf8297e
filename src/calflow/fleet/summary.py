"""What a fleet has as a whole: its tables, one page as a PDF, and a page with a table of all robots for a browser."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.files.problems import InputError
from calflow.files.results import Results
from calflow.files.tables import to_frame
from calflow.files.writing import write_whole
from calflow.fleet.collected import Collected, collected
from calflow.fleet.fleet import Fleet
from calflow.fleet.fleet_folder import CAUSES, TABLE, TYPES, UNLIKE, FleetFolder
from calflow.fleet.outcome import Outcome, worst_first
from calflow.fleet.reason import reason
from calflow.fleet.types import CommonCauseRow, TypeParameter, UnlikeRow, by_type, unlike_parameters
from calflow.runs.kept import keep_results

TABLES = {TABLE: Outcome, TYPES: TypeParameter, UNLIKE: UnlikeRow, CAUSES: CommonCauseRow}


def write_summary(fleet: Fleet, folder: FleetFolder, outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Write a fleet's tables and reports from what came of its robots, and of each type a robot file that knows it.

    Return the outcomes that these tell of: a robot whose run was changed since counts as failed.
    """
    from calflow.fleet.fleet_report import fleet_report
    from calflow.reporting import document
    from calflow.reporting import page as writing
    from calflow.reporting.style import style

    known, found = _known(fleet, folder, outcomes)
    types = by_type(known)
    tables = {
        TABLE: to_frame(worst_first(found, unlike_parameters(types)), Outcome),
        TYPES: to_frame([row for one in types for row in one.parameters()], TypeParameter),
        UNLIKE: to_frame([row for one in types for row in one.odd_ones()], UnlikeRow),
        CAUSES: to_frame([row for one in types for row in one.common()], CommonCauseRow),
    }
    keep_results(folder.path, Results(tables), TABLES, fleet.title)
    for one in types:
        expecting = one.expecting(next(type_.study.robot for type_ in fleet.types if type_.name == one.type))
        if expecting:
            write_whole(folder.type_robot(one.type), expecting.toml_text().encode())
    with style():
        page, *more = fleet_report(fleet.title, found, types)
        document.write_pdf(fleet.title, [page], folder.path)
        writing.write_html(fleet.title, [page, *more], folder.path)
    return found


def _known(fleet: Fleet, folder: FleetFolder, found: Sequence[Outcome]) -> tuple[list[Collected], list[Outcome]]:
    """What was found of every calibrated robot, and the outcomes: a robot whose run was changed since is none of these any more."""
    known, told = list[Collected](), list[Outcome]()
    for one in found:
        try:
            if one.status == "calibrated":
                known.append(collected(fleet.robot(one.robot), folder))
            told.append(one)
        except InputError as error:
            told.append(Outcome(robot=one.robot, type=one.type, status="failed", reason=reason(error)))
    return known, told
