"""Aims: the targets of programs, with the tool and the frame of the moves to them; one aim per pair of these."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count, groupby
from pathlib import Path

import numpy as np

from calflow.deployment.conventions import UNIT_LENGTH
from calflow.files.problems import InputError, Problem
from calflow.programs.calibrated_robot import Axes
from calflow.programs.edits import Edit, declared_again
from calflow.programs.target import Program, Reason, Skipped, Target, Use

LONGEST_NAME = 24  # characters that every maker allows


@dataclass(frozen=True)
class FilterSettings:
    """The user's settings for what programs do not state.

    tools, frames: poses (4, 4) by name; tool, frame: the names used where a move gives none. base, flange (4, 4): the
    controller's, relative to those of the robot file. start [rad or m]: joint readings near the first target, for
    programs without configuration flags. any_configuration: if no solution has a target's flags, take the one nearest to
    the previous target.
    """

    tools: Mapping[str, np.ndarray]
    frames: Mapping[str, np.ndarray]
    tool: str | None = None
    frame: str | None = None
    base: np.ndarray = field(default_factory=lambda: np.eye(4))
    flange: np.ndarray = field(default_factory=lambda: np.eye(4))
    start: tuple[float, ...] | None = None
    any_configuration: bool = False


@dataclass(frozen=True, kw_only=True)
class Aim:
    """A target of a file with its tool and frame (4, 4), and the joint readings (n_joints,) intended there.

    The flange is at frame @ target @ np.linalg.inv(tool). use: the move, if it goes to a pose computed from the target;
    follows: whether that pose shares the correction of another aim. copy: the name of a second target, declared for
    moves with another tool or frame; empty for the target itself. note, reason: why readings are missing.
    """

    file: str
    target: Target
    tool: np.ndarray = field(default_factory=lambda: np.eye(4))
    frame: np.ndarray = field(default_factory=lambda: np.eye(4))
    use: Use | None = None
    follows: bool = False
    copy: str = ""
    readings: np.ndarray | None = None
    note: str = ""
    reason: Reason = "configuration"

    @property
    def key(self) -> tuple[str, int, str]:
        """The declaration written for it, shared by aims that follow: file, byte position of the target, copy."""
        return self.file, self.target.numbers[0].start, self.copy

    @cached_property
    def flange(self) -> np.ndarray:
        """The flange pose (4, 4) at the target in the robot's base, as the controller computes it."""
        return self.frame @ self.target.pose @ np.linalg.inv(self.tool)


@dataclass(frozen=True)
class _Moves:
    """The moves to a target with the same tool and frame, placed (4, 4) each; unknown: which of them, and why."""

    uses: tuple[Use, ...]
    placed: tuple[np.ndarray, np.ndarray] | None
    unknown: tuple[tuple[str, Skipped], ...] = ()

    def same_frames(self, other: _Moves) -> bool:
        """Return whether other moves have the same tool and frame."""
        if self.placed is None or other.placed is None:
            return self.placed is other.placed
        return bool(np.allclose(self.placed, other.placed, atol=1e-9))

    @property
    def bound(self) -> bool:
        """Whether some move cannot be redirected to a target of another name."""
        return not all(use.span for use in self.uses)


def all_targets(programs: Iterable[Program]) -> Iterator[tuple[str, Target]]:
    """Return the targets of programs with their files."""
    return ((program.file, target) for program in programs for target in program.targets)


def aims_of(
    programs: Sequence[Program], choices: FilterSettings, axes: Axes
) -> tuple[list[Aim], list[tuple[str, Skipped]]]:
    """Return the aims of all targets, and by file the targets whose tool or frame is unknown or ambiguous.

    Aims at poses computed from a target come after the target's aim, and follow it.

    Raises:
        InputError: no target has both a known tool and a known frame.
    """
    problems: dict[str, Problem] = {}
    aims: list[Aim] = []
    doubtful: list[tuple[str, Skipped]] = []
    where = "this file" if len(programs) == 1 else "these files"
    new_name = _new_names(programs)
    for program in programs:
        known = replace(choices, tools={**program.tools, **choices.tools}, frames={**program.frames, **choices.frames})
        for target in program.targets:
            if unusual := axes.external_problem(target) or _norm_problem(target):
                doubtful.append((program.file, Skipped(target.name, target.line, "incomplete", unusual)))
                continue
            if target.turn is None:
                aims.append(Aim(file=program.file, target=target, readings=axes.readings(target, target.values)))
                continue
            first, *others = groups = _by_tool_and_frame(target, known, where)
            if others and (target.declared is None or any(moves.bound or moves.unknown for moves in others)):
                doubtful.append((program.file, _conflict(target, groups)))
                continue
            for what, unknown in first.unknown:
                message = unknown.note if unknown.name else f"{target.name}: {unknown.note}"
                problems.setdefault(f"{what} {unknown.name}", Problem(message, Path(program.file), target.line))
            if first.unknown:
                doubtful.append((program.file, replace(first.unknown[0][1], name=target.name, line=target.line)))
            for moves in groups:
                copy = "" if moves is first else new_name(target.name)
                aims += _of_moves(program.file, replace(target, uses=moves.uses), moves.placed, copy)
    if problems and not aims:
        raise InputError(problems.values())
    return aims, doubtful


