"""The section on planned poses: how many are worth it, and which."""

from __future__ import annotations

import pandas as pd

from calflow.design.selection import Aim, Certificate
from calflow.design.worth import HowMany
from calflow.files.words import mm, number
from calflow.reporting.blocks import Block, Heading, Paragraph, Plot, Table
from calflow.reporting.figures.poses import observability
from calflow.reporting.figures.residuals import map_of_poses
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.robot.readings import reading_columns, reading_labels
from calflow.robot.robot import Robot

SHOWN = 10  # poses in the table
AIMS: dict[Aim, str] = {
    "parameters": "tell the most about all parameters",
    "tool": "make the tool's position over the task as sure as can be",
    "worst": "make the tool's position sure also where in the task it is least so",
}
WORTH = (
    "What more poses are worth. Left: observability indices O1 to O5 (the higher, the better parameters are told apart), "
    "each relative to its value with all poses. Right: expected standard deviation of the predicted tool position over the "
    "task, and at its worst pose; where the curve is flat, more poses gain little. A line is what no other choice of as "
    "many gets below."
)


def write(material: Material) -> list[Block]:
    """Show what the number of poses is worth, where they are and the first of them."""
    poses, worth = material.tables["select/poses.csv"], material.tables["select/observability.csv"]
    expected, worst = (float(worth[name].iloc[-1]) for name in ("expected_sd_mm", "worst_sd_mm"))
    certificate = material.results.document("select/certificate.json", Certificate)
    position = poses[[f"nominal_{axis}_mm" for axis in "xyz"]].to_numpy(dtype=float)
    return [
        Paragraph(
            f"{len(poses)} poses were chosen so that together they {AIMS[certificate.criterion]}. With all of them the "
            f"predicted tool position is expected to be certain to {mm(expected)} mm (1 sd, root mean square over the task), "
            f"and to {mm(worst)} mm where it is least so. {_proof(certificate)}",
            keep=True,
        ),
        Paragraph(_number(material.results.document("select/how_many.json", HowMany))),
        Plot("observability", observability(worth, certificate), WORTH, worth),
        Plot(
            "poses",
            map_of_poses(position),
            "The tool at the chosen poses, in measuring order; the square is the first.",
            poses,
        ),
        *_first(poses, material.study.robot),
    ]


def _proof(certificate: Certificate) -> str:
    """Say how much better other poses could be."""
    what = "the parameters' standard deviations" if certificate.criterion == "parameters" else "that standard deviation"
    gained = certificate.refined_percent
    moved = "" if gained is None else f" Moved between the candidates, these are better by {gained:.2g} %."
    return (
        f"No other choice of {certificate.n_poses} of these {certificate.n_candidates:,} candidates makes {what} smaller by "
        f"more than {certificate.could_gain_percent:.2g} % (equivalence theorem).{moved}"
    )


def _number(how_many: HowMany) -> str:
    """Say what the number of poses is worth."""
    said = f"Ten poses more would lower it by {mm(how_many.next_ten_mm)} mm; the curve below bends at {how_many.knee_poses} poses."
    if how_many.tolerance_mm is None:
        return said
    asked = f"{mm(how_many.tolerance_mm)} mm"
    if how_many.enough_poses is None:
        return f"{said} The {asked} asked for are not met by any number of these candidates."
    return (
        f"{said} The {asked} asked for are met with {how_many.enough_poses} poses; with fewer than {how_many.needed_poses} no "
        "choice of these candidates meets them."
    )


def _first(poses: pd.DataFrame, robot: Robot) -> list[Block]:
    joints = reading_columns(robot)
    columns = ["pose", *joints, *(f"nominal_{axis}_mm" for axis in "xyz")]
    head = ["pose", *reading_labels(robot), *(f"{axis} [mm]" for axis in "xyz")]
    rows = [
        [str(row["pose"]), *(number(row[name], ".2f") for name in joints),
         *(number(row[name], ".0f") for name in columns[-3:])]
        for row in poses.head(SHOWN).to_dict("records")
    ]  # fmt: skip
    return [
        Heading("The first poses to measure"),
        Paragraph("All poses, with the side from which each joint is to arrive, are in select/poses.csv.", keep=True),
        Table(head, rows, "r" * len(head), size=7.6 if len(joints) > 6 else 8.4),
    ]


SECTION = Section(
    70,
    "Planned poses",
    ("select/poses.csv", "select/observability.csv", "select/certificate.json", "select/how_many.json"),
    write,
)
