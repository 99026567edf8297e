"""The study file and the workflow file as written.

What a calibration is signed with: the robot's serial number, what measured it, who and when, and how accurate it must be.
"""

from __future__ import annotations

import datetime
import re
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from calflow.files.problems import nearest
from calflow.files.toml import NONE, ONE, SEVERAL, FileModel, Length, Unit
from calflow.measurements.source import MeasurementSource


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

    @field_validator("name")
    @classmethod
    def _names_a_folder(cls, name: str) -> str:
        if not re.fullmatch(r"\w[\w.-]*", name):
            raise ValueError(f"expected letters, digits, '_', '-' and '.' (it names the run's folder), found {name!r}")
        return name

    @field_validator("effects")
    @classmethod
    def _known_effects(cls, effects: tuple[str, ...]) -> tuple[str, ...]:
        from calflow.effects import catalogue

        for effect in known_effects(effects):
            if catalogue()[effect].is_noise():
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
    from calflow.effects import catalogue

    unknown = [
        f"unknown effect '{effect}'{nearest(effect, catalogue())}" for effect in effects if effect not in catalogue()
    ]
    if unknown:
        raise ValueError("; ".join(unknown))
    if not effects or len(set(effects)) < len(effects):
        raise ValueError("expected at least one effect, and each once")
    return effects
