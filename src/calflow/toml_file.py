"""TOML files as frozen objects: keys carry units, and every problem is told with its file, line and key."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from calflow.problems import InputError, Problem, nearest, refuse
from calflow.units import SUFFIXES, split_unit, to_si


class Unit(str):
    """The dimension of a field; its key in the file ends in one of that dimension's units."""


Length = Annotated[float, Unit("length")]
Angle = Annotated[float, Unit("angle")]
Mass = Annotated[float, Unit("mass")]
Moment = Annotated[float, Unit("moment")]
Compliance = Annotated[float, Unit("compliance")]
Lengths3 = Annotated[tuple[float, float, float], Unit("length")]
Angles3 = Annotated[tuple[float, float, float], Unit("angle")]

File = TypeVar("File", bound="FileModel")


class FileModel(BaseModel):
    """Base of everything read from TOML: frozen, no unknown keys, quantities converted to SI by their key."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _units(cls, raw: Any) -> Any:
        """Replace `a_mm = 5` by `a = 0.005` for the fields that have a dimension."""
        if not isinstance(raw, dict):
            return raw
        dimensions = {name: _dimension(field) for name, field in cls.model_fields.items()}
        converted: dict[str, Any] = {}
        for key, value in raw.items():
            plain = dimensions.get(key)
            if plain:
                raise ValueError(f"'{key}' needs its unit in the key: {_spellings(key, plain)}")
            name, unit = split_unit(key) or (key, "")
            dimension = dimensions.get(name)
            if unit and dimension and key not in dimensions:
                if unit not in SUFFIXES[dimension]:
                    raise ValueError(f"'{key}': expected a unit of {dimension}: {_spellings(name, dimension)}")
                if name in converted:
                    raise ValueError(f"'{name}' is given twice, in different units")
                converted[name] = _convert(value, unit)
            else:
                converted[key] = _frozen(value)
        return converted


def read_toml(path: Path, kind: type[File]) -> File:
    """Read a TOML file into a model.

    Raises:
        InputError: the file cannot be read or is not TOML, or with all that is wrong in it.
    """
    try:
        text = path.read_text(encoding="utf-8")
        raw = tomllib.loads(text)
    except FileNotFoundError:
        raise refuse("no such file", path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise refuse(f"cannot be read: {error}", path) from None
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        raise refuse(f"not TOML: {error}", path, int(line.group(1)) if line else None) from None
    return validate(raw, kind, path, line_numbers(text))


def validate(raw: dict[str, Any], kind: type[File], path: Path, lines: dict[tuple[Any, ...], int]) -> File:
    """Validate parsed TOML; `lines` maps key paths to line numbers (see `line_numbers`)."""
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        raise InputError(_problem(item, kind, path, lines) for item in error.errors()) from None


def line_numbers(text: str) -> dict[tuple[Any, ...], int]:
    """Map each key path of a TOML text, tables of arrays indexed, to its line number (from 1)."""
    table: tuple[Any, ...] = ()
    counts: dict[tuple[str, ...], int] = {}
    lines: dict[tuple[Any, ...], int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(#.*)?$", line):
            names = tuple(_keys(header.group(2)))
            if header.group(1) == "[[":
                counts[names] = counts.get(names, -1) + 1
            table = tuple(
                part
                for i, name in enumerate(names)
                for part in ((name, counts[names[: i + 1]]) if names[: i + 1] in counts else (name,))
            )
            lines.setdefault(table, number)
        elif entry := re.match(r"""\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"))*)\s*=""", line):
            lines.setdefault(table + tuple(_keys(entry.group(1))), number)
    return lines


def _keys(dotted: str) -> list[str]:
    return [key.strip().strip("\"'") for key in re.findall(r"\"[^\"]*\"|'[^']*'|[^.\s]+", dotted)]


def _dimension(field: Any) -> str | None:
    for item in field.metadata:
        if isinstance(item, Unit):
            return str(item)
    for argument in get_args(field.annotation):  # Optional[Length] keeps the unit one level down
        for item in getattr(argument, "__metadata__", ()):
            if isinstance(item, Unit):
                return str(item)
    return None


def _spellings(name: str, dimension: str) -> str:
    return " or ".join(f"{name}_{suffix}" for suffix in SUFFIXES[dimension])


def _frozen(value: Any) -> Any:
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value


def _convert(value: Any, unit: str) -> Any:
    factor, offset = to_si(unit)
    if isinstance(value, list):
        return tuple(_convert(item, unit) for item in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value  # left for the type check, which names the key
    return factor * value + offset


def _problem(item: Any, kind: type[BaseModel], path: Path, lines: dict[tuple[Any, ...], int]) -> Problem:
    location = tuple(item["loc"])
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "extra_forbidden":
        key = str(location[-1])
        message = f"unknown key{nearest(key, _known_keys(kind, location[:-1]))}"
    elif item["type"] == "missing":
        dimension = _dimension_at(kind, location)
        wanted = _spellings(str(location[-1]), dimension) if dimension else f"'{location[-1]}'"
        message = f"missing: expected {wanted}"
        location = location[:-1]
    elif "input" in item and not isinstance(item["input"], dict):
        message = f"{message}, found {item['input']!r}"
    return Problem(message, path, _line(location, lines), _dotted(location) or None)


def _model_at(kind: Any, location: tuple[Any, ...]) -> type[BaseModel] | None:
    for part in location:
        field = kind.model_fields.get(part) if isinstance(kind, type) and issubclass(kind, BaseModel) else None
        if field is not None:
            kind = field.annotation
        while not (isinstance(kind, type) and issubclass(kind, BaseModel)):
            arguments = [a for a in get_args(kind) if a not in (str, type(None), ...)]
            if not arguments:
                return None
            kind = arguments[0]
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def _known_keys(kind: Any, location: tuple[Any, ...]) -> list[str]:
    model = _model_at(kind, location)
    keys: list[str] = []
    for name, field in (model.model_fields if model else {}).items():
        dimension = _dimension(field)
        keys += [f"{name}_{suffix}" for suffix in SUFFIXES[dimension]] if dimension else [field.alias or name]
    return keys


def _dimension_at(kind: Any, location: tuple[Any, ...]) -> str | None:
    model = _model_at(kind, location[:-1])
    field = model.model_fields.get(str(location[-1])) if model else None
    return _dimension(field) if field is not None else None


def _line(location: tuple[Any, ...], lines: dict[tuple[Any, ...], int]) -> int | None:
    """The line of the key itself (with or without a unit), else of the nearest table around it."""
    for end in range(len(location), 0, -1):
        where = location[:end]
        for key, number in lines.items():
            same_table = key[:-1] == where[:-1] and len(key) == len(where)
            if same_table and (key[-1] == where[-1] or (split_unit(str(key[-1])) or ("",))[0] == where[-1]):
                return number
    return None


def _dotted(location: tuple[Any, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else str(part))
    return text
