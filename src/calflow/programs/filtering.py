"""Filtering: correct the targets of a robot program for the calibrated robot, with a report on each target.

Tools and frames that the program does not define are given in the maker's notation; only the targets' numbers change.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from calflow.deployment.conventions import NOTATIONS, UNIT_LENGTH
from calflow.deployment.prediction import Missing
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.needed_conditions import check_payload_stated, check_stated
from calflow.files.problems import InputError, nearest, refuse, unknown_name
from calflow.files.toml import checked_arguments
from calflow.files.units import SUFFIXES, in_si, split_unit
from calflow.measurements.measurements import Measurements
from calflow.programs.aims import FilterSettings, all_targets
from calflow.programs.backup import is_backup, read_files
from calflow.programs.calibrated_robot import CalibratedRobot
from calflow.programs.correction import Filtered, filtered, skipped_row
from calflow.programs.formats import parsed, read_project
from calflow.programs.target import Maker, Program
from calflow.robot.frames import PARALLEL
from calflow.robot.mechanism import nominal_posture
from calflow.robot.robot import Robot

CONDITIONS = ("time", "temperature")  # one value holds for a whole program
GO_ON = (
    "--in-order derives approach and travel from the order of the moves, --condition states time_s=… and temperature_degC=…; "
    "others cannot be stated for a program; --without-conditions goes on without"
)


def stated_frames(maker: Maker, options: Iterable[str], option: str) -> tuple[dict[str, np.ndarray], str | None]:
    """Return the frames of `NAME=numbers` by name, and the default: a name given alone, for moves that state none.

    Args:
        maker: whose notation the numbers follow.
        options: the user's input.
        option: the option's name, for messages.

    Raises:
        InputError: an option cannot be parsed.
    """
    frames: dict[str, np.ndarray] = {}
    usual = None
    for text in options:
        name, equals, numbers = text.partition("=")
        name = name.strip().lower() if maker == "rapid" else name.strip()
        if not name:
            raise refuse(f"expected NAME or NAME=numbers, found '{text}'", key=option)
        if equals:
            frames[name] = stated_frame(maker, numbers, f"{option} {name}")
        else:
            usual = name
    return frames, usual


def stated_frame(maker: Maker, text: str, key: str) -> np.ndarray:
    """Return the pose (4, 4) that numbers in a maker's notation state; key: the option, for messages.

    Raises:
        InputError: the text is not such a pose.
    """
    notation = NOTATIONS[maker]
    words = [word for word in re.split(r"[\s,;\[\]{}()]+", text) if word]
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([np.nan])
    if len(values) != len(notation.scales) or not np.isfinite(values).all():
        raise refuse(f"expected {notation.words}, found '{text.strip()}'", key=key)
    if notation.turn == "quaternion" and abs(np.linalg.norm(values[3:]) - 1) > UNIT_LENGTH:
        raise refuse(f"expected a quaternion of length 1, found one of {np.linalg.norm(values[3:]):.4g}", key=key)
    return notation.pose(values)


@checked_arguments
def filter_program(
    calibrated: CalibratedModel, program: str | Path, *, payload: str | None = None, tools: Sequence[str] = (),
    frames: Sequence[str] = (), base: str | None = None, flange: str | None = None, start: Sequence[float] | None = None,
    any_configuration: bool = False, in_order: bool = False, conditions: Mapping[str, float] | None = None,
    missing: Missing = "refuse",
) -> Filtered:  # fmt: skip
    """Return a robot program, or a whole project, with corrected targets, and a row for each (see `FilteredTarget`).

    No file is changed: `files` holds the bytes to write, `source` those of a single program.

    Args:
        calibrated: the calibrated model.
        program: a RAPID, KRL, FANUC LS or URScript file, or a folder or ZIP archive of such files of one controller.
        payload: name of the payload in the robot file; "": nothing is carried. None only where the model depends on none.
        tools: `NAME=numbers` defines a tool that the program does not define, in the maker's notation; `NAME` alone is
            the tool of moves that state none.
        frames: the same for work objects, bases and user frames.
        base: pose of the controller's base or world in the robot file's base, in the maker's notation.
        flange: pose of the controller's flange in the robot file's flange, likewise.
        start: the controller's joint readings [deg or mm] near the first target, for programs without configuration
            flags.
        any_configuration: if no solution has a target's flags, take the one nearest to the previous target.
        in_order: whether the robot moves in the order of each file, so that each joint's side of approach follows from it.
        conditions: `temperature_degC`, `time_s` and the like, where the model needs them.
        missing: whether a program without a condition that the model needs is refused, or corrected without it.

    Raises:
        InputError: the program cannot be read, or a tool, frame, payload or condition is unknown.
    """
    path, robot = Path(program), calibrated.model.robot
    files = read_files(path)
    programs, unread = read_project(files, path) if is_backup(path) else ([parsed(files[path.name], path)], [])
    maker = programs[0].maker
    known_tools, tool = stated_frames(maker, tools, "--tool")
    known_frames, frame = stated_frames(maker, frames, "--frame")
    placed = {
        name: stated_frame(maker, text, f"--{name}") for name, text in (("base", base), ("flange", flange)) if text
    }
    choices = FilterSettings(
        known_tools,
        known_frames,
        tool,
        frame,
        start=_start(robot, start),
        any_configuration=any_configuration,
        **placed,
    )
    stated: dict[str, Any] = _conditions(conditions or {})
    given = (*stated, *(("approach", "travel") if in_order else ()))
    if missing == "refuse":
        check_stated(calibrated.needed, given, GO_ON)
    check_payload_stated(calibrated.model, calibrated.payloads, payload is not None)
    if unknown := unknown_name("payload", payload or "", robot.payloads):
        raise refuse(unknown, key="--payload")
    if "time" in stated:
        stated["time_origin"] = calibrated.time_origin
    if payload is not None:
        stated["payload"] = payload
    corrector = CalibratedRobot(calibrated.later(given), partial(_rows, robot, stated), in_order, missing)
    try:
        done = filtered(programs, corrector, choices)
    except InputError as error:
        root = path if is_backup(path) else path.parent
        raise InputError(
            replace(problem, file=problem.file and root / problem.file) for problem in error.problems
        ) from None
    notes = (*_coupled(programs, robot), *done.notes)
    rows = (*(skipped_row(file, entry) for file, entry in unread), *done.rows)
    return replace(done, files={**files, **done.files}, rows=rows, notes=notes)


def _rows(robot: Robot, stated: Mapping[str, Any], readings: np.ndarray) -> Measurements:
    """Return rows to be predicted at readings (n, n_joints), each a pose, under the same conditions."""
    return Measurements.from_arrays(robot, readings, None, pose=np.arange(len(readings)), **stated)


def _coupled(programs: Sequence[Program], robot: Robot) -> Iterator[str]:
    """Note the coupling that FANUC's joint targets have, where the robot file has none: joint 2 leaves joint 3 level."""
    joint_targets = any(target.turn is None for _, target in all_targets(programs))
    if programs[0].maker != "fanuc" or not joint_targets or robot.couplings or len(robot.arm) < 3:
        return
    axes, (_, source, joint, *_) = nominal_posture(robot).joints, robot.arm
    along = float(ca.DM(ca.dot(axes[source][:3, 2], axes[joint][:3, 2])))
    if abs(along) < np.cos(PARALLEL):
        return
    factor = -robot.joints[source].sign * round(along)
    yield (
        "joint targets are taken for readings of the robot file: FANUC shows joint 3 against the horizontal, so joint 2 changes "
        f"it, but the robot file has no [[couplings]] with joint = {joint + 1}, source = {source + 1}, factor = {factor}; add it "
        "unless its figures allow for that"
    )


