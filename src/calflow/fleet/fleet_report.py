"""The report of a fleet: a one-page summary, a table of all robots, findings on types, and the CSV tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress

from calflow.effects.wording import amount, cause_name
from calflow.files.problems import InputError
from calflow.files.tables import Results, to_frame
from calflow.files.units import METRE
from calflow.files.words import chance_figure, first_up, listed, plural, ratio
from calflow.files.writing import write_whole
from calflow.fleet.engine import CAUSES, TABLE, TYPES, UNLIKE, FleetFolder
from calflow.fleet.fleet import Fleet
from calflow.fleet.standing import Outcome, error, failure_reason, fleet_lines, needs_look, why, worst_first
from calflow.fleet.types import (
    Collected,
    TypeFindings,
    TypeParameter,
    by_type,
    collected,
    moved_at_tool,
    type_lines,
    unlike_parameters,
)
from calflow.population.common_causes import CommonCause
from calflow.population.type_prior import FEWEST_ROBOTS
from calflow.population.unlike import Unlike
from calflow.reporting.blocks import NEXT, Block, Gap, Heading, Link, Paragraph, Part, Plot, RestOfPage, Table, headed
from calflow.reporting.style import ACCENT, DARK, MIDDLE, chart, plain_decades
from calflow.runs.kept import keep_results

WHOSE = {"type": "the type's", "robot": "each robot's own", "cannot tell": "cannot tell"}
PICTURES = ("region", "error_distribution")  # figures of a robot's report, in order of preference
MOST_SHOWN = 18  # robots on the first page
MOST_ON_TYPES = 3  # sentences on types on the first page
LONGEST_VERDICT = 150  # characters of a verdict on the first page
BAND = 0.6  # height of a type's band over the distance between bands
TABLES = {TABLE: Outcome, TYPES: TypeParameter, UNLIKE: Unlike, CAUSES: CommonCause}


def type_blocks(types: Sequence[TypeFindings]) -> Iterator[Block]:
    """Yield the report's blocks on each type."""
    for type_ in types:
        yield Heading(f"Type {type_.type}: {plural(type_.robots, 'robot')}")
        yield from (Paragraph(line) for line in type_lines([type_], 100))
        if type_.prior is None:
            yield Paragraph(f"Too few to say how far robots of the type differ: that takes {FEWEST_ROBOTS}.")
            continue
        if type_.unlike:
            words = {parameter.name: parameter.meaning or parameter.name for parameter in type_.prior.parameters}
            rows = [
                (odd.robot, words[odd.parameter], f"{odd.spreads:+.1f}", chance_figure(odd.p),
                 ", ".join(words[other] for other in odd.instead)) for odd in type_.unlike
            ]  # fmt: skip
            yield Table(("robot", "parameter", "off by [spreads of the type]", "p", "or instead"), rows, "llrrl")
        else:
            yield Paragraph("No robot is unlike the others.")
        if type_.causes:
            yield Table(("cause", "variant", "robots", "share, 95 % interval", "size, spread", "whose"), [
                (cause_name(cause.cause, cause.joint or 0), cause.detail, f"{len(cause.robots)} of {cause.of}",
                 f"{cause.low:.2f} to {cause.high:.2f}", amount(cause.cause, cause.size, cause.spread, cause.unit),
                 WHOSE[cause.whose]) for cause in type_.causes
            ], "lllrrl")  # fmt: skip
        yield Paragraph(
            f"types/{type_.type}.toml is the type's robot file with what to expect of a further one, by these robots: a study that "
            "names it needs far fewer poses. type_parameters.csv has the figures."
        )


Odd = Mapping[str, Sequence[str]]  # deviations from the type, in words, by robot


def fleet_report(
    title: str, outcomes: Sequence[Outcome], types: Sequence[TypeFindings], moved_mm: Mapping[Unlike, float] = {},
    reports: Mapping[str, Link] = {},
) -> list[Part]:  # fmt: skip
    """Return the parts of a fleet's report: the summary page, the table of all robots, and the findings on types.

    moved_mm is how far robots' deviations from their type move the tool; reports links each robot's own report and figure.
    """
    odd = unlike_parameters(types, moved_mm)
    worst = worst_first(outcomes, odd)
    parts: list[Part] = [
        ("", _page(title, worst, odd, type_lines(types, MOST_ON_TYPES), reports)),
        ("All robots", [_caption(worst), _table(worst, odd, reports)]),
    ]
    return [*parts, ("Types", list(type_blocks(types)))] if types else parts


