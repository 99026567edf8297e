"""TOML files as frozen objects, read and written: keys carry units, and every problem has its file, line and key.

Arguments from Python are judged in the same words, by the annotations of the function that is called.
"""

from __future__ import annotations

import inspect
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, wraps
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    InstanceOf,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.functional_validators import ModelWrapValidatorHandler
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from calflow.files.problems import (
    CONTROL,
    InputError,
    Problem,
    counted,
    nearest,
    refuse,
    refuse_any,
    regular_file,
    shortened,
)
from calflow.files.units import KEY_SUFFIXES, LARGEST, MEASURED, split_unit, to_si

LONGEST_KEY, LONGEST_TEXT = 200, 10_000  # characters
LARGEST_WHOLE = 2**63 - 1  # of TOML
DEEPEST = 20  # tables and lists within each other
TOO_LONG = f"is too long: expected at most {LONGEST_KEY} characters in a name, {LONGEST_TEXT} in a text"

WINDOWS = re.compile(r'"(?:[A-Za-z]:|\.{1,2}|\w+)\\(?![\\"])')  # a path with backslashes in double quotes
ESCAPED = re.compile(r"^[A-Za-z]:[\b\t\n\f\r]")  # a path in which TOML took a backslash and a letter for an escape
SLASHES = "a backslash begins an escape here: write the path with /, or in single quotes ('C:\\data\\points.csv')"

UNKNOWN = "unknown"  # in the place of a quantity that must be stated, and that nobody knows

