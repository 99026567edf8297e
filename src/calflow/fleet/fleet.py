"""A fleet: robots of a few types, each with measurements and a study of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import tomli_w

from calflow.files.problems import InputError, Problem, nearest, refuse_any, run_checks
from calflow.files.toml import Origin, parse_toml, read_toml
from calflow.files.writing import write_whole
from calflow.fleet.fleet_file import FleetFile, TypeTable, beyond_reach, named_file, robots_of
from calflow.robot.robot import Robot
from calflow.run_folder import beside
from calflow.runs.planning import stages_of
from calflow.study import Study, check_effects, check_name, load_settings, study_path

NEEDED = "identify"  # the stage that a study of a fleet must contain
FOUND_BY = {"file", "url", "sha256"}  # keys that identify a measurement file


@dataclass(frozen=True)
class RobotType:
    """A type of robots: the study whose settings they share, with the type's nominal robot."""

    name: str
    study: Study

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that define the type: study, robot and workflow."""
        return (self.study.path, *self.study.robot_paths, self.study.workflow_path)


def robot_type(name: str, table: TypeTable, origin: Origin, folders: Sequence[Path]) -> RobotType:
    """Load a type's study and check that it is suitable for many robots; origin is the fleet file's.

    No file outside the given folders is read.

    Raises:
        InputError: all problems of its files, and all settings that a study of many robots cannot have.
    """
    folder = origin.path.parent
    keys = {"study": folder / table.study} | ({"robot": folder / table.robot} if table.robot else {})
    refuse_any(
        origin.problem(f"there is no file {at}", "types", name, key) for key, at in keys.items() if not at.exists()
    )
    for key, at in keys.items():
        for path in _study_files(at) if key == "study" else _robot_files(at):
            if wrong_path := beyond_reach(path, folders):
                raise origin.refuse(wrong_path, "types", name, key)
    study = load_settings(study_path(keys["study"]))
    if "robot" in keys:
        study = replace(study, robot=study.file.on(Robot.from_toml(keys["robot"])), robot_path=keys["robot"])
        check_effects(study.file.effects, study.robot, study.robot_path)
    refuse_any(
        origin.problem(f"{study.path} is no study for many robots: {reason}", "types", name, "study")
        for reason in _unsuitable(study)
    )
    return RobotType(name, study)


def _study_files(study: Path) -> Iterator[Path]:
    """Yield the files read with a study, each before the files that it names; one that cannot be read names none."""
    path = study_path(study)
    yield path
    raw = _content(path)
    if str(raw.get("workflow")).endswith(".toml"):
        yield path.parent / str(raw["workflow"])
    if "robot" in raw:
        yield from _robot_files(path.parent / str(raw["robot"]))


def _robot_files(robot: Path) -> Iterator[Path]:
    """Yield a robot file and then the URDF that it names, each before it is read."""
    yield robot
    urdf = _content(robot).get("urdf")
    if isinstance(urdf, dict) and "file" in urdf:
        yield robot.parent / str(urdf["file"])


def _content(path: Path) -> dict[str, Any]:
    """Return what a TOML file says; nothing where it cannot be read, which is told where it is loaded."""
    with suppress(InputError):
        return parse_toml(path)[0]
    return {}


def _unsuitable(study: Study) -> Iterator[str]:
    """Yield the reasons why a study cannot be shared by many robots."""
    stages = stages_of(study)
    if NEEDED not in study.stages:
        yield f"its workflow '{study.workflow.name}' lacks the stage {NEEDED}, without which nothing is known of a robot"
    if study.file.confirm:
        yield "it has 'confirm', which names a series of one robot and not of all"
    for stage in stages:
        for file in stage.reads(study, study.validated_settings(stage.name, stage.settings)):
            yield f"its stage {stage.name} reads files of its own ({file.name}), which a study of many robots cannot have"


@dataclass(frozen=True)
class FleetRobot:
    """A robot of a fleet: name, type, measurement files (one per series), and the folder of the fleet file."""

    name: str
    type: RobotType
    data: tuple[Path, ...]
    home: Path


@dataclass(frozen=True)
class Fleet:
    """A fleet file with its types and robots; the robots are sorted by name."""

    path: Path
    file: FleetFile
    types: tuple[RobotType, ...]
    robots: tuple[FleetRobot, ...]

    @property
    def name(self) -> str:
        """The fleet's name, also that of its folder."""
        return self.file.fleet.name

    @property
    def title(self) -> str:
        """Title of the report."""
        return self.file.fleet.title or self.name

    def robot(self, name: str) -> FleetRobot:
        """Return a robot by its name."""
        return next(robot for robot in self.robots if robot.name == name)


