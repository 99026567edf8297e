"""Correction: rewriting a project's targets so that the real robot reaches the programmed poses, with a report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calflow.deployment.conventions import angle_between
from calflow.files.problems import Problem, refuse_any
from calflow.files.tables import column
from calflow.programs.aims import Aim, FilterSettings, aims_of, all_targets, runs_of_moves, second_targets
from calflow.programs.calibrated_robot import CalibratedRobot
from calflow.programs.edits import PLACE_STEP, Edit, to_flags, to_pose, to_readings, with_edits
from calflow.programs.postures import following, with_intended_readings
from calflow.programs.target import UNASKED, ArmPosture, Flag, Program, Reason, Skipped, Target

SHARED_SHARE = 0.5  # a computed pose counts as corrected if its remaining error is below this share of its correction
FROM_SIDES = "moves come to it from either side of a joint's play, and land {:.3f} mm to either side"
Outcome = Literal["moved", "unchanged", "follows", "not reached", "left alone"]
FAILURES: Mapping[Reason, str] = {
    "singularity": "at a singularity: the correction would turn a joint by more than 10 degrees",
    "out of reach": "once corrected, outside the joint limits",
}


@dataclass(frozen=True, kw_only=True)
class FilteredTarget:
    """A target of a program, or a statement that affects its targets, and what became of it."""

    file: str = column("the file in which it stands", default="")
    name: str = column("the target's name, or what the program does with it")
    line: int = column("its line")
    kind: Literal["pose", "joints", ""] = column("how it is stated; empty: it is no target that can be rewritten")
    outcome: Outcome = column(
        "whether it was moved, needed no move, follows the target it is computed from, is not reached, or was left alone"
    )
    moved_mm: float = column(
        "nominal displacement of the tool by the correction; for joint targets, of the flange", "mm", default=0.0
    )
    turned_mrad: float = column("nominal rotation by the correction", "mrad", default=0.0)
    largest_deg: float = column("the largest change of a joint", "deg", default=0.0)
    remaining_mm: float = column(
        "position error of the tool after correction, by the calibrated model", "mm", default=math.nan
    )
    promised_mm: float = column(
        "expected root mean square position error of the tool: the remaining error and the calibration's standard deviation there",
        "mm",
        default=math.nan,
    )
    configuration: str = column("flags of the configuration that change, old > new", default="")
    reason: Reason | None = column("the kind of reason why it is not corrected", default=None)
    note: str = column("the reason in words, or a remark")


@dataclass(frozen=True)
class Filtered:
    """The corrected files of a project by name, a row for each target, and general notes."""

    files: Mapping[str, bytes]
    rows: tuple[FilteredTarget, ...]
    notes: tuple[str, ...] = ()

    @property
    def source(self) -> bytes:
        """The content of the only file of a project."""
        (source,) = self.files.values()
        return source

    @property
    def is_corrected(self) -> bool:
        """Whether any target was corrected, or none needs correction."""
        outcomes = {row.outcome for row in self.rows if row.kind and row.outcome != "follows"}
        return "moved" in outcomes or outcomes == {"unchanged"}

    @property
    def uncorrected(self) -> tuple[FilteredTarget, ...]:
        """The targets that the robot goes to, or may go to, without correction."""
        return tuple(row for row in self.rows if row.reason is not None and row.reason not in UNASKED)


def filtered(programs: Sequence[Program], corrector: CalibratedRobot, choices: FilterSettings) -> Filtered:
    """Return the programs of a project with corrected targets.

    A joint target becomes the corrected readings, a pose the nominal forward kinematics of these. Targets that cannot
    be reached, or whose posture is ambiguous, stay unchanged.

    Raises:
        InputError: no target has a known tool and frame, or targets and arm differ in their number of joints.
    """
    refuse_any(
        Problem(
            f"{target.name} has {len(target.numbers)} joints, the robot's arm {len(corrector.axes.arm)}",
            Path(file),
            target.line,
        )
        for file, target in all_targets(programs)
        if target.turn is None and len(target.numbers) != len(corrector.axes.arm)
    )
    aims, doubtful = aims_of(programs, choices, corrector.axes)
    resolved = with_intended_readings([aim for aim in aims if not aim.follows], corrector, choices)
    resolved += following([aim for aim in aims if aim.follows], resolved, corrector)
    skipped = [(program.file, entry) for program in programs for entry in program.skipped]
    rows = [skipped_row(file, entry) for file, entry in (*skipped, *doubtful)]
    rows += [
        _row(aim, "not reached" if aim.reason == "out of reach" else "left alone", aim.note, reason=aim.reason)
        for aim in resolved
        if aim.readings is None
    ]
    unresolved = [use for aim in resolved if aim.readings is None for use in aim.target.uses if use.line]
    elsewhere = {(use.file, use.line) for use in unresolved}
    elsewhere |= {(file, entry.line) for file, entry in (*skipped, *doubtful) if entry.reason not in UNASKED}
    known = [aim for aim in resolved if aim.readings is not None]
    runs = runs_of_moves(known, [program.file for program in programs], elsewhere)
    edits, corrected, notes = _corrected(known, runs, corrector)
    sources = {program.file: program.source for program in programs}
    by_file: dict[str, list[Edit]] = {file: [] for file in sources}
    for file, change in second_targets(resolved, edits, sources):
        by_file[file].append(change)
    for (file, _, copy), changes in edits.items():
        by_file[file] += () if copy else changes
    place = {file: k for k, file in enumerate(sources)}
    ordered = tuple(sorted([*rows, *corrected], key=lambda row: (place[row.file], row.line)))
    files = {file: with_edits(source, by_file[file]) for file, source in sources.items()}
    return Filtered(
        files, ordered, (*corrector.axes.unknown_axes_note(target for _, target in all_targets(programs)), *notes)
    )


def _corrected(
    aims: Sequence[Aim], runs: Sequence[Sequence[int]], corrector: CalibratedRobot
) -> tuple[dict[tuple[str, int, str], list[Edit]], list[FilteredTarget], tuple[str, ...]]:
    """Return the edits and the rows of aims with known readings, and the notes of the correction.

    Aims that follow come last, since their poses are computed from those written; runs: as `runs_of_moves` returns them.
    """
    if not aims:
        return {}, [], ()
    edits: dict[tuple[str, int, str], list[Edit]] = {}
    rows = []
    poses: dict[tuple[str, int, str], np.ndarray] = {}  # as written to the file
    readings = np.stack([aim.readings for aim in aims if aim.readings is not None])
    tools = [aim.tool @ aim.use.computed.after if aim.use and aim.use.computed else aim.tool for aim in aims]
    places = np.stack([tool[:3, 3] for tool in tools])
    correction = corrector.corrected(readings, places, [aim.target.name for aim in aims], runs)
    before, after = corrector.flange(readings), corrector.flange(correction.readings)
    ways = np.split(
        corrector.flange(np.concatenate(correction.ways)), np.cumsum([len(w) for w in correction.ways])[:-1]
    )
    turned = 1e3 * angle_between(before, after)
    postures = list(zip(corrector.postures(readings), corrector.postures(correction.readings), strict=True))
    for k, aim in enumerate(aims):
        remaining, sd = 1e3 * float(correction.remaining[k]), 1e3 * float(np.linalg.norm(correction.sd[k]))
        if reason := correction.reasons[k]:
            rows.append(_row(aim, "not reached", FAILURES[reason], reason=reason, remaining_mm=remaining))
            continue
        old, new, tool = readings[k], correction.readings[k], tools[k]
        beside = max(_distance_mm(way, after[k], tool) for way in ways[k])
        remaining += beside
        if aim.follows:
            sent = aim.frame @ poses[aim.key] @ np.linalg.inv(aim.tool) if aim.key in poses else before[k]
            remaining += _distance_mm(sent, after[k], tool)
        moved = _distance_mm(before[k], after[k], tool)
        figures: dict[str, Any] = {
            "moved_mm": moved, "turned_mrad": float(turned[k]), "remaining_mm": remaining,
            "largest_deg": float(np.rad2deg(np.abs(new - old).max())), "promised_mm": math.hypot(remaining, sd),
        }  # fmt: skip
        if aim.follows:
            shared: Reason | None = "shared" if remaining > max(SHARED_SHARE * moved, 1e3 * PLACE_STEP) else None
            note = f"is computed from {aim.copy or aim.target.name}, whose correction it shares"
            rows.append(_row(aim, "follows", note, reason=shared, **figures))
            continue
        pose = np.linalg.inv(aim.frame) @ after[k] @ aim.tool
        if aim.target.turn:
            poses[aim.key] = pose
        written, flags = _written(aim.target, new[corrector.axes.arm], pose, postures[k])
        edits[aim.key] = [*written, *to_flags(flags)]
        changed = "; ".join(f"{flag.text} > {text}" for flag, text in flags)
        sides = FROM_SIDES.format(beside) if beside > 1e3 * PLACE_STEP else ""
        note = "; ".join(filter(None, (aim.note, sides)))
        rows.append(_row(aim, "moved" if written else "unchanged", note, configuration=changed, **figures))
    return edits, rows, correction.notes


def _written(
    target: Target, readings: np.ndarray, pose: np.ndarray, postures: tuple[ArmPosture, ArmPosture]
) -> tuple[Sequence[Edit], Sequence[tuple[Flag, str]]]:
    """Return the edits of a target's numbers, and its flags that change between two postures."""
    if target.turn is None:
        return to_readings(target, readings), ()
    written = to_pose(target, pose)
    return written, target.configuration.changes(*postures) if target.configuration and written else ()


