"""Filtering: a robot program's targets corrected, with what moved how far, what could not be reached, and what was left alone.

Tools and frames that the program does not hold are given in the way of its maker; nothing but the targets' numbers changes.
"""

from __future__ import annotations

import math
import re
from bisect import bisect
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calflow.deployment.conventions import Turn, angle_between, inverse, pose_matrix, pose_values
from calflow.deployment.prediction import Missing
from calflow.estimation.calibrated_model import CalibratedModel, NeededCondition
from calflow.files.problems import InputError, Problem, nearest, refuse, refuse_any
from calflow.files.tables import column
from calflow.files.units import split_unit, to_si
from calflow.measurements.measurements import Measurements
from calflow.programs.backup import is_backup, read_files
from calflow.programs.calibrated_robot import Axes, CalibratedRobot
from calflow.programs.formats import parsed, read_project
from calflow.programs.target import NEAR, UNASKED, ArmPosture, Flag, Left, Maker, Number, Program, Reason, Target, Use
from calflow.robot.robot import Robot

# What a number's last decimal may stand for at most: 1 µm of place, 1 µrad of orientation, of a joint what moves a tool that is
# 3 m away by 1 µm.
PLACE_STEP, TURN_STEP, JOINT_STEP = 1e-6, 1e-6, 3e-7
WORTH = 0.5  # a place that follows a target is corrected where it misses by less than this of what it would without
SAME = 1e-7  # m and rad: a target that moves less has not moved


@dataclass(frozen=True)
class Edit:
    """New text for the bytes [start, end)."""

    start: int
    end: int
    text: str


def with_edits(source: bytes, edits: Iterable[Edit]) -> bytes:
    """Return a program with its edits made."""
    pieces = []
    place = 0
    for edit in sorted(edits, key=lambda edit: edit.start):
        if edit.start < place:
            raise ValueError(f"edits overlap at byte {edit.start}")
        pieces += [source[place : edit.start], edit.text.encode("ascii")]
        place = edit.end
    return b"".join([*pieces, source[place:]])


def to_pose(target: Target, pose: np.ndarray) -> tuple[Edit, ...]:
    """Return the edits that bring a target to a pose (4, 4) in its frame; none where it is there."""
    assert target.turn is not None
    before = pose_matrix(target.values, target.turn)
    apart = np.linalg.norm(pose[:3, 3] - before[:3, 3])
    if apart < SAME and np.linalg.norm(pose[:3, :3] - before[:3, :3]) < SAME * np.sqrt(2):  # of a small turn, its angle
        return ()
    values = pose_values(pose, target.turn, target.values)
    steps = [PLACE_STEP] * 3 + [TURN_STEP] * (len(values) - 3)
    return _edits(target, values, steps)


def to_readings(target: Target, readings: np.ndarray) -> tuple[Edit, ...]:
    """Return the edits that give a target other joint readings [rad, or m]; none where it has them."""
    if np.abs(readings - target.values).max() < SAME:
        return ()
    return _edits(target, readings, [JOINT_STEP] * len(readings))


def to_flags(changes: Iterable[tuple[Flag, str]]) -> tuple[Edit, ...]:
    """Return the edits of a configuration."""
    return tuple(Edit(flag.start, flag.end, text) for flag, text in changes)


def spelled(number: Number, value: float, step: float) -> str:
    """Return a value [SI] as a number's text: its own where that says as much, else with as many decimals or as the step needs."""
    decimals = max(_decimals(number.text), int(np.ceil(-np.log10(step / number.scale) - 1e-9)), 0)
    new = value / number.scale
    if abs(new - number.written) < 0.5 * 10.0**-decimals:
        return number.text
    text = f"{new:.{decimals}f}"
    if float(text) == 0:
        text = text.lstrip("-")
    bare = number.text.lstrip("+-")
    if bare.startswith("."):  # as the file leaves out the 0 before the point
        text = text.replace("0.", ".", 1) if text.lstrip("-").startswith("0.") else text
    return f"+{text}" if number.text.startswith("+") and not text.startswith("-") else text


def _edits(target: Target, values: Iterable[float], steps: Iterable[float]) -> tuple[Edit, ...]:
    texts = [spelled(number, value, step) for number, value, step in zip(target.numbers, values, steps, strict=True)]
    return tuple(
        Edit(number.start, number.end, text)
        for number, text in zip(target.numbers, texts, strict=True)
        if text != number.text
    )