def load_fleet(path: str | Path, allowed: Iterable[str | Path] = ()) -> Fleet:
    """Read a fleet file with its types' studies and find its robots; measurements are read when a robot is calibrated.

    Args:
        path: the fleet file.
        allowed: folders besides its own in which it may name files.

    Raises:
        InputError: all problems of the files read.
    """
    path = Path(path)
    file = read_toml(path, FleetFile)
    origin, folders = Origin.of(path), (path.parent, *map(Path, allowed))
    parts = run_checks(
        *(partial(robot_type, name, table, origin, folders) for name, table in file.types.items()),
        partial(_check_tables, file, origin, folders),
    )
    types: dict[str, RobotType] = {robot_type.name: robot_type for robot_type in parts[:-1]}
    robots = [FleetRobot(name, types[type_], data, path.parent) for name, type_, data in _robots(file, path.parent)]
    problems = [
        *_named_wrongly("robots", (robot.name for robot in robots), origin),
        *_named_twice(robots, origin),
        *_of_other_series(robots, origin),
        *_beyond_reach(robots, origin, folders),
    ]
    refuse_any(problems)
    if not robots:
        raise origin.refuse("has no robots: no file is where 'data' says, and no [robots.NAME] is there", "types")
    return Fleet(path, file, tuple(types.values()), tuple(sorted(robots, key=lambda robot: robot.name)))


def _check_tables(file: FleetFile, origin: Origin, folders: Sequence[Path]) -> None:
    """Check that types have valid folder names and patterns within reach, and robots a known type and measurements."""
    problems = [*_named_wrongly("types", file.types, origin)]
    for name, shared in file.types.items():
        beyond = {beyond_reach(folders[0] / named_file(pattern, "x"), folders) for pattern in shared.data}
        problems += [origin.problem(path, "types", name, "data") for path in sorted(beyond) if path]
    for name, table in file.robots.items():
        if table.type not in file.types:
            message = f"unknown type '{table.type}'; there are {', '.join(file.types)}{nearest(table.type, file.types)}"
            problems.append(origin.problem(message, "robots", name, "type"))
        elif not (table.data or file.types[table.type].data):
            message = f"missing: expected 'data', here or in [types.{table.type}]"
            problems.append(origin.problem(message, "robots", name))
    refuse_any(problems)


def _robots(file: FleetFile, folder: Path) -> Iterator[tuple[str, str, tuple[Path, ...]]]:
    """Yield each robot's name, type and files: the robots listed, then those found by each type's pattern."""
    for name, table in file.robots.items():
        patterns = table.data or file.types[table.type].data
        yield name, table.type, tuple(folder / named_file(pattern, name) for pattern in patterns)
    for type_, shared in file.types.items():
        names = robots_of(shared.data[0], folder) if shared.data else []
        for name in names:
            if name not in file.robots or file.robots[name].type != type_:
                yield name, type_, tuple(folder / named_file(pattern, name) for pattern in shared.data)


def _named_wrongly(key: str, names: Iterable[str], origin: Origin) -> Iterator[Problem]:
    """Yield a problem for each name in a table that is no valid folder name."""
    for name in names:
        try:
            check_name(name)
        except ValueError as error:
            yield origin.problem(str(error), key, name)


def _named_twice(robots: list[FleetRobot], origin: Origin) -> Iterator[Problem]:
    """Yield a problem for each name that several robots share."""
    for name, number in Counter(robot.name for robot in robots).items():
        if number > 1:
            types = " and ".join(robot.type.name for robot in robots if robot.name == name)
            yield origin.problem(
                f"robot '{name}' is there {number} times, of the types {types}: expected a name of its own", "types"
            )


def _of_other_series(robots: list[FleetRobot], origin: Origin) -> Iterator[Problem]:
    """Yield a problem for each robot whose number of files is not that of its study's series."""
    for robot in robots:
        series = max(1, len(robot.type.study.file.sources))
        if len(robot.data) != series:
            message = (
                f"robot '{robot.name}': expected {series} in 'data', one a series of its study, found {len(robot.data)}"
            )
            yield origin.problem(message, *_place_of_data(robot, origin))


def _beyond_reach(robots: list[FleetRobot], origin: Origin, folders: Sequence[Path]) -> Iterator[Problem]:
    """Yield a problem for each file outside the folders in which the fleet file may name files."""
    for robot in robots:
        for path in robot.data:
            if beyond := beyond_reach(path, folders):
                yield origin.problem(f"robot '{robot.name}': {beyond}", *_place_of_data(robot, origin))


def _place_of_data(robot: FleetRobot, origin: Origin) -> tuple[str, str, str]:
    """Return the key of the fleet file that states a robot's files."""
    keys = ("robots", robot.name, "data")
    return keys if keys in origin.lines else ("types", robot.type.name, "data")


def write_robot_study(robot: FleetRobot, path: Path) -> None:
    """Write a robot's study file."""
    write_whole(path, tomli_w.dumps(study_of(robot, path.parent)).encode())


def study_of(robot: FleetRobot, folder: Path) -> dict[str, Any]:
    """Return the content of a robot's study file in a folder, with relative paths, so that everything can be moved together."""
    study = robot.type.study
    raw, _ = parse_toml(study.path)
    title = {"title": f"{study.file.title}, {robot.name}"} if study.file.title else {}
    workflow = {"workflow": beside(folder, study.workflow_path)} if study.file.workflow.endswith(".toml") else {}
    files = [beside(folder, path) for path in robot.data]
    measured = raw.get("measurements", {})
    several = isinstance(measured, list)
    sources = [
        {"file": file} | {key: value for key, value in source.items() if key not in FOUND_BY}
        for source, file in zip(measured if several else [measured], files, strict=True)
    ]
    return {
        **raw, "name": robot.name, **title, "robot": beside(folder, study.robot_path), **workflow,
        "measurements": sources if several else sources[0],
    }  # fmt: skip
