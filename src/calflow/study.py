"""The study: models of the study and workflow files, and `Study`, a frozen object of these and the robot."""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from calflow.effects import effect_class
from calflow.effects.base import unmet
from calflow.effects.stated import Effects
from calflow.estimation.parameters import contradictions, mistaken
from calflow.faults.implausible import plausible
from calflow.files.problems import (
    InputError,
    NoSuchFile,
    Problem,
    limited_problems,
    nearest,
    nearest_file,
    problems_of,
    refuse,
    refuse_any,
    regular_file,
    run_checks,
    truncated,
)
from calflow.files.toml import (
    NONE,
    ONE,
    SEVERAL,
    FileModel,
    Length,
    Origin,
    Seed,
    Unit,
    parse_toml,
    read_toml,
    sound_part,
    validate_table,
)
from calflow.files.units import LARGEST, SUFFIXES, UNITS, split_unit
from calflow.files.words import listed, plural
from calflow.measurements.measurements import Measurements, combined, continued
from calflow.measurements.rows import layout_of_further
from calflow.measurements.series import Series
from calflow.measurements.source import MeasurementSource, data_folder, is_to_fetch, locate
from calflow.model import Model, build, stated
from calflow.observations import Observation, observation_kinds, observations
from calflow.robot.formats import robot_file
from calflow.robot.parts import Expected
from calflow.robot.robot import Robot
from calflow.stage_settings import SETTINGS

# Keys of a table [parameters.NAME], before their unit, with the attribute of `Expected` that each states.
FIGURES = {"value": "value", "lower": "lower", "upper": "upper", "prior_mean": "mean", "prior_sd": "sd"}
MODELS, FIELD = ("identify", "diagnose"), "residual_field"  # stages
NO_STUDIES = (".pdf", ".html", ".json", ".xlsx", ".mat", ".png", ".jpg", ".urdf", ".xml")  # endings of other files
USUAL_KIND = "pose"  # of observation, where a study states none
FEWEST_POSES = 3  # fewer do not even determine the robot's base


def check_name(name: str) -> str:
    """Return the name if it is valid as a folder name.

    Raises:
        ValueError: it is not.
    """
    if not re.fullmatch(r"\w[\w.-]*", name):
        raise ValueError(f"expected letters, digits, '_', '-' and '.' (it names a folder), found {name!r}")
    return name


FolderName = Annotated[str, AfterValidator(check_name)]


class Acceptance(FileModel):
    """The table `[acceptance]` of a study; every key is optional, and used in the report only."""

    serial_number: str = Field(default="", description="of the robot")
    instrument: str = Field(default="", description="the measuring instrument, with its serial number")
    certificate: str = Field(default="", description="of the instrument's calibration: number, issuer, date of expiry")
    date: datetime.date | None = Field(
        default=None, description="when it was measured, e.g. `2025-11-22` (without quotes)"
    )
    operator: str = Field(default="", description="who measured")
    temperature: Annotated[float, Unit("temperature")] | None = Field(
        default=None, description="ambient temperature during the measurement, e.g. `temperature_degC`"
    )
    simulated: bool = Field(
        default=False, description="whether the data are simulated, which the top of the report then states"
    )
    tolerance: Length | None = Field(
        default=None,
        gt=0,
        description="largest permitted error of any held-out position, e.g. `tolerance_mm`, for the verdict passed or failed",
    )

    @model_validator(mode="after")
    def _says_something(self) -> Acceptance:
        if self == type(self).model_construct():
            raise ValueError(f"expected one or more of {', '.join(type(self).model_fields)}")
        return self


class Split(FileModel):
    """The share of held-out poses, drawn at random with the study's seed unless the data have a split."""

    holdout: float = Field(default=0.3, ge=0, lt=1)


def _how_many(value: object) -> str:
    """Return the tag of the form of `[measurements]`: several tables, one, or none."""
    return SEVERAL if isinstance(value, list | tuple) else NONE if value is None else ONE


