"""The section on the task: how far off the tool may be where the robot works."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calflow.files.results import Results
from calflow.files.words import mm
from calflow.reporting.blocks import Block, Bullets, Paragraph, Plot, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Advice, Section
from calflow.reporting.task_answer import LIKELY, Course, along, answer, chance, strange, task_map, task_of
from calflow.sampling.task_points import TaskSummary

MAPS = 3  # payloads that have a line of maps, the least sure ones
WORST = 5  # points in the table
WORST_HEADER = ("least sure points", "payload", "nominal [mm]", "95 % [mm]", "95 % [mrad]", "within")
PATH = "Along the path: what errors are below with 95 % probability."
MAP = "Radius in which the tool is with 95 % probability; of points behind each other the largest."
INTRODUCTION = (
    "How far the tool may be from where the calibrated model says it is: draws of the parameters, with what the model lacks beside "
    "them, at poses that it was not fitted to. The robot itself is as accurate only where its commands are corrected by the model."
)
TOGETHER = (
    "Where two probabilities are told that all points are within, what the model lacks is taken for another error at every pose, "
    "and for one error at all of them; how it really goes from pose to pose is not known."
)


def write(material: Material) -> list[Block]:
    """Show errors over the task, and what is probable."""
    task, table = _summary(material.results), material.tables["sample/task.csv"]
    said = answer(task)
    return [
        Paragraph(INTRODUCTION, keep=True),
        *([Paragraph(said, bold=True)] if said else []),
        Table(("over the task", "typical", "largest"), _sizes(task, table), "lrr"),
        *_pictures(task, table),
        Table(WORST_HEADER, _worst(task, table), "llrrrr"),
        *([Paragraph(TOGETHER)] if said else []),
        *([Bullets(list(task.notes))] if task.notes else []),
    ]  # fmt: skip


def _sizes(task: TaskSummary, table: pd.DataFrame) -> list[tuple[str, str, str]]:
    def row(words: str, name: str, unit: str) -> tuple[str, str, str]:
        own = table[name].to_numpy(dtype=float)
        return words, f"{mm(float(np.median(own)))} {unit}", f"{mm(float(own.max()))} {unit}"

    return [
        row("error of the nominal robot", "nominal_mm", "mm"),
        row("expected error of the calibrated one", "expected_mm", "mm"),
        row("95 % of errors are below", "radius95_mm", "mm"),
        row("95 % of turns are below", "turn95_mrad", "mrad"),
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
            Course("turn [mrad]", table["turn95_mrad"].to_numpy(dtype=float), task.turn_tolerance_mrad),
        ]
        blocks.append(Plot("task_path", along(parts, groups), PATH, table))
    return blocks


def _worst(task: TaskSummary, table: pd.DataFrame) -> list[tuple[str, ...]]:
    by, upwards = ("within", True) if task.likely_points is not None else ("radius95_mm", False)
    told = table.fillna({"payload": ""})
    rows = told.sort_values([by, "radius95_mm"], ascending=[upwards, False], kind="stable").head(WORST)
    return [
        (row["point"], row["payload"] or "none", mm(row["nominal_mm"]), mm(row["radius95_mm"]), mm(row["turn95_mrad"]),
         chance(row["within"]) if task.likely_points is not None else "not asked")
        for row in rows.to_dict("records")
    ]  # fmt: skip


def not_met(results: Results) -> list[Advice]:
    """Tolerances that some points hardly meet, and points unlike those measured, are to be acted on."""
    task, found = _summary(results), list[Advice]()
    sure = f"with {100 * LIKELY:.0f} % probability"
    if task.likely_positions is not None and (short := task.points - task.likely_positions):
        found.append(
            Advice(
                2,
                f"{short} of {task.points} points of the task are not within {mm(task.tolerance_mm or 0.0)} mm {sure}: "
                "sample/task.csv says which; poses near them, under their payload, tell most ([stages.select.task] chooses such).",
            )
        )
    if task.likely_turns is not None and (short := task.points - task.likely_turns):
        how = "poses near them tell most" if task.orientation_measured else (
            "no orientation was measured; measure some, or markers whose places on the tool are known"
        )  # fmt: skip
        found.append(
            Advice(
                2,
                f"{short} of {task.points} points of the task are not turned within {mm(task.turn_tolerance_mrad or 0.0)} mrad "
                f"{sure}: {how}.",
            )
        )
    if task.beyond_measured:
        found.append(Advice(2, f"{strange(task)} Measure there too."))
    return found


def _summary(results: Results) -> TaskSummary:
    found = task_of(results)
    assert found is not None
    return found


SECTION = Section(78, "How accurate where it works", ("sample/task.csv", "sample/task_summary.json"), write, (not_met,))
