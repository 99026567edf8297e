"""Rows given for a calibration, in the format of its measurements: to predict, to reach, or measured later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calflow.calibration import Calibration
from calflow.deployment.attained import TARGET
from calflow.deployment.compensation import Compensation, compensate_rows, targets_in_measuring_frame
from calflow.deployment.inverse_kinematics import Targets
from calflow.deployment.prediction import Missing, beyond_limits
from calflow.faults.implausible import plausible
from calflow.files.deferred import pd
from calflow.files.problems import InputError, Problem, nearest, refuse, refuse_any
from calflow.files.tables import csv_text
from calflow.files.words import plural
from calflow.measurements.cells import read_cells
from calflow.measurements.measurements import Measurements, numbering_images
from calflow.measurements.rows import FRAME, LABELS, Layout, numbered
from calflow.measurements.source import MeasurementSource, sha256
from calflow.observations import observation_kinds
from calflow.robot.formats.frames_file import read_frames
from calflow.robot.mechanism import reading_columns
from calflow.run_folder import is_measured
from calflow.study import SeriesSource, Study

DISPENSABLE = ("split", "session", "repeat")  # mapped columns of the study's file that a new file may lack


@dataclass(frozen=True)
class GivenRows:
    """Rows of a user's CSV: the file's table with parsed numbers, without empty lines, and the measurements read."""

    table: pd.DataFrame
    data: Measurements
    source: MeasurementSource

    @staticmethod
    def of(path: Path, data: Measurements, source: MeasurementSource) -> GivenRows:
        """Return the rows of a CSV from which data was read, with the file's columns and order."""
        given = pd.read_csv(
            path, sep=source.separator, dtype=str, keep_default_na=False, skip_blank_lines=False, encoding="utf-8-sig"
        ).fillna("")
        given = given.iloc[data.table["line"] - 2].reset_index(drop=True)
        for name in given:
            labels = name in (*LABELS, FRAME)
            given[name] = data.table[name] if labels else pd.to_numeric(given[name].str.replace(source.decimal, "."))
        return GivenRows(given, data, source)

    def beside(self, answer: pd.DataFrame) -> pd.DataFrame:
        """Return the rows with the columns of an answer appended."""
        return pd.concat([self.table, answer], axis=1)

    def text(self, table: pd.DataFrame) -> str:
        """Return a table as CSV text with the separator and decimal sign of the given rows."""
        return csv_text(table, separator=self.source.separator, decimal=self.source.decimal)


def rows_to_predict(calibration: Calibration, rows: str | Path) -> GivenRows:
    """Return rows of a file at which marker positions are to be predicted.

    The file has a measurement file's columns except x, y and z, and the calibration's separator and decimal sign.

    Raises:
        InputError: the rows have errors.
    """
    path, source = Path(rows), calibration.source
    if path.suffix.lower() == ".mat":
        raise refuse("expected a CSV", path)
    how = {"separator": source.separator, "decimal": source.decimal}
    data = Measurements.to_predict(path, calibration.robot, time_origin=calibration.time_origin, **how)
    return GivenRows.of(path, plausible(data, path), source)


def compensate_file(
    calibration: Calibration, targets: str | Path, *, frames: str | Path | None = None, in_order: bool = False,
    missing: Missing = "refuse", seed: int = 1,
) -> tuple[GivenRows, Compensation]:  # fmt: skip
    """Return the targets of a CSV without their joint readings, and the joint commands that reach them.

    The file has x, y and z; optionally orientations, and the joint readings of the nominal robot; and a measurement
    file's payload, marker and conditions, with the separator and decimal sign of the calibration's measurements.

    Args:
        calibration: the calibration.
        targets: the CSV.
        frames: a TOML file of frames that its column `frame` names, besides measuring and base.
        in_order: whether the robot moves from row to row, so that approach directions follow from the commands.
        missing: whether rows that lack a needed condition are refused, or corrected without it.
        seed: seed of the start poses from which nominal readings are searched.

    Raises:
        InputError: targets or frames have errors.
    """
    path, source = Path(targets), calibration.source
    stated = {} if frames is None else read_frames(Path(frames))
    how = {"separator": source.separator, "decimal": source.decimal}
    data = Measurements.to_reach(path, calibration.robot, calibration.time_origin, **how)
    started = not np.isnan(data.joints).any()
    if not started:
        check_external(data, path)
    elif FRAME not in data.table:
        data = plausible(data, path)
    names = data.table[FRAME].astype(str) if FRAME in data.table else [""] * len(data)
    aims = Targets(data.position, data.rotation)
    asked = targets_in_measuring_frame(aims, list(names), stated, calibration.later(data.given), data.conditions)
    compensation = compensate_rows(
        calibration, data, asked, start=data.joints if started else None, in_order=in_order, missing=missing, seed=seed
    )
    table = GivenRows.of(path, data, source).table
    readings = numbered("q", data.robot.n_joints)
    table = table.drop(columns=[name for name in table if str(name).split("_")[0] in readings])
    notes = (*_start_notes(data, started), *calibration.notes, *compensation.notes)
    return GivenRows(table, data, source), replace(compensation, notes=notes)


