"""TOML files as frozen objects: keys carry units, and every problem is told with its file, line and key.

Limits: what keys, texts and whole numbers of any TOML file may be, whatever they stand for.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import tomli_w
from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from calflow.files.problems import CONTROL, InputError, Problem, counted, nearest, refuse, shortened
from calflow.files.regular import regular_file
from calflow.files.units import LARGEST, MEASURED, SUFFIXES, split_unit, to_si
from calflow.files.writing import write_text

LONGEST_KEY, LONGEST_TEXT = 200, 10_000  # characters
LARGEST_WHOLE = 2**63 - 1  # of TOML
DEEPEST = 20  # tables and lists within each other
TOO_LONG = f"is too long: expected at most {LONGEST_KEY} characters in a name, {LONGEST_TEXT} in a text"

Found = Iterator[tuple[tuple[Any, ...], str]]


def beyond(raw: Any, where: tuple[Any, ...] = ()) -> Found:
    """Yield the places of what a parsed file holds beyond these limits, each with what to say."""
    if len(where) > DEEPEST:
        yield where[:DEEPEST], f"expected at most {DEEPEST} tables and lists within each other"
        return
    if isinstance(raw, str):
        yield from _text(raw, LONGEST_TEXT, where)
    if isinstance(raw, int) and not -LARGEST_WHOLE <= raw <= LARGEST_WHOLE:
        yield where, f"expected a whole number of at most {LARGEST_WHOLE}"
    members = raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    for key, value in members:
        unfit = list(_text(key, LONGEST_KEY, (*where, key))) if isinstance(key, str) else []
        yield from unfit or beyond(value, (*where, key))


def _text(text: str, longest: int, where: tuple[Any, ...]) -> Found:
    if len(text) > longest:
        yield where, TOO_LONG
    elif control := CONTROL.search(text):
        yield where, f"expected a text that can be seen, found the control character {control.group()!r}"


# What pydantic's types are called in the words of a TOML file.
_EXPECTED = {
    "bool_type": "expected true or false",
    "date_type": "expected a date without quotes, such as 2025-11-22",
    "dict_type": "expected a table",
    "finite_number": "expected a finite number",
    "float_type": "expected a number",
    "int_type": "expected a whole number",
    "model_type": "expected a table",
    "string_type": "expected a text in quotes",
    "too_short": "expected at least {min_length} of them",
    "too_long": "expected at most {max_length} of them",
    "tuple_type": "expected a list [ … ]",
}
_KEY = r"""(?:[\w-]+|"[^"]*"|'[^']*')"""


class Unit(str):
    """The dimension of a field; its key in the file ends in one of that dimension's units."""


Length = Annotated[float, Unit("length")]
Angle = Annotated[float, Unit("angle")]
Mass = Annotated[float, Unit("mass")]
Moment = Annotated[float, Unit("moment")]
Sigma = Annotated[float, Unit(MEASURED)]  # a field `sigma_unit` beside it has the unit that the key names
Lengths3 = Annotated[tuple[float, float, float], Unit("length")]
Angles3 = Annotated[tuple[float, float, float], Unit("angle")]

ONE, SEVERAL, NONE = "<table>", "<tables>", "<nothing>"  # forms of what may be given once or several times

File = TypeVar("File", bound="FileModel")


@dataclass(frozen=True)
class Origin:
    """Where a table was written: its file, the table's own path in it, and the line of every key path of the file."""

    path: Path
    table: tuple[Any, ...]
    lines: Mapping[tuple[Any, ...], int]  # of every key path, and of what stands around it: its first line

    @staticmethod
    def of(path: Path, *table: str) -> Origin:
        """Return the origin of a table of a file that has been read before."""
        return Origin.of_text(path, read_text(path), *table)

    @staticmethod
    def of_text(path: Path, text: str, *table: str) -> Origin:
        """Return the origin of a table of a file's text."""
        lines: dict[tuple[Any, ...], int] = {}
        for key, line in line_numbers(text).items():
            for end in range(min(len(key), DEEPEST), 0, -1):
                lines[key[:end]] = min(line, lines.get(key[:end], line))
        return Origin(path, table, lines)

    def problem(self, message: str, *location: Any) -> Problem:
        """Return a problem with the key at a location in the table, or with the nearest thing around it."""
        where = (*self.table, *location)
        around = (self.lines.get(where[:end]) for end in range(len(where), 0, -1))
        line = next((number for number in around if number), None)
        return Problem(message, self.path, line, _dotted(where) or None)


@dataclass(frozen=True)
class _Wrong:
    """Stands for a value that has no SI value, so that its own field fails; key is how the file spells it."""

    reason: str
    key: str


