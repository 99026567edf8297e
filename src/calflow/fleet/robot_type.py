"""A type of robots: the study whose settings they share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from calflow.files.problems import InputError
from calflow.files.toml import Origin, read_toml
from calflow.fleet.fleet_file import TypeTable, beyond_reach
from calflow.robot.formats import robot_file
from calflow.robot.robot import Robot
from calflow.runs.planning import stages_of
from calflow.study import Study, check_effects, load_study, study_path
from calflow.study_file import StudyFile

NEEDED = "identify"  # the stage without which nothing is known of a robot


@dataclass(frozen=True)
class RobotType:
    """A type of robots: the study whose settings they share, with the type's robot file."""

    name: str
    study: Study

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that say what is asked of robots of this type."""
        return (self.study.path, *self.study.robot_paths, self.study.workflow_path)


def robot_type(name: str, table: TypeTable, origin: Origin, folders: Sequence[Path]) -> RobotType:
    """Load a type's study and hold it against what every robot's study must be; origin is the fleet file's.

    Nothing outside of the folders is read.

    Raises:
        InputError: with all that is wrong in its files, and with what no study of many robots can have.
    """
    folder = origin.path.parent
    keys = {"study": folder / table.study} | ({"robot": folder / table.robot} if table.robot else {})
    absent = [
        origin.problem(f"there is no file {at}", "types", name, key) for key, at in keys.items() if not at.exists()
    ]
    if absent:
        raise InputError(absent)
    for key, at in keys.items():
        for path in _opened(at) if key == "study" else _described(at):
            if said := beyond_reach(path, folders):
                raise InputError([origin.problem(said, "types", name, key)])
    study = load_study(keys["study"])
    if "robot" in keys:
        study = replace(study, robot=study.file.on(Robot.from_toml(keys["robot"])), robot_path=keys["robot"])
        check_effects(study.file.effects, study.robot, study.robot_path)
    if wrong := list(_unsuitable(study)):
        raise InputError(
            origin.problem(f"{study.path} is no study for many robots: {said}", "types", name, "study")
            for said in wrong
        )
    return RobotType(name, study)


def _opened(study: Path) -> Iterator[Path]:
    """The files that are read with a study, each before anything is that it names."""
    path = study_path(study)
    yield path
    file = read_toml(path, StudyFile)
    if file.workflow.endswith(".toml"):
        yield path.parent / file.workflow
    yield from _described(path.parent / file.robot)


def _described(robot: Path) -> Iterator[Path]:
    """A robot file and the URDF that it names, each before it is read."""
    yield robot
    yield from robot_file.files(robot)[1:]


def _unsuitable(study: Study) -> Iterator[str]:
    """What keeps a study from being that of many robots."""
    stages = stages_of(study)
    if NEEDED not in study.stages:
        yield f"its workflow '{study.workflow.name}' lacks the stage {NEEDED}, without which nothing is known of a robot"
    if study.file.confirm:
        yield "it has 'confirm', which names a series of one robot and not of all"
    for stage in stages:
        for file in stage.reads(study, study.validated_settings(stage.name, stage.settings)):
            yield f"its stage {stage.name} reads files of its own ({file.name}), which a study of many robots cannot have"
