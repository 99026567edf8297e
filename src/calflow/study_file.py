"""The study file and the workflow file as written."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from calflow.files.problems import InputError, nearest, shortened
from calflow.files.toml import NONE, ONE, SEVERAL, FileModel, Length, Origin, Unit
from calflow.files.units import LARGEST, UNITS
from calflow.measurements.source import MeasurementSource
from calflow.robot.parts import Expected
from calflow.robot.robot import Robot

# Keys of a table [parameters.NAME], each with its unit: what of `Expected` it states.
FIGURES = {"value": "value", "lower": "lower", "upper": "upper", "prior_mean": "mean", "prior_sd": "sd"}


class Acceptance(FileModel):
    """The table `[acceptance]` of a study; every key may be left out, and concerns the report alone."""

    serial_number: str = Field(default="", description="of the robot")
    instrument: str = Field(default="", description="what measured, with its own serial number")
    certificate: str = Field(
        default="", description="of the instrument's calibration: number, who issued it, until when"
    )
    date: datetime.date | None = Field(
        default=None, description="when it was measured, e.g. `2025-11-22` (without quotes)"
    )
    operator: str = Field(default="", description="who measured")
    temperature: Annotated[float, Unit("temperature")] | None = Field(
        default=None, description="where it was measured, e.g. `temperature_degC`"
    )
    tolerance: Length | None = Field(
        default=None,
        gt=0,
        description="the most by which any held-out position may be off, e.g. `tolerance_mm`: passed or failed",
    )

    @model_validator(mode="after")
    def _says_something(self) -> Acceptance:
        if self == type(self).model_construct():
            raise ValueError(f"expected one or more of {', '.join(type(self).model_fields)}")
        return self


class Split(FileModel):
    """How many poses no fit may see; drawn by pose, with the study's seed, unless the data say which."""

    holdout: float = Field(default=0.3, ge=0, lt=1)


def _how_many(value: object) -> str:
    """Which form of `[measurements]` a file has."""
    return SEVERAL if isinstance(value, list | tuple) else NONE if value is None else ONE


OneOrSeveral = Annotated[
    Annotated[MeasurementSource, Tag(ONE)]
    | Annotated[tuple[MeasurementSource, ...], Tag(SEVERAL)]
    | Annotated[None, Tag(NONE)],
    Discriminator(_how_many),
]


class StudyFile(FileModel):
    """A study file as written; confirm names the study of an independent series of the same robot.

    residual_field: whether a correction that no cause explains is to be made of what the final model leaves.
    """

    name: str
    title: str = ""
    robot: str
    workflow: str = "calibrate"
    seed: int = Field(ge=0)
    effects: tuple[str, ...] = ("geometry", "joint-compliance")
    parameters: dict[str, dict[str, Any]] = {}
    measurements: OneOrSeveral = None
    confirm: str = ""
    residual_field: bool = False
    acceptance: Acceptance | None = None
    split: Split = Split()
    stages: dict[str, dict[str, Any]] = {}

    @property
    def sources(self) -> tuple[MeasurementSource, ...]:
        """The series of measurements, in order; none where nothing was measured yet."""
        if self.measurements is None:
            return ()
        return self.measurements if isinstance(self.measurements, tuple) else (self.measurements,)

    def on(self, robot: Robot) -> Robot:
        """Return the robot with what the study states of its parameters, which must be in order (see `stated_parameters`)."""
        stated = {one.name: one for _, one, _ in _stated(self.parameters)}
        others = (one for one in robot.expected if one.name not in stated)
        return replace(robot, expected=(*others, *stated.values())) if stated else robot

    @field_validator("name")
    @classmethod
    def _names_a_folder(cls, name: str) -> str:
        if not re.fullmatch(r"\w[\w.-]*", name):
            raise ValueError(f"expected letters, digits, '_', '-' and '.' (it names the run's folder), found {name!r}")
        return name

    @field_validator("effects")
    @classmethod
    def _known_effects(cls, effects: tuple[str, ...]) -> tuple[str, ...]:
        from calflow.effects import effect_class

        for effect in known_effects(effects):
            kind = effect_class(effect)
            if kind and kind.is_noise():
                raise ValueError(
                    f"effect '{effect}' is a model of the noise, which no fit can have; diagnose looks for it"
                )
        return effects


