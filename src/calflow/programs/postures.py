"""Postures: selecting the inverse-kinematics solution intended at each target, by flags, nearby readings or path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.programs.aims import Aim, FilterSettings
from calflow.programs.calibrated_robot import Axes, CalibratedRobot
from calflow.programs.target import NEAR_CHANGE, ArmPosture, Reason, Target

# Starts of the inverse kinematics (the second if the first finds no match), and those for targets without flags.
STARTS, STARTS_ALONE = (16, 120), 40
# Margins at a flag's switching angle, tried in sequence, and whether flags that some robots ignore must agree.
MARGINS = ((0.0, True), (NEAR_CHANGE, True), (NEAR_CHANGE, False))
CLOSE = np.deg2rad(5.0)  # largest motion from the readings that a program states as near


@dataclass(frozen=True)
class _Solutions:
    """The admissible solutions (k, n_joints) at a target; note, reason: why there is none, or more than one."""

    readings: np.ndarray
    note: str = ""
    reason: Reason = "configuration"


def with_intended_readings(aims: list[Aim], corrector: CalibratedRobot, choices: FilterSettings) -> list[Aim]:
    """Return aims with the readings intended at each pose; with a note, and without readings, where they are ambiguous.

    Ambiguities are resolved by the previous target, in the order of the moves of each file.
    """
    place = {aim.file: k for k, aim in reversed([*enumerate(aims)])}
    order = sorted(range(len(aims)), key=lambda k: (place[aims[k].file], _first_line(aims[k])))
    resolved = _resolved([aims[k] for k in order], corrector, choices)
    return [resolved[k] for k in np.argsort(order)]


def _first_line(aim: Aim) -> int:
    """Return the line of the first move in the file to the aim's target, or the target's line."""
    return min((use.line for use in aim.target.uses if use.file == aim.file), default=aim.target.line)


def _resolved(aims: list[Aim], corrector: CalibratedRobot, choices: FilterSettings) -> list[Aim]:
    """Return aims, given in the order of the moves, with the readings intended at each pose."""
    asked = [k for k, aim in enumerate(aims) if aim.readings is None]
    alone = [k for k in asked if (aims[k].target.configuration or aims[k].target.near) is None]
    options = _from_near(aims, [k for k in asked if aims[k].target.near], corrector)
    flagless = set(alone)
    for starts in STARTS:
        unsolved = [k for k in asked if k not in flagless and not (k in options and len(options[k].readings))]
        options |= _solved(aims, unsolved, starts, corrector, choices.any_configuration)
    options |= _solved(aims, alone, STARTS_ALONE, corrector, any_configuration=True)
    resolved, before = _in_sequence(aims, options, corrector, choices)
    # The solution nearest to the previous target may have been missed; adding it changes the choice at later targets.
    while nearer := _nearer(
        aims, {k: readings for k in alone if (readings := before[k]) is not None}, resolved, corrector
    ):
        options |= {k: _unselected(np.vstack([options[k].readings, readings])) for k, readings in nearer.items()}
        resolved, before = _in_sequence(aims, options, corrector, choices)
    return resolved


def _from_near(aims: list[Aim], which: list[int], corrector: CalibratedRobot) -> dict[int, _Solutions]:
    """Return the solutions at targets reached from the readings that the program states as near."""
    near = [(k, readings) for k in which if (readings := _near(aims[k].target, corrector.axes)) is not None]
    reached = _reached(aims, near, corrector)
    return {k: _intended(aims[k], readings[None], (), corrector, False) for k, readings in reached}


def _reached(
    aims: list[Aim], begun: Sequence[tuple[int, np.ndarray]], corrector: CalibratedRobot
) -> list[tuple[int, np.ndarray]]:
    """Return (aim index, solution) for each aim whose inverse kinematics converges from its initial readings."""
    if not begun:
        return []
    reached, of = corrector.continued(np.stack([aims[k].flange for k, _ in begun]), np.stack([r for _, r in begun]))
    return [(begun[i][0], readings) for i, readings in zip(of, reached, strict=True)]


def _solved(
    aims: list[Aim], which: list[int], starts: int, corrector: CalibratedRobot, any_configuration: bool
) -> dict[int, _Solutions]:
    """Return the admissible solutions at some targets, from so many starts each."""
    if not which:
        return {}
    near = [_near(aims[k].target, corrector.axes) for k in which]
    external = np.stack([corrector.axes.external_readings(aims[k].target) for k in which])
    solutions = corrector.solutions(np.stack([aims[k].flange for k in which]), starts, near, external)
    postures_found = iter(corrector.postures(np.concatenate(solutions)))
    postures = [[next(postures_found) for _ in solution] for solution in solutions]
    return {
        k: _intended(aims[k], solution, posture, corrector, any_configuration or not aims[k].target.flagged)
        for k, solution, posture in zip(which, solutions, postures, strict=True)
    }


def _in_sequence(
    aims: list[Aim], options: Mapping[int, _Solutions], corrector: CalibratedRobot, choices: FilterSettings
) -> tuple[list[Aim], list[np.ndarray | None]]:
    """Return aims with readings chosen in sequence, each by the previous target's, and these previous readings."""
    start = last = None if choices.start is None else np.array(choices.start)
    resolved, before = [], []
    for k, aim in enumerate(aims):
        if k and aim.file != aims[k - 1].file:
            last = start
        axes = corrector.axes
        before.append(None if last is None else axes.readings(aim.target, last[axes.arm]))
        resolved.append(_chosen(aim, options[k], before[-1]) if k in options else aim)
        readings = resolved[-1].readings
        last = readings if readings is not None else before[-1]
    return resolved, before


