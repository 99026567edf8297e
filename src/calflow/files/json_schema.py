"""JSON Schemas of the TOML files, derived from the models that read them, by which editors complete and check keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from calflow.files.toml import FileModel, Record, keys_of
from calflow.files.units import to_si

Schema = dict[str, Any]
BOUNDS = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")
DIALECT = "https://json-schema.org/draft/2020-12/schema"
DIALECT_4 = "http://json-schema.org/draft-04/schema#"


class FileSchema(GenerateJsonSchema):
    """Generator of JSON Schema 2020-12 with one key per unit of a quantity and without null, which TOML lacks."""

    def model_schema(self, schema: core_schema.ModelSchema) -> Schema:
        """Return the schema of a model, with the keys as a file spells them."""
        return _with_units(super().model_schema(schema), schema["cls"])

    def dataclass_schema(self, schema: core_schema.DataclassSchema) -> Schema:
        """Return the schema of a record, with the keys as a file spells them."""
        return _with_units(super().dataclass_schema(schema), schema["cls"])

    def nullable_schema(self, schema: core_schema.NullableSchema) -> Schema:
        """Return the schema of the value where there is one."""
        return self.generate_inner(schema["schema"])

    def none_schema(self, schema: core_schema.NoneSchema) -> Schema:
        """Return the schema that no value satisfies."""
        return {"not": {}}


def _with_units(made: Schema, kind: type[Any]) -> Schema:
    if not issubclass(kind, FileModel | Record) or "properties" not in made:
        return made
    required = made.pop("required", [])
    properties: Schema = {}
    needed: list[Schema] = []
    always: list[str] = []
    for name, quantity in made["properties"].items():
        keys = keys_of(kind)[name]
        properties |= {key: _in_unit(quantity, unit) for key, unit in keys.items()}
        if name in required and name in keys:
            always.append(name)
        elif name in required:
            needed.append({"oneOf": [{"required": [key]} for key in keys]})
    stated = {"properties": properties, "required": always, "allOf": needed}
    return made | {key: value for key, value in stated.items() if value}


def json_schema(kind: Any, title: str) -> Schema:
    """Return the JSON Schema (draft 2020-12) of a file model or of a union of file models."""
    made = TypeAdapter(kind).json_schema(schema_generator=FileSchema)
    return {"$schema": DIALECT, "title": title, **{key: value for key, value in made.items() if key != "title"}}


def draft_4(schema: Schema) -> Schema:
    """Return a schema translated to draft 4, the draft of Taplo, on which most editors' TOML support is built."""
    made: Schema = _older(schema)
    return made | {"$schema": DIALECT_4}


def _older(value: Any) -> Any:
    if isinstance(value, list):
        return [_older(member) for member in value]
    if not isinstance(value, Mapping):
        return value
    older = {
        key: _older(member) for key, member in value.items() if key not in ("$schema", "discriminator", "propertyNames")
    }
    if "$defs" in older:
        older["definitions"] = older.pop("$defs")
    if isinstance(older.get("$ref"), str):
        older["$ref"] = older["$ref"].replace("#/$defs/", "#/definitions/")
        if len(older) > 1:  # draft 4 ignores keywords beside a reference
            older = {"allOf": [{"$ref": older.pop("$ref")}], **older}
    if "const" in older and not isinstance(older["const"], Mapping):
        older["enum"] = [older.pop("const")]
    if isinstance(older.get("prefixItems"), list):
        older |= {"items": older.pop("prefixItems"), "additionalItems": False}
    for bound, plain in (("exclusiveMinimum", "minimum"), ("exclusiveMaximum", "maximum")):
        if isinstance(older.get(bound), int | float) and not isinstance(older[bound], bool):
            older |= {plain: older[bound], bound: True}
    return older


def _in_unit(schema: Any, unit: str) -> Any:
    """The schema of a quantity with its bounds and default converted from SI to a unit."""
    if not unit:
        return schema
    factor, offset = to_si(unit)

    def converted(value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [converted(member) for member in value]
        return float(f"{(value - offset) / factor:.10g}") if isinstance(value, int | float) else value

    if isinstance(schema, list):
        return [_in_unit(member, unit) for member in schema]
    if not isinstance(schema, Mapping):
        return schema
    made = {
        key: converted(member) if key in (*BOUNDS, "default") else _in_unit(member, unit)
        for key, member in schema.items()
    }
    return {key: member for key, member in made.items() if not (key == "default" and member is None)}
