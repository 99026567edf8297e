"""A calibrated run: the robot that a run folder identified, opened to be used on further rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calflow.deployment.needed_conditions import NeededCondition
from calflow.estimation.calibrated import Identified, calibrated
from calflow.estimation.fit_summary import IdentifySummary
from calflow.files.problems import refuse
from calflow.files.results import Results
from calflow.files.toml import read_toml
from calflow.measurements.source import MeasurementSource
from calflow.robot.robot import Robot
from calflow.runs.folder import read_results, run_folder
from calflow.runs.manifest import Manifest, read_manifest
from calflow.runs.reasons import outdated
from calflow.study import StudyFile


@dataclass(frozen=True)
class CalibratedRun:
    """A run folder that holds an identified robot: its study's and robot's files, and the results of identify and diagnose."""

    folder: Path
    manifest: Manifest
    robot: Robot
    file: StudyFile
    results: Results

    @staticmethod
    def of(study_or_run: str | Path) -> CalibratedRun:
        """Open a run that is named by its folder, or by its study.

        Raises:
            InputError: the run has not identified yet, or its files were changed.
        """
        folder = run_folder(Path(study_or_run))
        manifest = read_manifest(folder)
        if manifest is None:
            raise refuse("holds no run: expected a folder that 'calflow run' has filled", folder)
        robot = Robot.from_toml(folder / "inputs" / "robot.toml")
        reason = outdated(manifest, folder, "identify", robot)
        if reason:
            raise refuse(f"holds no identified robot: {reason}; run the study again", folder)
        results = read_results(manifest, folder, "identify")
        if outdated(manifest, folder, "diagnose", robot) is None:
            results |= read_results(manifest, folder, "diagnose")
        return CalibratedRun(folder, manifest, robot, read_toml(folder / "inputs" / "study.toml", StudyFile), results)

    def known(self, given: tuple[str, ...]) -> Identified:
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
        faults = self.results.tables["identify/faults.csv"]
        whole = faults[(faults["row"] == 0) & (faults["action"] == "corrected")]
        return [f"{said}; the rows given now are taken to be right" for said in whole["statement"]]