class FileModel(BaseModel):
    """Base of everything read from TOML: frozen, no unknown keys, quantities converted to SI by their key."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @classmethod
    def dimensions(cls) -> dict[str, str | None]:
        """Return the dimension of each field; None of one whose key carries no unit."""
        return {name: _dimension(field) for name, field in cls.model_fields.items()}

    @model_validator(mode="before")
    @classmethod
    def _units(cls, raw: Any) -> Any:
        """Replace `a_mm = 5` by `a = 0.005` for the fields that have a dimension."""
        if not isinstance(raw, dict):
            return raw
        dimensions = cls.dimensions()
        converted: dict[str, Any] = {}
        for key, value in raw.items():
            name, unit = (key, "") if key in dimensions else split_unit(key) or (key, "")
            dimension = dimensions.get(name)
            if dimension is None:
                converted[key] = _frozen(value)
            elif name in converted:
                converted[name] = _Wrong(f"'{name}' is given twice, in different units", key)
            elif not unit:
                converted[name] = _Wrong(f"needs its unit in the key: {_spellings(name, dimension)}", key)
            elif unit not in SUFFIXES[dimension]:
                converted[name] = _Wrong(f"expected a unit of {dimension}: {_spellings(name, dimension)}", key)
            else:
                converted[name] = _convert(value, unit)
                if dimension == MEASURED:
                    converted[f"{name}_unit"] = unit
        return converted

    @field_validator("*")
    @classmethod
    def _within_what_robots_have(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse figures that no robot has, and whose squares may be beyond what a computer can hold."""
        name = info.field_name or ""
        dimension = _dimension(cls.model_fields[name])
        if dimension is None and (split := split_unit(name)):  # a field that keeps the unit of its key
            unit = split[1]
            dimension = next(known for known, units in SUFFIXES.items() if unit in units)
        else:
            unit = SUFFIXES[dimension][0] if dimension else ""
        factor = to_si(unit)[0] if unit else 1.0
        if any(abs(factor * number) > LARGEST[dimension or ""] for number in _numbers(value)):
            most = f"{LARGEST[dimension or '']:g}{f' {SUFFIXES[dimension][0]}' if dimension else ''}"
            raise PydanticCustomError("beyond", "expected at most {most}", {"most": most})
        return value


def read_toml(path: Path, kind: type[File]) -> File:
    """Read a TOML file into a model.

    Raises:
        InputError: the file cannot be read or is not TOML, or with all that is wrong in it.
    """
    raw, origin = parse_toml(path)
    return validate(raw, kind, origin)


def parse_toml(path: Path) -> tuple[dict[str, Any], Origin]:
    """Return what a TOML file holds, and where it was written.

    Raises:
        InputError: the file cannot be read or is not TOML.
    """
    try:
        text = read_text(path)
        raw = tomllib.loads(text)
    except FileNotFoundError:
        raise refuse("no such file", path) from None
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        last = len(text.splitlines()) if "end of document" in str(error) else None
        raise refuse(f"not TOML: {error}", path, int(line.group(1)) if line else last) from None
    except (OSError, ValueError, RecursionError) as error:  # not UTF-8, or a number of thousands of digits
        raise refuse(f"cannot be read: {error}", path) from None
    origin = Origin.of_text(path, text)
    unfit = list(beyond(raw))
    if unfit:
        raise InputError(counted(unfit, lambda one: origin.problem(one[1], *one[0])))
    return raw, origin


def read_text(path: Path) -> str:
    """Return the text of a file that may be opened.

    Raises:
        FileNotFoundError: nothing is there.
        InputError: it is a folder, a device or a pipe.
    """
    return regular_file(path).read_text(encoding="utf-8-sig")


def validate(raw: dict[str, Any], kind: type[File], origin: Origin, others: Mapping[str, Origin] | None = None) -> File:
    """Validate a parsed table; others tells which of its keys were written elsewhere, and where.

    Raises:
        InputError: with all that is wrong in it.
    """
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        items = [item | {"loc": _named(item["loc"])} for item in error.errors(include_url=False)]
        inner = {item["loc"][:end] for item in items for end in range(len(item["loc"]))}
        told = [
            item
            for item in items
            if item["type"] != "too_short" or item["loc"] not in inner  # pydantic does not count wrong members
        ]
        kinds = dict.fromkeys(item["type"] for item in told)
        problems = [
            problem
            for one in kinds
            for problem in counted(
                [item for item in told if item["type"] == one],
                lambda item: _problem(item, kind, raw, origin, others or {}),
            )
        ]
        raise InputError(sorted(problems, key=lambda problem: (str(problem.file), problem.line or 0))) from None


def _named(location: tuple[Any, ...]) -> tuple[Any, ...]:
    """A location without the names of the forms that a value may have."""
    return tuple(part for part in location if part not in (ONE, SEVERAL, NONE))


