"""A calibrated run: the robot that a run folder identified, opened to be used on further rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calflow.deployment.usability import warning
from calflow.estimation.calibrated_model import CalibratedModel, calibrated
from calflow.estimation.fit_summary import IdentifySummary
from calflow.estimation.needed_conditions import NeededCondition
from calflow.faults.base import FaultyRow
from calflow.files.results import Results
from calflow.files.tables import lacking
from calflow.measurements.source import MeasurementSource
from calflow.robot.robot import Robot
from calflow.run_folder import (
    Manifest,
    read_calibrated,
)
from calflow.stages import STAGES
from calflow.study_file import StudyFile


@dataclass(frozen=True)
class CalibratedRun:
    """A run folder that holds an identified robot: its study's and robot's files, and the results of identify and diagnose.

    without says what the model lacks that the run, or its study, would add, and why.
    """

    folder: Path
    manifest: Manifest
    robot: Robot
    file: StudyFile
    results: Results
    without: tuple[str, ...] = ()

    @staticmethod
    def of(study_or_run: str | Path) -> CalibratedRun:
        """Open a run that is named by its folder, or by its study.

        Raises:
            InputError: the run has not identified yet, or what it wrote of its model, or read, was changed since.
        """
        read = read_calibrated(study_or_run)
        return CalibratedRun(read.folder, read.manifest, read.robot, read.file, read.results, read.without)

    def known(self, given: tuple[str, ...]) -> CalibratedModel:
        """Return the best model there is, for rows with these optional conditions."""
        return calibrated(self.robot, self.results, given)

    @property
    def stage(self) -> str:
        """The stage that the best model is of."""
        return "diagnose" if "diagnose/effects.csv" in self.results else "identify"

    @property
    def needed(self) -> list[NeededCondition]:
        """The conditions that it must be told of a row."""
        return self.results.rows(f"{self.stage}/needed_conditions.csv", NeededCondition)

    @property
    def time_origin(self) -> float | None:
        """The reading of the clock from which its times count [s]."""
        return self.results.document("identify/summary.json", IdentifySummary).time_origin_s

    @property
    def source(self) -> MeasurementSource:
        """How the study's own measurements, those of its first series, are written."""
        return self.file.sources[0]

    @property
    def columns_mended(self) -> list[str]:
        """Say which columns of its measurements were wrong throughout: further rows are taken as they stand."""
        faults = self.results.rows("identify/faults.csv", FaultyRow)
        whole = [one.statement for one in faults if one.row == 0 and one.action == "corrected"]
        return [f"{said}; the rows given now are taken to be right" for said in whole]

    @property
    def warning(self) -> tuple[str, ...]:
        """Say that its own report finds that the model is not to be used; nothing where it may be."""
        declared = {**STAGES["identify"].tables, **STAGES["diagnose"].tables}
        tables = self.results.tables
        older = [name for name, rows in declared.items() if name in tables and lacking(tables[name], rows)]
        if older:
            return (f"whether the model is to be used cannot be told from {', '.join(older)}, which another version of calflow "
                    "made; run the study again",)  # fmt: skip
        said = warning(self.results)
        return () if said is None else (said,)

    @property
    def notes(self) -> tuple[str, ...]:
        """What there is to say of it whatever rows are given."""
        return (*self.columns_mended, *(f"without {said}; run the study again" for said in self.without))