def _nearer(
    aims: list[Aim], before: Mapping[int, np.ndarray], resolved: list[Aim], corrector: CalibratedRobot
) -> dict[int, np.ndarray]:
    """Return the solutions continued from previous readings that are nearer to these than the chosen ones."""
    return {
        k: reading
        for k, reading in _reached(aims, [*before.items()], corrector)
        if (chosen := resolved[k].readings) is None
        or np.abs(reading - before[k]).max() < np.abs(chosen - before[k]).max() - CLOSE
    }


def _near(target: Target, axes: Axes) -> np.ndarray | None:
    """Return the readings (n_joints,) that a program states as near a target, with the target's external axes."""
    return None if target.near is None else axes.readings(target, target.near)


def _intended(
    aim: Aim, solutions: np.ndarray, postures: Sequence[ArmPosture], corrector: CalibratedRobot, any_configuration: bool
) -> _Solutions:
    """Return the solutions that agree with the target's configuration flags, or with the readings stated as near it."""
    none = solutions[:0]
    if not len(solutions):
        return _Solutions(none, "the nominal robot does not reach it within its joint limits", "out of reach")
    near = _near(aim.target, corrector.axes)
    if near is not None:
        close = _nearest(corrector.axes.turned_near(solutions, near), near)
        off = np.abs(close - near).max()
        apart = f"the readings stated near it are {np.rad2deg(off):.3g}° from the nearest solution"
        return _Solutions(close[None]) if off < CLOSE else _Solutions(none, apart)
    configuration = aim.target.configuration
    if configuration is None:
        return _unselected(solutions)
    # Solutions within half a turn precede those a turn further.
    for options in (solutions, corrector.axes.with_turns(solutions)):
        postures = postures if options is solutions else corrector.postures(options)
        for margin, strictly in MARGINS:
            fitting = options[[configuration.agrees(posture, margin, strictly) for posture in postures]]
            if len(fitting):
                several = f"{len(fitting)} solutions have its configuration"
                return _Solutions(fitting, "" if len(fitting) == 1 else several)
    reason = "no solution of the nominal robot has its configuration"
    if any_configuration:
        return _Solutions(solutions, reason)
    return _Solutions(none, f"{reason}; --any-configuration takes the one nearest to the target before")


def _unselected(solutions: np.ndarray) -> _Solutions:
    """Return the solutions at a target without flags."""
    several = f"no configuration selects one of {len(solutions)} solutions"
    return _Solutions(solutions, "" if len(solutions) == 1 else several)


def _chosen(aim: Aim, options: _Solutions, before: np.ndarray | None) -> Aim:
    """Return an aim with its readings, or with a note why they are ambiguous."""
    if not len(options.readings):
        return replace(aim, note=options.note, reason=options.reason)
    if not options.note:
        return replace(aim, readings=options.readings[0])
    if before is None:
        return replace(aim, note=f"{options.note}: state readings near it (--start)")
    note = f"{options.note}: taken as the one nearest to the target before"
    return replace(aim, readings=_nearest(options.readings, before), note=note)


def following(aims: list[Aim], leading: Sequence[Aim], corrector: CalibratedRobot) -> list[Aim]:
    """Return aims that follow a target with the readings reached from the target's."""
    lead = {aim.key: aim.readings for aim in leading}
    before = [(k, readings) for k, aim in enumerate(aims) if (readings := lead[aim.key]) is not None]
    by_number = dict(_reached(aims, before, corrector))
    missed = "the nominal robot does not reach it from the target that it is computed from"
    return [
        replace(aims[k], readings=by_number[k])
        if k in by_number
        else replace(aims[k], note=missed, reason="out of reach")
        for k, _ in before
    ]


def _nearest(solutions: np.ndarray, readings: np.ndarray) -> np.ndarray:
    return np.asarray(solutions[np.abs(solutions - readings).max(axis=1).argmin()])
