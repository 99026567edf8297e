"""The study file and the workflow file as written."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, field_validator

from calflow.files.problems import nearest
from calflow.files.toml import NONE, ONE, SEVERAL, FileModel
from calflow.measurements.acceptance import Acceptance
from calflow.measurements.source import MeasurementSource


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