class WorkflowFile(FileModel):
    """A workflow file as written: the stages in order; a table a stage holds its settings."""

    name: str
    stages: tuple[str, ...] = Field(min_length=1)
    settings: dict[str, dict[str, Any]] = {}

    @field_validator("stages")
    @classmethod
    def _each_once(cls, stages: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(stages)) < len(stages):
            raise ValueError("expected each stage once")
        return stages


def known_effects(effects: tuple[str, ...]) -> tuple[str, ...]:
    """Return a file's effects.

    Raises:
        ValueError: one of them is unknown or there twice, or there is none.
    """
    from calflow.effects import effects_given

    try:
        effects_given(effects)
    except InputError as error:
        raise ValueError("; ".join(problem.message for problem in error.problems)) from None
    if not effects or len(set(effects)) < len(effects):
        raise ValueError("expected at least one effect, and each once")
    return effects


def check_parameters(file: StudyFile, origin: Origin) -> None:
    """Check the tables `[parameters.NAME]` of a study, whatever the parameters of its model are.

    Raises:
        InputError: with all that is wrong in them.
    """
    problems = [
        origin.problem(message, "parameters", *location, *key)
        for location, _, wrong in _stated(file.parameters)
        for *key, message in wrong
    ]
    if problems:
        raise InputError(problems)


def parameter_location(file: StudyFile, name: str) -> tuple[str, ...]:
    """Return the keys of the table in which a study states something of a parameter."""
    return next(location for location, stated, _ in _stated(file.parameters) if stated.name == name)


def _stated(tables: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], Expected, list[tuple[str, ...]]]]:
    """Yield each parameter's keys, what is stated of it in SI, and what is wrong with that: perhaps a key, and a message."""
    for location, table in _named_tables(tables):
        figures, units, wrong = dict[str, float](), dict[str, str](), list[tuple[str, ...]]()
        for key, value in table.items():
            figure = next((name for name in FIGURES if key == name or key.startswith(f"{name}_")), "")
            if not figure:
                if key != "fixed":
                    wrong.append(
                        (
                            key,
                            f"unknown key{nearest(key, ('fixed', *FIGURES))}; expected fixed, or {', '.join(FIGURES)} with a unit",
                        )
                    )
                elif not isinstance(value, bool):
                    wrong.append((key, f"expected true or false, found {shortened(repr(value))}"))
            elif isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST[""]:
                wrong.append((key, f"expected a number of at most {LARGEST['']:g}, found {shortened(repr(value))}"))
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
        of = figures.get
        stated = Expected(
            name=".".join(location), unit=next(iter(units.values()), ""), mean=of("mean"), sd=of("sd"), lower=of("lower"),
            upper=of("upper"), fixed=fixed, value=of("value"),
        )  # fmt: skip
        yield location, stated, wrong


def _named_tables(
    tables: Mapping[str, Any], location: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
    """Yield the tables that hold other than tables: `[parameters.joint3.theta]` is one within another."""
    for name, table in tables.items():
        where = (*location, name)
        if isinstance(table, dict) and table and all(isinstance(value, dict) for value in table.values()):
            yield from _named_tables(table, where)
        else:
            yield where, table if isinstance(table, dict) else {}


def _in_si(suffix: str) -> tuple[float, str]:
    """Return the factor of a key's unit, and the SI unit that it leads to, as parameters have it (`rad/Nm`)."""
    for units in UNITS.values():
        if suffix in units:
            return units[suffix][0], next(iter(units)).replace("_per_", "/")
    return 1.0, suffix.replace("_per_", "/") or "1"