class SeriesSource(MeasurementSource):
    """A table `[measurements]` of a kind of observation that there is, with settings that this kind has."""

    @field_validator("kind")
    @classmethod
    def _there_is(cls, kind: str) -> str:
        if kind not in {"", *observation_kinds()}:
            there = f"there are {', '.join(observation_kinds())}{nearest(kind, observation_kinds())}"
            raise ValueError(f"unknown kind '{kind}'; {there}")
        return kind

    @field_validator("settings")
    @classmethod
    def _of_its_kind(cls, settings: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        if "kind" in info.data:  # else it is a mistake itself
            observation_kinds()[info.data["kind"] or USUAL_KIND].settings.model_validate(settings)
        return settings


OneOrSeveral = Annotated[
    Annotated[SeriesSource, Tag(ONE)] | Annotated[tuple[SeriesSource, ...], Tag(SEVERAL)] | Annotated[None, Tag(NONE)],
    Discriminator(_how_many),
]


class StudyFile(FileModel):
    """The content of a study file; confirm names the study of an independent series of the same robot.

    residual_field: whether to add a smooth, non-physical correction fitted to the residuals of the final model.
    """

    name: FolderName
    title: str = ""
    robot: str
    workflow: str = "calibrate"
    seed: Seed
    effects: Effects = ("geometry", "joint-compliance")
    parameters: dict[str, dict[str, Any]] = {}
    measurements: OneOrSeveral = None
    confirm: str = ""
    residual_field: bool = False
    acceptance: Acceptance | None = None
    split: Split = Split()
    stages: dict[str, dict[str, Any]] = {}

    @property
    def sources(self) -> tuple[SeriesSource, ...]:
        """The series of measurements, in order; empty if nothing was measured yet."""
        if self.measurements is None:
            return ()
        return self.measurements if isinstance(self.measurements, tuple) else (self.measurements,)

    def on(self, robot: Robot) -> Robot:
        """Return the robot with the study's statements on parameters, which must be valid (see `check_parameters`)."""
        stated = {expected.name: expected for _, expected, _ in _stated(self.parameters)}
        others = (expected for expected in robot.expected if expected.name not in stated)
        return replace(robot, expected=(*others, *stated.values())) if stated else robot

    @field_validator("effects")
    @classmethod
    def _none_to_be_found(cls, effects: tuple[str, ...]) -> tuple[str, ...]:
        for effect in effects:
            kind = effect_class(effect)
            if kind and (why := kind.unstatable()):
                raise ValueError(f"effect '{effect}' {why}; diagnose looks for it")
        return effects


class WorkflowFile(FileModel):
    """The content of a workflow file: the stages in order, and a table of settings for each stage."""

    name: str
    stages: tuple[str, ...] = Field(min_length=1)
    settings: dict[str, dict[str, Any]] = {}

    @field_validator("stages")
    @classmethod
    def _each_once(cls, stages: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(stages)) < len(stages):
            raise ValueError("expected each stage once")
        return stages


def check_parameters(file: StudyFile, origin: Origin) -> None:
    """Check the tables `[parameters.NAME]` of a study, independently of the parameters of its model.

    Raises:
        InputError: with all errors in them.
    """
    refuse_any(
        origin.problem(message, "parameters", *location, *key)
        for location, _, wrong in _stated(file.parameters)
        for *key, message in wrong
    )


def _stated(tables: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], Expected, list[tuple[str, ...]]]]:
    """Yield each parameter's path of keys, its statement in SI units, and its errors: messages, each after any key."""
    for location, table in _named_tables(tables):
        figures, units, wrong = dict[str, Any](), dict[str, str](), list[tuple[str, ...]]()
        for key, value in table.items():
            figure = next((name for name in FIGURES if key == name or key.startswith(f"{name}_")), "")
            if not figure:
                if key != "fixed":
                    near = nearest(key, ("fixed", *FIGURES))
                    wrong.append((key, f"unknown key{near}; expected fixed, or {', '.join(FIGURES)} with a unit"))
                elif not isinstance(value, bool):
                    wrong.append((key, f"expected true or false, found {truncated(repr(value))}"))
            elif isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST[""]:
                wrong.append((key, f"expected a number of at most {LARGEST['']:g}, found {truncated(repr(value))}"))
            elif FIGURES[figure] in figures:
                wrong.append((key, f"'{figure}' is given twice, in different units"))
            else:
                factor, units[key] = _in_si(key.removeprefix(figure).removeprefix("_"))
                figures[FIGURES[figure]] = factor * value
        fixed = table.get("fixed") is True
        if len(set(units.values())) > 1:
            wrong.append((f"expected all figures in units of one kind, found {', '.join(units)}",))
        if ("mean" in figures) != ("sd" in figures):
            wrong.append(("expected prior_mean and prior_sd together",))
        if not figures.get("sd", 1.0) > 0:
            wrong.append((f"expected prior_sd > 0, found {figures['sd']:g}",))
        if "value" in figures and not fixed:
            wrong.append(("value is where a parameter is held: expected fixed = true beside it",))
        if not (figures or fixed or wrong):
            wrong.append((f"states nothing: expected fixed = true, or {', '.join(FIGURES)} with a unit",))
        name, unit = ".".join(location), next(iter(units.values()), "")
        yield location, Expected(name=name, unit=unit, fixed=fixed, **figures), wrong