Message = tuple[tuple[Any, ...], str]  # with its place
# What pydantic's types are called in the words of a TOML file.
_EXPECTED = {
    "bool_type": "expected true or false",
    "dataclass_type": "expected a table",
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
_IN_PYTHON = {
    "dataclass_type": "expected a {class_name}",
    "is_instance_of": "expected a {class}",
    "tuple_type": "expected several numbers",
}
_KEY = r"""(?:[\w-]+|"[^"]*"|'[^']*')"""
LONGEST_LINK = 20.0  # m
ONE, SEVERAL, NONE = "<table>", "<tables>", "<nothing>"  # forms of what may be given once or several times


def beyond_toml(raw: Any, where: tuple[Any, ...] = ()) -> Iterator[Message]:
    """Yield what a parsed file holds that no TOML file should, whatever it stands for."""
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
        yield from unfit or beyond_toml(value, (*where, key))


def _text(text: str, longest: int, where: tuple[Any, ...]) -> Iterator[Message]:
    if len(text) > longest:
        yield where, TOO_LONG
    elif ESCAPED.match(text):
        yield where, SLASHES
    elif control := CONTROL.search(text):
        yield where, f"expected a text that can be seen, found the control character {control.group()!r}"


class Unit(str):
    """The dimension of a field; its key in the file ends in one of that dimension's units."""


Length = Annotated[float, Unit("length")]
Angle = Annotated[float, Unit("angle")]
Mass = Annotated[float, Unit("mass")]
Moment = Annotated[float, Unit("moment")]
Sigma = Annotated[float, Unit(MEASURED)]  # a field `sigma_unit` beside it has the unit that the key names
Lengths3 = Annotated[tuple[float, float, float], Unit("length")]
Angles3 = Annotated[tuple[float, float, float], Unit("angle")]


def _of_a_link(value: Any) -> Any:
    """Refuse a length that was rather meant in mm; what no quantity can be is told as of any other."""
    longest = max(map(abs, _numbers(value)), default=0.0)
    if LONGEST_LINK < longest <= LARGEST["length"]:
        raise ValueError(f"{longest:g} m: no link of a robot is so long. Did you mean mm?")
    return value


LinkLength = Annotated[Length, AfterValidator(_of_a_link)]
LinkPoint = Annotated[Lengths3, AfterValidator(_of_a_link)]


File = TypeVar("File", bound="FileModel | Record")


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

    def refuse(self, message: str, *location: Any) -> InputError:
        """Return the error for a single problem with the key at a location in the table, to be raised by the caller."""
        return InputError([self.problem(message, *location)])

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

    @model_validator(mode="before")
    @classmethod
    def _units(cls, raw: Any) -> Any:
        return _in_si(cls, raw)

    @field_validator("*")
    @classmethod
    def _within_what_robots_have(cls, value: Any, info: ValidationInfo) -> Any:
        return _within_what_robots_have(cls, value, info)


@dataclass(frozen=True)
class Record:
    """Base of the frozen dataclasses that are built in Python, in SI, or read from a table, whose keys carry units.

    What is built is checked where it belongs to something whole (see `checked`), so that all that is wrong is told at once.
    Sequences and NumPy's numbers become tuples and Python's own, so that records can be compared.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, revalidate_instances="always")

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, _plain(getattr(self, field.name)))

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        made = handler(source)
        inner: Any = made
        while inner["type"] != "dataclass":
            inner = inner["schema"]
        inner["strict"] = False  # its fields are: but a table may state it
        return made

    @model_validator(mode="wrap")
    @classmethod
    def _units(cls, raw: Any, handler: ModelWrapValidatorHandler[Any]) -> Any:
        return handler(_in_si(cls, raw))

    @field_validator("*")
    @classmethod
    def _within_what_robots_have(cls, value: Any, info: ValidationInfo) -> Any:
        return _within_what_robots_have(cls, value, info)


# The dimension of each field of a kind of file or record; None of one whose key carries no unit.
dimensions: Callable[[Any], dict[str, str | None]] = cache(
    lambda kind: {name: _dimension(annotation) for name, annotation in _annotations(kind).items()}
)


def _annotations(kind: type[BaseModel | Record]) -> dict[str, Any]:
    if issubclass(kind, BaseModel):
        return {
            name: Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
            for name, field in kind.model_fields.items()
        }
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name] for field in fields(kind)}


def _in_si(kind: type[FileModel | Record], raw: Any) -> Any:
    """A table with `a = 0.005` in the place of `a_mm = 5` for the fields that have a dimension."""
    if not isinstance(raw, dict):
        return raw
    converted: dict[str, Any] = {}
    for key, value in raw.items():
        name, unit = (key, "") if key in dimensions(kind) else split_unit(key) or (key, "")
        dimension = dimensions(kind).get(name)
        if dimension is None:
            converted[key] = as_tuples(value)
        elif name in converted:
            converted[name] = _Wrong(f"'{name}' is given twice, in different units", key)
        elif not unit:
            converted[name] = _Wrong(f"needs its unit in the key: {_spellings(name, dimension)}", key)
        elif unit not in KEY_SUFFIXES[dimension]:
            converted[name] = _Wrong(f"expected a unit of {dimension}: {_spellings(name, dimension)}", key)
        else:
            converted[name] = _convert(value, unit)
            if dimension == MEASURED:
                converted[f"{name}_unit"] = unit
    return converted


def _within_what_robots_have(kind: type[FileModel | Record], value: Any, info: ValidationInfo) -> Any:
    """Refuse figures that no robot has, and whose squares may be beyond what a computer can hold."""
    name = info.field_name or ""
    dimension = dimensions(kind).get(name)
    if dimension is None and (split := split_unit(name)):  # a field that keeps the unit of its key
        unit = split[1]
        dimension = next(dimension for dimension, units in KEY_SUFFIXES.items() if unit in units)
    else:
        unit = KEY_SUFFIXES[dimension][0] if dimension else ""
    factor = to_si(unit)[0] if unit else 1.0
    if any(abs(factor * number) > LARGEST[dimension or ""] for number in _numbers(value)):
        most = f"{LARGEST[dimension or '']:g}{f' {KEY_SUFFIXES[dimension][0]}' if dimension else ''}"
        raise PydanticCustomError("beyond", "expected at most {most}", {"most": most})
    return value


def refuse_all(messages: Iterable[Message]) -> None:
    """Tell pydantic all that is wrong with a value at once, each with its place within that.

    Raises:
        ValidationError: there is any.
    """
    errors = [
        InitErrorDetails(
            type=PydanticCustomError("value_error", "{message}", {"message": message}), loc=where, input=None
        )
        for where, message in messages
    ]
    if errors:
        raise ValidationError.from_exception_data("", errors)


def read_toml(path: Path, kind: type[File]) -> File:
    """Read a TOML file into a model.

    Raises:
        InputError: the file cannot be read or is not TOML, or with all that is wrong in it.
    """
    raw, origin = parse_toml(path)
    return validate_table(raw, kind, origin)


def parse_toml(path: Path) -> tuple[dict[str, Any], Origin]:
    """Return what a TOML file holds, and where it was written.

    Raises:
        InputError: the file cannot be read or is not TOML.
    """
    text = read_text(path)
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        lines = text.splitlines()
        at = int(line.group(1)) if line else len(lines) if "end of document" in str(error) else None
        hint = f"; {SLASHES}" if at and WINDOWS.search(lines[at - 1]) else ""
        raise refuse(f"not TOML: {error}{hint}", path, at) from None
    except (ValueError, RecursionError) as error:  # a number of thousands of digits
        raise refuse(f"cannot be read: {error}", path) from None
    origin = Origin.of_text(path, text)
    refuse_any(counted(list(beyond_toml(raw)), lambda item: origin.problem(item[1], *item[0])))
    return raw, origin


def read_text(path: Path) -> str:
    """Return the text of a file that may be opened.

    Raises:
        InputError: it cannot be read, or nothing is there, or a folder, a device or a pipe.
    """
    try:
        return regular_file(path).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:  # not UTF-8
        raise refuse(f"cannot be read: {error}", path) from None


def validate_table(
    raw: dict[str, Any],
    kind: type[File],
    origin: Origin,
    others: Mapping[str, Origin] | None = None,
    context: Mapping[str, Any] | None = None,
) -> File:
    """Validate a parsed table; others has the keys that were written elsewhere, and where; context is for the validators.

    Raises:
        InputError: with all that is wrong in it.
    """
    try:
        made: File = adapter(kind).validate_python(raw, context=context)
        return made
    except ValidationError as error:
        problems = _problems(error, kind, raw, origin, others or {}, _EXPECTED)
        raise InputError(sorted(problems, key=lambda problem: (str(problem.file), problem.line or 0))) from None


def checked(record: Record, kind: type[File], place: str, context: Mapping[str, Any]) -> File:
    """Return what was built in Python, as a kind of record, checked with all that it is made of.

    Raises:
        InputError: with all that is wrong in it, each by its place.
    """
    try:
        made: File = adapter(kind).validate_python(record, context=context)
        return made
    except ValidationError as error:
        problems = _problems(error, kind, record, Origin(Path(), (), {}), {}, _EXPECTED | _IN_PYTHON)
        raise InputError(replace(problem, file=None, key=f"{place}: {problem.key}") for problem in problems) from None


adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)  # which takes long to make


Function = TypeVar("Function", bound=Callable[..., Any])
Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
Confidence = Annotated[float, Field(ge=0.5, lt=1)]
FalseAlarm = Annotated[float, Field(gt=0, lt=0.5)]


def checked_arguments(function: Function) -> Function:
    """Have a function that is called from Python refuse, with an InputError, all arguments that its annotations rule out.

    Choices, numbers, texts and objects of a class are looked at; what is given as several or as an array the function judges.
    """

    @wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        try:
            given = inspect.signature(function).bind(*args, **kwargs)
        except TypeError:  # a name too many or too few, of which Python says by itself whose it is
            return function(*args, **kwargs)
        given.arguments |= as_annotated(function, given.arguments)
        return function(*given.args, **given.kwargs)

    return cast(Function, called)


def as_annotated(function: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return which of the arguments of a function, or fields of a class, its annotations judge, as these say.

    Raises:
        InputError: with all that they rule out.
    """
    right, problems = dict[str, Any](), list[Problem]()
    for name, kind in _kinds(function).items():
        if name in given:
            try:
                right[name] = adapter(kind).validate_python(given[name])
            except ValidationError as error:
                words = _refusal_words(error.errors()[0], _EXPECTED | _IN_PYTHON)
                problems.append(Problem(f"{words}, found {_shown(given[name])}", key=name))
    refuse_any(problems)
    return right


@cache
def _kinds(function: Callable[..., Any]) -> dict[str, Any]:
    """What each argument may be, of those that pydantic can judge."""
    hints = get_type_hints(function, include_extras=True)
    kinds = {name: _judged(kind) for name, kind in hints.items() if name != "return"}
    return {name: kind for name, kind in kinds.items() if kind is not None}


def _judged(kind: Any) -> Any:
    """What pydantic is to judge an argument by; None where its annotation is neither of one value nor of a choice."""
    if get_origin(kind) in (Union, UnionType):
        alone = [member for member in get_args(kind) if member is not type(None)]
        judged = _judged(alone[0]) if len(alone) == 1 else None
        return None if judged is None else judged | None
    if get_origin(kind) in (Annotated, Literal) or kind in (bool, int, float, str, Path):
        return kind
    of_ours = inspect.isclass(kind) and kind.__module__.startswith("calflow.")
    return Annotated[kind, InstanceOf()] if of_ours else None


def _problems(
    error: ValidationError,
    kind: Any,
    raw: Any,
    origin: Origin,
    others: Mapping[str, Origin],
    expected: Mapping[str, str],
) -> list[Problem]:
    """What pydantic refuses, in the order of its finding."""
    items = [item | {"loc": _named(item["loc"])} for item in error.errors(include_url=False)]
    inner = {item["loc"][:end] for item in items for end in range(len(item["loc"]))}
    # pydantic does not count wrong members
    counting = [item for item in items if item["type"] != "too_short" or item["loc"] not in inner]
    return counted(
        counting, lambda item: _problem(item, kind, raw, origin, others, expected), lambda item: item["type"]
    )


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


def _dimension(annotation: Any) -> str | None:
    """The dimension of a quantity, or of one that may be left out: a level or two down."""
    of = (str(item) for item in getattr(annotation, "__metadata__", ()) if isinstance(item, Unit))
    return next(of, None) or next(filter(None, map(_dimension, get_args(annotation))), None)


def _spellings(name: str, dimension: str) -> str:
    return " or ".join(f"{name}_{suffix}" for suffix in KEY_SUFFIXES[dimension])


def _plain(value: Any) -> Any:
    """A value with its sequences as tuples and NumPy's numbers as Python's."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    return tuple(map(_plain, value)) if isinstance(value, Sequence) and not isinstance(value, str) else value


def as_tuples(value: Any) -> Any:
    """Return a value with its lists as tuples."""
    return tuple(map(as_tuples, value)) if isinstance(value, list) else value


def _numbers(value: Any) -> Iterator[float]:
    """The figures of a value, in lists too."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for member in value:
            yield from _numbers(member)


def _convert(value: Any, unit: str) -> Any:
    factor, offset = to_si(unit)
    if isinstance(value, list | tuple):
        return tuple(_convert(item, unit) for item in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value  # left for the type check, which names the key
    try:
        return factor * value + offset
    except OverflowError:  # an integer of hundreds of digits
        return math.inf


def _problem(
    item: Any,
    kind: type[FileModel | Record],
    raw: Any,
    origin: Origin,
    others: Mapping[str, Origin],
    expected: Mapping[str, str],
) -> Problem:
    location, value, wrong = tuple(item["loc"]), item.get("input"), item["type"] == "value_error"
    message, written = _refusal_words(item, expected), _written(raw, location)
    if isinstance(value, _Wrong):
        message, wrong, written = value.reason, True, (*written[:-1], value.key)
    elif item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        key = str(location[-1])
        message, wrong = f"unknown key{nearest(key, _known_keys(kind, location[:-1]))}", True
    elif item["type"] == "missing":
        name, table, wrong = location[-1], _table_at(kind, location[:-1]), True
        dimension = dimensions(table).get(str(name)) if table else None
        message = f"missing: expected {_spellings(str(name), dimension) if dimension else repr(name)}"
        if isinstance(name, int):
            message = f"value {name + 1} is missing"
        written = written[:-1]
    if item["type"] == "order":
        message += f", found {' and '.join(f'{figure:g}' for figure in _at(raw, written))}"
    elif not wrong:
        message += f", found {_shown(_at(raw, written))}"
    return (others.get(str(location[0]), origin) if location else origin).problem(message, *written)


def _refusal_words(item: Any, expected: Mapping[str, str]) -> str:
    """Say what pydantic expected where it refused, in the words expected for that kind of refusal if there are any."""
    message = expected.get(item["type"], "").format(**item.get("ctx", {})) or item["msg"]
    message = re.sub("^Input should be (greater|less)", r"expected a number \1", message)
    return re.sub("^Input should be ", "expected ", message).removeprefix("Value error, ")


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
        members = (
            vars(raw) if isinstance(raw, Record) else dict(enumerate(raw)) if isinstance(raw, list | tuple) else raw
        )
        raw = members.get(part) if isinstance(members, Mapping) else None
    return raw


def _shown(value: Any) -> str:
    """A value as TOML spells it, cut where it is long."""
    text = str(value).lower() if isinstance(value, bool) else repr(list(value) if isinstance(value, tuple) else value)
    return shortened(text)


def _table_at(kind: Any, location: tuple[Any, ...]) -> type[FileModel | Record] | None:
    for part in location:
        if _is_table(kind):
            kind = _annotations(kind).get(part, kind)
        while not _is_table(kind):
            arguments = [a for a in get_args(kind) if a not in (str, type(None), ...)]
            if not arguments:
                return None
            kind = arguments[0]
    return kind if _is_table(kind) else None


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel | Record)


def _known_keys(kind: Any, location: tuple[Any, ...]) -> list[str]:
    table = _table_at(kind, location)
    if table is None:
        return []
    aliases = {name: field.alias or name for name, field in getattr(table, "model_fields", {}).items()}
    return [
        key
        for name, dimension in dimensions(table).items()
        for key in (
            [f"{name}_{suffix}" for suffix in KEY_SUFFIXES[dimension]] if dimension else [aliases.get(name, name)]
        )
    ]


def _dotted(location: tuple[Any, ...]) -> str:
    """A location as text; members of a list are counted from 1, as joints are."""
    text = ""
    for part in location:
        text += f"[{part + 1}]" if isinstance(part, int) else (f".{shortened(part)}" if text else shortened(str(part)))
    return text
