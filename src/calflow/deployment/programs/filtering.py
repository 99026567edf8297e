"""Filtering: a program's targets corrected, with what moved how far, what could not be reached, and what was left alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from calflow.deployment.programs.axes import Axes
from calflow.deployment.programs.configuration import NEAR
from calflow.deployment.programs.correction import Corrector
from calflow.deployment.programs.orientation import angle_between, inverse, pose_matrix
from calflow.deployment.programs.rewriting import Edit, to_flags, to_pose, to_readings, with_edits
from calflow.deployment.programs.target import Left, Program, Target
from calflow.files.problems import InputError, Problem
from calflow.files.tables import column

# Joint positions from which a pose is approached: more where the first do not tell which is meant; and where no flags tell it.
STARTS, STARTS_ALONE = (16, 120), 40
CLOSE = np.deg2rad(5.0)  # readings within this of those that a program calls near are the ones meant
UNIT_LENGTH = 1e-3  # by how much a quaternion's length may differ from 1, as makers allow
Outcome = Literal["moved", "unchanged", "not reached", "left alone"]


@dataclass(frozen=True, kw_only=True)
class FilteredTarget:
    """A target of a program, or something else of it that matters to its targets, and what became of it."""

    name: str = column("the target's name, or what the program does with it")
    line: int = column("its line")
    kind: Literal["pose", "joints", ""] = column("how it is stated; empty: it is no target that can be rewritten")
    outcome: Outcome = column("whether it was moved, needed no move, cannot be reached, or was left alone")
    moved_mm: float = column(
        "by how much the tool is sent elsewhere, as the controller counts; of joints the flange", "mm"
    )
    turned_mrad: float = column("by how much it is turned", "mrad")
    largest_deg: float = column("the largest change of a joint", "deg")
    remaining_mm: float = column("how far from its place the tool lands, by the calibrated model", "mm")
    configuration: str = column("flags of the configuration that change, old > new")
    note: str = column("why, or what to know of it")


@dataclass(frozen=True)
class Filtered:
    """A program with its targets corrected, what became of each, and what else is to be known."""

    source: bytes
    rows: tuple[FilteredTarget, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Choices:
    """What a user says that a program does not: tools and frames by name, those of targets of which it names none, and more.

    base is where the controller's base is in the robot file's, flange where its flange is in the robot file's (4, 4). start are
    readings [rad, or m] near the first target, where the program has no flags that tell its posture. loosely: where the flags
    of a target are those of no way to it, the way nearest to the target before is taken.
    """

    tools: Mapping[str, np.ndarray]
    frames: Mapping[str, np.ndarray]
    tool: str | None = None
    frame: str | None = None
    base: np.ndarray = field(default_factory=lambda: np.eye(4))
    flange: np.ndarray = field(default_factory=lambda: np.eye(4))
    start: tuple[float, ...] | None = None
    loosely: bool = False


@dataclass(frozen=True)
class _Aim:
    """A target with the tool and the frame (4, 4) that it is of, and the readings meant."""

    target: Target
    tool: np.ndarray
    frame: np.ndarray
    readings: np.ndarray | None = None
    note: str = ""


def filtered(program: Program, corrector: Corrector, choices: Choices) -> Filtered:
    """Return a program that lands where it says.

    A pose becomes the one whose nominal joint readings are those that the correction found; joint readings become the corrected
    ones. What is not reached, or whose posture is not told, stays as it is.

    Raises:
        InputError: a tool or a frame is known to neither the program nor the user, or the numbers of joints differ.
    """
    _check_joints(program, corrector.axes)
    aims, doubtful = _aims(program, choices, corrector.axes)
    aims = _with_readings(aims, corrector, choices)
    found = [aim for aim in aims if aim.readings is not None]
    edits: list[Edit] = []
    rows = [_untouched(one) for one in (*program.left, *doubtful)]
    rows += [
        _row(aim.target, "not reached" if aim.note.startswith("the nominal") else "left alone", note=aim.note)
        for aim in aims if aim.readings is None
    ]  # fmt: skip
    notes = corrector.axes.unknown_words(program)
    if found:
        own, corrected_rows, said = _corrected(found, corrector)
        edits += own
        rows += corrected_rows
        notes += said
    return Filtered(with_edits(program.source, edits), tuple(sorted(rows, key=lambda row: row.line)), notes)


def _check_joints(program: Program, axes: Axes) -> None:
    problems = [
        Problem(f"{target.name} has {len(target.numbers)} joints, the robot's arm {len(axes.arm)}", line=target.line)
        for target in program.targets if target.turn is None and len(target.numbers) != len(axes.arm)
    ]  # fmt: skip
    if problems:
        raise InputError(problems)


def _aims(program: Program, choices: Choices, axes: Axes) -> tuple[list[_Aim], list[Left]]:
    """Targets with their tools and frames, and those of which more than one is named, or that do not say where all axes are."""
    tools, frames = {**program.tools, **choices.tools}, {**program.frames, **choices.frames}
    problems: dict[str, Problem] = {}
    aims: list[_Aim] = []
    doubtful = []
    for target in program.targets:
        if lacking := axes.lacking(target):
            doubtful.append(Left(target.name, target.line, lacking))
            continue
        if target.turn is None:
            aims.append(_Aim(target, np.eye(4), np.eye(4), axes.readings(target, target.values)))
            continue
        if target.turn == "quaternion" and abs(np.linalg.norm(target.values[3:]) - 1) > UNIT_LENGTH:
            length = np.linalg.norm(target.values[3:])
            doubtful.append(
                Left(target.name, target.line, f"has a quaternion of length {length:.4g}, where 1 is meant")
            )
            continue
        tool = _named("tool", target.tools, choices.tool, tools, target, problems)
        frame = _named("frame", target.frames, choices.frame, frames, target, problems)
        if isinstance(tool, str) or isinstance(frame, str):
            doubtful.append(Left(target.name, target.line, tool if isinstance(tool, str) else str(frame)))
        elif tool is not None and frame is not None:
            aims.append(_Aim(target, choices.flange @ tool, choices.base @ frame))
    if problems:
        raise InputError(problems.values())
    return aims, doubtful


def _named(
    what: str,
    names: Sequence[str],
    usual: str | None,
    known: Mapping[str, np.ndarray],
    target: Target,
    problems: dict[str, Problem],
) -> np.ndarray | str | None:
    """The tool or frame of a target; what is wrong where it has several; None, and a problem, where it is not known."""
    wanted = [name for name in names if name and name != "F"] or ([usual] if usual is not None else [])
    if not wanted:
        message = f"{target.name}: the program does not say with which {what} it goes there: name it (--{what} NAME)"
        problems.setdefault(f"{what} of none", Problem(message, line=target.line))
        return None
    lacking = [name for name in wanted if name not in known]
    for name in lacking:
        message = f"the numbers of {what} '{name}' do not stand in this file: state them (--{what} '{name}=…')"
        problems.setdefault(f"{what} {name}", Problem(message, line=target.line))
    if lacking:
        return None
    first = known[wanted[0]]
    if any(not np.allclose(known[name], first, atol=1e-9) for name in wanted[1:]):
        return f"is used with several {what}s ({', '.join(wanted)}): each would need a correction of its own"
    return first


def _with_readings(aims: list[_Aim], corrector: Corrector, choices: Choices) -> list[_Aim]:
    """The readings that are meant at each pose; without them, and with a note, where that is not told."""
    flagged = [k for k, aim in enumerate(aims) if aim.readings is None and _is_told(aim.target)]
    found: dict[int, np.ndarray] = {}
    told = aims
    for starts in STARTS:
        lacking = [k for k in flagged if told[k].readings is None]
        if lacking:
            near = [_near(aims[k].target, corrector.axes) for k in lacking]
            external = np.stack([corrector.axes.at(aims[k].target) for k in lacking])
            ways = corrector.solutions(np.stack([_flange(aims[k]) for k in lacking]), starts, near, external)
            found |= dict(zip(lacking, ways, strict=True))
            told = _in_turn(aims, found, corrector, choices, alone=False)
    return _in_turn(aims, found, corrector, choices, alone=True)


def _in_turn(
    aims: list[_Aim], found: Mapping[int, np.ndarray], corrector: Corrector, choices: Choices, alone: bool
) -> list[_Aim]:
    """The readings meant, one target after the other, since what is not told follows from the target before.

    alone: those that nothing tells are looked for as well, from the readings of the target before them.
    """
    before = None if choices.start is None else np.array(choices.start)
    told = list(aims)
    for k, aim in enumerate(aims):
        ways = found.get(k)
        before = None if before is None else corrector.axes.moved_to(before, aim.target)
        if ways is None and aim.readings is None and alone:
            external = corrector.axes.at(aim.target)[None]
            ways = corrector.solutions(_flange(aim)[None], STARTS_ALONE, [before], external)[0]
        if ways is not None:
            told[k] = _chosen(aim, ways, before, corrector, choices.loosely)
        readings = told[k].readings
        before = readings if readings is not None else before
    return told


def _is_told(target: Target) -> bool:
    """Whether a program says which of several joint positions a target means."""
    return target.configuration is not None or target.near is not None


def _near(target: Target, axes: Axes) -> np.ndarray | None:
    """The readings that a program says are close to a target, the external axes as at the target."""
    return None if target.near is None else axes.readings(target, target.near)


def _flange(aim: _Aim) -> np.ndarray:
    """Where the controller has the flange at a target, in the robot's base."""
    return aim.frame @ pose_matrix(aim.target.values, aim.target.turn or "quaternion") @ inverse(aim.tool)