def _decimals(text: str) -> int:
    """How many decimals a number has."""
    digits, _, exponent = text.lower().partition("e")
    return max(0, len(digits.partition(".")[2]) - int(exponent or 0))


# Joint positions from which a pose is approached: first of the stance that its flags say alone, then all, and more where these
# do not tell which is meant; and where no flags tell it.
STARTS, STARTS_ALONE = ((16, True), (16, False), (120, False)), 40
# How near to where a flag changes a joint may have either, and whether flags must agree that some robots do not use.
MARGINS = ((0.0, True), (NEAR, True), (NEAR, False))
BETWEEN = 20  # of targets that nothing tells, one in so many is looked for from all sides
UNTOLD = "no configuration tells which joint position is meant"
CLOSE = np.deg2rad(5.0)  # readings within this of those that a program calls near are the ones meant
UNIT_LENGTH = 1e-3  # by how much a quaternion's length may differ from 1, as makers allow
Outcome = Literal["moved", "unchanged", "follows", "not reached", "left alone"]
DONE: tuple[Outcome, ...] = ("moved", "unchanged", "follows")


@dataclass(frozen=True, kw_only=True)
class FilteredTarget:
    """A target of a program, or something else of it that matters to its targets, and what became of it."""

    file: str = column("the file in which it stands", default="")
    name: str = column("the target's name, or what the program does with it")
    line: int = column("its line")
    kind: Literal["pose", "joints", ""] = column("how it is stated; empty: it is no target that can be rewritten")
    outcome: Outcome = column(
        "whether it was moved, needed no move, follows the target that it is computed from, cannot be reached, or was left alone"
    )
    moved_mm: float = column(
        "by how much the tool is sent elsewhere, as the controller counts; of joints the flange", "mm", default=0.0
    )
    turned_mrad: float = column("by how much it is turned", "mrad", default=0.0)
    largest_deg: float = column("the largest change of a joint", "deg", default=0.0)
    remaining_mm: float = column(
        "how far from its place the tool lands, by the calibrated model", "mm", default=math.nan
    )
    promised_mm: float = column(
        "the root mean square distance from its place to be expected: what remains, and what the calibration does not know there",
        "mm", default=math.nan,
    )  # fmt: skip
    configuration: str = column("flags of the configuration that change, old > new", default="")
    reason: Reason | None = column("of what sort the reason is, where it is not corrected", default=None)
    note: str = column("why, or what to know of it")


@dataclass(frozen=True)
class Filtered:
    """The files of a project with their targets corrected, by name, what became of each target, and what else is to be known."""

    files: Mapping[str, bytes]
    rows: tuple[FilteredTarget, ...]
    notes: tuple[str, ...] = ()

    @property
    def source(self) -> bytes:
        """The file, of a project of one."""
        (source,) = self.files.values()
        return source

    @property
    def is_corrected(self) -> bool:
        """Whether any target of the program stands where it should because of the correction, or all do without."""
        outcomes = {row.outcome for row in self.rows if row.kind and row.outcome != "follows"}
        return "moved" in outcomes or outcomes == {"unchanged"}

    @property
    def uncorrected(self) -> tuple[FilteredTarget, ...]:
        """What the robot goes to, or may go to, and is not corrected."""
        return tuple(row for row in self.rows if row.reason is not None and row.reason not in UNASKED)


@dataclass(frozen=True)
class FilterSettings:
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


IN_THE_WAY: Mapping[Reason, str] = {
    "singularity": "at a singularity: the correction would turn a joint by more than 10 degrees",
    "out of reach": "not reached within the joint limits once corrected",
}
COUPLED = (
    "joint targets count as the robot file counts its readings: FANUC shows joint 3 against the horizontal, so that joint 2 moves "
    "it too, and the robot file has no [[couplings]]: joint = 3, source = 2, factor = 1, unless its figures allow for that"
)


@dataclass(frozen=True)
class _Aim:
    """A target of a file with the tool and the frame (4, 4) that it is of, and the readings meant.

    The flange is at frame @ target @ inverse of tool. use is the move, where it goes to what is computed from the target and not
    to the target itself; of a place that shares the correction of another aim, follows is that one's number.
    """

    file: str
    target: Target
    tool: np.ndarray
    frame: np.ndarray
    use: Use | None = None
    follows: int | None = None
    readings: np.ndarray | None = None
    note: str = ""
    reason: Reason = "configuration"


