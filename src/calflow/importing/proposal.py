"""Import proposals: measurements from foreign tables, the origin of each column and its reason, and notes."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calflow.files.deferred import pd
from calflow.files.problems import InputError, Problem, nearest, refuse, refuse_any
from calflow.files.units import split_unit
from calflow.files.words import listed, rounded
from calflow.importing.bag import bag_tables, is_bag
from calflow.importing.column_choice import ONE_POSE, Choice, chosen_columns
from calflow.importing.column_role import seconds
from calflow.importing.foreign_table import ForeignTable, foreign_tables
from calflow.importing.joined_rows import ONLY, Joined, joined_rows
from calflow.importing.joint_mapping import FACTORS, SCALES, FittedReading, FlangeKinematics, readings_of
from calflow.importing.orientation import infer_orientations
from calflow.measurements.rows import POSES
from calflow.observations import observation_kinds
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class ColumnOrigin:
    """The origin of a column of the measurements: the file's column, its conversion, and the reason for the choice."""

    ours: str
    theirs: str
    how: str
    reason: str


@dataclass(frozen=True)
class ImportProposal:
    """Measurements in calflow's format, with the origin of each column and notes for the user."""

    table: pd.DataFrame
    origins: tuple[ColumnOrigin, ...]
    notes: tuple[str, ...]


Imported = tuple[ColumnOrigin, Mapping[str, object]]  # columns that have one origin, with the values of all rows


def propose_import(
    paths: Sequence[Path], robot: Robot, stated: Mapping[str, str] | None = None, sigma_rotation: float | None = None
) -> ImportProposal:
    """Return the measurements in files: joints by the robot's forward kinematics, other columns by names and values.

    stated maps calflow's column names to those of the files, with a minus before a joint of opposite sign; these are
    not inferred. sigma_rotation [rad] is the standard deviation of measured orientations, omitted if it is None.

    Raises:
        InputError: a file cannot be read, or the columns cannot be determined.
    """
    tables = [table for path in paths for table in (bag_tables(path) if is_bag(path) else foreign_tables(path))]
    settings = dict(stated or {})
    _check_stated(settings, tables)
    tables = [_in_stated_units(table, settings) for table in _appended(tables)]
    problems: list[Problem] = []
    for joined in joined_rows(tables, robot, settings, problems):
        try:
            return _proposed(joined.still(robot), robot, settings, sigma_rotation)
        except InputError as error:
            problems += error.problems
    raise InputError([*_of_other_kinds(tables)] or dict.fromkeys(problems))


def _of_other_kinds(tables: Sequence[ForeignTable]) -> Iterator[Problem]:
    """Return for each table that has what another device than one of positions reports, how a study reads it."""
    for table in tables:
        names = {split_unit(column.name)[0] for column in table.columns}
        asked = {kind.id: {*kind.columns.needed, *kind.columns.within} for kind in observation_kinds().values()}
        suited = [name for name in asked if asked[name] and not {*POSES.needed} & asked[name] and asked[name] <= names]
        if suited:
            kind = max(suited, key=lambda name: len(asked[name]))
            yield Problem(
                f'{table.path.name}: has what kind = "{kind}" reads, and no points to import: name the file in the study, with '
                "that kind, and its columns in [measurements.columns] if they have other names"
            )


def stated_columns(pairs: Sequence[str]) -> dict[str, str]:
    """Return the columns that options `OURS=NAME` state, as a mapping from calflow's names to the file's.

    Raises:
        InputError: an option is not such a pair, or its column cannot be stated.
    """
    names = ("q1_deg", "q1_rad", "q1_mm", "q1_m", *(f"{axis}_{unit}" for axis in "xyz" for unit in SCALES), "time_s", "pose",
             "marker", "payload")  # fmt: skip
    stated = {}
    for pair in pairs:
        ours, sign, theirs = pair.partition("=")
        kind = "q1" + ours[ours.find("_") :] if ours[:1] == "q" and ours[1:].split("_")[0].isdigit() else ours
        if not sign or not theirs or kind not in names:
            raise refuse(
                f"expected OURS=NAME, found '{pair}'{nearest(ours, names) or '.'} OURS may be q1_deg …, x_mm, y_mm, z_mm, "
                "time_s, pose, marker or payload; a study reads other columns by [measurements.columns]",
                key="--column",
            )
        stated[ours] = theirs
    return stated