def _chosen(aim: _Aim, solutions: np.ndarray, before: np.ndarray | None, corrector: Corrector, loosely: bool) -> _Aim:
    """The readings that the target's flags, or the readings near it, tell among all that lead there."""
    if not len(solutions):
        return replace(aim, note="the nominal robot does not get there within its joint limits")
    near = _near(aim.target, corrector.axes)
    if near is not None:
        close = _nearest(corrector.axes.turned_to(solutions, near), near)
        if np.abs(close - near).max() < CLOSE:
            return replace(aim, readings=close)
        apart = f"{np.rad2deg(np.abs(close - near).max()):.3g}°"
        return replace(aim, note=f"the readings said to be near it are {apart} away from the nearest that lead there")
    fitting, said = _fitting(aim, solutions, corrector, loosely)
    if len(fitting) == 1 and not said:
        return replace(aim, readings=fitting[0])
    if not len(fitting):
        return replace(aim, note=said)
    if before is None:
        return replace(aim, note=f"{said}: state readings near it (--start)")
    note = f"{said}: taken as the one nearest to the target before"
    return replace(aim, readings=_nearest(fitting, before), note=note)


def _fitting(aim: _Aim, solutions: np.ndarray, corrector: Corrector, loosely: bool) -> tuple[np.ndarray, str]:
    """The readings that have a target's flags, and what is to be said of them where these do not tell which is meant."""
    configuration = aim.target.configuration
    if configuration is None:
        only = len(solutions) == 1
        return solutions, "" if only else f"no configuration tells which of {len(solutions)} joint positions is meant"
    for ways in (solutions, corrector.axes.turned(solutions)):  # flags that hold within half a turn mean that one
        postures = [corrector.posture(one) for one in ways]
        for margin, strictly in ((0.0, True), (NEAR, True), (NEAR, False)):
            fitting = ways[[configuration.agrees(one, margin, strictly) for one in postures]]
            if len(fitting):
                return fitting, "" if len(fitting) == 1 else f"{len(fitting)} joint positions have its configuration"
    none = "no joint readings of the nominal robot that lead there have its configuration"
    return (solutions, none) if loosely else (fitting, none)


