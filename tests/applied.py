"""What a calibration is used for, of a run folder and files, as the commands do it."""

from __future__ import annotations

from dataclasses import replace

from calflow.calibration import Calibration
from calflow.deployment import check_poses
from calflow.deployment import drift as drifting
from calflow.deployment.compensation import command_table
from calflow.deployment.prediction import predict_rows
from calflow.programs import filtering
from calflow.runs.between_runs import compare_runs, history_of_runs
from calflow.runs.given_rows import compensate_file, rows_measured, rows_to_predict


def predict(run, rows, missing="refuse"):
    """The rows of a CSV with where their marker will be; attrs["notes"] say what was assumed."""
    calibration = Calibration.load(run)
    given = rows_to_predict(calibration, rows)
    predicted = predict_rows(calibration, given.data, missing)
    table = given.beside(predicted.table)
    table.attrs["notes"] = (*calibration.warnings, *given.data.notes, *calibration.notes, *predicted.notes)
    return table


def compensate(run, targets, **asked):
    """The targets of a CSV with the joint readings that land on them; attrs["notes"] say what was assumed."""
    calibration = Calibration.load(run)
    given, found = compensate_file(calibration, targets, **asked)
    table = given.beside(command_table(found, asked.get("in_order", False)))
    table.attrs["notes"] = (*calibration.warnings, *found.notes)
    return table


def export_run(run, to):
    """The calibrated robot in a format."""
    calibration = Calibration.load(run)
    found = calibration.export(to)
    return replace(found, notes=(*calibration.warnings, *found.notes))


def filter_program(run, program, **asked):
    """A robot program that lands where it says."""
    calibration = Calibration.load(run)
    done = filtering.filter_program(calibration, program, **asked)
    return replace(done, notes=(*calibration.warnings, *calibration.notes, *done.notes))


def validate(run, rows, **asked):
    """A run's robot held against new measurements."""
    calibration = Calibration.load(run)
    return calibration.validate(rows_measured(calibration, rows), **asked)


def drift(run, rows, **asked):
    """Whether anything has moved since a run."""
    calibration = Calibration.load(run)
    return drifting.drift(calibration, rows_measured(calibration, rows), seed=calibration.seed, **asked)


def choose_check_poses(run, rows, number):
    """Poses to check a run's robot by."""
    calibration = Calibration.load(run)
    return check_poses.choose_check_poses(calibration, rows_measured(calibration, rows), number)


def compare(*runs):
    """Runs side by side."""
    return compare_runs(*map(Calibration.load, runs))


def history(*runs, **asked):
    """A robot over time."""
    return history_of_runs(*map(Calibration.load, runs), **asked)