def filtered(programs: Sequence[Program], corrector: CalibratedRobot, choices: FilterSettings) -> Filtered:
    """Return programs of a project that land where they say.

    A pose becomes the one whose nominal joint readings are those that the correction found; joint readings become the corrected
    ones. What is not reached, or whose posture is not told, stays as it is.

    Raises:
        InputError: no target has a tool and a frame that the programs or the user know, or the numbers of joints differ.
    """
    refuse_any(
        Problem(
            f"{target.name} has {len(target.numbers)} joints, the robot's arm {len(corrector.axes.arm)}",
            Path(file),
            target.line,
        )
        for file, target in _targets(programs)
        if target.turn is None and len(target.numbers) != len(corrector.axes.arm)
    )
    aims, doubtful = _aims(programs, choices, corrector.axes)
    resolved = _with_readings([aim for aim in aims if aim.follows is None], corrector, choices)
    resolved += _following([aim for aim in aims if aim.follows is not None], resolved, corrector)
    left = [(program.file, skipped) for program in programs for skipped in program.left]
    rows = [_left_row(file, skipped) for file, skipped in (*left, *doubtful)]
    rows += [
        _row(aim, "not reached" if aim.reason == "out of reach" else "left alone", aim.note, reason=aim.reason)
        for aim in resolved if aim.readings is None
    ]  # fmt: skip
    edits, corrected, notes = _corrected(resolved, corrector)
    place = {program.file: k for k, program in enumerate(programs)}
    ordered = tuple(sorted([*rows, *corrected], key=lambda row: (place[row.file], row.line)))
    files = {program.file: with_edits(program.source, edits.get(program.file, ())) for program in programs}
    return Filtered(files, ordered, (*corrector.axes.unknown_words(target for _, target in _targets(programs)), *notes))


def _targets(programs: Iterable[Program]) -> Iterator[tuple[str, Target]]:
    return ((program.file, target) for program in programs for target in program.targets)


def _aims(
    programs: Sequence[Program], choices: FilterSettings, axes: Axes
) -> tuple[list[_Aim], list[tuple[str, Left]]]:
    """Targets with their tools and frames, by their files; and those of which more or less than one is known.

    Places that are computed from a target come after it, and follow it.
    """
    problems: dict[str, Problem] = {}
    aims: list[_Aim] = []
    doubtful: list[tuple[str, Left]] = []
    where = "this file" if len(programs) == 1 else "these files"
    for program in programs:
        tools, frames = {**program.tools, **choices.tools}, {**program.frames, **choices.frames}
        for target in program.targets:
            if lacking := axes.lacking(target):
                doubtful.append((program.file, Left(target.name, target.line, "incomplete", lacking)))
                continue
            if target.turn is None:
                readings = axes.readings(target, target.values)
                aims.append(_Aim(program.file, target, np.eye(4), np.eye(4), readings=readings))
                continue
            length = np.linalg.norm(target.values[3:])
            if target.turn == "quaternion" and abs(length - 1) > UNIT_LENGTH:
                why = f"has a quaternion of length {length:.4g}, where 1 is meant"
                doubtful.append((program.file, Left(target.name, target.line, "incomplete", why)))
                continue
            tool = _named("tool", target.tools, choices.tool, tools, where)
            frame = _named("frame", target.frames, choices.frame, frames, where)
            if isinstance(tool, np.ndarray) and isinstance(frame, np.ndarray):
                aims += _of_uses(program.file, target, choices.flange @ tool, choices.base @ frame, len(aims))
                continue
            unknown = [
                (what, missing) for what, missing in (("tool", tool), ("frame", frame)) if isinstance(missing, Left)
            ]
            doubtful.append((program.file, replace(unknown[0][1], name=target.name, line=target.line)))
            for what, missing in unknown:
                if missing.reason == "unknown tool or frame":
                    message = missing.note if missing.name else f"{target.name}: {missing.note}"
                    problems.setdefault(f"{what} {missing.name}", Problem(message, Path(program.file), target.line))
    if problems and not aims:
        raise InputError(problems.values())
    return aims, doubtful


