"""JSON Schemas of the kinds of files that a user writes, with installed effects and settings by name, for editors."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from operator import or_
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, create_model
from pydantic_core import CoreSchema

from calflow.effects import catalogue
from calflow.files.json_schema import Schema, draft_4, json_schema
from calflow.files.problems import nearest, refuse
from calflow.files.toml import FileModel
from calflow.files.units import SUFFIXES
from calflow.fleet.fleet_file import FleetFile
from calflow.measurements.source import MeasurementSource
from calflow.observations import observation_kinds
from calflow.robot.formats.frames_file import FramesFile
from calflow.robot.formats.robot_file import RobotFile, UrdfRobotFile
from calflow.simulation import Truth
from calflow.stage_settings import SETTINGS
from calflow.study import FIGURES, StudyFile, WorkflowFile

Draft = Literal["4", "2020-12"]
MEANINGS = {
    "value": "where it is held, with its unit, e.g. `value_deg`; beside `fixed = true`",
    "lower": "its lower bound, e.g. `lower_mm`",
    "upper": "its upper bound, e.g. `upper_mm`",
    "prior_mean": "the mean of its prior, e.g. `prior_mean_deg`; with `prior_sd`",
    "prior_sd": "the standard deviation of its prior, e.g. `prior_sd_deg`; with `prior_mean`",
}


def schema(kind: str, draft: Draft = "4") -> Schema:
    """Return the JSON Schema of a kind of file, with all installed effects, observations and stages.

    Raises:
        InputError: there is no such kind.
    """
    if kind not in SCHEMAS:
        raise refuse(f"unknown kind '{kind}'; there are {', '.join(SCHEMAS)}{nearest(kind, SCHEMAS)}")
    made = json_schema(SCHEMAS[kind](), f"calflow's {kind} file")
    return draft_4(made) if draft == "4" else made


def schema_text(kind: str, draft: Draft = "4") -> str:
    """Return the JSON Schema of a kind of file as text.

    Raises:
        InputError: there is no such kind.
    """
    return f"{json.dumps(schema(kind, draft), indent=2, ensure_ascii=False)}\n"


class ParameterTable(BaseModel):
    """A table `[parameters.NAME]`, or one of such tables: `[parameters.joint3.theta]` is one within another."""

    __pydantic_extra__: dict[str, ParameterTable]
    model_config = ConfigDict(extra="allow")

    fixed: bool = Field(default=False, description="`true`: it is held at its `value`, or where its effect is absent")

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> Schema:
        """Return the schema with a key for every figure and unit; parameters may have units that no other key has."""
        made = handler(core)
        units = dict.fromkeys(("", *(f"_{suffix}" for suffixes in SUFFIXES.values() for suffix in suffixes)))
        table = handler.resolve_ref_schema(made)
        table["properties"] |= {
            f"{name}{unit}": {"type": "number", "description": meaning}
            | ({"exclusiveMinimum": 0} if name == "prior_sd" else {})
            for name, meaning in MEANINGS.items()
            for unit in units
        }
        table["patternProperties"] = {f"^({'|'.join(FIGURES)})_": {"type": "number"}}
        table["minProperties"] = 1  # an empty table states nothing
        return made


def _study() -> type[FileModel]:
    """Return the model of a study file restricted to the installed effects, observations and stages."""
    settings = reduce(
        or_, dict.fromkeys(observation_kind.settings for observation_kind in observation_kinds().values())
    )
    source = create_model(
        "MeasurementSource", __base__=MeasurementSource, __doc__=MeasurementSource.__doc__,
        kind=(_one_of("", *observation_kinds()), ""), settings=(settings, {}),
    )  # fmt: skip
    measurements: Any = source | tuple[source, ...] | None  # type: ignore[valid-type]
    return create_model(
        "StudyFile", __base__=StudyFile, __doc__=StudyFile.__doc__,
        effects=(_several(catalogue()), StudyFile.model_fields["effects"].default),
        parameters=(dict[str, ParameterTable], {}), measurements=(measurements, None), stages=(_settings(), {}),
    )  # fmt: skip


def _workflow() -> type[FileModel]:
    return create_model(
        "WorkflowFile",
        __base__=WorkflowFile,
        __doc__=WorkflowFile.__doc__,
        stages=(_several(SETTINGS), ...),
        settings=(_settings(), {}),
    )


def _settings() -> type[FileModel]:
    """Return the model of a table with the settings of each stage."""
    fields: Any = {name: (settings | None, None) for name, settings in SETTINGS.items()}
    made: type[FileModel] = create_model("StageSettings", __base__=FileModel, **fields)
    return made


def _one_of(*names: str) -> Any:
    return Literal[names]


def _several(names: Iterable[str]) -> Any:
    schema: Any = _one_of(*names)
    return tuple[schema, ...]


SCHEMAS: Mapping[str, Callable[[], Any]] = {
    "study": _study,
    "robot": lambda: RobotFile,
    "urdf-robot": lambda: UrdfRobotFile,
    "workflow": _workflow,
    "truth": lambda: create_model("Truth", __base__=Truth, __doc__=Truth.__doc__, effects=(_several(catalogue()), ...)),
    "frames": lambda: FramesFile,
    "fleet": lambda: FleetFile,
}
