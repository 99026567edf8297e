"""Task: the tool's predicted error where the robot works, in space and along a path, against the tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from calflow.files.deferred import pd
from calflow.files.words import mm
from calflow.reporting.advice import strange
from calflow.reporting.blocks import Block, Paragraph, Plot, Table, listing
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.style import ALONE, figure, shade, shades, view
from calflow.sampling.task_points import LIKELY, TaskSummary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALMOST_CERTAIN = 0.999  # probability above which no further digits are stated
VIEWS = (((0, 1), "from above"), ((0, 2), "from the side"), ((1, 2), "from the front"))
MAPS = 3  # payloads with a row of maps, those with the largest radius
WORST_POINTS = 5  # points in the table
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


def task_map(place: np.ndarray, radius: np.ndarray, groups: Sequence[tuple[str, np.ndarray]]) -> Figure:
    """Draw the radius (n_points,) [mm] over places (n_points, 3) [m] from three sides; the darker, the larger.

    groups: payloads and masks (n_points,) of their points, a row of maps each. Many points are reduced to cells, each of which
    shows the largest radius in it.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    dark = shades(0.1)
    norm = Normalize(radius.min(), radius.max() if np.ptp(radius) > 0 else radius.min() + 1e-6)
    drawn = figure(2.1 * len(groups) + 0.3)
    grid = drawn.subplots(len(groups), len(VIEWS), squeeze=False)
    for line, (name, rows) in zip(grid, groups, strict=True):
        for axes, ((i, j), title) in zip(line, VIEWS, strict=True):
            shade(axes, place[rows][:, [i, j]], radius[rows], dark, norm, np.max)
            view(axes, i, j, f"{name}, {title}" if name else title)
    drawn.colorbar(ScalarMappable(norm, dark), ax=grid, shrink=0.8, aspect=30, label="95 % radius [mm]")
    return drawn


@dataclass(frozen=True, eq=False)
class Course:
    """A quantity along a path (n_points,), its axis label, and the tolerance in the same unit, None where there is none."""

    words: str
    limit: np.ndarray
    tolerance: float | None


def path_figure(courses: Sequence[Course], groups: Sequence[tuple[str, np.ndarray]]) -> Figure:
    """Draw quantities along a path, below each other; groups as for `task_map`, a line each."""
    drawn = figure(1.9 * len(courses) + 0.2)
    grid = drawn.subplots(len(courses), 1, squeeze=False, sharex=True)[:, 0]
    for axes, course in zip(grid, courses, strict=True):
        for (name, rows), (colour, dashes, _) in zip(groups, ALONE, strict=False):
            number = np.arange(1, int(rows.sum()) + 1)
            axes.plot(number, course.limit[rows], color=colour, linestyle=dashes, label=name or "95 %")
        if course.tolerance is not None:
            axes.axhline(course.tolerance, color="#000000", linewidth=1.8, linestyle=(0, (1, 1)), label="tolerance")
        axes.set(ylabel=course.words, ylim=(0, None))
    grid[-1].set_xlabel("point of the path")
    drawn.legend(*grid[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return drawn


def _task(material: Material) -> list[Block]:
    """State whether the tolerances are met, and tabulate and draw the errors over the task."""
    if (task := material.task) is None:
        return []
    table = material.tables["sample/task.csv"]
    words = answer(task)
    return [
        Paragraph(INTRODUCTION, keep=True),
        *([Paragraph(words, bold=True)] if words else []),
        Table(("over the task", "typical", "largest"), _sizes(table), "lrr"),
        *_pictures(task, table),
        Table(WORST_HEADER, _worst(task, table), "llrrrr"),
        *([Paragraph(TOGETHER)] if words else []),
        *listing(task.notes),
    ]


def _sizes(table: pd.DataFrame) -> list[tuple[str, str, str]]:
    def row(words: str, name: str, unit: str) -> tuple[str, str, str]:
        values = table[name].to_numpy(dtype=float)
        return words, f"{mm(float(np.median(values)))} {unit}", f"{mm(float(values.max()))} {unit}"

    return [
        row("error of the nominal robot", "nominal_mm", "mm"),
        row("expected error of the calibrated one", "expected_mm", "mm"),
        row("95 % limit of the error", "radius95_mm", "mm"),
        row("95 % limit of the orientation error", "turn95_mrad", "mrad"),
    ]


def _pictures(task: TaskSummary, table: pd.DataFrame) -> list[Block]:
    place = table[["x_mm", "y_mm", "z_mm"]].to_numpy(dtype=float) / 1e3
    radius = table["radius95_mm"].to_numpy(dtype=float)
    payload = table["payload"].fillna("").astype(str).to_numpy()
    carried = sorted(set(payload), key=lambda name: -radius[payload == name].max())[:MAPS]
    groups = [(name or ("no payload" if len(carried) > 1 else ""), payload == name) for name in carried]
    blocks: list[Block] = [Plot("task_map", task_map(place, radius, groups), MAP, table)]
    if task.in_order:
        parts = [
            Course("position [mm]", table["radius95_mm"].to_numpy(dtype=float), task.tolerance_mm),
            Course("orientation [mrad]", table["turn95_mrad"].to_numpy(dtype=float), task.turn_tolerance_mrad),
        ]
        blocks.append(Plot("task_path", path_figure(parts, groups), PATH, table))
    return blocks


def _worst(task: TaskSummary, table: pd.DataFrame) -> list[tuple[str, ...]]:
    by, upwards = ("within", True) if task.likely_points is not None else ("radius95_mm", False)
    filled = table.fillna({"payload": ""})
    rows = filled.sort_values([by, "radius95_mm"], ascending=[upwards, False], kind="stable").head(WORST_POINTS)
    return [
        (row["point"], row["payload"] or "none", mm(row["nominal_mm"]), mm(row["radius95_mm"]), mm(row["turn95_mrad"]),
         _chance(row["within"]) if task.likely_points is not None else "not asked")
        for row in rows.to_dict("records")
    ]  # fmt: skip


TASK_SECTION = Section(8, "How accurate the task is done", "sample/task.csv", _task)
