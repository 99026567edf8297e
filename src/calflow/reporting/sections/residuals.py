"""The section on residuals: where the model is still wrong, and which rows do not fit."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from calflow.files.results import Results
from calflow.files.words import listed, mm, plural, ratio
from calflow.reporting.blocks import Block, Heading, Paragraph, Plot, Scene, Table
from calflow.reporting.figures.residuals import against_joints, against_place, in_workspace, magnification
from calflow.reporting.material import Material, latest
from calflow.reporting.section import Advice, Section
from calflow.robot.readings import reading_columns, reading_labels, shown_readings

SHOWN = 15  # flagged rows in the table
DRAWN = 700  # arrows in the workspace that can still be told apart
INTRODUCTION = (
    "What the calibrated model still gets wrong: predicted minus measured position. Errors that are noise point "
    "anywhere; neighbours that point the same way, or a trend along a joint, mean that the model lacks a cause."
)
PLACE = (
    "Size of the errors against reach, height and the order of the rows; a trend along the rows may be warm-up or a "
    "moved device."
)
JOINTS = (
    "Errors against each joint reading. Open circles: used for the fit; triangles: held out; line: mean of neighbouring "
    "rows, flat and near zero where nothing is missing."
)


def write(material: Material) -> list[Block]:
    """Show the errors of the calibrated model in space, against joints and place, and the rows that stand out."""
    shown = _shown(material)
    some = f" {len(shown)} of {len(material.data)} rows are shown." if len(shown) < len(material.data) else ""
    drawn = material.drawn_words
    directed, rows = _directed(material), by_row(material)
    enlarged = f", drawn {_factor(material):,.0f} times enlarged" if directed else " (lengths have no direction: dots)"
    return [
        Paragraph(INTRODUCTION, keep=True),
        Plot("residuals_place", by_place(material), PLACE + drawn, rows),
        Plot(
            "residuals_workspace",
            in_space(material),
            f"Errors in the measuring frame{enlarged}; the darker, the larger.{some}",
            rows,
            scene=Scene(shown.tolist(), _factor(material), ("pose", "marker")),
        ),
        Plot("residuals_joints", by_joint(material), JOINTS + drawn, rows),
        *_flagged(material),
    ]


def by_row(material: Material) -> pd.DataFrame:
    """Return what the figures show of each row drawn: which it is, where it was, its joints' readings and its errors."""
    robot, told = material.data.robot, material.data.table
    place = {f"{axis}_mm": 1e3 * material.place[:, k] for k, axis in enumerate("xyz")}
    joints = shown_readings(robot, material.data.joints)
    readings = {name: joints[:, k] for k, name in enumerate(reading_columns(robot))}
    error = {f"d{axis}_mm": material.error[:, k] for k, axis in enumerate("xyz")} | {"error_mm": material.distance}
    named = {name: told[name].astype(str).to_numpy() for name in ("pose", "marker")}
    return pd.DataFrame({**named, "held_out": material.held, **place, **readings, **error}).iloc[material.drawn]


def by_place(material: Material) -> Figure:
    """Draw the errors' size against reach, height and row."""
    reach = np.linalg.norm(material.place[:, :2] - np.array(material.data.robot.base.origin[:2]), axis=1)
    return against_place(reach, material.place[:, 2], material.distance, material.held, material.drawn)


def in_space(material: Material) -> Figure:
    """Draw the errors in the workspace."""
    position, shown = 1e3 * material.place, material.drawn[_shown(material)]
    error, distance, held = (values[shown] for values in (material.error, material.distance, material.held))
    return in_workspace(position[shown], error, distance, held, _factor(material))


def by_joint(material: Material) -> Figure:
    """Draw the errors against each joint's reading."""
    robot = material.data.robot
    reading = shown_readings(robot, material.data.joints)
    return against_joints(reading, _components(material), material.held, material.drawn, reading_labels(robot))


def _directed(material: Material) -> bool:
    """Whether any error has a direction."""
    return bool(np.isfinite(material.error).all(axis=1).any())


def _factor(material: Material) -> float:
    """How many times errors are enlarged."""
    return magnification(1e3 * material.place, material.error) if _directed(material) else 1.0


def _shown(material: Material) -> np.ndarray:
    """Which of the rows drawn are shown in the workspace."""
    n = len(material.drawn)
    return np.unique(np.linspace(0, n - 1, DRAWN).astype(int))


def _components(material: Material) -> dict[str, np.ndarray]:
    """The errors' parts (n_rows,) [mm] by their names, nan where a row does not have one."""
    parts = {f"d{axis}": material.error[:, k] for k, axis in enumerate("xyz")} | {"length": material.length_error}
    return {name: values for name, values in parts.items() if np.isfinite(values).any()}


def _flagged(material: Material) -> list[Block]:
    rows = _flags(material.results)
    flagged = rows[rows["flagged"].astype(bool)].sort_values("error_mm", ascending=False)
    if flagged.empty:
        return [Paragraph("No row stands out: none has an error too large for noise and for the spread of the rest.")]
    cells = [
        (*(str(row[name]) for name in ("line", "pose", "repeat", "marker")),
         "held out" if row["split"] == "holdout" else "used", mm(row["error_mm"]), ratio(row["whitened"]))
        for row in flagged.head(SHOWN).to_dict("records")
    ]  # fmt: skip
    left = f" The {SHOWN} largest of {len(flagged)} are shown." if len(flagged) > SHOWN else ""
    header = ("line of the file", "pose", "repeat", "marker", "row", "error [mm]", "times the expected")
    return [
        Heading("Rows that do not fit"),
        Paragraph(f"Their errors are too large for noise and for the spread of the rest.{left}", keep=True),
        Table(header, cells, "rrrllrr"),
    ]


def _flags(results: Results) -> pd.DataFrame:
    """Return the residuals of the last model whose rows were judged one by one."""
    rows = latest(results, "residuals")
    return rows if "flagged" in rows else results.tables["identify/residuals.csv"]


def flagged_rows(results: Results) -> list[Advice]:
    """Rows that do not fit are to be looked at."""
    rows = _flags(results)
    lines = rows.loc[rows["flagged"].astype(bool), "line"].tolist()
    if not lines:
        return []
    noun = "line" if len(lines) == 1 else "lines"
    sentence = (
        f"Check {plural(len(lines), 'row')} of the measurement file ({noun} {listed(lines)}): the error there is too large "
        "for noise. Measure again, or leave out what was mistaken."
    )
    return [Advice(2, sentence)]


SECTION = Section(50, "What is left: residuals", ("identify/residuals.csv",), write, (flagged_rows,))