def _named_tables(
    tables: Mapping[str, Any], location: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
    """Yield the innermost tables, with their paths of keys: `[parameters.joint3.theta]` is a table within another."""
    for name, table in tables.items():
        where = (*location, name)
        if isinstance(table, dict) and table and all(isinstance(value, dict) for value in table.values()):
            yield from _named_tables(table, where)
        else:
            yield where, table if isinstance(table, dict) else {}


def _in_si(suffix: str) -> tuple[float, str]:
    """Return the factor from a key's unit to SI, and the SI unit as parameters spell it (`rad/Nm`)."""
    for units in UNITS.values():
        if suffix in units:
            return units[suffix][0], next(iter(units)).replace("_per_", "/")
    return 1.0, suffix.replace("_per_", "/") or "1"


def check_effects(effects: tuple[str, ...], robot: Robot, path: Path) -> None:
    """Check that the robot file states the data that the effects need, and no priors of parameters that do not exist.

    Raises:
        InputError: it lacks data, or states such priors.
    """
    origin = Origin.of(path)
    refuse_any(origin.problem(message, "expected", k) for k, message in mistaken(robot, effects))
    needing = [effect.id for effect in build(robot, effects).effects if "torques" in effect.needs]
    measured = all(joint.rated_torque for joint in robot.joints)  # measured torques can then replace masses
    if needing and not robot.has_masses and not measured:
        missing: list[tuple[str, Any, str]]
        missing = [("joints", i, f"joint {i + 1}") for i, joint in enumerate(robot.joints) if joint.mass is None]
        missing += [("payloads", name, f"payload {name}") for name, load in robot.payloads.items() if load.mass is None]
        message = (
            f"effect '{needing[0]}' needs mass_kg and com_mm of every joint's link and payload; missing: "
            f"{listed([name for *_, name in missing])} (where joint torques are measured, every joint's rated_torque_Nm is "
            "enough; or leave the effect out of the study)"
        )
        raise origin.refuse(message, *missing[0][:2])


def check_stated_parameters(study: Study, model: Model) -> None:
    """Check that the parameters on which a study makes statements exist, and do not contradict these.

    Raises:
        InputError: with all that do not exist, or contradict.
    """
    expected, origin = study.file.on(replace(study.robot, expected=())).expected, Origin.of(study.path)
    locations = {parameter.name: location for location, parameter, _ in reversed([*_stated(study.file.parameters)])}
    refuse_any(
        origin.problem(message, "parameters", *locations[expected[k].name])
        for k, message in contradictions(expected, model)
    )


def check_columns(effects: tuple[str, ...], data: Measurements, path: Path) -> None:
    """Check that the measurements have the columns that the effects need.

    Raises:
        InputError: columns are missing.
    """
    refuse_any(
        Problem(f"effect '{effect.id}' needs {lacking}", path)
        for effect in build(data.robot, effects).effects
        for lacking in unmet(effect.needs, data.robot, data.given)
    )


@dataclass(frozen=True)
class Request:
    """What a study's file and its workflow's ask for."""

    path: Path
    file: StudyFile
    workflow: WorkflowFile
    workflow_path: Path

    def settings(self, stage: str) -> dict[str, Any]:
        """Return a stage's settings: the workflow's, overridden by the study's, also where these have other units."""
        settings = self.file.stages.get(stage, {})
        given = {split_unit(key)[0] for key in settings}
        base = self.workflow.settings.get(stage, {})
        return {key: value for key, value in base.items() if split_unit(key)[0] not in given} | settings

    def setting_problem(self, stage: str, message: str, setting: str, *further: str) -> Problem:
        """Return a problem located at a stage's setting in the study or workflow file."""
        if setting in {split_unit(key)[0] for key in self.file.stages.get(stage, {})}:
            return Origin.of(self.path, "stages", stage).problem(message, setting, *further)
        return Origin.of(self.workflow_path, "settings", stage).problem(message, setting, *further)

    def validated_settings(self, stage: str, kind: type[FileModel]) -> FileModel:
        """Return a stage's settings, validated; problems are located in the file that states the setting."""
        there = Origin.of(self.workflow_path, "settings", stage)
        stated = self.file.stages.get(stage, {})
        here = Origin.of(self.path, "stages", stage) if stated else there
        settings = self.settings(stage)
        elsewhere = {name: there for key in settings if key not in stated for name in (key, split_unit(key)[0])}
        return validate_table(settings, kind, here, elsewhere)

    def check_stages(self) -> None:
        """Check that the stages exist, and that their settings are valid.

        Raises:
            InputError: with all that do not exist, or else with all errors in their settings.
        """
        workflow, study = Origin.of(self.workflow_path), Origin.of(self.path)
        unknown = [
            workflow.problem(f"unknown stage '{name}'{nearest(name, SETTINGS)}", "stages")
            for name in self.workflow.stages
            if name not in SETTINGS
        ]
        for origin, key, tables in (
            (workflow, "settings", self.workflow.settings),
            (study, "stages", self.file.stages),
        ):
            unknown += _unknown_stages(tables, origin, key)
        refuse_any(unknown)
        set_ = dict.fromkeys((*self.workflow.stages, *self.workflow.settings, *self.file.stages))
        run_checks(*(partial(self.validated_settings, name, SETTINGS[name]) for name in set_))


def _unknown_stages(tables: Iterable[str], origin: Origin, key: str) -> list[Problem]:
    """Return problems of the tables of a file that belong to no stage."""
    unknown = [name for name in tables if name not in SETTINGS]
    return limited_problems(unknown, lambda name: origin.problem(f"unknown stage{nearest(name, SETTINGS)}", key, name))


@dataclass(frozen=True)
class Study(Request):
    """A study with its robot and workflow, ready to run.

    further are files of additional rows of the first series, measured later; data is the folder searched for
    measurements before the study's own folder, or None.
    """

    robot: Robot
    robot_path: Path
    further: tuple[Path, ...] = ()
    data: Path | None = field(default_factory=data_folder)

    @property
    def name(self) -> str:
        """The study's name, which is also that of its run folder."""
        return self.file.name

    @property
    def stages(self) -> tuple[str, ...]:
        """The workflow's stages, with the residual field, if requested, after the last stage that makes a model."""
        names = self.workflow.stages
        models = [k for k, name in enumerate(names) if name in MODELS]
        if not self.file.residual_field or not models or FIELD in names:
            return names
        return (*names[: models[-1] + 1], FIELD, *names[models[-1] + 1 :])

    @property
    def robot_paths(self) -> tuple[Path, ...]:
        """The robot file, and the URDF that it names, if any."""
        return robot_file.files(self.robot_path)

    @property
    def measurement_paths(self) -> tuple[Path, ...]:
        """The measurement files: one for each series, then the further ones.

        Raises:
            InputError: the study names none, or one cannot be found.
        """
        if not self.file.sources:
            raise refuse("has no measurements yet: expected a table [measurements] with file = …", self.path)
        return (*run_checks(*(partial(self._located, k) for k in range(len(self.file.sources)))), *self.further)

    @property
    def measurement_path(self) -> Path:
        """The first measurement file.

        Raises:
            InputError: the study names none, or it cannot be found.
        """
        return self.measurement_paths[0]

    @property
    def to_fetch(self) -> tuple[MeasurementSource, ...]:
        """The measurement files that a run would download."""
        return tuple(source for source in self.file.sources if is_to_fetch(source, self.path.parent, self.data))

    @property
    def all_to_fetch(self) -> tuple[MeasurementSource, ...]:
        """The measurement files that a run would download, including those of the confirming study.

        Raises:
            InputError: the confirming study's files have errors.
        """
        return self.to_fetch + (self.confirming.to_fetch if self.confirming else ())

    @property
    def confirming(self) -> Study | None:
        """The study of the independent series; None if there is none.

        Raises:
            InputError: its files have errors, or its robot has another number of joints.
        """
        if not self.file.confirm:
            return None
        other = replace(load_study(self.path.parent / self.file.confirm), data=self.data)
        n, joints = self.robot.n_joints, other.robot.n_joints
        if n != joints:
            raise Origin.of(self.path).refuse(f"expected a robot with {n} joints, found {joints}", "confirm")
        return other

    def measurements(self) -> Measurements:
        """Return the measurements, read once, split into train and holdout."""
        return self._measured

    @cached_property
    def _measured(self) -> Measurements:
        n = len(self.file.sources)
        of_series = [(k, partial(self._located, k)) for k in range(n)] + [
            (0, partial(Path, path)) for path in self.further
        ]
        parts = run_checks(*(partial(self._series, k, located) for k, located in of_series))
        path = self.measurement_path
        measured = combined((continued([parts[0], *parts[n:]]), *parts[1:n]))
        check_columns(self.file.effects, measured, path)
        model = stated(self.robot, self.file.effects, measured, observations(measured))
        self._check_names(model)
        if self.file.parameters:
            check_stated_parameters(self, model)
        measured = measured.split(self.file.split.holdout, self.file.seed)
        poses = measured.table.loc[measured.train, "pose"].nunique()
        if poses < FEWEST_POSES:
            raise refuse(f"holds {plural(poses, 'pose')} to fit and {plural(int((~measured.train).sum()), 'row')} in holdout: "
                         "nothing can be identified with so few", path)  # fmt: skip
        return measured

    def _check_names(self, model: Model) -> None:
        """Refuse series whose parameters would have the same names as another series' or the robot's."""
        of_robot = {parameter.name for effect in model.effects for parameter in effect.declared}
        names = [{parameter.name for parameter in observation.declared} for observation in model.observations]
        for k, declared in enumerate(names):
            if both := sorted(declared & set().union(*names[:k])):
                message = (
                    f"two series have parameters of the same names ({', '.join(both[:3])}, …): give each series a name of its own, "
                    "and each further station one series, or state where it stands (known = true)"
                )
            elif both := sorted(declared & of_robot):
                message = (
                    f"the series and a part of the robot have parameters of the same names ({', '.join(both[:3])}, …): give the "
                    "series another name than a marker, a joint or another part of the robot has"
                )
            else:
                continue
            raise Origin.of(self.path).refuse(message, *self._source(k), "name")

    def _located(self, k: int) -> Path:
        """Return the file of series k."""
        return locate(self.file.sources[k], self.path.parent, self.data)

    def _series(self, k: int, located: Callable[[], Path]) -> Measurements:
        """Return the measurements of series k read from a file, once it is located."""
        path = located()
        kind, series = self.series(k)
        source, dimension = self.file.sources[k], kind.units[0].dimension
        if source.sigma_unit and source.sigma_unit not in SUFFIXES[dimension]:
            message = f"expected the unit of what was measured: {' or '.join(f'sigma_{unit}' for unit in SUFFIXES[dimension])}"
            raise InputError([self.source_problem(k, message, f"sigma_{source.sigma_unit}")])
        layout = replace(source.layout, reports=replace(kind.columns, sigma=dimension))
        layout = layout_of_further(path, layout) if path in self.further else layout
        measured = Measurements.from_csv(path, self.robot, **vars(layout))
        return plausible(replace(measured, series=(series,)), path)

    def _source(self, k: int) -> tuple[str | int, ...]:
        """Return the keys under which the study file describes a series."""
        return ("measurements", k) if isinstance(self.file.measurements, tuple) else ("measurements",)

    def source_problem(self, k: int, message: str, key: str) -> Problem:
        """Return a problem located at a key of a series in the study file."""
        return Origin.of(self.path).problem(message, *self._source(k), key)

    def series(self, k: int) -> tuple[type[Observation], Series]:
        """Return a series' kind of observation, and the series that the study describes.

        Raises:
            InputError: its kind has settings that must be stated.
        """
        source = self.file.sources[k]
        kind = observation_kinds()[source.kind or USUAL_KIND]
        settings = validate_table(
            source.settings, kind.settings, replace(Origin.of(self.path), table=(*self._source(k), "settings"))
        )
        given = {name: value for name, value in settings.model_dump().items() if value is not None}
        return kind, source.series(kind.columns, given)


def check_confirm(file: StudyFile, path: Path) -> None:
    """Check that the confirming study exists, and is not the study itself.

    Raises:
        InputError: it is missing, or the same.
    """
    if not file.confirm:
        return
    other = study_path(path.parent / file.confirm)
    try:
        wrong = "is this study itself" if regular_file(other).samefile(path) else ""
    except NoSuchFile:
        wrong = f"there is no file {other}"
    except InputError as error:
        wrong = error.problems[0].message
    if wrong:
        message = f"{wrong}: expected the study of an independent series of the same robot"
        raise Origin.of(path).refuse(message, "confirm")


def study_path(path: Path) -> Path:
    """Return the path of a study file, given the file or its folder."""
    return path / "study.toml" if os.path.isdir(path) else path  # for a name too long Path.is_dir would raise


def _parsed(path: Path) -> tuple[dict[str, Any], Origin]:
    """Return the content of a study file, and its origin; refuse other files with a message that says what they are."""
    if not path.suffix and not os.path.exists(path):
        expected = f"expected a study's folder, or its file{nearest_file(path)}"
        raise refuse(f"no such file or folder in {Path.cwd()}: {expected}", path)
    if path.name == "study.toml" and os.path.isdir(path.parent) and not path.exists():
        if path.with_name("manifest.json").exists():
            raise refuse("is the folder of a run: expected the study that it was run from", path.parent)
        others = " or ".join(str(file) for file in sorted(path.parent.glob("*.toml")) if _may_be_study(file))
        expected = others or f"a study in folder {path.parent}; calflow new writes one"
        raise refuse(f"no such file: expected {expected}", path)
    if path.suffix == ".csv":
        raise refuse("is a table: expected a study's folder, or its file; calflow import brings a table into one", path)
    if path.suffix.lower() in NO_STUDIES:
        raise refuse(f"is a {path.suffix[1:].upper()} file: expected a study's folder, or its file", path)
    raw, origin = parse_toml(path)
    if "robot" not in raw and ("joints" in raw or "urdf" in raw):
        raise refuse("is a robot file: expected the study that names it, such as study.toml", path)
    return raw, origin


def _may_be_study(path: Path) -> bool:
    """Whether a file names a robot and a workflow, as only studies do."""
    with suppress(InputError):
        return {"robot", "workflow"} <= set(parse_toml(path)[0])
    return False


def load_study(path: str | Path) -> Study:
    """Return the study of a file, with the robot and workflow that it names; measurements are read when needed.

    Raises:
        InputError: with all problems of these files, and of its measurements.
    """
    path = study_path(Path(path))
    try:
        return load_settings(path)
    except InputError as error:
        measured = problems_of(partial(_check_measured, path))
        raise InputError(dict.fromkeys((*error.problems, *measured))) from None


def load_settings(path: Path) -> Study:
    """Return the study of a file, whatever its measurements are: those of a type's robots are others.

    Raises:
        InputError: with all problems of the file, and of the robot and workflow that it names.
    """
    raw, origin = _parsed(path)
    sound = _sound(raw)
    try:
        file, named = run_checks(
            lambda: validate_table(raw, StudyFile, origin), lambda: _named_files(sound, path) if sound else None
        )
    except InputError as error:
        further = problems_of(partial(_check_stages, sound, path)) if sound else ()
        raise InputError(dict.fromkeys((*error.problems, *further))) from None
    study = _study(path, file, named)
    study.check_stages()
    if file.parameters and not file.sources:
        check_stated_parameters(study, build(study.robot, file.effects))
    return study


def _sound(raw: dict[str, Any]) -> StudyFile | None:
    return sound_part(raw, StudyFile, {"name": "study", "seed": 0, "effects": ["geometry"]})


def _study(path: Path, file: StudyFile, named: tuple[tuple[Robot, Path], tuple[WorkflowFile, Path]]) -> Study:
    robot, workflow = named
    return Study(path, file, *workflow, *robot)


def _check_measured(path: Path) -> None:
    """Check that the measurement files of a study that is refused are there and, if all it names can be read, what is in them."""
    raw, origin = _parsed(path)
    if sound := _sound(raw):
        _check_located(sound, path)
    file = validate_table(raw, StudyFile, origin)
    study = _study(path, file, _named_files(file, path))
    if file.sources and not study.to_fetch:
        study.measurements()


def _named_files(file: StudyFile, path: Path) -> tuple[tuple[Robot, Path], tuple[WorkflowFile, Path]]:
    """Return a study's robot and workflow, each with its file.

    Raises:
        InputError: with all problems of these files, of the confirming study and of what is stated on parameters.
    """
    robot_path = path.parent / file.robot

    def checked_robot() -> tuple[Robot, Path]:
        robot = Robot.from_toml(robot_path)
        check_effects(file.effects, robot, robot_path)
        return file.on(robot), robot_path

    robot, workflow, *_ = run_checks(
        checked_robot,
        lambda: _workflow(file, path),
        lambda: check_confirm(file, path),
        lambda: check_parameters(file, Origin.of(path)),
    )
    return robot, workflow


def _workflow(file: StudyFile, path: Path) -> tuple[WorkflowFile, Path]:
    """Return the workflow of a study's file, and its path."""
    workflow_path = find_workflow(file.workflow, path)
    return read_toml(workflow_path, WorkflowFile), workflow_path


def _check_stages(file: StudyFile, path: Path) -> None:
    """Check the stages' settings of a study."""
    Request(path, file, *_workflow(file, path)).check_stages()


def _check_located(file: StudyFile, path: Path) -> None:
    """Check that the measurement files are there, or that a run would fetch them."""
    folder, data = path.parent, data_folder()
    run_checks(*(partial(locate, of, folder, data) for of in file.sources if not is_to_fetch(of, folder, data)))


def workflow_folder() -> Path:
    """Return the folder of the built-in workflows, in the installed package or in the source tree."""
    installed = Path(__file__).parent / "_workflows"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "workflows"


def find_workflow(name: str, study: Path) -> Path:
    """Return the workflow file: relative to the study if the name ends in .toml, else a built-in workflow."""
    if name.endswith(".toml"):
        return study.parent / name
    path = workflow_folder() / f"{name}.toml"
    if not os.path.isfile(path):
        workflows = sorted(file.stem for file in workflow_folder().glob("*.toml"))
        message = (
            f"unknown workflow '{name}'; there are {', '.join(workflows)}{nearest(name, workflows)}"
            if workflows
            else f"calflow's own workflows are not in {workflow_folder()}: install calflow again, "
            "or state a file that ends in .toml"
        )
        raise Origin.of(study).refuse(message, "workflow")
    return path