def check_external(data: Measurements, path: Path) -> None:
    """Check that the readings of external axes, which no correction changes, are given for every target.

    Raises:
        InputError: they are missing for some targets.
    """
    refuse_any(
        Problem(f"expected {reading_columns(data.robot)[data.robot.driven.index(i)]} of every target: joint {i + 1} is an external "
                "axis, which stays where it is commanded", path)
        for i in data.robot.external if np.isnan(data.joints[:, i]).any()
    )  # fmt: skip


def _start_notes(data: Measurements, started: bool) -> list[str]:
    """Return notes on assumptions about the rows, and about the readings of the nominal robot."""
    if started:
        return [
            *data.notes,
            *beyond_limits(data, "the way to the target begins at the limit, and may not get there from it"),
        ]
    asked = "of the arm's joints" if data.robot.external else "q1 …"
    return [
        *data.notes,
        f"no columns {asked}: the arm keeps one posture, that which reaches most targets; for another, give the readings that the "
        "nominal robot would be sent to",
    ]


def rows_measured(calibration: Calibration, rows: str | Path, series: str = "") -> Measurements:
    """Return new measurements from a file, with notes on assumptions; all rows are evaluated, whatever their split.

    The file has the format of one of the calibration's series, with its mapping of columns, or calflow's own columns.

    Args:
        calibration: the calibration.
        rows: the file.
        series: the name of the series, or its kind where it has none; the first that the file can be read as by default.

    Raises:
        InputError: with all errors in the file, or there is no such series.
    """
    path, observed = Path(rows), calibration.model.observations
    names = [observation.part for observation in observed]
    if series and series not in names:
        raise refuse(f"expected {' or '.join(names)}, found {series}{nearest(series, names)}", key="series")
    failed = []
    for k in [names.index(series)] if series else range(len(observed)):
        try:
            measured = _rows_of_series(calibration, k, path)
            break
        except InputError as error:
            failed.append(error)
    else:
        raise min(failed, key=lambda error: len(error.problems))
    targets = [name for name in TARGET if name in measured.table]
    if targets and len(targets) < len(TARGET):
        missing = ", ".join(name for name in TARGET if name not in targets)
        raise refuse(f"missing column: expected {missing} beside {', '.join(targets)}", path, 1)
    read_as = (
        (f"read as rows of the series '{names[k]}'; --series says otherwise",)
        if len(observed) > 1 and not series
        else ()
    )
    notes = (*measured.notes, *read_as, *_seen(calibration, measured, path), *calibration.notes)
    return replace(measured, table=measured.table.assign(split="train"), notes=notes)


def _rows_of_series(calibration: Calibration, k: int, path: Path) -> Measurements:
    """Return the rows of a file as rows of the calibration's series k.

    Raises:
        InputError: with all errors in the file.
    """
    observed, sources = calibration.model.observations, calibration.request.sources
    source = sources[k] if k < len(sources) else calibration.source
    kind = observation_kinds()[observed[k].series.kind or "pose"]
    reports = replace(kind.columns, sigma=kind.units[0].dimension)
    layout = replace(source.layout, reports=reports)
    plain = Layout(separator=source.separator, decimal=source.decimal, in_order=source.in_order, tracker=source.tracker,
                   missing=source.missing, reports=reports)  # fmt: skip
    if layout.named:
        there = set(map(str, read_cells(path, layout, layout.named)))
        columns = {
            name: column for name, column in layout.columns.items() if column in there or name not in DISPENSABLE
        }
        layout = replace(layout, columns=columns) if there & set(layout.named) else plain
    measured = plausible(Measurements.from_csv(path, calibration.robot, **vars(layout)), path)
    table = measured.table.assign(series=k) if len(observed) > 1 else measured.table
    return numbering_images(replace(measured, table=table, series=tuple(each.series for each in observed)))


def _seen(calibration: Calibration, data: Measurements, path: Path) -> tuple[str, ...]:
    """Return a note if rows are among those to which the calibration was fitted."""
    lines = calibration.fitted_lines(data)
    if not lines:
        return ()
    inputs = calibration.folder.manifest.inputs if calibration.folder else {}
    same = sha256(path) in {digest for name, digest in inputs.items() if is_measured(name)}
    what = "is the very file that" if same else f"has {plural(len(lines), 'row')} that"
    return (
        f"{path.name} {what} the calibration was made of: errors at fitted poses are smaller than at new ones; "
        "measure new poses",
    )


def with_rows(study: Study, files: Sequence[Path]) -> Study:
    """Return a study with additional files of measured rows, which become its measurements if it has none."""
    if study.file.sources or not files:
        return replace(study, further=tuple(files))
    file = study.file.model_copy(update={"measurements": SeriesSource(file=str(files[0].resolve()))})
    return replace(study, file=file, further=tuple(files[1:]))