def _page(
    title: str, worst: Sequence[Outcome], odd: Odd, on_types: Sequence[str], reports: Mapping[str, Link]
) -> list[Block]:
    types = list(dict.fromkeys(sorted(outcome.type for outcome in worst)))
    needy = [outcome for outcome in worst if needs_look(outcome, odd)]
    shown = needy[:MOST_SHOWN]
    further = f" (the first {len(shown)} here)" if len(shown) < len(needy) else ""
    head = f"{plural(len(needy), 'robot')} to look at, worst first{further}" if needy else "No robot needs a look."
    beside, in_unit = _units(worst)
    rows = [
        (_named(of, reports), of.type, in_unit(of, of.before_mean), in_unit(of, of.after_mean), _short_verdict(of, odd))
        for of in shown
    ]
    first, *more = fleet_lines(worst)
    return [
        Paragraph("Fleet report", 10),
        Heading(title, 0),
        Paragraph(f"{plural(len(worst), 'robot')} of {plural(len(types), 'type')}: {listed(types)}", 10),
        Gap(14),
        Paragraph(first, 13, bold=True),
        *(Paragraph(line, 11) for line in (*more, *on_types)),
        *headed(NEXT, Paragraph(_next_step(worst, needy), 11)),
        Gap(8),
        *([_error_plot(worst, types)] if any(outcome.after_mean is not None for outcome in worst) else []),
        RestOfPage([
            Heading(head),
            *([Table(("robot", "type", f"before{beside}", f"after{beside}", "verdict"), rows, "llrrl", size=None, wide=4)]
              if rows else []),
        ]),
    ]  # fmt: skip


def _next_step(worst: Sequence[Outcome], needy: Sequence[Outcome]) -> str:
    """Return the next step: for the worst robot, else for those not yet run, else for all."""
    if needy:
        step = "Correct what stopped its run" if needy[0].status == "failed" else needy[0].next_step.rstrip(".")
        return f"{needy[0].robot} first. {step or 'Look at how it differs from its type'}."
    if any(outcome.status == "not run" for outcome in worst):
        return "Run the fleet on (calflow fleet run): what is calibrated stays."
    return "Put the robots to work, and choose check poses (calflow check-poses) that will show whether anything moves."


def _short_verdict(outcome: Outcome, odd: Odd) -> str:
    """Return a robot's verdict, shortened for the first page."""
    verdict = f"{_unlike(outcome, odd)} {outcome.verdict or why(outcome)} {_causes_found(outcome)}".strip()
    return verdict if len(verdict) <= LONGEST_VERDICT else f"{verdict[:LONGEST_VERDICT]} …"


def _unlike(outcome: Outcome, odd: Odd) -> str:
    """Return a robot's deviations from its type in words; empty where there are none."""
    return f"Unlike its type: {listed(odd[outcome.robot], 3)}." if outcome.robot in odd else ""


def _causes_found(outcome: Outcome) -> str:
    return f"Found: {'; '.join(outcome.causes)}." if outcome.causes else ""


def _units(outcomes: Sequence[Outcome]) -> tuple[str, Callable[[Outcome, float | None], str]]:
    """Return the unit for a column's header, if all robots share one, and a function that formats an error for a cell."""
    units = dict.fromkeys(outcome.unit for outcome in outcomes if outcome.after_mean is not None) or {METRE.label: None}
    if len(units) == 1:
        return f" [{next(iter(units))}]", lambda outcome, value: error(value)
    return "", lambda outcome, value: error(value) if value is None else f"{error(value)} {outcome.unit}"


def _caption(outcomes: Sequence[Outcome]) -> Block:
    what = "Position errors" if all(outcome.unit == METRE.label for outcome in outcomes) else "Errors"
    return Paragraph(
        f"{what} are those of poses held out of the fit where there are any, with the robot as its maker states it and "
        "as it was calibrated. Each robot's own report is in robots/NAME, the log of its run in logs/NAME.log.",
        9.5,
    )


def _named(outcome: Outcome, reports: Mapping[str, Link]) -> str:
    return Link(outcome.robot, reports[outcome.robot].file) if outcome.robot in reports else outcome.robot


def _table(worst: Sequence[Outcome], odd: Odd, reports: Mapping[str, Link]) -> Block:
    beside, _ = _units(worst)
    pictured = ["before, now"] if reports else []
    errors = [f"{what}{beside}" for what in ("mean before", "mean after", "largest before", "largest after")]
    header = ("robot", *pictured, "type", "verdict", *errors, "times better", "remarks")
    rows = [_row(outcome, odd, _units(worst)[1], reports) for outcome in worst]
    return Table(header, rows, "l" * (3 + len(pictured)) + "rrrrrl", size=7)


def _row(
    outcome: Outcome, odd: Odd, in_unit: Callable[[Outcome, float | None], str], reports: Mapping[str, Link]
) -> tuple[str, ...]:
    before, after = outcome.before_mean, outcome.after_mean
    figures = [in_unit(outcome, value) for value in (before, after, outcome.before_max, outcome.after_max)]
    gain = ratio(before / after) if before and after else "–"
    done = outcome.status == "calibrated"
    remarks = (_unlike(outcome, odd), _causes_found(outcome), "" if done else why(outcome))
    return (
        _named(outcome, reports), *([reports.get(outcome.robot, "")] if reports else []), outcome.type,
        outcome.verdict if done else first_up(outcome.status), *figures, gain, " ".join(filter(None, remarks)),
    )  # fmt: skip