def _appended(tables: Sequence[ForeignTable]) -> list[ForeignTable]:
    """The tables, with those of identical column names concatenated."""
    merged: list[ForeignTable] = []
    for table in tables:
        titles = [column.title for column in table.columns]
        same = [k for k, other in enumerate(merged) if table.named and [c.title for c in other.columns] == titles]
        if not same:
            merged.append(table)
            continue
        before = merged[same[0]]
        columns = tuple(
            replace(a, cells=pd.concat([a.cells, b.cells], ignore_index=True), figures=np.r_[a.figures, b.figures])
            for a, b in zip(before.columns, table.columns, strict=True)
        )
        reasons = (*before.reasons, f"rows of {table.title} follow")
        merged[same[0]] = replace(before, columns=columns, reasons=reasons)
    return merged


def _check_stated(stated: Mapping[str, str], tables: Sequence[ForeignTable]) -> None:
    """Refuse stated columns that no table has, and a point with fewer than three stated coordinates."""
    there = {name for table in tables for column in table.columns for name in (column.name, column.title)}
    refuse_any(
        Problem(f"no column '{theirs.lstrip('-')}'{nearest(theirs.lstrip('-'), there)}", key=f"--column {ours}")
        for ours, theirs in stated.items()
        if theirs.lstrip("-") not in there
    )
    if 0 < sum(ours.partition("_")[0] in ("x", "y", "z") for ours in stated) < 3:
        raise refuse("expected all of x, y and z, or none", key="--column")


def _in_stated_units(table: ForeignTable, stated: Mapping[str, str]) -> ForeignTable:
    """The table with the units of stated columns, where the file gives none."""
    units = {theirs.lstrip("-"): ours.partition("_")[2] for ours, theirs in stated.items()}
    columns = tuple(replace(column, unit=column.unit or units.get(column.name, "")) for column in table.columns)
    return replace(table, columns=columns)


def _marker(joined: Joined, robot: Robot) -> tuple[str, list[str] | None]:
    """The most frequent marker, by which the mapping is identified, and the marker of each row if a column states it.

    Raises:
        InputError: the robot has several markers, and no column says to which a row belongs.
    """
    names = {name.lower(): name for name in robot.markers}
    if "marker" in joined.roles.labels:
        markers = [
            names.get(str(cell).lower(), str(cell)) for cell in joined.columns[joined.roles.labels["marker"]].cells
        ]
        return max(set(markers), key=markers.count), markers
    if len(names) > 1:
        raise refuse(
            f"{joined.title}: no column says which of the robot's markers ({', '.join(robot.markers)}) a row is of: expected one "
            "that holds these names, or a robot file with the marker that was measured alone"
        )
    return next(iter(robot.markers)), None


def _proposed(joined: Joined, robot: Robot, stated: Mapping[str, str], sigma_rotation: float | None) -> ImportProposal:
    """The proposal for joined rows of joints and points.

    Raises:
        InputError: the columns cannot be determined.
    """
    marker, markers = _marker(joined, robot)
    flange = FlangeKinematics.of(robot, marker)
    rows = np.full(len(joined), True) if markers is None else np.array([name == marker for name in markers])
    choice, computed = chosen_columns(joined, flange, marker, rows, stated)
    readings = readings_of(choice.mapping.taken.hypothesis, joined.figures)
    position = joined.figures[:, choice.points] * SCALES[choice.unit]
    complete = np.isfinite(readings).all(axis=1) & np.isfinite(position).all(axis=1)
    parts = [_poses(joined, readings, complete), *_labels(joined, robot, markers), *_conditions(joined)]
    parts += [*_joints(joined, robot, choice.mapping.taken, readings), *_point(joined, choice, position)]
    notes = [*joined.notes, *computed]
    if not complete.all():
        notes.append(f"{int((~complete).sum())} of {len(complete)} rows lack joints or a point, and are left out")
    notes += _doubts(joined, robot, choice, marker)
    if joined.roles.turns:
        parts += _orientations(joined, readings, complete, flange, sigma_rotation, notes)
    origins = tuple(origin for origin, _ in parts)
    notes += _left_out(joined, {origin.theirs for origin in origins})
    columns = {name: values for _, part in parts for name, values in part.items()}
    return ImportProposal(pd.DataFrame(columns)[complete].reset_index(drop=True), origins, tuple(notes))