def _of_uses(file: str, target: Target, tool: np.ndarray, frame: np.ndarray, number: int) -> list[_Aim]:
    """A target as moves go to it, if only in another frame, or else as they go to what is computed from it; others follow."""
    itself = _Aim(file, target, tool, frame)
    aims = [
        replace(itself, tool=tool @ inverse(place.after), frame=frame @ place.before, use=use)
        for use in target.uses if (place := use.computed)
    ]  # fmt: skip
    if len(aims) < len(target.uses) or not aims:
        aims = [itself, *aims]
    aims.sort(key=lambda aim: aim.use is not None and not np.allclose(aim.tool, tool))
    return [aims[0], *(replace(aim, follows=number) for aim in aims[1:])]


def _named(
    what: str, names: Sequence[str], usual: str | None, matrices: Mapping[str, np.ndarray], where: str
) -> np.ndarray | Left:
    """The tool or frame of a target; why not, where it is not known or has several, with the name of what is not known."""
    wanted = [name for name in names if name and name != "F"] or ([usual] if usual is not None else [])
    if not wanted:
        note = f"the program does not say with which {what} it goes there: name it (--{what} NAME)"
        return Left("", 0, "unknown tool or frame", note)
    for name in wanted:
        if name not in matrices:
            note = f"the numbers of {what} '{name}' do not stand in {where}: state them (--{what} '{name}=…')"
            return Left(name, 0, "unknown tool or frame", note)
    first = matrices[wanted[0]]
    if any(not np.allclose(matrices[name], first, atol=1e-9) for name in wanted[1:]):
        note = f"is used with several {what}s ({', '.join(wanted)}): each would need a correction of its own"
        return Left("", 0, "several tools or frames", note)
    return first


@dataclass(frozen=True)
class _Ways:
    """The readings (k, n_joints) that may be meant at a target, and what is to be said: why none, or how one is chosen of them."""

    readings: np.ndarray
    note: str = ""
    reason: Reason = "configuration"


def _with_readings(aims: list[_Aim], corrector: CalibratedRobot, choices: FilterSettings) -> list[_Aim]:
    """The readings that are meant at each pose; without them, and with a note, where that is not told.

    What is told by the target before goes by the order in which moves of the file come to them.
    """
    place = {aim.file: k for k, aim in reversed([*enumerate(aims)])}
    came = sorted(range(len(aims)), key=lambda k: (place[aims[k].file], _first_line(aims[k])))
    resolved = _told_in_turn([aims[k] for k in came], corrector, choices)
    return [resolved[k] for k in np.argsort(came)]


def _first_line(aim: _Aim) -> int:
    """The line of the first move of its file that goes to a target, or its own."""
    return min((use.line for use in aim.target.uses if use.file == aim.file), default=aim.target.line)


def _told_in_turn(aims: list[_Aim], corrector: CalibratedRobot, choices: FilterSettings) -> list[_Aim]:
    """The readings that are meant at each pose, in the order of the moves."""
    asked = [k for k, aim in enumerate(aims) if aim.readings is None]
    alone = [k for k in asked if (aims[k].target.configuration or aims[k].target.near) is None]
    ways = _from_near(aims, [k for k in asked if aims[k].target.near], corrector)
    flagless = set(alone)
    for starts, sided in STARTS:
        lacking = [k for k in asked if k not in flagless and not (k in ways and len(ways[k].readings))]
        ways |= _ways(aims, lacking, starts, corrector, choices.loosely, sided)
    ways |= _untold(aims, alone, corrector)
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


def _from_near(aims: list[_Aim], which: list[int], corrector: CalibratedRobot) -> dict[int, _Ways]:
    """The ways to targets from the readings that the program says are near them."""
    near = [_near(aims[k].target, corrector.axes) for k in which]
    if not which:
        return {}
    reached, of = corrector.continued(
        np.stack([_flange(aims[k]) for k in which]), np.stack([readings for readings in near if readings is not None])
    )
    return {
        which[i]: _meant(aims[which[i]], readings[None], (), corrector, False, False)
        for i, readings in zip(of, reached, strict=True)
    }


