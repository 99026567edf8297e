"""New measurements: a file that was measured after a run, read as the run's own were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from calflow.deployment.attained import TARGET
from calflow.estimation.calibrated_model import ModelObservation
from calflow.estimation.plausibility import plausible
from calflow.files.problems import refuse
from calflow.measurements.cells import read_cells
from calflow.measurements.layout import Layout
from calflow.measurements.measurements import Measurements
from calflow.measurements.reading import sha256
from calflow.run_folder import is_measured
from calflow.runs.calibrated_run import CalibratedRun

SEEN_FROM_OUTSIDE = ("position", "pose")
DISPENSABLE = ("split", "session", "repeat")  # what a mapped column of the study's file may say that a new one need not


def read_new(run: CalibratedRun, rows: str | Path) -> Measurements:
    """Return the rows of a file, with what was assumed of them in notes; all of them are to be judged, whatever their split.

    It is written as the study's (first) measurements are, mapping of foreign columns included, or has calflow's own columns.

    Raises:
        InputError: with everything that is wrong in the file, or the run's device does not see the robot from outside.
    """
    path = Path(rows)
    kinds = [row.kind for row in run.results.rows("identify/observations.csv", ModelObservation)]
    if kinds[0] not in SEEN_FROM_OUTSIDE:
        raise refuse(
            f"was calibrated by '{kinds[0]}': expected a run whose first measurements are positions or poses",
            run.folder,
        )
    source = run.source
    layout = source.layout
    plain = Layout(separator=source.separator, decimal=source.decimal, in_order=source.in_order, tracker=source.tracker,
                   missing=source.missing)  # fmt: skip
    if layout.named:
        there = set(map(str, read_cells(path, plain)))
        columns = {
            name: column for name, column in layout.columns.items() if column in there or name not in DISPENSABLE
        }
        layout = replace(layout, columns=columns) if there & set(layout.named) else plain
    measured = plausible(Measurements.from_csv(path, run.robot, **vars(layout)), path)
    targets = [name for name in TARGET if name in measured.table]
    if targets and len(targets) < len(TARGET):
        lacking = ", ".join(name for name in TARGET if name not in targets)
        raise refuse(f"missing column: expected {lacking} beside {', '.join(targets)}", path, 1)
    return replace(
        measured,
        table=measured.table.assign(split="train"),
        notes=(*measured.notes, *_seen(run, path), *run.notes),
    )


def _seen(run: CalibratedRun, path: Path) -> tuple[str, ...]:
    """Say that a file is one that the run was made of; a part of it, or a copy written otherwise, is not recognised."""
    used = {digest for name, digest in run.manifest.inputs.items() if is_measured(name)}
    if sha256(path) not in used:
        return ()
    return (f"{path.name} is the very file that the calibration was made of: at poses that it was fitted to errors are smaller "
            "than at others; measure new ones",)  # fmt: skip