def _labels(joined: Joined, robot: Robot, markers: list[str] | None) -> Iterator[Imported]:
    """The marker and the payload of each row, where columns state them."""
    columns = {name: joined.columns[k] for name, k in joined.roles.labels.items()}
    payloads = {name.lower(): name for name in robot.payloads}
    values = {"marker": markers} if markers is not None else {}
    if "payload" in columns:
        values["payload"] = [payloads[str(cell).lower()] if cell else "" for cell in columns["payload"].cells]
    for name, labels in values.items():
        origin = ColumnOrigin(name, columns[name].title, "as it is", "it holds the robot file's names")
        yield origin, {name: labels}


def _conditions(joined: Joined) -> Iterator[Imported]:
    """The time and the temperature of each row, where columns state them."""
    if joined.roles.time is not None:
        clock = joined.columns[joined.roles.time]
        time = np.round(seconds(clock) - np.nanmin(seconds(clock)), 6)
        reason = "its name" if clock.name else "it only grows"
        yield ColumnOrigin("time_s", clock.title, "s since the first row", reason), {"time_s": time}
    if joined.roles.temperature is not None:
        warm = joined.columns[joined.roles.temperature]
        origin = ColumnOrigin("temperature", warm.title, "as it is", "its name and unit")
        yield origin, {f"temperature_{'K' if warm.unit == 'K' else 'degC'}": warm.figures}


def _joints(joined: Joined, robot: Robot, taken: FittedReading, readings: np.ndarray) -> Iterator[Imported]:
    """The readings (n_rows, n) [rad or m] of the driven joints."""
    named, chosen = joined.roles.joints, taken.hypothesis
    first = "stated" if ("stated",) in named else "its name" if named else "by the robot's kinematics"
    for k, i in enumerate(robot.driven):
        shown, factor = robot.joints[i].shown
        turned = chosen.signs[k] < 0
        changed = [*(["sign turned"] if turned else []), *_from_unit(chosen.factors[k], shown)]
        reason = first if named else "so too"
        if turned:
            reason = "with its sign turned the robot fits, else it does not"
        elif k == 0:
            reason = f"{first}; the nominal robot is then {rounded(1e3 * taken.error, 2)} mm off (median)"
        name, theirs = f"q{i + 1}_{shown}", joined.columns[chosen.columns[k]].title
        origin = ColumnOrigin(name, theirs, ", ".join(changed) or "as it is", reason)
        yield origin, {name: readings[:, k] * factor}


def _point(joined: Joined, choice: Choice, position: np.ndarray) -> Iterator[Imported]:
    """The coordinates of the measured point (n_rows, 3) [m]."""
    named = joined.roles.points and choice.group != ONLY
    why = "stated" if choice.group == ("stated",) else "its name" if named else "the only three that fit"
    for axis, k, values in zip("xyz", choice.points, position.T, strict=True):
        column, name = joined.columns[k], f"{axis}_mm"
        reason = why if column.unit else f"{why}, unit by the robot's size"
        how = "as it is" if choice.unit == "mm" else f"from {choice.unit}"
        yield ColumnOrigin(name, column.title, how, reason), {name: 1e3 * values}


def _doubts(joined: Joined, robot: Robot, choice: Choice, name: str) -> Iterator[str]:
    """Notes on the points' scale, a marker that is not at its place, and signs that cannot be told."""
    taken, marker = choice.mapping.taken, robot.markers[name]
    if abs(taken.scale - 1) > 0.02:
        yield f"the points are {rounded(taken.scale)} times as far apart as the robot's: is their unit {choice.unit}?"
    if marker.known and np.linalg.norm(taken.marker - np.array(marker.point)) > 0.02:
        place = ", ".join(f"{1e3 * v:z.0f}" for v in taken.marker)
        yield (
            f"marker '{name}' is near ({place}) mm by these points, and elsewhere in the robot file: known = false there lets"
            " the poses say where"
        )
    if choice.mapping.untold and ("stated",) not in joined.roles.joints:
        each = [" with ".join(f"q{robot.driven[k] + 1}" for k in joints) for joints in choice.mapping.untold]
        yield f"the sign of {', and of '.join(each)} cannot be told: the points fit as well with it turned"