def _untold(aims: list[_Aim], which: list[int], corrector: CalibratedRobot) -> dict[int, _Ways]:
    """The ways to targets of which nothing tells the posture: all that lead to some of them, and on from there to those between."""
    leading = [k for i, k in enumerate(which) if i % BETWEEN == 0 or aims[k].file != aims[which[i - 1]].file]
    ways = _ways(aims, leading, STARTS_ALONE, corrector, loosely=True)
    between = [(k, leading[bisect(leading, k) - 1]) for k in which]
    asked = [(k, reading) for k, lead in between if k != lead for reading in ways[lead].readings]
    if asked:
        found, of = corrector.continued(
            np.stack([_flange(aims[k]) for k, _ in asked]),
            np.stack([corrector.axes.moved_to(reading, aims[k].target) for k, reading in asked]),
        )
        reached: dict[int, list[np.ndarray]] = {}
        for i, readings in zip(of, found, strict=True):
            reached.setdefault(asked[i][0], []).append(readings)
        ways |= {k: _Ways(np.stack(every), UNTOLD) for k, every in reached.items()}
    return ways | _ways(aims, [k for k in which if k not in ways], STARTS_ALONE, corrector, loosely=True)


def _ways(
    aims: list[_Aim], which: list[int], starts: int, corrector: CalibratedRobot, loosely: bool, sided: bool = False
) -> dict[int, _Ways]:
    """The ways to some targets, each approached from so many joint positions, sided: of the stance alone that its flags say."""
    if not which:
        return {}
    near = [_near(aims[k].target, corrector.axes) for k in which]
    external = np.stack([corrector.axes.at(aims[k].target) for k in which])
    flags = [aims[k].target.configuration for k in which]
    sides = [flag.sides if flag and sided else None for flag in flags]
    solutions = corrector.solutions(np.stack([_flange(aims[k]) for k in which]), starts, near, external, sides)
    stands = iter(corrector.postures(np.concatenate(solutions)))
    postures = [[next(stands) for _ in solution] for solution in solutions]
    return {
        k: _meant(aims[k], solution, stand, corrector, loosely or not aims[k].target.flagged, sided)
        for k, solution, stand in zip(which, solutions, postures, strict=True)
    }


def _in_turn(
    aims: list[_Aim], ways: Mapping[int, _Ways], corrector: CalibratedRobot, choices: FilterSettings
) -> tuple[list[_Aim], list[np.ndarray | None]]:
    """The readings meant, one target after the other, since what is not told follows from the target before; and those before."""
    start = last = None if choices.start is None else np.array(choices.start)
    resolved, before = [], []
    for k, aim in enumerate(aims):
        if k and aim.file != aims[k - 1].file:
            last = start
        before.append(None if last is None else corrector.axes.moved_to(last, aim.target))
        resolved.append(_chosen(aim, ways[k], before[-1]) if k in ways else aim)
        readings = resolved[-1].readings
        last = readings if readings is not None else before[-1]
    return resolved, before


def _nearer(
    aims: list[_Aim], before: Mapping[int, np.ndarray], resolved: list[_Aim], corrector: CalibratedRobot
) -> dict[int, np.ndarray]:
    """The readings at targets that are reached from those before, where these are nearer to them than what was chosen."""
    if not before:
        return {}
    numbers = list(before)
    continued, of = corrector.continued(np.stack([_flange(aims[k]) for k in numbers]), np.stack(list(before.values())))
    nearer = {}
    for k, reading in ((numbers[i], reading) for i, reading in zip(of, continued, strict=True)):
        chosen = resolved[k].readings
        if chosen is None or np.abs(reading - before[k]).max() < np.abs(chosen - before[k]).max() - CLOSE:
            nearer[k] = reading
    return nearer


def _near(target: Target, axes: Axes) -> np.ndarray | None:
    """The readings that a program says are close to a target, the external axes as at the target."""
    return None if target.near is None else axes.readings(target, target.near)


def _flange(aim: _Aim) -> np.ndarray:
    """Where the controller has the flange at a target, in the robot's base."""
    return aim.frame @ pose_matrix(aim.target.values, aim.target.turn or "quaternion") @ inverse(aim.tool)


