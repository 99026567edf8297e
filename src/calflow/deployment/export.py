"""Export: a calibrated robot in the formats that other programs read, and what these cannot hold."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np

from calflow.deployment.calibrated_robot import EVERYTHING, Exported, LeftOut, cost, exported
from calflow.deployment.controller_figures import ControllerFigure, controller_figures
from calflow.estimation.calibrated import Identified
from calflow.files.csv import csv_text
from calflow.files.tables import to_frame
from calflow.model import Model
from calflow.robot.formats.chain_json import json_text
from calflow.robot.formats.rigid_chain import RigidChain, rigid_chain, said_of_variables
from calflow.robot.formats.urdf_document import Drive
from calflow.robot.formats.urdf_written import properties_text, said_of_drives, urdf_text
from calflow.robot.robot import Robot

Format = Literal["urdf", "xacro-properties", "dh", "json", "controller"]
ALL_BUT_ZEROS = "lengths and twists, where only joint zeros, base and tool can be typed in"


@dataclass(frozen=True)
class Export:
    """A calibrated robot as a file's text; notes say what it cannot hold, and what that costs."""

    text: str
    notes: tuple[str, ...]
    left_out: tuple[LeftOut, ...]


def export(
    known: Identified, rows: np.ndarray, to: Format, maker: Robot | None = None, drives: Mapping[str, Drive] | None = None
) -> Export:  # fmt: skip
    """Return a calibrated model in a format.

    Args:
        known: the calibrated model.
        rows: packed conditions (n_conditions, n) of the measured rows, over which costs are told.
        to: the format; dh is a robot file with the calibrated figures in the place of the maker's.
        maker: the robot as its file has it, where the calibration placed base, tool or markers elsewhere before it began.
        drives: of a URDF, what moves each joint, by its name in the robot.

    Raises:
        InputError: the robot's frames cannot be stated in it.
    """
    found = exported(known, rows)
    if to == "dh":
        notes, lost = _said(found.without), found.without
        return Export(found.robot.toml_text(), notes, lost)
    if to == "controller":
        lost = (*found.without, _zeros_alone(known, found, rows))
        table = to_frame(controller_figures(maker or found.nominal, found.robot), ControllerFigure)
        return Export(csv_text(table), _said(lost), lost)
    chain = rigid_chain(found.robot)
    notes = (*_said(found.without), *said_of_variables(found.robot))
    if to == "urdf":
        own = [(drives or {}).get(joint.name, Drive()) for joint in found.robot.joints]
        notes = (*notes, *said_of_drives(chain, own))
        return Export(urdf_text(chain, _heading(notes), own), notes, found.without)
    return Export(_written(chain, known, found, notes, to), notes, found.without)


def _written(chain: RigidChain, known: Identified, found: Exported, notes: Sequence[str], to: Format) -> str:
    if to == "json":
        parameters = [
            {"parameter": one.name, "effect": one.effect, "unit": one.unit, "estimate": float(value), "sd": float(sd)}
            for one, value, sd in zip(
                known.model.parameters, known.estimate, np.sqrt(np.diag(known.covariance)), strict=True
            )
        ]
        figures = json.loads(found.robot.canonical())
        left_out = [asdict(one) for one in found.without]
        return json_text(chain, {"figures": figures, "parameters": parameters, "left_out": left_out, "notes": notes})
    return properties_text(chain, _heading(notes))


def _heading(notes: Sequence[str]) -> str:
    return "; ".join(("calibrated figures, SI units", *notes))


def _zeros_alone(known: Identified, found: Exported, rows: np.ndarray) -> LeftOut:
    """What is lost where a controller takes joint zeros, base and tool, and has its own lengths and twists."""
    joints = tuple(
        replace(mine, frame=replace(mine.frame, turn=theirs.frame.turn))
        for mine, theirs in zip(found.nominal.joints, found.robot.joints, strict=True)
    )
    zeros = replace(found.robot, joints=joints, loop=found.nominal.loop)
    return cost(ALL_BUT_ZEROS, (), _points(known.model, found.robot, rows), _points(known.model, zeros, rows))


def _points(model: Model, robot: Robot, rows: np.ndarray) -> np.ndarray:
    return Model(robot, (), model.given).point(np.zeros(0), rows)


def _said(lost: Sequence[LeftOut]) -> tuple[str, ...]:
    """What is left out, in words; all effects together only where they are several."""
    if sum(bool(one.parts) for one in lost) == 1:
        lost = [one for one in lost if one.effect != EVERYTHING]
    return tuple(
        f"left out: {one.effect}{f' ({_between(one.parts)})' if one.parts else ''}: without it the tool is off by "
        f"{one.mean_mm:.3f} mm on average over the measured rows, {one.max_mm:.3f} mm at most"
        for one in lost
    )


def _between(parts: Sequence[str]) -> str:
    """The first and the last of parts, or the only one."""
    return parts[0] if len(parts) == 1 else f"{parts[0]} … {parts[-1]}"
