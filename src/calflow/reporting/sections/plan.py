"""Plan: the number of poses, which and in what order, the tool's expected uncertainty, and the gain by additions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calflow.deployment.run_outcome import RunOutcome
from calflow.design.isolability import isolability_gaps, isolability_summary
from calflow.design.measuring_order import DriftPull
from calflow.design.planned import Aim
from calflow.design.selection import Certificate
from calflow.design.worth import HowMany, Worth
from calflow.files.deferred import pd
from calflow.files.words import cut, first_up, listed, mm, number, percent, plural
from calflow.reporting.advice import ISOLABILITY_TABLE as ISOLABILITY
from calflow.reporting.blocks import (
    NEXT,
    Block,
    Bullets,
    Card,
    Columns,
    Gap,
    Heading,
    Item,
    Paragraph,
    Plot,
    RestOfPage,
    Table,
    cover,
    headed,
    in_a_line,
)
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.style import ACCENT, ALONE, DARK, MIDDLE, MOST_VECTOR_POINTS, chart, figure, same_scale, view
from calflow.robot.mechanism import reading_columns, reading_labels
from calflow.robot.robot import Robot

INDICES = ("O1", "O2", "O3", "O4", "O5")
CURVES = {"expected_sd_mm": "root mean square", "worst_sd_mm": "worst pose"}
WORTH_TABLE = "select/worth.csv"
GAPS = 5  # on the first page
UNASKED = (
    "Not computed: with isolability = true under [stages.select] this page says which causes these poses would detect."
)
EXPECTED_CAPTION = "Expected standard deviation of the predicted tool position over the task, by the number of poses."
FIRST_POSES = 10  # poses in the table
AIMS: dict[Aim, str] = {
    "parameters": "determine all parameters best",
    "tool": "make the tool's position over the task as certain as possible",
    "worst": "make the tool's position certain even where it is least certain in the task",
}
MAP_CAPTION = "The tool at the chosen poses, in measuring order; the square is the first."
NUMBER_CAPTION = (
    "What more poses are worth: observability indices O1 to O5 (the higher, the better the data separate the parameters), each "
    "relative to its value with all poses. Where a curve is flat, more poses gain little."
)
ADDITIONS = (
    "The tool's standard deviation over the task with one addition to the plan. Only the uncertainty of the parameters counts; "
    "causes that a payload or a marker would show are not included. Locating a second station or marker is included."
)
ORDER_TABLE = "select/order.csv"
DRIFTS = (
    "A steady drift while the poses are measured biases the parameters, by an amount that depends on the order. Short: short "
    "moves from pose to pose. Random: blocks of ten poses drawn from all, with short moves in each; of fifty such orders the one "
    "with the least bias. The device drifts in the worst direction; the robot grows from its base, as it does when warm."
)
VIAS = (
    "Each joint approaches its pose directly from a via point (columns via1 …), from either side about equally often, so that "
    "backlash and friction are not mistaken for effects of the joint's position."
)


def _to_measure(outcome: RunOutcome) -> bool:
    """Whether the poses are still to be measured; a calibration has another first page."""
    return "identify/summary.json" not in outcome.results


def over_number(curves: pd.DataFrame, label: str) -> tuple[Figure, Axes]:
    """Draw curves, a column each, against the number of poses, their index; label: that of their values."""
    drawn, axes = chart(2.3, 3.4)
    for name, (colour, line, marker) in zip(curves, ALONE, strict=False):
        look: dict[str, Any] = {"color": colour, "linestyle": line, "marker": marker, "markersize": 2.5}
        axes.plot(curves[name], markevery=max(1, len(curves) // 8), label=name, **look)
    axes.set(xlabel="number of poses", ylabel=label, ylim=(0, None))
    return drawn, axes


def observability_figure(table: pd.DataFrame) -> Figure:
    """Draw the indices, each relative to its value with all poses, where there is one."""
    indices = table.set_index("n_poses")[list(INDICES)].astype(float)
    relative = (indices / indices.iloc[-1].replace(0, np.nan)).dropna(axis="columns", how="all")
    drawn, axes = over_number(relative, "observability index\n[relative to all poses]")
    if axes.lines:  # too few poses have no index
        axes.legend(ncols=2)
    return drawn


def expected_error(table: pd.DataFrame, how_many: HowMany) -> Figure:
    """Draw the tool's expected sd [mm] against the number of poses, with the knee and the required tolerance."""
    curves = table.set_index("n_poses")[list(CURVES)].rename(columns=CURVES)
    drawn, axes = over_number(curves, "expected sd of the tool [mm]")
    axes.axvline(how_many.knee_poses, color=MIDDLE, linestyle=":", linewidth=0.9, label="knee")
    if how_many.tolerance_mm is not None:
        axes.axhline(how_many.tolerance_mm, color=DARK, linewidth=0.8, label="tolerance")
    axes.legend()
    return drawn