def _start(robot: Robot, start: Sequence[float] | None) -> tuple[float, ...] | None:
    """Return readings (n_joints,) in SI, with zero for external axes, whose values targets state."""
    if start is None:
        return None
    if len(start) != len(robot.arm):
        raise refuse(f"expected {len(robot.arm)} readings of the arm, found {len(start)}", key="--start")
    if not np.isfinite(start).all():
        raise refuse(f"expected finite readings, found {', '.join(f'{reading:g}' for reading in start)}", key="--start")
    readings = np.zeros(robot.n_joints)
    readings[robot.arm] = [value / robot.joints[i].shown[1] for value, i in zip(start, robot.arm, strict=True)]
    return tuple(map(float, readings))


def _conditions(stated: Mapping[str, float]) -> dict[str, float]:
    """Return conditions in SI by name, from names with units."""
    conditions = {}
    for name, value in stated.items():
        condition, unit = split_unit(name)
        if condition not in CONDITIONS or unit not in SUFFIXES[condition]:
            names = ("temperature_degC", "temperature_K", "time_s", "time_min", "time_h")
            raise refuse(f"expected one of {', '.join(names)}{nearest(name, names)}", key=f"--condition {name}")
        if not np.isfinite(value):
            raise refuse(f"expected a finite number, found {value:g}", key=f"--condition {name}")
        conditions[condition] = in_si(unit, value)
    return conditions
