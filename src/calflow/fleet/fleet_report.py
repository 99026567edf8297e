"""The report of a fleet: one page for whoever has a minute, and a table of all robots for whoever looks for one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calflow.files.tables import to_frame
from calflow.files.words import first_up, listed, plural, ratio
from calflow.fleet.fleet_lines import error, fleet_lines, why
from calflow.fleet.outcome import Outcome, worst_first
from calflow.fleet.type_blocks import type_blocks
from calflow.fleet.types import TypeFindings, type_lines, unlike_parameters
from calflow.reporting.blocks import Block, Gap, Heading, Paragraph, Part, Plot, RestOfPage, Table
from calflow.reporting.style import ACCENT, DARK, MIDDLE, figure, plain_decades

MOST_TOLD = 18  # robots on the first page
MOST_ON_TYPES = 3  # sentences on the first page
LONGEST = 150  # letters of a verdict on the first page
Odd = Mapping[str, Sequence[str]]  # parameters in which robots are unlike their type
BAND = 0.6  # of the room between types that a type's robots take


def fleet_report(title: str, found: Sequence[Outcome], types: Sequence[TypeFindings]) -> list[Part]:
    """Return the parts of a fleet's report: the page, the table of all robots, and what those of a type tell together."""
    odd = unlike_parameters(types)
    worst = worst_first(found, odd)
    parts: list[Part] = [
        ("", _page(title, worst, odd, type_lines(types, MOST_ON_TYPES))),
        ("All robots", [_explained(), _table(worst, odd)]),
    ]
    return [*parts, ("Types", list(type_blocks(types)))] if types else parts


def _page(title: str, worst: Sequence[Outcome], odd: Odd, on_types: Sequence[str]) -> list[Block]:
    types = list(dict.fromkeys(sorted(one.type for one in worst)))
    told = worst[:MOST_TOLD]
    head = (
        "All robots, worst first"
        if len(told) == len(worst)
        else f"The {len(told)} of {len(worst)} robots that need a look first"
    )
    rows = [
        (one.robot, one.type, error(one.before_mean_mm), error(one.after_mean_mm), _in_short(one, odd)) for one in told
    ]
    first, *more = fleet_lines(worst)
    return [
        Paragraph("Fleet report", 10),
        Heading(title, 0),
        Paragraph(f"{plural(len(worst), 'robot')} of {plural(len(types), 'type')}: {listed(types)}", 10),
        Gap(14),
        Paragraph(first, 13, bold=True),
        *(Paragraph(line, 11) for line in (*more, *on_types)),
        Gap(8),
        *([_drawn(worst, types)] if any(one.after_mean_mm is not None for one in worst) else []),
        RestOfPage([
            Heading(head),
            Table(("robot", "type", "before [mm]", "after [mm]", "verdict"), rows, "llrrl", size=None, wide=4),
        ]),
    ]  # fmt: skip


def _in_short(one: Outcome, odd: Odd) -> str:
    """A robot's verdict as the first page has room for it."""
    said = one.verdict or why(one)
    if one.robot in odd:
        said = f"Unlike its type: {listed(odd[one.robot], 3)}. {said}"
    if one.causes:
        said += f" Found: {'; '.join(one.causes)}."
    return said if len(said) <= LONGEST else f"{said[:LONGEST]} …"


def _explained() -> Block:
    return Paragraph(
        "Position errors are those of poses held out of the fit where there are any, with the robot as its maker states it and "
        "as it was calibrated. Each robot's own report is in robots/NAME, what its run told in logs/NAME.log.", 9.5
    )  # fmt: skip


def _table(worst: Sequence[Outcome], odd: Odd) -> Block:
    header = ("robot", "type", "verdict", "mean before [mm]", "mean after [mm]", "largest before [mm]", "largest after [mm]",
              "times better", "causes found", "unlike its type", "failed: where and why")  # fmt: skip
    return Table(header, [_row(one, odd) for one in worst], "lllrrrrrlll", size=7)


def _row(one: Outcome, odd: Odd) -> tuple[str, ...]:
    figures = (one.before_mean_mm, one.after_mean_mm, one.before_max_mm, one.after_max_mm)
    gain = ratio(one.before_mean_mm / one.after_mean_mm) if one.before_mean_mm and one.after_mean_mm else "–"
    verdict, reason = (one.verdict, "") if one.status == "calibrated" else (first_up(one.status), why(one))
    return (
        one.robot,
        one.type,
        verdict,
        *map(error, figures),
        gain,
        "; ".join(one.causes),
        "; ".join(odd.get(one.robot, ())),
        reason,
    )


def _drawn(worst: Sequence[Outcome], types: Sequence[str]) -> Plot:
    """The error of every robot before and after, a band a type."""
    judged = [one for one in worst if one.after_mean_mm is not None]
    data = to_frame(judged, Outcome)[["type", "robot", "before_mean_mm", "after_mean_mm", "usable"]]
    data = data.sort_values(["type", "robot"], ignore_index=True)
    count = data.groupby("type")["robot"].transform("size")
    place = (data.groupby("type").cumcount() + 0.5) / count - 0.5  # across the band
    height = data["type"].map(types.index) + BAND * place
    errors = data[["before_mean_mm", "after_mean_mm"]].to_numpy()
    drawn = figure(0.8 + min(0.36 * len(types), 3.2))
    axes = drawn.add_subplot()
    axes.plot(data["before_mean_mm"], height, "o", color=MIDDLE, mfc="none", label="before")
    axes.plot(data["after_mean_mm"], height, "^", color=DARK, label="after")
    if (bad := ~data["usable"].fillna(True)).any():
        axes.plot(data["after_mean_mm"][bad], height[bad], "x", color=ACCENT, ms=7, label="not to be used")
    axes.set_xscale("log")
    plain_decades(axes.xaxis, errors.min(), errors.max())
    axes.set_yticks(range(len(types)), types)
    axes.set_ylim(len(types) - 0.5, -0.5)
    axes.set_xlabel("mean position error of a robot [mm]")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return Plot("fleet", drawn, "Every robot of each type before and after calibration.", data=data)
