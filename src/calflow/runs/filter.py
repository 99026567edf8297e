"""Filtering from a run folder: a robot program whose targets are corrected by what the run found."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calflow.deployment.prediction import Missing
from calflow.estimation.needed_conditions import NeededCondition
from calflow.files.problems import InputError, Problem, nearest, refuse
from calflow.files.units import split_unit, to_si
from calflow.measurements.measurements import Measurements
from calflow.programs.calibrated_robot import CalibratedRobot
from calflow.programs.filtering import Choices, Filtered, filtered, stated_frame, stated_frames
from calflow.programs.formats import read_program
from calflow.robot.robot import Robot
from calflow.runs.calibrated_run import CalibratedRun

CONDITIONS = ("time", "temperature")  # one value holds for a whole program


def filter_program(
    study_or_run: str | Path, program: str | Path, *, payload: str | None = None, tools: Sequence[str] = (),
    frames: Sequence[str] = (), base: str | None = None, flange: str | None = None, start: Sequence[float] | None = None,
    any_configuration: bool = False, in_order: bool = False, conditions: Mapping[str, float] | None = None,
    missing: Missing = "refuse",
) -> Filtered:  # fmt: skip
    """Return a robot program that lands where it says, and what became of each of its targets (see `FilteredTarget`).

    The run is named by its folder, or by its study. The program's file is left as it is: `source` holds the bytes to write.

    Args:
        study_or_run: a run folder, or a study that was run.
        program: a file of RAPID, KRL, FANUC LS or URScript.
        payload: what is carried, by the robot file's name.
        tools: `NAME=numbers` of a tool that the program names and does not state, in its maker's way; `NAME` alone: the tool of
            targets of which the program does not say it.
        frames: the same of work objects, bases and user frames.
        base: numbers, in the maker's way, of where the controller's base or world is in the robot file's base.
        flange: the same of where the controller's flange is in the robot file's.
        start: readings [deg, or mm] near the first target, as the controller shows them, where nothing else tells its posture.
        any_configuration: where the flags of a target are those of no way to it, take the way nearest to the target before.
        in_order: the targets are gone to one after the other, so that each joint's side of approach follows from them.
        conditions: `temperature_degC`, `time_s` and the like, where the model needs them.
        missing: whether a program is refused that lacks a condition which the model needs, or corrected without it.

    Raises:
        InputError: the run has not identified yet, the program cannot be read, or something of it is not known.
    """
    run, path = CalibratedRun.of(study_or_run), Path(program)
    read = read_program(path)
    known_tools, tool = stated_frames(read.maker, tools, "--tool")
    known_frames, frame = stated_frames(read.maker, frames, "--frame")
    placed = {
        name: stated_frame(read.maker, text, f"--{name}") for name, text in (("base", base), ("flange", flange)) if text
    }
    choices = Choices(
        known_tools, known_frames, tool, frame, start=_start(run.robot, start), loosely=any_configuration, **placed
    )
    stated = _conditions(conditions or {})
    given = (*stated, *(("approach", "travel") if in_order else ()))
    if missing == "refuse":
        _check_conditions(run.needed, given)
    known = run.known(given)
    robot = known.model.robot
    if payload is not None and payload not in robot.payloads:
        there = f"expected one of {', '.join(robot.payloads)}" if robot.payloads else "the robot file has none"
        raise refuse(f"unknown payload: {there}{nearest(payload, robot.payloads)}", key=f"--payload {payload}")
    origin = {"time_origin": run.time_origin} if "time" in stated else {}
    carried = {} if payload is None else {"payload": payload}

    def rows(readings: np.ndarray) -> Measurements:
        return Measurements.from_arrays(
            robot, readings, None, pose=np.arange(len(readings)), **carried, **origin, **stated  # type: ignore[arg-type]
        )  # fmt: skip

    corrector = CalibratedRobot(known, run.needed, rows, in_order, missing)
    try:
        done = filtered(read, corrector, choices)
    except InputError as error:
        problems = (replace(one, file=path) if one.line else one for one in error.problems)
        raise InputError(problems) from None
    return replace(done, notes=(*run.warning, *_empty_handed(robot, payload), *run.notes, *done.notes))


def _empty_handed(robot: Robot, payload: str | None) -> tuple[str, ...]:
    """Say that nothing is carried where a load would be known."""
    if payload is not None or not robot.payloads:
        return ()
    return (f"no --payload: the robot counts as carrying none of {', '.join(robot.payloads)}",)


def _check_conditions(needed: Iterable[NeededCondition], given: Collection[str]) -> None:
    """Check that all is said on which it depends where the robot will be."""
    told = {"approach": "--in-order has it from the order of the targets",
            "travel": "--in-order has it from the order of the targets", "time": "--condition time_s=… says it",
            "temperature": "--condition temperature_degC=… says it"}  # fmt: skip
    problems = [
        Problem(
            f"where the robot will be depends on {one.condition} ({', '.join(one.effects)}): "
            f"{told.get(one.condition, 'a program cannot say it')}; --without-conditions goes on without it"
        )
        for one in needed if one.condition not in given
    ]  # fmt: skip
    if problems:
        raise InputError(problems)


def _start(robot: Robot, start: Sequence[float] | None) -> tuple[float, ...] | None:
    """Readings in SI; external axes, which a target gives, at 0."""
    if start is None:
        return None
    if len(start) != len(robot.arm):
        raise refuse(f"expected {len(robot.arm)} readings of the arm, found {len(start)}", key="--start")
    if not np.isfinite(start).all():
        raise refuse(f"expected finite readings, found {', '.join(f'{one:g}' for one in start)}", key="--start")
    found = np.zeros(robot.n_joints)
    found[robot.arm] = [value / robot.joints[i].shown[1] for value, i in zip(start, robot.arm, strict=True)]
    return tuple(map(float, found))


def _conditions(stated: Mapping[str, float]) -> dict[str, float]:
    """Conditions in SI by name, from names with units."""
    found = {}
    for name, value in stated.items():
        split = split_unit(name)
        if split is None or split[0] not in CONDITIONS or split_unit(name, split[0]) is None:
            known = ("temperature_degC", "temperature_K", "time_s", "time_min", "time_h")
            raise refuse(f"expected one of {', '.join(known)}{nearest(name, known)}", key=f"--condition {name}")
        if not np.isfinite(value):
            raise refuse(f"expected a finite number, found {value:g}", key=f"--condition {name}")
        factor, offset = to_si(split[1])
        found[split[0]] = factor * value + offset
    return found
