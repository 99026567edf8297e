"""Task: the tool's predicted error where the robot works, in space and along a path, against the tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from calflow.files.words import mm
from calflow.reporting.advice import strange
from calflow.reporting.blocks import Block, Paragraph, Plot, Table, listing
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.style import ALONE, panels, shade, shades, view
from calflow.sampling.task_points import LIKELY, TaskPoint, TaskSummary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALMOST_CERTAIN = 0.999  # probability above which no further digits are stated
VIEWS = (((0, 1), "from above"), ((0, 2), "from the side"), ((1, 2), "from the front"))
MAPS = 3  # payloads with a row of maps, those with the largest radius
WORST_POINTS = 5  # points in the table
SIZES = {  # of a point, by its field
    "nominal_mm": "error of the nominal robot",
    "expected_mm": "expected error of the calibrated one",
    "radius95_mm": "95 % limit of the error",
    "turn95_mrad": "95 % limit of the orientation error",
}
WORST_HEADER = ("least certain points", "payload", "nominal [mm]", "95 % [mm]", "95 % [mrad]", "within")
PATH = "95 % limits of the errors along the path."
MAP = "Radius that contains the tool with 95 % probability; of points behind each other the largest."
INTRODUCTION = (
    "Distance of the tool from where the calibrated model predicts it, by draws of the parameters and of the model's own errors. "
    "The robot is as accurate only with corrected commands."
)
TOGETHER = (
    "Of two probabilities that all points are within, one takes the model's own errors as independent at every pose, the other as "
    "equal at all of them. Which is nearer the truth is not known."
)


def tolerances(task: TaskSummary) -> str:
    """Return the tolerances in words."""
    limits = ((task.tolerance_mm, "mm"), (task.turn_tolerance_mrad, "mrad"))
    return " and ".join(f"{mm(limit)} {unit}" for limit, unit in limits if limit is not None)


def answer(task: TaskSummary) -> str | None:
    """Return a sentence or two on whether the task's tolerances are met; None where there are none."""
    if task.likely_points is None or task.all_within is None or task.all_within_alike is None:
        return None
    where = "points of the path" if task.in_order else "points of the task"
    together = sorted((task.all_within, task.all_within_alike))
    low, high = map(_chance, together)
    chances = low if low == high else f"{low} to {high}"
    sentence = (
        f"Task: {task.likely_points} of {task.points} {where} are within {tolerances(task)} with at least {100 * LIKELY:.0f} % "
        f"probability{_apart(task)}. All of them together: {chances}."
    )
    return sentence + (f" {strange(task)}" if task.beyond_measured else "")


def _apart(task: TaskSummary) -> str:
    """Return words on how many points meet each of two tolerances alone."""
    if task.likely_positions is None or task.likely_turns is None:
        return ""
    return f" ({task.likely_positions} in position alone, {task.likely_turns} in orientation alone)"


def _chance(probability: float) -> str:
    """Return a probability, estimated by draws to about a per cent."""
    if probability > ALMOST_CERTAIN:
        return f"more than {100 * ALMOST_CERTAIN:.1f} %"
    if probability < 1 - ALMOST_CERTAIN:
        return f"less than {100 * (1 - ALMOST_CERTAIN):.1f} %"
    return f"{100 * probability:.0f} %" if 0.01 < probability < 0.99 else f"{100 * probability:.1f} %"


Groups = Mapping[str, Sequence[TaskPoint]]  # points by payload, in words