def _corrected(aims: Sequence[_Aim], corrector: Corrector) -> tuple[list[Edit], list[FilteredTarget], tuple[str, ...]]:
    """The edits and rows of targets whose readings are known, and what is to be known of the correction."""
    readings = np.stack([aim.readings for aim in aims if aim.readings is not None])
    correction = corrector.corrected(readings, [aim.target.name for aim in aims])
    before, after = corrector.flange(readings), corrector.flange(correction.readings)
    edits: list[Edit] = []
    rows = []
    for k, aim in enumerate(aims):
        remaining = 1e3 * float(correction.remaining[k])
        if correction.why[k]:
            rows.append(_row(aim.target, "not reached", remaining=remaining, note=correction.why[k]))
            continue
        old, new = readings[k], correction.readings[k]
        changes = []
        if aim.target.turn is None:
            own = to_readings(aim.target, new[list(corrector.axes.arm)])
        else:
            pose = inverse(aim.frame) @ after[k] @ aim.tool
            own = to_pose(aim.target, pose)
            if aim.target.configuration and own:
                changes = list(aim.target.configuration.changes(corrector.posture(old), corrector.posture(new)))
        edits += [*own, *to_flags(changes)]
        moved = np.linalg.norm((after[k] @ aim.tool)[:3, 3] - (before[k] @ aim.tool)[:3, 3])
        rows.append(
            _row(
                aim.target, "moved" if own else "unchanged", 1e3 * float(moved), 1e3 * float(angle_between(before[k], after[k])),
                float(np.rad2deg(np.abs(new - old).max())), remaining,
                "; ".join(f"{flag.text} > {text}" for flag, text in changes), aim.note,
            )
        )  # fmt: skip
    return edits, rows, correction.notes


def _row(
    target: Target, outcome: Outcome, moved: float = 0.0, turned: float = 0.0, largest: float = 0.0,
    remaining: float = float("nan"), configuration: str = "", note: str = "",
) -> FilteredTarget:  # fmt: skip
    return FilteredTarget(
        name=target.name, line=target.line, kind="joints" if target.turn is None else "pose", outcome=outcome, moved_mm=moved,
        turned_mrad=turned, largest_deg=largest, remaining_mm=remaining, configuration=configuration, note=note,
    )  # fmt: skip


def _untouched(left: Left) -> FilteredTarget:
    return FilteredTarget(
        name=left.name, line=left.line, kind="", outcome="left alone", moved_mm=0.0, turned_mrad=0.0, largest_deg=0.0,
        remaining_mm=float("nan"), configuration="", note=left.reason,
    )  # fmt: skip


def _nearest(solutions: np.ndarray, readings: np.ndarray) -> np.ndarray:
    return np.asarray(solutions[np.abs(solutions - readings).max(axis=1).argmin()])
