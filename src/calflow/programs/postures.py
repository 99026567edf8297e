"""Postures: which of the joint positions that lead to a target are meant there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.programs.aims import Aim, FilterSettings
from calflow.programs.calibrated_robot import Axes, CalibratedRobot
from calflow.programs.target import NEAR_CHANGE, ArmPosture, Reason, Target

# Joint positions from which a pose is approached, and more where these do not tell which is meant; and where no flags tell it.
STARTS, STARTS_ALONE = (16, 120), 40
# How near to where a flag changes a joint may have either, and whether flags must agree that some robots do not use.
MARGINS = ((0.0, True), (NEAR_CHANGE, True), (NEAR_CHANGE, False))
CLOSE = np.deg2rad(5.0)  # readings within this of those that a program calls near are the ones meant


@dataclass(frozen=True)
class _Ways:
    """The readings (k, n_joints) that may be meant at a target, and what is to be said: why none, or how one is chosen of them."""

    readings: np.ndarray
    note: str = ""
    reason: Reason = "configuration"


def with_meant_readings(aims: list[Aim], corrector: CalibratedRobot, choices: FilterSettings) -> list[Aim]:
    """Return the readings that are meant at each pose; without them, and with a note, where that is not told.

    What is told by the target before goes by the order in which moves of the file come to them.
    """
    place = {aim.file: k for k, aim in reversed([*enumerate(aims)])}
    came = sorted(range(len(aims)), key=lambda k: (place[aims[k].file], _first_line(aims[k])))
    resolved = _told_in_turn([aims[k] for k in came], corrector, choices)
    return [resolved[k] for k in np.argsort(came)]


def _first_line(aim: Aim) -> int:
    """The line of the first move of its file that goes to a target, or its own."""
    return min((use.line for use in aim.target.uses if use.file == aim.file), default=aim.target.line)


def _told_in_turn(aims: list[Aim], corrector: CalibratedRobot, choices: FilterSettings) -> list[Aim]:
    """The readings that are meant at each pose, in the order of the moves."""
    asked = [k for k, aim in enumerate(aims) if aim.readings is None]
    alone = [k for k in asked if (aims[k].target.configuration or aims[k].target.near) is None]
    ways = _from_near(aims, [k for k in asked if aims[k].target.near], corrector)
    flagless = set(alone)
    for starts in STARTS:
        lacking = [k for k in asked if k not in flagless and not (k in ways and len(ways[k].readings))]
        ways |= _ways(aims, lacking, starts, corrector, choices.loosely)
    ways |= _ways(aims, alone, STARTS_ALONE, corrector, loosely=True)
    resolved, before = _in_turn(aims, ways, corrector, choices)
    # The way on from the target before need not be among those that were found; with it, those after go on otherwise.
    while nearer := _nearer(
        aims, {k: readings for k in alone if (readings := before[k]) is not None}, resolved, corrector
    ):
        ways |= {
            k: replace(ways[k], readings=np.vstack([ways[k].readings, readings])) for k, readings in nearer.items()
        }
        resolved, before = _in_turn(aims, ways, corrector, choices)
    return resolved


def _from_near(aims: list[Aim], which: list[int], corrector: CalibratedRobot) -> dict[int, _Ways]:
    """The ways to targets from the readings that the program says are near them."""
    near = [(k, readings) for k in which if (readings := _near(aims[k].target, corrector.axes)) is not None]
    reached = _reached(aims, near, corrector)
    return {k: _meant(aims[k], readings[None], (), corrector, False) for k, readings in reached}


def _reached(
    aims: list[Aim], begun: Sequence[tuple[int, np.ndarray]], corrector: CalibratedRobot
) -> list[tuple[int, np.ndarray]]:
    """The targets, by number, that are reached from readings, and the readings there."""
    if not begun:
        return []
    reached, of = corrector.continued(np.stack([aims[k].flange for k, _ in begun]), np.stack([r for _, r in begun]))
    return [(begun[i][0], readings) for i, readings in zip(of, reached, strict=True)]


def _ways(
    aims: list[Aim], which: list[int], starts: int, corrector: CalibratedRobot, loosely: bool
) -> dict[int, _Ways]:
    """The ways to some targets, each approached from so many joint positions."""
    if not which:
        return {}
    near = [_near(aims[k].target, corrector.axes) for k in which]
    external = np.stack([corrector.axes.at(aims[k].target) for k in which])
    solutions = corrector.solutions(np.stack([aims[k].flange for k in which]), starts, near, external)
    stands = iter(corrector.postures(np.concatenate(solutions)))
    postures = [[next(stands) for _ in solution] for solution in solutions]
    return {
        k: _meant(aims[k], solution, stand, corrector, loosely or not aims[k].target.flagged)
        for k, solution, stand in zip(which, solutions, postures, strict=True)
    }


def _in_turn(
    aims: list[Aim], ways: Mapping[int, _Ways], corrector: CalibratedRobot, choices: FilterSettings
) -> tuple[list[Aim], list[np.ndarray | None]]:
    """The readings meant, one target after the other, since what is not told follows from the target before; and those before."""
    start = last = None if choices.start is None else np.array(choices.start)
    resolved, before = [], []
    for k, aim in enumerate(aims):
        if k and aim.file != aims[k - 1].file:
            last = start
        axes = corrector.axes
        before.append(None if last is None else axes.readings(aim.target, last[list(axes.arm)]))
        resolved.append(_chosen(aim, ways[k], before[-1]) if k in ways else aim)
        readings = resolved[-1].readings
        last = readings if readings is not None else before[-1]
    return resolved, before


def _nearer(
    aims: list[Aim], before: Mapping[int, np.ndarray], resolved: list[Aim], corrector: CalibratedRobot
) -> dict[int, np.ndarray]:
    """The readings at targets that are reached from those before, where these are nearer to them than what was chosen."""
    return {
        k: reading
        for k, reading in _reached(aims, [*before.items()], corrector)
        if np.abs(reading - before[k]).max() < _off(resolved[k], before[k]) - CLOSE
    }


def _off(aim: Aim, before: np.ndarray) -> float:
    """How far the joint that moves most goes from readings to a target's; without end where these are not told."""
    return np.inf if aim.readings is None else float(np.abs(aim.readings - before).max())