def task_map(groups: Groups) -> Figure:
    """Draw each point's radius at its place from three sides, a row of maps for each payload; the darker, the larger.

    Many points are reduced to cells, each of which shows the largest radius in it.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    dark, every = shades(0.1), [point.radius95_mm for points in groups.values() for point in points]
    norm = Normalize(min(every), max(*every, min(every) + 1e-6))
    drawn, grid = panels(len(groups), len(VIEWS), 2.1 * len(groups) + 0.3)
    for line, (name, points) in zip(grid, groups.items(), strict=True):
        place = np.array([(point.x_mm, point.y_mm, point.z_mm) for point in points]) / 1e3
        radius = np.array([point.radius95_mm for point in points])
        for axes, ((i, j), title) in zip(line, VIEWS, strict=True):
            shade(axes, place[:, [i, j]], radius, dark, norm, np.max)
            view(axes, i, j, f"{name}, {title}" if name else title)
    drawn.colorbar(ScalarMappable(norm, dark), ax=grid, shrink=0.8, aspect=30, label="95 % radius [mm]")
    return drawn


def path_figure(groups: Groups, task: TaskSummary) -> Figure:
    """Draw the limits of position and orientation along a path, with their tolerances, a line for each payload."""
    drawn, grid = panels(2, 1, 4.0, sharex=True)
    limits = (("position", "radius95_mm", task.tolerance_mm), ("orientation", "turn95_mrad", task.turn_tolerance_mrad))
    for axes, (what, limit, tolerance) in zip(grid[:, 0], limits, strict=True):
        for (name, points), (colour, dashes, _) in zip(groups.items(), ALONE, strict=False):
            number, values = range(1, len(points) + 1), [getattr(point, limit) for point in points]
            axes.plot(number, values, color=colour, linestyle=dashes, label=name or "95 %")
        if tolerance is not None:
            axes.axhline(tolerance, color="#000000", linewidth=1.8, linestyle=(0, (1, 1)), label="tolerance")
        axes.set(ylabel=f"{what} [{_unit(limit)}]", ylim=(0, None))
    grid[-1, 0].set_xlabel("point of the path")
    drawn.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return drawn


def _unit(field: str) -> str:
    """Return the unit with which the name of a field ends."""
    return field.rpartition("_")[2]


@section(8, "How accurate the task is done", "sample/task.csv")
def task_section(material: Material) -> list[Block]:
    """State whether the tolerances are met, and tabulate and draw the errors over the task."""
    if (task := material.task) is None:
        return []
    path = "sample/task.csv"
    points, words = material.results.rows(path, TaskPoint), answer(task)
    groups, data = _by_payload(points), material.tables[path]
    return [
        Paragraph(INTRODUCTION, keep=True),
        *([Paragraph(words, bold=True)] if words else []),
        Table(("over the task", "typical", "largest"), _sizes(points), "lrr"),
        Plot("task_map", task_map(groups), MAP, data),
        *([Plot("task_path", path_figure(groups, task), PATH, data)] if task.in_order else []),
        Table(WORST_HEADER, _worst(points, words is not None), "llrrrr"),
        *([Paragraph(TOGETHER)] if words else []),
        *listing(task.notes),
    ]


def _by_payload(points: Sequence[TaskPoint]) -> Groups:
    """Return the points under each of the payloads with the largest radii, in descending order of these."""
    groups: dict[str, list[TaskPoint]] = {}
    for point in sorted(points, key=lambda point: -point.radius95_mm):
        groups.setdefault(point.payload, [])
    for point in points:
        groups[point.payload].append(point)
    alone = "" if len(groups) == 1 else "no payload"
    return {payload or alone: groups[payload] for payload in list(groups)[:MAPS]}


def _sizes(points: Sequence[TaskPoint]) -> list[tuple[str, ...]]:
    values = {name: [getattr(point, name) for point in points] for name in SIZES}
    return [
        (words, *(f"{mm(float(of(values[name])))} {_unit(name)}" for of in (np.median, np.max)))
        for name, words in SIZES.items()
    ]


def _worst(points: Sequence[TaskPoint], asked: bool) -> list[tuple[str, ...]]:
    rows = sorted(points, key=lambda point: (point.within if asked else 0.0, -point.radius95_mm))
    return [
        (row.point, row.payload or "none", mm(row.nominal_mm), mm(row.radius95_mm), mm(row.turn95_mrad),
         _chance(row.within) if asked else "not asked")
        for row in rows[:WORST_POINTS]
    ]  # fmt: skip