def _distance_mm(flange: np.ndarray, other: np.ndarray, tool: np.ndarray) -> float:
    """Return the distance [mm] between the tool's positions at two flange poses."""
    return 1e3 * float(np.linalg.norm((flange @ tool)[:3, 3] - (other @ tool)[:3, 3]))


def skipped_row(file: str, entry: Skipped) -> FilteredTarget:
    """Return the row of a target or statement of a file that is left alone."""
    return FilteredTarget(
        file=file, name=entry.name, line=entry.line, kind="", outcome="left alone", reason=entry.reason, note=entry.note
    )


def _row(aim: Aim, outcome: Outcome, note: str, **figures: Any) -> FilteredTarget:
    kind: Literal["pose", "joints"] = "joints" if aim.target.turn is None else "pose"
    name, file, line = aim.copy or aim.target.name, aim.file, aim.target.line
    if aim.follows and aim.use and aim.use.computed:
        name, file, line = aim.use.computed.name, aim.use.file, aim.use.line
    elif aim.copy:
        lines = ", ".join(dict.fromkeys(str(use.line) for use in aim.target.uses))
        second = f"a second {aim.target.name}, for the moves with another tool or frame (line {lines})"
        note = f"{second}; {note}" if note else second
    return FilteredTarget(file=file, name=name, line=line, kind=kind, outcome=outcome, note=note, **figures)