def _left_out(joined: Joined, taken: Collection[str]) -> list[str]:
    """The note that lists the columns not imported, except orientations, on which there is a separate note."""
    turns = {k for group in joined.roles.turns.values() for k in group.values()}
    titles = [column.title for k, column in enumerate(joined.columns) if column.title not in taken and k not in turns]
    if not titles:
        return []
    quoted = listed([f"'{title}'" for title in dict.fromkeys(titles)])
    return [
        f"left out: {quoted}. For approach, session and the like, map your file in the study: [measurements.columns]"
    ]


def _orientations(
    joined: Joined, readings: np.ndarray, good: np.ndarray, flange: FlangeKinematics, sigma: float | None, notes: list[str]
) -> list[Imported]:  # fmt: skip
    """The columns of measured orientations if convention, tool and standard deviation are known, else a note."""
    members = next(iter(joined.roles.turns.values()))
    rows = tuple(replace(column, figures=column.figures[good]) for column in joined.columns)
    orientations = infer_orientations(rows, members, flange.at(readings[good])[1])
    if orientations is None:
        notes.append("orientations are left out: in no convention do they turn as the robot does")
        return []
    if flange.robot.tool_rotation is None or sigma is None:
        tool = ", ".join(f"{np.rad2deg(angle):z.1f}" for angle in orientations.tool)
        wanted = [
            *([f"tool_rotation_deg = [{tool}] in the robot file"] if flange.robot.tool_rotation is None else []),
            *(["--sigma-rotation-mrad"] if sigma is None else []),
        ]
        notes.append(f"orientations ({orientations.convention}) are left out: with {' and '.join(wanted)} they come in")
        return []
    parts = np.full((len(good), 4), np.nan)
    parts[good] = orientations.turns.as_quat(canonical=True, scalar_first=True)
    theirs = ", ".join(joined.columns[k].title for k in orientations.columns)
    origin = ColumnOrigin(
        "qw … qz", theirs, f"from {orientations.convention}", "so they turn as the robot does, and in no other way"
    )
    stated = ColumnOrigin("sigma_rotation_mrad", "", f"{1e3 * sigma:g}", "stated")
    quaternion = dict(zip(("qw", "qx", "qy", "qz"), parts.T, strict=True))
    return [(origin, quaternion), (stated, {"sigma_rotation_mrad": np.full(len(good), 1e3 * sigma)})]


def _from_unit(factor: float, shown: str) -> list[str]:
    unit = next(
        name
        for name, value in FACTORS.items()
        if value == factor and (name in ("deg", "rad", "mrad")) == (shown == "deg")
    )
    return [] if unit == shown else [f"from {unit}"]


def _poses(joined: Joined, readings: np.ndarray, complete: np.ndarray) -> Imported:
    """The pose of each row: from a column that agrees with the readings, else by groups of nearly equal readings.

    complete: which rows are imported.
    """
    numbers = _clusters(readings)
    if "pose" in joined.roles.labels:
        column = joined.columns[joined.roles.labels["pose"]]
        names = [f"{v:g}" for v in column.figures] if column.is_figures else [str(cell) for cell in column.cells]
        pairs = set(zip(names, numbers, strict=True))
        if all(names) and len(pairs) == len(set(names)) == len(set(numbers)):
            origin = ColumnOrigin("pose", column.title, "as it is", "its name, and rows of one have equal joints")
            return origin, {"pose": names}
    origin = ColumnOrigin(
        "pose", "", "numbered", f"rows of equal joints are one pose: {len(set(np.array(numbers)[complete]))}"
    )
    return origin, {"pose": [str(k) for k in numbers]}


def _clusters(readings: np.ndarray) -> list[int]:
    """Group numbers (from 1, in order of appearance) of rows with nearly equal readings (n_rows, n)."""
    leaders = np.empty((0, readings.shape[1]))
    numbers = []
    for row in readings:
        near = np.flatnonzero((np.abs(leaders - row) < ONE_POSE).all(axis=1))
        if len(near):
            numbers.append(int(near[0]) + 1)
        else:
            leaders = np.vstack([leaders, row])
            numbers.append(len(leaders))
    return numbers