def line_numbers(text: str) -> dict[tuple[Any, ...], int]:
    """Map each key path of a TOML text, tables of arrays indexed, to its line number (from 1)."""
    table: tuple[Any, ...] = ()
    counts: dict[tuple[str, ...], int] = {}
    lines: dict[tuple[Any, ...], int] = {}
    until, depth = "", 0  # the quotes that end a text of several lines, and how many lists are open
    for number, line in enumerate(text.splitlines(), start=1):
        if until:
            until = "" if until in line else until
            continue
        inside, bare = depth, re.sub(r"\"[^\"]*\"|'[^']*'|#.*", "", line)
        depth += bare.count("[") - bare.count("]")
        if inside:
            continue
        if header := re.match(rf"\s*(\[\[?)\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*\]\]?\s*(#.*)?$", line):
            names = tuple(_keys(header.group(2)))
            if header.group(1) == "[[":
                counts[names] = counts.get(names, -1) + 1
            table = tuple(
                part
                for i, name in enumerate(names)
                for part in ((name, counts[names[: i + 1]]) if names[: i + 1] in counts else (name,))
            )
            lines.setdefault(table, number)
        elif entry := re.match(rf"\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*=\s*(\"{{3}}|'{{3}})?(.*)", line):
            lines.setdefault(table + tuple(_keys(entry.group(1))), number)
            quotes = entry.group(2) or ""
            until = "" if quotes in entry.group(3) else quotes
    return lines


def _keys(dotted: str) -> list[str]:
    return [key.strip("\"'") for key in re.findall(_KEY, dotted)]


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


def _numbers(value: Any) -> Iterator[float]:
    """The figures of a value, in lists too."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for member in value:
            yield from _numbers(member)


def _convert(value: Any, unit: str) -> Any:
    factor, offset = to_si(unit)
    if isinstance(value, list):
        return tuple(_convert(item, unit) for item in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value  # left for the type check, which names the key
    try:
        return factor * value + offset
    except OverflowError:  # an integer of hundreds of digits
        return math.inf


def _problem(item: Any, kind: type[BaseModel], raw: Any, origin: Origin, others: Mapping[str, Origin]) -> Problem:
    location, found, wrong = tuple(item["loc"]), item.get("input"), item["type"] == "value_error"
    message = _EXPECTED.get(item["type"], "").format(**item.get("ctx", {})) or item["msg"]
    message = re.sub("^Input should be (greater|less)", r"expected a number \1", message)
    message = re.sub("^Input should be ", "expected ", message).removeprefix("Value error, ")
    written = _written(raw, location)
    if isinstance(found, _Wrong):
        message, wrong, written = found.reason, True, (*written[:-1], found.key)
    elif item["type"] == "extra_forbidden":
        key = str(location[-1])
        message, wrong = f"unknown key{nearest(key, _known_keys(kind, location[:-1]))}", True
    elif item["type"] == "missing":
        name, dimension, wrong = location[-1], _dimension_at(kind, location), True
        message = f"missing: expected {_spellings(str(name), dimension) if dimension else repr(name)}"
        if isinstance(name, int):
            message = f"value {name + 1} is missing"
        written = written[:-1]
    if not wrong:
        message += f", found {_shown(_at(raw, written))}"
    return (others.get(str(location[0]), origin) if location else origin).problem(message, *written)


def _written(raw: Any, location: tuple[Any, ...]) -> tuple[Any, ...]:
    """A location spelled as the file spells it: its keys with their units."""
    written: list[Any] = []
    for part in location:
        if isinstance(raw, dict) and part not in raw:
            part = next((key for key in raw if (split_unit(key) or ("",))[0] == part), part)
        written.append(part)
        raw = _at(raw, (part,))
    return tuple(written)


def _at(raw: Any, location: tuple[Any, ...]) -> Any:
    for part in location:
        known = part in raw if isinstance(raw, dict) else isinstance(raw, list | tuple) and part in range(len(raw))
        raw = raw[part] if known else None
    return raw


def _shown(value: Any) -> str:
    """A value as TOML spells it, cut where it is long."""
    text = str(value).lower() if isinstance(value, bool) else repr(list(value) if isinstance(value, tuple) else value)
    return shortened(text)


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


def _dotted(location: tuple[Any, ...]) -> str:
    """A location as text; members of a list are counted from 1, as joints are."""
    text = ""
    for part in location:
        text += f"[{part + 1}]" if isinstance(part, int) else (f".{shortened(part)}" if text else shortened(str(part)))
    return text


def write_toml(path: Path, file: FileModel) -> None:
    """Write a file that `read_toml` reads back equal: all that is not as it is by default, in SI units."""
    write_text(path, tomli_w.dumps(_stated(file)))


def _stated(file: FileModel) -> dict[str, Any]:
    dimensions = type(file).dimensions()
    stated = {
        name: value for name, value in file if value is not None and value != type(file).model_fields[name].default
    }
    return {
        f"{name}_{SUFFIXES[dimension][0]}" if (dimension := dimensions[name]) else name: _toml_value(value)
        for name, value in stated.items()
    }


def _toml_value(value: Any) -> Any:
    if isinstance(value, FileModel):
        return _stated(value)
    if isinstance(value, Mapping):
        return {name: _toml_value(member) for name, member in value.items() if member is not None}
    return [_toml_value(member) for member in value] if isinstance(value, list | tuple) else value