def runs_of_moves(aims: Sequence[Aim], files: Sequence[str], elsewhere: Collection[tuple[str, int]]) -> list[list[int]]:
    """Return which aim each move goes to, in the order of its file, in runs between moves to unknown places.

    elsewhere: file and line of these. No run goes on in another file. An aim to which no move goes counts where it stands.
    """
    place = {file: k for k, file in enumerate(files)}
    moves = [(place[file], line, (0, 0), -1) for file, line in elsewhere]
    for k, aim in enumerate(aims):
        uses = (aim.use,) if aim.use else tuple(use for use in aim.target.uses if use.line and not use.computed)
        spots = [(use.file, use.line, use.span or (0, 0)) for use in uses]
        moves += [(place[file], line, span, k) for file, line, span in spots or [(aim.file, aim.target.line, (0, 0))]]
    runs: list[list[int]] = []
    for _, in_file in groupby(sorted(moves), key=lambda move: move[0]):
        runs.append([])
        for *_, k in in_file:
            if k >= 0:
                runs[-1].append(k)
            else:
                runs.append([])
    return [run for run in runs if run]


def _norm_problem(target: Target) -> str:
    """Return what is wrong with the norm of a target's quaternion, in words; empty if nothing."""
    length = float(np.linalg.norm(target.values[3:])) if target.turn == "quaternion" else 1.0
    return f"has a quaternion of length {length:.4g} instead of 1" if abs(length - 1) > UNIT_LENGTH else ""


def _by_tool_and_frame(target: Target, known: FilterSettings, where: str) -> list[_Moves]:
    """Return the moves to a target by tool and frame: first those bound to its name, then those with unknowns."""
    groups: list[_Moves] = []
    for use in target.uses or (Use(),):
        tool = _lookup("tool", use.tool, known.tool, known.tools, where)
        frame = _lookup("frame", use.frame, known.frame, known.frames, where)
        if isinstance(tool, np.ndarray) and isinstance(frame, np.ndarray):
            moves = _Moves((use,), (known.flange @ tool, known.base @ frame))
        else:
            pair = ("tool", tool), ("frame", frame)
            moves = _Moves((use,), None, tuple((what, why) for what, why in pair if isinstance(why, Skipped)))
        alike = next((k for k, group in enumerate(groups) if group.same_frames(moves)), None)
        if alike is None:
            groups.append(moves)
        else:
            groups[alike] = replace(groups[alike], uses=(*groups[alike].uses, use))
    return sorted(groups, key=lambda moves: (not moves.bound, not moves.unknown))


def _conflict(target: Target, groups: Sequence[_Moves]) -> Skipped:
    """Return why a target with several tools or frames is not corrected."""
    if unknown := [why for moves in groups for _, why in moves.unknown]:
        return replace(unknown[0], name=target.name, line=target.line)
    uses = [use for moves in groups for use in moves.uses]
    names = {"tools": dict.fromkeys(use.tool for use in uses), "frames": dict.fromkeys(use.frame for use in uses)}
    named = [f"{what} ({', '.join(filter(None, each))})" for what, each in names.items() if len(each) > 1]
    why = "some of its moves do not name it" if target.declared else "it has no declaration of its own to be repeated"
    note = f"is used with several {' and '.join(named)}: each needs a target of its own, and {why}"
    return Skipped(target.name, target.line, "several tools or frames", note)


def _of_moves(file: str, target: Target, placed: tuple[np.ndarray, np.ndarray] | None, copy: str) -> list[Aim]:
    """Return the aims of moves with one tool and frame; the first is the target itself if any move goes there."""
    if placed is None:
        return []
    itself = Aim(file=file, target=target, tool=placed[0], frame=placed[1], copy=copy)
    aims = [
        replace(itself, tool=itself.tool @ np.linalg.inv(place.after), frame=itself.frame @ place.before, use=use)
        for use in target.uses
        if (place := use.computed)
    ]
    if not aims:
        return [itself]
    if len(aims) < len(target.uses):
        aims = [itself, *aims]
    aims.sort(key=lambda aim: aim.use is not None and not np.allclose(aim.tool, itself.tool))
    return [aims[0], *(replace(aim, follows=True) for aim in aims[1:])]


def _lookup(
    what: str, name: str | None, usual: str | None, matrices: Mapping[str, np.ndarray], where: str
) -> np.ndarray | Skipped:
    """Return the tool or frame (4, 4) of a move, or why it is unknown."""
    wanted = name if name and name != "F" else usual
    if wanted is None:
        note = f"the program does not state the {what} of its moves: name it (--{what} NAME)"
        return Skipped("", 0, "unknown tool or frame", note)
    if wanted not in matrices:
        note = f"{what} '{wanted}' is not defined in {where}: state it (--{what} '{wanted}=…')"
        return Skipped(wanted, 0, "unknown tool or frame", note)
    return matrices[wanted]


def _new_names(programs: Sequence[Program]) -> Callable[[str], str]:
    """Return a function that derives from a target's name a numbered name that occurs in no file of the project."""
    taken: set[str] = set()

    def another(name: str) -> str:
        if not taken:
            taken.update(word.decode("latin-1").lower() for p in programs for word in re.findall(rb"[\w$]+", p.source))
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")  # languages have no other letters in names
        for k in count(2):
            new = f"{plain[: LONGEST_NAME - 1 - len(str(k))]}_{k}"
            if new.lower() not in taken:
                taken.add(new.lower())
                return new
        raise AssertionError

    return another


def second_targets(
    aims: Sequence[Aim], edits: Mapping[tuple[str, int, str], Sequence[Edit]], sources: Mapping[str, bytes]
) -> Iterator[tuple[str, Edit]]:
    """Yield (file, edit) pairs that declare second targets and redirect moves there, where either is corrected."""
    corrected = {key[:2] for key, changes in edits.items() if changes}
    for aim in aims:
        declared = aim.target.declared
        if not aim.copy or aim.follows or aim.key[:2] not in corrected or declared is None:
            continue
        yield aim.file, declared_again(declared, aim.copy, sources[aim.file], edits.get(aim.key, ()))
        for use in aim.target.uses:
            if use.span:
                yield use.file, Edit(*use.span, aim.copy)