def _error_plot(worst: Sequence[Outcome], types: Sequence[str]) -> Plot:
    """Return a plot of every robot's error before and after calibration, one band per type."""
    judged = [outcome for outcome in worst if outcome.after_mean is not None]
    units = list(dict.fromkeys(outcome.unit for outcome in judged))
    lengths = units == [METRE.label]
    before, after = ("before_mean_mm", "after_mean_mm") if lengths else ("before_mean", "after_mean")
    data = to_frame(judged, Outcome)[["type", "robot", before, after, "usable", *([] if lengths else ["unit"])]]
    data = data.sort_values(["type", "robot"], ignore_index=True)
    count = data.groupby("type")["robot"].transform("size")
    place = (data.groupby("type").cumcount() + 0.5) / count - 0.5  # across the band
    height = data["type"].map(types.index) + BAND * place
    errors = data[[before, after]].to_numpy()
    drawn, axes = chart(0.8 + min(0.36 * len(types), 3.2))
    axes.plot(data[before], height, "o", color=MIDDLE, mfc="none", label="before")
    axes.plot(data[after], height, "^", color=DARK, label="after")
    if (bad := ~data["usable"].fillna(True)).any():
        axes.plot(data[after][bad], height[bad], "x", color=ACCENT, ms=7, label="not to be used")
    axes.set_xscale("log")
    plain_decades(axes.xaxis, errors.min(), errors.max())
    axes.set_yticks(range(len(types)), types)
    axes.set_ylim(len(types) - 0.5, -0.5)
    axes.set_xlabel(f"mean {'position ' if lengths else ''}error of a robot [{', '.join(units)}]")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return Plot("fleet", drawn, "Every robot of each type before and after calibration.", data=data)


def write_summary(fleet: Fleet, folder: FleetFolder, outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Write a fleet's tables and reports from its robots' outcomes, and a robot file with pooled priors for each type.

    Returns the outcomes reported, in which a robot whose run was changed since counts as failed.
    """
    from calflow.reporting import document
    from calflow.reporting import page as writing
    from calflow.reporting.style import style

    robots, judged = _results(fleet, folder, outcomes)
    types = by_type(robots)
    tables = {
        TABLE: to_frame(worst_first(judged, unlike_parameters(types)), Outcome),
        TYPES: to_frame([row for type_ in types for row in type_.parameters()], TypeParameter),
        UNLIKE: to_frame([row for type_ in types for row in type_.unlike], Unlike),
        CAUSES: to_frame([row for type_ in types for row in type_.causes], CommonCause),
    }
    keep_results(folder.path, Results(tables), TABLES, fleet.title)
    for one in types:
        expecting = one.expecting(next(type_.study.robot for type_ in fleet.types if type_.name == one.type))
        if expecting:
            write_whole(folder.type_robot(one.type), expecting.toml_text().encode())
    with style():
        page, *more = fleet_report(fleet.title, judged, types, _moved(fleet, types), _reports(fleet, folder))
        document.write_pdf(fleet.title, [page], folder.path)
        writing.write_html(fleet.title, [page, *more], folder.path)
    return judged


def _moved(fleet: Fleet, types: Sequence[TypeFindings]) -> dict[Unlike, float]:
    """Return the displacement of the tool by each robot's deviations from its type [mm]."""
    moved: dict[Unlike, float] = {}
    for findings in (findings for findings in types if findings.unlike):
        study = next(type_.study for type_ in fleet.types if type_.name == findings.type)
        with suppress(InputError):  # too few valid poses can be drawn
            moved |= moved_at_tool(study, findings.unlike)
    return moved


def _reports(fleet: Fleet, folder: FleetFolder) -> dict[str, Link]:
    """Return links to the robots' own reports, each with its map of errors or else its error distribution."""
    reports = {}
    for robot in fleet.robots:
        run = folder.run(robot.name)
        here = run.relative_to(folder.path).as_posix()
        drawn = [f"{here}/figures/{name}" for name in PICTURES if (run / f"figures/{name}.svg").is_file()]
        if (run / "report.html").is_file():
            reports[robot.name] = Link("", f"{here}/report.html", *drawn[:1])
    return reports


def _results(fleet: Fleet, folder: FleetFolder, outcomes: Sequence[Outcome]) -> tuple[list[Collected], list[Outcome]]:
    """Return the results of every calibrated robot, and the outcomes, in which a run changed since counts as failed."""
    robots, judged = list[Collected](), list[Outcome]()
    for outcome in outcomes:
        try:
            if outcome.status == "calibrated":
                robots.append(collected(fleet.robot(outcome.robot), folder))
            judged.append(outcome)
        except InputError as error:
            reason = failure_reason(error, fleet.path.parent)
            judged.append(Outcome(robot=outcome.robot, type=outcome.type, status="failed", reason=reason))
    return robots, judged
