"""What was asked: study, robot and workflow files as frozen objects."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from calflow.measurements import Measurements, MeasurementSource, draw_split, locate, read_measurements
from calflow.problems import InputError, Problem, nearest, refuse
from calflow.robot.description import Robot, read_robot
from calflow.toml_file import FileModel, line_numbers, read_toml, validate


class Split(FileModel):
    """How many poses no fit may see; drawn by pose, with the study's seed, unless the data say which."""

    holdout: float = Field(default=0.3, ge=0, lt=1)


class StudyFile(FileModel):
    """A study file as written."""

    name: str = Field(pattern=r"^[\w.-]+$")
    title: str = ""
    robot: str
    workflow: str = "calibrate"
    seed: int = Field(ge=0)
    effects: tuple[str, ...] = ("geometry", "joint-compliance")
    measurements: MeasurementSource | None = None
    split: Split = Split()
    stages: dict[str, dict[str, Any]] = {}

    @field_validator("effects")
    @classmethod
    def _known_effects(cls, effects: tuple[str, ...]) -> tuple[str, ...]:
        from calflow.effects import catalogue

        for effect in effects:
            if effect not in catalogue():
                raise ValueError(f"unknown effect '{effect}'{nearest(effect, catalogue())}")
        if not effects or len(set(effects)) < len(effects):
            raise ValueError("expected at least one effect, and each once")
        return effects


class WorkflowFile(FileModel):
    """A workflow file as written: the stages in order; a table a stage holds its settings."""

    name: str
    stages: tuple[str, ...] = Field(min_length=1)
    settings: dict[str, dict[str, Any]] = {}


@dataclass(frozen=True)
class Study:
    """A study with its robot and workflow, ready to run; settings holds each stage's table, study over workflow."""

    path: Path
    file: StudyFile
    robot: Robot
    robot_path: Path
    workflow: WorkflowFile
    workflow_path: Path

    @property
    def name(self) -> str:
        """The study's name, which names its run folder."""
        return self.file.name

    @property
    def measurement_path(self) -> Path:
        """The measurement file.

        Raises:
            InputError: the study names none, or it cannot be found.
        """
        if self.file.measurements is None:
            raise refuse("has no measurements yet: expected a table [measurements] with file = …", self.path)
        return locate(self.file.measurements, self.path.parent)

    def measurements(self) -> Measurements:
        """Read the measurements, split into train and holdout."""
        path = self.measurement_path
        measured = read_measurements(path, self.robot, self.file.measurements)
        self._check_masses()
        return draw_split(measured, self.file.split.holdout, self.file.seed)

    def settings(self, stage: str) -> dict[str, Any]:
        """Return a stage's settings: the workflow's, overridden by the study's."""
        return {**self.workflow.settings.get(stage, {}), **self.file.stages.get(stage, {})}

    def validated_settings(self, stage: str, kind: type[FileModel]) -> FileModel:
        """Check a stage's settings; a problem is told in the file that it stands in."""
        own = self.file.stages.get(stage, {})
        base = self.workflow.settings.get(stage, {})
        workflow_lines = line_numbers(self.workflow_path.read_text(encoding="utf-8"))
        validate(
            base,
            kind,
            self.workflow_path,
            {k[2:]: n for k, n in workflow_lines.items() if k[:2] == ("settings", stage)},
        )
        lines = line_numbers(self.path.read_text(encoding="utf-8"))
        here = {key[2:]: number for key, number in lines.items() if key[:2] == ("stages", stage)}
        return validate({**base, **own}, kind, self.path, here)

    def _check_masses(self) -> None:
        from calflow.effects import catalogue

        for effect in self.file.effects:
            if "masses" in catalogue()[effect].needs and not self.robot.has_masses:
                raise refuse(
                    f"effect '{effect}' needs the mass of every joint's link (mass_kg, com_mm)",
                    self.robot_path,
                )


def load_study(path: str | Path) -> Study:
    """Read a study file with the robot and workflow it names; measurements are read when a stage asks for them.

    Raises:
        InputError: with all problems of the files read.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "study.toml"
    file = read_toml(path, StudyFile)
    problems: list[Problem] = []
    robot_path = path.parent / file.robot
    try:
        robot = read_robot(robot_path)
    except InputError as error:
        problems += error.problems
    try:
        workflow_path = find_workflow(file.workflow, path)
        workflow = read_toml(workflow_path, WorkflowFile)
    except InputError as error:
        problems += error.problems
    if problems:
        raise InputError(problems)
    return Study(path, file, robot, robot_path, workflow, workflow_path)


def workflow_folder() -> Path:
    """Return the folder of calflow's own workflows, installed or in the source tree."""
    installed = Path(__file__).parent / "_workflows"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "workflows"


def find_workflow(name: str, study: Path) -> Path:
    """Return the workflow file: a path beside the study where the name ends in .toml, else one of calflow's own."""
    if name.endswith(".toml"):
        return study.parent / name
    path = workflow_folder() / f"{name}.toml"
    if not path.is_file():
        known = sorted(file.stem for file in workflow_folder().glob("*.toml"))
        raise refuse(
            f"unknown workflow '{name}'; there are {', '.join(known)}{nearest(name, known)}",
            study,
            key="workflow",
        )
    return path