def _meant(
    aim: _Aim,
    solutions: np.ndarray,
    postures: Sequence[ArmPosture],
    corrector: CalibratedRobot,
    loosely: bool,
    sided: bool,
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
        for margin, strictly in MARGINS[:2] if sided else MARGINS:
            fitting = ways[[configuration.agrees(posture, margin, strictly) for posture in postures]]
            if len(fitting):
                several = f"{len(fitting)} joint positions have its configuration"
                return _Ways(fitting, "" if len(fitting) == 1 else several)
    reason = "no joint readings of the nominal robot that lead there have its configuration"
    return _Ways(solutions if loosely and not sided else none, reason)


def _chosen(aim: _Aim, ways: _Ways, before: np.ndarray | None) -> _Aim:
    """A target with the readings that are meant at it, or why these are not told."""
    if not len(ways.readings):
        return replace(aim, note=ways.note, reason=ways.reason)
    if not ways.note:
        return replace(aim, readings=ways.readings[0])
    if before is None:
        return replace(aim, note=f"{ways.note}: state readings near it (--start)")
    note = f"{ways.note}: taken as the one nearest to the target before"
    return replace(aim, readings=_nearest(ways.readings, before), note=note)


def _following(aims: list[_Aim], leading: Sequence[_Aim], corrector: CalibratedRobot) -> list[_Aim]:
    """The readings at places that follow a target, which are those that are reached from the target's."""
    lead = {(aim.file, aim.target.numbers[0].start): aim for aim in leading}
    before = [lead[aim.file, aim.target.numbers[0].start].readings for aim in aims]
    resolved = [k for k, readings in enumerate(before) if readings is not None]
    if not resolved:
        return []
    reached, of = corrector.continued(
        np.stack([_flange(aims[k]) for k in resolved]),
        np.stack([readings for readings in before if readings is not None]),
    )
    by_number = dict(zip((resolved[i] for i in of), reached, strict=True))
    missed = "the nominal robot does not get there from the target that it is computed from"
    return [
        replace(aims[k], readings=by_number[k])
        if k in by_number
        else replace(aims[k], note=missed, reason="out of reach")
        for k in resolved
    ]


def _corrected(
    aims: Sequence[_Aim], corrector: CalibratedRobot
) -> tuple[dict[str, list[Edit]], list[FilteredTarget], tuple[str, ...]]:
    """The edits by file and the rows of aims whose readings are known, and what is to be known of the correction."""
    edits: dict[str, list[Edit]] = {}
    rows, notes = [], dict[str, None]()
    poses: dict[tuple[str, int], np.ndarray] = {}  # of what is written, by where it stands
    leading = [aim for aim in aims if aim.readings is not None and aim.follows is None]
    following = [aim for aim in aims if aim.readings is not None and aim.follows is not None]
    for group in (leading, following):  # first what is written, since the others are computed from that
        if not group:
            continue
        readings = np.stack([aim.readings for aim in group if aim.readings is not None])
        correction = corrector.corrected(readings, [aim.target.name for aim in group])
        notes |= dict.fromkeys(correction.notes)
        before, after = corrector.flange(readings), corrector.flange(correction.readings)
        turned = 1e3 * angle_between(before, after)
        postures = list(zip(corrector.postures(readings), corrector.postures(correction.readings), strict=True))
        for k, aim in enumerate(group):
            key = aim.file, aim.target.numbers[0].start
            remaining, unknown = 1e3 * float(correction.remaining[k]), 1e3 * float(correction.unknown[k])
            if reason := correction.reasons[k]:
                rows.append(_row(aim, "not reached", IN_THE_WAY[reason], reason=reason, remaining_mm=remaining))
                continue
            old, new = readings[k], correction.readings[k]
            tool = aim.tool @ aim.use.computed.after if aim.use and aim.use.computed else aim.tool
            moved = 1e3 * float(np.linalg.norm((after[k] @ tool)[:3, 3] - (before[k] @ tool)[:3, 3]))
            figures: dict[str, Any] = {
                "moved_mm": moved, "turned_mrad": float(turned[k]),
                "largest_deg": float(np.rad2deg(np.abs(new - old).max())),
            }  # fmt: skip
            if aim.follows is not None:
                sent = aim.frame @ poses[key] @ inverse(aim.tool) if key in poses else before[k]
                remaining += 1e3 * float(np.linalg.norm((sent @ tool)[:3, 3] - (after[k] @ tool)[:3, 3]))
                shared: Reason | None = "shared" if remaining > WORTH * moved and remaining > 1e3 * PLACE_STEP else None
                note = f"is computed from {aim.target.name}, whose correction it shares"
                figures["promised_mm"] = math.hypot(remaining, unknown)
                rows.append(_row(aim, "follows", note, reason=shared, remaining_mm=remaining, **figures))
                continue
            figures["promised_mm"] = math.hypot(remaining, unknown)
            changes: list[tuple[Flag, str]] = []
            if aim.target.turn is None:
                written = to_readings(aim.target, new[list(corrector.axes.arm)])
            else:
                poses[key] = inverse(aim.frame) @ after[k] @ aim.tool
                written = to_pose(aim.target, poses[key])
                if aim.target.configuration and written:
                    changes = list(aim.target.configuration.changes(*postures[k]))
            edits.setdefault(aim.file, []).extend((*written, *to_flags(changes)))
            flags = "; ".join(f"{flag.text} > {text}" for flag, text in changes)
            outcome: Outcome = "moved" if written else "unchanged"
            rows.append(_row(aim, outcome, aim.note, remaining_mm=remaining, configuration=flags, **figures))
    return edits, rows, tuple(notes)


def _left_row(file: str, left: Left) -> FilteredTarget:
    return FilteredTarget(
        file=file, name=left.name, line=left.line, kind="", outcome="left alone", reason=left.reason, note=left.note
    )


def _row(aim: _Aim, outcome: Outcome, note: str, **figures: Any) -> FilteredTarget:
    kind: Literal["pose", "joints"] = "joints" if aim.target.turn is None else "pose"
    name, file, line = aim.target.name, aim.file, aim.target.line
    if aim.follows is not None and aim.use and aim.use.computed:
        name, file, line = aim.use.computed.name, aim.use.file, aim.use.line
    return FilteredTarget(file=file, name=name, line=line, kind=kind, outcome=outcome, note=note, **figures)


def _nearest(solutions: np.ndarray, readings: np.ndarray) -> np.ndarray:
    return np.asarray(solutions[np.abs(solutions - readings).max(axis=1).argmin()])


# What six or seven numbers are to each maker: of which turn, and how much one of a length and of an angle is in SI.
WAYS: Mapping[Maker, tuple[Turn, float, float, str]] = {
    "rapid": ("quaternion", 1e-3, 1.0, "x,y,z,q1,q2,q3,q4 in mm"),
    "krl": ("zyx", 1e-3, np.pi / 180, "X,Y,Z,A,B,C in mm and degrees"),
    "fanuc": ("xyz", 1e-3, np.pi / 180, "X,Y,Z,W,P,R in mm and degrees"),
    "urscript": ("vector", 1.0, 1.0, "x,y,z,rx,ry,rz in m and radians"),
}


def stated_frames(maker: Maker, options: Iterable[str], option: str) -> tuple[dict[str, np.ndarray], str | None]:
    """Return the frames of `NAME=numbers` by name, and the name that stands alone: of what the program does not name.

    Args:
        maker: whose numbers they are.
        options: the user's words.
        option: how the option is called, for what is told.

    Raises:
        InputError: they cannot be understood.
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
    """Return the transform (4, 4) that numbers in a maker's way mean; key says where they are from.

    Raises:
        InputError: they are none.
    """
    turn, length, angle, way = WAYS[maker]
    words = [word for word in re.split(r"[\s,;\[\]{}()]+", text) if word]
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([np.nan])
    wanted = 7 if turn == "quaternion" else 6
    if len(values) != wanted or not np.isfinite(values).all():
        raise refuse(f"expected {way}, found '{text.strip()}'", key=key)
    if turn == "quaternion" and abs(np.linalg.norm(values[3:]) - 1) > UNIT_LENGTH:
        raise refuse(f"expected a quaternion of length 1, found one of {np.linalg.norm(values[3:]):.4g}", key=key)
    return pose_matrix(values * np.array([length] * 3 + [angle] * (wanted - 3)), turn)


CONDITIONS = ("time", "temperature")  # one value holds for a whole program


def filter_program(
    calibrated: CalibratedModel, program: str | Path, *, payload: str | None = None, tools: Sequence[str] = (),
    frames: Sequence[str] = (), base: str | None = None, flange: str | None = None, start: Sequence[float] | None = None,
    any_configuration: bool = False, in_order: bool = False, conditions: Mapping[str, float] | None = None,
    missing: Missing = "refuse",
) -> Filtered:  # fmt: skip
    """Return a robot program, or a whole project, that lands where it says, and what became of each target (see `FilteredTarget`).

    What is there is left as it is: `files` holds the bytes to write, `source` those of a single program.

    Args:
        calibrated: the calibrated model.
        program: a file of RAPID, KRL, FANUC LS or URScript, or a folder or a ZIP archive of such, of one controller.
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
        InputError: the program cannot be read, or something of it is not known.
    """
    path, robot = Path(program), calibrated.model.robot
    files, unread = read_files(path), list[tuple[str, Left]]()
    if is_backup(path):
        programs, unread = read_project(files, path)
    else:
        programs = [parsed(files[path.name], path)]
    maker = programs[0].maker
    if in_order and sum(bool(program.targets) for program in programs) > 1:
        raise refuse("the order of targets is that of one program, and here are several", key="--in-order")
    known_tools, tool = stated_frames(maker, tools, "--tool")
    known_frames, frame = stated_frames(maker, frames, "--frame")
    placed = {
        name: stated_frame(maker, text, f"--{name}") for name, text in (("base", base), ("flange", flange)) if text
    }
    choices = FilterSettings(
        known_tools, known_frames, tool, frame, start=_start(robot, start), loosely=any_configuration, **placed
    )
    stated = _conditions(conditions or {})
    given = (*stated, *(("approach", "travel") if in_order else ()))
    if missing == "refuse":
        _check_conditions(calibrated.needed, given)
    if payload is not None and payload not in robot.payloads:
        there = f"expected one of {', '.join(robot.payloads)}" if robot.payloads else "the robot file has none"
        raise refuse(f"unknown payload: {there}{nearest(payload, robot.payloads)}", key=f"--payload {payload}")
    origin = {"time_origin": calibrated.time_origin} if "time" in stated else {}
    carried = {} if payload is None else {"payload": payload}

    def rows(readings: np.ndarray) -> Measurements:
        return Measurements.from_arrays(
            robot, readings, None, pose=np.arange(len(readings)), **carried, **origin, **stated  # type: ignore[arg-type]
        )  # fmt: skip

    corrector = CalibratedRobot(
        replace(calibrated, model=replace(calibrated.model, given=given)), rows, in_order, missing
    )
    root = path if is_backup(path) else path.parent
    try:
        done = filtered(programs, corrector, choices)
    except InputError as error:
        problems = (
            replace(problem, file=root / problem.file) if problem.file else problem for problem in error.problems
        )
        raise InputError(problems) from None
    loads = robot.payloads if payload is None else ()
    empty = [f"no --payload: the robot counts as carrying none of {', '.join(loads)}"] if loads else []
    shown = maker == "fanuc" and not robot.couplings and any(target.turn is None for _, target in _targets(programs))
    rows_unread = tuple(_left_row(file, skipped) for file, skipped in unread)
    return replace(
        done, files={**files, **done.files}, rows=(*rows_unread, *done.rows),
        notes=(*empty, *([COUPLED] if shown else ()), *done.notes),
    )  # fmt: skip


def _check_conditions(needed: Iterable[NeededCondition], given: Collection[str]) -> None:
    """Check that all is said on which it depends where the robot will be."""
    sources = {"approach": "--in-order has it from the order of the targets",
            "travel": "--in-order has it from the order of the targets", "time": "--condition time_s=… says it",
            "temperature": "--condition temperature_degC=… says it"}  # fmt: skip
    refuse_any(
        Problem(
            f"where the robot will be depends on {need.condition} ({', '.join(need.effects)}): "
            f"{sources.get(need.condition, 'a program cannot say it')}; --without-conditions goes on without it"
        )
        for need in needed if need.condition not in given
    )  # fmt: skip


def _start(robot: Robot, start: Sequence[float] | None) -> tuple[float, ...] | None:
    """Readings in SI; external axes, which a target gives, at 0."""
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
    """Conditions in SI by name, from names with units."""
    conditions = {}
    for name, value in stated.items():
        split = split_unit(name)
        if split is None or split[0] not in CONDITIONS or split_unit(name, split[0]) is None:
            names = ("temperature_degC", "temperature_K", "time_s", "time_min", "time_h")
            raise refuse(f"expected one of {', '.join(names)}{nearest(name, names)}", key=f"--condition {name}")
        if not np.isfinite(value):
            raise refuse(f"expected a finite number, found {value:g}", key=f"--condition {name}")
        factor, offset = to_si(split[1])
        conditions[split[0]] = factor * value + offset
    return conditions
