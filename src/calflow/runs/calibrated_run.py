"""A calibrated run: the robot that a run folder identified, opened to be used on further rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calflow.deployment.needed_conditions import NeededCondition
from calflow.estimation.calibrated_model import CalibratedModel, calibrated
from calflow.estimation.fit_summary import IdentifySummary
from calflow.faults.base import FaultyRow
from calflow.files.problems import refuse
from calflow.files.results import Results
from calflow.files.tables import lacking
from calflow.files.toml import read_toml
from calflow.measurements.source import MeasurementSource
from calflow.robot.robot import Robot
from calflow.runs.folder import read_results, run_folder
from calflow.runs.manifest import Manifest, read_manifest
from calflow.runs.reasons import damage, of_others, outdated
from calflow.runs.study_files import check_inputs
from calflow.stages import STAGES
from calflow.study import FIELD
from calflow.study_file import StudyFile, WorkflowFile


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
        folder = run_folder(Path(study_or_run))
        manifest = read_manifest(folder)
        if manifest is None:
            raise refuse("holds no run: expected a folder that 'calflow run' has filled", folder)
        check_inputs(folder, manifest)
        robot = Robot.from_toml(folder / "inputs" / "robot.toml")
        reason = outdated(manifest, folder, "identify", robot)
        if reason:
            raise refuse(f"holds no identified robot: {reason}; run the study again", folder)
        results = read_results(manifest, folder, "identify")
        undiagnosed = _without_diagnosis(manifest, folder, robot)
        if undiagnosed is None:
            results |= read_results(manifest, folder, "diagnose")
        file = read_toml(folder / "inputs" / "study.toml", StudyFile)
        asked = file.residual_field or FIELD in read_toml(folder / "inputs" / "workflow.toml", WorkflowFile).stages
        lacking = _without_field(manifest, folder, robot, "diagnose/effects.csv" in results) if asked else None
        if asked and lacking is None:
            results |= read_results(manifest, folder, FIELD)
        without = (
            *([f"what diagnose found: {undiagnosed}"] if undiagnosed else []),
            *([f"the residual field that the study asks for: {lacking}"] if lacking else []),
        )
        return CalibratedRun(folder, manifest, robot, file, results, without)

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
        from calflow.reporting.tolerance import warning

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


def _without_diagnosis(manifest: Manifest, folder: Path, robot: Robot) -> str | None:
    """Return why diagnose does not hold for the results of identify, empty where it was never run; None where it does.

    Raises:
        InputError: its files were changed, so that the model would be another than the one that the run tells of.
    """
    entry = manifest.stages.get("diagnose")
    if entry is None:
        return ""
    reason = _unfit(manifest, folder, robot, "diagnose", ("identify",))
    if reason and entry.status == "done" and reason == damage(entry, folder):
        raise refuse(f"holds no diagnosed robot any more: {reason}; run the study again", folder)
    return reason


def _without_field(manifest: Manifest, folder: Path, robot: Robot, diagnosed: bool) -> str | None:
    """Return why a residual field does not hold for the results of identify, or of diagnose; None where it does."""
    return _unfit(manifest, folder, robot, FIELD, ("identify", "diagnose") if diagnosed else ("identify",))


def _unfit(manifest: Manifest, folder: Path, robot: Robot, stage: str, bases: tuple[str, ...]) -> str | None:
    """Return why a stage's results are not of those of its bases, or do not hold for a robot; None where all is well."""
    return outdated(manifest, folder, stage, robot) or of_others(manifest, stage, bases)