def map_of_poses(position: np.ndarray) -> Figure:
    """Draw planned tool positions (n_poses, 3) [mm] in space and from above, the path in measuring order."""
    drawn = figure(2.9)
    drawn.set_layout_engine("none")
    points = position / 1000
    space = drawn.add_axes((0.0, 0.02, 0.5, 0.98), projection="3d")
    assert isinstance(space, Axes3D)
    above = drawn.add_axes((0.6, 0.17, 0.38, 0.75))
    for axes, columns in ((space, points.T), (above, points[:, :2].T)):
        axes.plot(*columns, color="#b4bbc3", linewidth=0.4)
        axes.plot(*columns, "o", color=DARK, markersize=2.5, rasterized=len(points) > MOST_VECTOR_POINTS)
        axes.plot(*columns[:, :1], "s", color=ACCENT, markersize=5)
    same_scale(space, points[:, None])
    view(above, 0, 1, "from above")
    return drawn


@section(1, "Plan", WORTH_TABLE, _to_measure)
def plan_section(material: Material) -> list[Block]:
    """Return the plan's first page."""
    how_many = material.results.document("select/how_many.json", HowMany)
    worth = material.results.rows(WORTH_TABLE, Worth)
    curve = material.tables["select/observability.csv"]
    expected, largest = how_many.expected_sd_mm, float(curve["worst_sd_mm"].iloc[-1])
    cards = [
        Card(plural(how_many.n_poses, "pose"), mm(expected), f"where least sure {mm(largest)} mm", "dark"),
        *(Card(first_up(row.addition), mm(row.expected_sd_mm), f"{row.gain_percent:.0f} % less") for row in worth[1:3]),
    ]
    return [
        *cover("Measurement plan", material.title, [Paragraph(_planned(material))], _plan_verdict(how_many), (), cards),
        Columns(
            [[Plot("expected_error", expected_error(curve, how_many), EXPECTED_CAPTION, curve)],
             [Heading("How many poses?"), Bullets([*_how_many_words(how_many), *_held_out(material, how_many)], 10.5)]],
            [1, 1],
        ),
        Gap(10),
        RestOfPage([
            *headed("Causes that these poses cannot distinguish, and what would help", Bullets(_gaps(material), None)),
            *headed(NEXT, Bullets(_next_things(how_many, worth), None)),
        ]),
    ]  # fmt: skip


def _plan_verdict(how_many: HowMany) -> str:
    """Return a sentence on the expected uncertainty of the tool."""
    certain = f"{plural(how_many.n_poses, 'pose')} make the tool's position certain to {mm(how_many.expected_sd_mm)} mm"
    if how_many.tolerance_mm is None:
        return f"{certain}."
    met = "met" if how_many.expected_sd_mm <= how_many.tolerance_mm else "not met"
    return f"{certain}: the tolerance of {mm(how_many.tolerance_mm)} mm is {met}."


def _how_many_words(how_many: HowMany) -> list[Item]:
    """Return items on the number of poses: the knee, ten more, and the tolerance."""
    items: list[Item] = [
        ("Knee:", f"the curve bends at {how_many.knee_poses} poses: fewer cost much, more gain little."),
        ("Ten more", f"would lower the error by {mm(how_many.next_ten_mm)} mm."),
    ]
    if how_many.tolerance_mm is None:
        return items
    needed = f"are met with {how_many.enough_poses} poses; no choice of fewer than {how_many.needed_poses} meets them."
    met = needed if how_many.enough_poses else "are not met by any number of these candidates."
    return [*items, (f"{mm(how_many.tolerance_mm)} mm", met)]


def _held_out(material: Material, how_many: HowMany) -> list[Item]:
    """Return an item on the poses to be held out in addition."""
    share = material.request.split.holdout
    more = math.ceil(how_many.n_poses / (1 - share))
    words = f"these poses are all fitted. The study holds out {percent(share)} in addition: measure {more} in all."
    return [("Held out:", words)] if share else []


def _planned(material: Material) -> str:
    poses, robot = material.tables["select/poses.csv"], material.robot
    loads = [str(load) for load in poses["payload"].dropna().unique() if load]
    return in_a_line(
        f"Robot: {robot.name}",
        plural(len(poses), "pose"),
        f"marker {listed(list(poses['marker'].astype(str).unique()), 3)}",
        f"payload {listed(loads, 3)}" if loads else "",
        "1 sd, root mean square over the task; nothing is measured yet",
    )


def _gaps(outcome: RunOutcome) -> list[Item]:
    """Return the causes that the poses do not detect or distinguish, each with the cheapest remedy."""
    if ISOLABILITY not in outcome.results:
        return [UNASKED]
    table = outcome.tables[ISOLABILITY]
    gaps = isolability_gaps(table)
    left = int(table["worst"].sum()) - len(gaps[:GAPS])
    more = f"{plural(left, 'further gap')} in {ISOLABILITY}, some without a remedy among the additions."
    return [*(f"{first_up(words)}." for words in (isolability_summary(table), *gaps[:GAPS])), *[more] * (left > 0)]