def _near(target: Target, axes: Axes) -> np.ndarray | None:
    """The readings that a program says are close to a target, the external axes as at the target."""
    return None if target.near is None else axes.readings(target, target.near)


def _meant(
    aim: Aim, solutions: np.ndarray, postures: Sequence[ArmPosture], corrector: CalibratedRobot, loosely: bool
) -> _Ways:
    """The readings that the target's flags, or the readings near it, tell among all that lead there."""
    none = solutions[:0]
    if not len(solutions):
        return _Ways(none, "the nominal robot does not get there within its joint limits", "out of reach")
    near = _near(aim.target, corrector.axes)
    if near is not None:
        close = _nearest(corrector.axes.turned_to(solutions, near), near)
        off = np.abs(close - near).max()
        apart = f"the readings said to be near it are {np.rad2deg(off):.3g}° away from the nearest that lead there"
        return _Ways(close[None]) if off < CLOSE else _Ways(none, apart)
    configuration = aim.target.configuration
    if configuration is None:
        several = f"no configuration tells which of {len(solutions)} joint positions is meant"
        return _Ways(solutions, "" if len(solutions) == 1 else several)
    for ways in (solutions, corrector.axes.turned(solutions)):  # flags that hold within half a turn mean that one
        postures = postures if ways is solutions else corrector.postures(ways)
        for margin, strictly in MARGINS:
            fitting = ways[[configuration.agrees(posture, margin, strictly) for posture in postures]]
            if len(fitting):
                several = f"{len(fitting)} joint positions have its configuration"
                return _Ways(fitting, "" if len(fitting) == 1 else several)
    reason = "no joint readings of the nominal robot that lead there have its configuration"
    if loosely:
        return _Ways(solutions, reason)
    return _Ways(none, f"{reason}; --any-configuration takes the nearest to the target before")


def _chosen(aim: Aim, ways: _Ways, before: np.ndarray | None) -> Aim:
    """A target with the readings that are meant at it, or why these are not told."""
    if not len(ways.readings):
        return replace(aim, note=ways.note, reason=ways.reason)
    if not ways.note:
        return replace(aim, readings=ways.readings[0])
    if before is None:
        return replace(aim, note=f"{ways.note}: state readings near it (--start)")
    note = f"{ways.note}: taken as the one nearest to the target before"
    return replace(aim, readings=_nearest(ways.readings, before), note=note)


def following(aims: list[Aim], leading: Sequence[Aim], corrector: CalibratedRobot) -> list[Aim]:
    """Return the readings at places that follow a target, which are those that are reached from the target's."""
    lead = {aim.key: aim.readings for aim in leading}
    before = [(k, readings) for k, aim in enumerate(aims) if (readings := lead[aim.key]) is not None]
    by_number = dict(_reached(aims, before, corrector))
    missed = "the nominal robot does not get there from the target that it is computed from"
    return [
        replace(aims[k], readings=by_number[k])
        if k in by_number
        else replace(aims[k], note=missed, reason="out of reach")
        for k, _ in before
    ]


def _nearest(solutions: np.ndarray, readings: np.ndarray) -> np.ndarray:
    return np.asarray(solutions[np.abs(solutions - readings).max(axis=1).argmin()])