def _next_things(how_many: HowMany, worth: list[Worth]) -> list[Item]:
    """Return the next steps."""
    items: list[Item] = []
    if how_many.enough_poses and how_many.enough_poses > how_many.n_poses:
        items.append(f"Plan {how_many.enough_poses} poses for the required tolerance.")
    if len(worth) > 1:
        best = worth[1]
        items.append(f"Consider first: {best.addition} takes {best.gain_percent:.0f} % off the tool's error.")
    return [
        *items,
        "Check the moves from pose to pose in simulation, then measure select/poses.csv in its order.",
        "Fill in what the device reports (a tracker x_mm, y_mm and z_mm): the file is then a measurement file, and the study can "
        "be run. From images calflow detect writes one: --joints takes the poses with a column image.",
    ]


@section(70, "Planned poses", "select/certificate.json", _to_measure)
def poses_section(material: Material) -> list[Block]:
    """State the poses' expected uncertainty, draw them, and tabulate the first."""
    poses, worth = material.tables["select/poses.csv"], material.tables["select/observability.csv"]
    expected, worst = (float(worth[name].iloc[-1]) for name in ("expected_sd_mm", "worst_sd_mm"))
    certificate = material.results.document("select/certificate.json", Certificate)
    position = poses[[f"nominal_{axis}_mm" for axis in "xyz"]].to_numpy(dtype=float)
    return [
        Paragraph(
            f"{len(poses)} poses were chosen so that together they {AIMS[certificate.criterion]}. The expected standard deviation "
            f"of the predicted tool position is {mm(expected)} mm over the task (root mean square), and {mm(worst)} mm where it is "
            f"largest. {_bound_words(certificate)}",
            keep=True,
        ),
        Plot("observability", observability_figure(worth), NUMBER_CAPTION, worth, 51),
        Plot("poses", map_of_poses(position), MAP_CAPTION, poses),
        *_first_poses(poses, material.robot),
    ]


def _bound_words(certificate: Certificate) -> str:
    """Return sentences on the bound of what other poses could gain."""
    what = "the parameters' standard deviations" if certificate.criterion == "parameters" else "that standard deviation"
    gained = certificate.refined_percent
    moved = "" if gained is None else f" Refined between the candidates, these are better by {gained:.2g} %."
    return (
        f"No other choice of {certificate.n_poses} of these {certificate.n_candidates:,} candidates makes {what} smaller by "
        f"more than {certificate.could_gain_percent:.2g} % (equivalence theorem).{moved}"
    )


def _first_poses(poses: pd.DataFrame, robot: Robot) -> list[Block]:
    joints = reading_columns(robot)
    columns = ["pose", *joints, *(f"nominal_{axis}_mm" for axis in "xyz")]
    head = ["pose", *reading_labels(robot), *(f"{axis} [mm]" for axis in "xyz")]
    rows = [
        [str(row["pose"]), *(number(row[name], ".2f") for name in joints),
         *(number(row[name], ".0f") for name in columns[-3:])]
        for row in poses.head(FIRST_POSES).to_dict("records")
    ]  # fmt: skip
    return [
        Heading("The first poses to measure"),
        Paragraph("All poses, with the side from which each joint approaches, are in select/poses.csv.", keep=True),
        Table(head, rows, "r" * len(head), size=7.6 if len(joints) > 6 else 8.4),
    ]


@section(72, "What one addition is worth", WORTH_TABLE)
def worth_section(material: Material) -> list[Block]:
    """Tabulate the additions in descending order of gain."""
    rows = material.results.rows(WORTH_TABLE, Worth)
    cells = [
        [first_up(row.addition) or "As planned", str(row.n_poses), str(row.n_points), mm(row.expected_sd_mm),
         f"{row.gain_percent:.0f} %" if row.addition else "",
         ", ".join(f"{cut(name)} {number(fall, '.0f')} %" for name, fall in zip(row.parameters, row.falls_percent, strict=True))]
        for row in rows
    ]  # fmt: skip
    head = ["addition", "poses", "points", "tool sd [mm]", "lower by", "parameters that gain most (sd lower by)"]
    return [Paragraph(ADDITIONS, keep=True), Table(head, cells, "lrrrrl", wide=0, size=8.4)]


@section(
    73,
    "The order of the poses",
    ORDER_TABLE,
    lambda outcome: _to_measure(outcome) and len(outcome.tables[ORDER_TABLE]) > 0,
)
def order_section(material: Material) -> list[Block]:
    """Tabulate the bias by each drift in each order."""
    rows = material.results.rows(ORDER_TABLE, DriftPull)
    poses = material.tables["select/poses.csv"]
    cells = [
        [f"{row.order}, as planned" if row.taken else row.order, f"{row.travel:.2f}", f"{row.drifting} by {mm(row.drift_mm)} mm",
         mm(row.tool_pull_mm), f"{row.parameter}: {row.pull_sd:.1f} sd"]
        for row in rows
    ]  # fmt: skip
    head = ["order", "travel (relative)", "drift", "bias of the tool [mm]", "most biased parameter"]
    via = [Paragraph(VIAS)] if any(str(name).startswith("via") for name in poses) else []
    return [Paragraph(DRIFTS, keep=True), Table(head, cells, "lrlrl", wide=4), *via]
