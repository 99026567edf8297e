"""Reading of TOML files into frozen objects: keys carry units; problems are reported with their file, line and key.

Arguments of functions called from Python are validated by their annotations, with messages in the same words.
"""

from __future__ import annotations

import inspect
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache, wraps
from itertools import chain
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
    limited_problems,
    nearest,
    refuse,
    refuse_any,
    regular_file,
    truncated,
)
from calflow.files.units import KEY_SUFFIXES, LARGEST, MEASURED, split_unit, to_si

LONGEST_KEY, LONGEST_TEXT = 200, 10_000  # characters
LARGEST_WHOLE = 2**63 - 1  # of TOML
DEEPEST = 20  # levels of nested tables and lists
TOO_LONG = f"is too long: expected at most {LONGEST_KEY} characters in a name, {LONGEST_TEXT} in a text"

WINDOWS = re.compile(r'"(?:[A-Za-z]:|\.{1,2}|\w+)\\(?![\\"])')  # a path with backslashes in double quotes
ESCAPED = re.compile(r"^[A-Za-z]:[\b\t\n\f\r]")  # a path in which TOML read a backslash and a letter as an escape
COMMA = re.compile(r"[^=#]*=\s*[-+]?\d+,\d")  # a number with a decimal comma
POINT = "numbers have a decimal point"
SLASHES = "a backslash begins an escape here: write the path with /, or in single quotes ('C:\\data\\points.csv')"

UNKNOWN = "unknown"  # in place of a quantity that must be stated but is not known

Message = tuple[tuple[Any, ...], str]  # location and message
# Messages for pydantic's types of error, in the terms of TOML.
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
ONE, SEVERAL, NONE = "<table>", "<tables>", "<nothing>"  # alternatives of a union: a single table, several, or none


def beyond_toml(raw: Any, where: tuple[Any, ...] = ()) -> Iterator[Message]:
    """Yield the values of a parsed file that no TOML file may hold: too deep, too long, too large or not printable."""
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
    """Annotation with the dimension of a field, whose key in the file ends in a unit of that dimension."""


Length = Annotated[float, Unit("length")]
Angle = Annotated[float, Unit("angle")]
Mass = Annotated[float, Unit("mass")]
Moment = Annotated[float, Unit("moment")]
Sigma = Annotated[float, Unit(MEASURED)]  # the field `sigma_unit` beside it keeps the unit that the key states
Lengths3 = Annotated[tuple[float, float, float], Unit("length")]
Angles3 = Annotated[tuple[float, float, float], Unit("angle")]


def _of_a_link(value: Any) -> Any:
    """Refuse a link's length that was probably meant in mm, unless it exceeds the limit of all lengths."""
    longest = max(map(abs, _numbers(value)), default=0.0)
    if LONGEST_LINK < longest <= LARGEST["length"]:
        raise ValueError(f"{longest:g} m: no link of a robot is so long. Did you mean mm?")
    return value


LinkLength = Annotated[Length, AfterValidator(_of_a_link)]
LinkPoint = Annotated[Lengths3, AfterValidator(_of_a_link)]


File = TypeVar("File", bound="FileModel | Record")


@dataclass(frozen=True)
class Origin:
    """The origin of a table: its file, its key path in the file, and the line of every key path of the file."""

    path: Path
    table: tuple[Any, ...]
    lines: Mapping[tuple[Any, ...], int]  # of every key path and each of its prefixes

    @staticmethod
    def of(path: Path, *table: str) -> Origin:
        """Return the origin of a table of a file, which is read again for its lines."""
        return Origin.of_text(path, read_text(path), *table)

    @staticmethod
    def of_text(path: Path, text: str, *table: str) -> Origin:
        """Return the origin of a table, given the text of its file."""
        lines: dict[tuple[Any, ...], int] = {}
        for key, line in line_numbers(text).items():
            for end in range(min(len(key), DEEPEST), 0, -1):
                lines[key[:end]] = min(line, lines.get(key[:end], line))
        return Origin(path, table, lines)

    def refuse(self, message: str, *location: Any) -> InputError:
        """Return the error for a single problem at a location in the table, to be raised by the caller."""
        return InputError([self.problem(message, *location)])

    def problem(self, message: str, *location: Any) -> Problem:
        """Return a problem at a location in the table, with the line of its key or of the innermost enclosing table."""
        where = (*self.table, *location)
        around = (self.lines.get(where[:end]) for end in range(len(where), 0, -1))
        line = next((number for number in around if number), None)
        return Problem(message, self.path, line, _dotted(where) or None)


@dataclass(frozen=True)
class _Wrong:
    """What makes a field fail, in place of its value; key is its spelling in the file, empty where it is not there."""

    reason: str
    key: str = ""


class FileModel(BaseModel):
    """Base of the models read from TOML: frozen, without unknown keys, quantities in SI by the unit of their key."""

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
    """Base of the frozen dataclasses that are built in Python, in SI, or read from a table whose keys carry units.

    Built records are validated with the object that contains them (see `checked`), so that all problems are reported.
    Sequences become tuples and NumPy scalars Python numbers, so that records can be compared.
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
        inner["strict"] = False  # the fields stay strict, but the record may be given as a table
        return made

    @model_validator(mode="wrap")
    @classmethod
    def _units(cls, raw: Any, handler: ModelWrapValidatorHandler[Any]) -> Any:
        return handler(_in_si(cls, raw))

    @field_validator("*")
    @classmethod
    def _within_what_robots_have(cls, value: Any, info: ValidationInfo) -> Any:
        return _within_what_robots_have(cls, value, info)


# The dimension of each field of a file model or record; None if its key carries no unit.
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


def keys_of(kind: type[FileModel | Record]) -> dict[str, dict[str, str]]:
    """Return the keys by which a table may state each field of a file model or record, and the unit of each key."""
    return {
        name: {f"{name}_{unit}": unit for unit in KEY_SUFFIXES[dimension]} if dimension else {name: ""}
        for name, dimension in dimensions(kind).items()
    }


def defaults(kind: type[FileModel | Record]) -> dict[str, Any]:
    """Return the default value of each field of a file model or record; MISSING where it must be stated."""
    if issubclass(kind, FileModel):
        return {
            name: MISSING if field.is_required() else field.get_default(call_default_factory=True)
            for name, field in kind.model_fields.items()
        }
    return {
        field.name: field.default if field.default_factory is MISSING else field.default_factory()
        for field in fields(kind)
    }


def _in_si(kind: type[FileModel | Record], raw: Any) -> Any:
    """The table with its quantities in SI under the names of their fields, such as `a = 0.005` for `a_mm = 5`."""
    if not isinstance(raw, dict):
        return raw
    keys = keys_of(kind)
    converted: dict[str, Any] = {}
    for key, value in raw.items():
        name, unit = (key, "") if key in keys else split_unit(key)
        dimension = dimensions(kind).get(name)
        if dimension is None and key in keys:
            converted[key] = as_tuples(value)
        elif dimension is None:
            spelled = list(chain(*keys.values()))
            alike = nearest(key, [other for other in spelled if unit and split_unit(other)[1] == unit])
            converted[key] = _Wrong(f"unknown key{alike or nearest(key, spelled)}", key)
        elif name in converted:
            converted[name] = _Wrong(f"'{name}' is given twice, in different units", key)
        elif not unit:
            converted[name] = _Wrong(f"needs its unit in the key: {' or '.join(keys[name])}", key)
        elif key not in keys[name]:
            converted[name] = _Wrong(f"expected a unit of {dimension}: {' or '.join(keys[name])}", key)
        else:
            converted[name] = _convert(value, unit)
            if dimension == MEASURED:
                converted[f"{name}_unit"] = unit
    for name, default in defaults(kind).items():
        if default is MISSING and name not in converted and dimensions(kind)[name]:
            converted[name] = _Wrong(f"missing: expected {' or '.join(keys[name])}")
    return converted


def _within_what_robots_have(kind: type[FileModel | Record], value: Any, info: ValidationInfo) -> Any:
    """Refuse magnitudes that no robot has, whose squares might overflow."""
    if not any(_numbers(value)):
        return value  # as most fields
    name = info.field_name or ""
    stated = dimensions(kind).get(name)
    unit = "" if stated else split_unit(name)[1]  # of a field that keeps the unit of its key
    dimension = stated or next((of for of, units in KEY_SUFFIXES.items() if unit in units), "")
    factor = to_si(unit)[0] if unit else 1.0
    if any(abs(factor * number) > LARGEST[dimension] for number in _numbers(value)):
        most = f"{LARGEST[dimension]:g}{f' {KEY_SUFFIXES[dimension][0]}' if dimension else ''}"
        raise PydanticCustomError("beyond", "expected at most {most}", {"most": most})
    return value


def refuse_all(messages: Iterable[Message]) -> None:
    """Report all problems of a value to pydantic at once, each with its location within the value.

    Raises:
        ValidationError: with all problems, if there are any.
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
    """Return a TOML file as a model.

    Raises:
        InputError: the file cannot be read or is not TOML; or with all problems in its content.
    """
    raw, origin = parse_toml(path)
    return validate_table(raw, kind, origin)


def parse_toml(path: Path) -> tuple[dict[str, Any], Origin]:
    """Return the content of a TOML file and its origin.

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
        wrong = lines[at - 1] if at else ""
        hint = f"; {SLASHES}" if WINDOWS.search(wrong) else f"; {POINT}" if COMMA.match(wrong) else ""
        raise refuse(f"not TOML: {error}{hint}", path, at) from None
    except (ValueError, RecursionError) as error:  # a number of thousands of digits
        raise refuse(f"cannot be read: {error}", path) from None
    origin = Origin.of_text(path, text)
    refuse_any(limited_problems(list(beyond_toml(raw)), lambda item: origin.problem(item[1], *item[0])))
    return raw, origin


def read_text(path: Path) -> str:
    """Return the text of a regular file in UTF-8.

    Raises:
        InputError: the file does not exist, is not a regular file, or cannot be read.
    """
    try:
        return regular_file(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise refuse(f"is not a text file in UTF-8: found the byte {error.object[error.start]:#04x}", path) from None
    except (OSError, ValueError) as error:
        raise refuse(f"cannot be read: {error}", path) from None


def validate_table(
    raw: dict[str, Any],
    kind: type[File],
    origin: Origin,
    others: Mapping[str, Origin] | None = None,
    context: Mapping[str, Any] | None = None,
) -> File:
    """Return a parsed table as a model; others has the origins of keys from elsewhere, context is for the validators.

    Raises:
        InputError: with all problems in the table.
    """
    try:
        made: File = adapter(kind).validate_python(raw, context=context)
        return made
    except ValidationError as error:
        problems = _problems(error, raw, origin, others or {}, _EXPECTED)
        raise InputError(sorted(problems, key=lambda problem: (str(problem.file), problem.line or 0))) from None


def sound_part(raw: dict[str, Any], kind: type[File], otherwise: Mapping[str, Any]) -> File | None:
    """Return a parsed table as a model without the keys and the tables in it that hold mistakes: what the others name is checked.

    otherwise has values for keys that are left out; None if still others are required.
    """
    try:
        return cast(File, adapter(kind).validate_python(raw))
    except ValidationError as error:
        wrong = {str(_named(item["loc"])[0]) for item in error.errors(include_url=False) if item["loc"]}
    left = {key: value for key, value in raw.items() if wrong.isdisjoint((key, split_unit(key)[0]))}
    with suppress(ValidationError):
        return cast(File, adapter(kind).validate_python({**otherwise, **left}))
    return None


def checked(record: Record, kind: type[File], place: str, context: Mapping[str, Any]) -> File:
    """Return a record that was built in Python, validated with all records that it contains.

    Raises:
        InputError: with all problems, each with its location after `place`.
    """
    try:
        made: File = adapter(kind).validate_python(record, context=context)
        return made
    except ValidationError as error:
        problems = _problems(error, record, Origin(Path(), (), {}), {}, _EXPECTED | _IN_PYTHON)
        raise InputError(replace(problem, file=None, key=f"{place}: {problem.key}") for problem in problems) from None


adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)  # cached, since building one is slow


Function = TypeVar("Function", bound=Callable[..., Any])
Count = Annotated[int, Field(ge=1)]
Seed = Annotated[int, Field(ge=0, le=10**9)]
Positive = Annotated[float, Field(gt=0)]
Confidence = Annotated[float, Field(ge=0.5, lt=1)]
FalseAlarm = Annotated[float, Field(gt=0, lt=0.5)]


def checked_arguments(function: Function) -> Function:
    """Decorate a function such that it raises an InputError with all arguments that contradict its annotations.

    Choices, numbers, texts, generators and instances of classes are validated; sequences and arrays are left to the function.
    """

    @wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        try:
            given = inspect.signature(function).bind(*args, **kwargs)
        except TypeError:  # a wrong number or name of arguments, on which Python's message is clear
            return function(*args, **kwargs)
        given.arguments |= as_annotated(function, given.arguments)
        return function(*given.args, **given.kwargs)

    return cast(Function, called)


def as_annotated(function: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return those arguments of a function, or fields of a class, that annotations can validate, converted accordingly.

    Raises:
        InputError: with all arguments that contradict their annotations.
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
    """The annotations, by argument, that pydantic can validate."""
    hints = get_type_hints(function, include_extras=True)
    kinds = {name: _judged(kind) for name, kind in hints.items() if name != "return"}
    return {name: kind for name, kind in kinds.items() if kind is not None}


def _judged(kind: Any) -> Any:
    """The annotation by which pydantic validates an argument; None if it is neither a single value nor a choice."""
    if get_origin(kind) in (Union, UnionType):
        alone = [member for member in get_args(kind) if member is not type(None)]
        judged = _judged(alone[0]) if len(alone) == 1 else None
        return None if judged is None else judged | None
    if get_origin(kind) in (Annotated, Literal) or kind in (bool, int, float, str, Path):
        return kind
    instance = inspect.isclass(kind) and kind.__module__.startswith(("calflow.", "numpy.random."))
    return Annotated[kind, InstanceOf()] if instance else None


def _problems(
    error: ValidationError, raw: Any, origin: Origin, others: Mapping[str, Origin], expected: Mapping[str, str]
) -> list[Problem]:
    """The problems of a pydantic error, in its order."""
    items = [item | {"loc": _named(item["loc"])} for item in error.errors(include_url=False)]
    inner = {item["loc"][:end] for item in items for end in range(len(item["loc"]))}
    # pydantic reports a list as too short if its members are wrong, which are reported themselves
    counting = [item for item in items if item["type"] != "too_short" or item["loc"] not in inner]
    return limited_problems(
        counting, lambda item: _problem(item, raw, origin, others, expected), lambda item: item["type"]
    )


def _named(location: tuple[Any, ...]) -> tuple[Any, ...]:
    """A location without the names of the alternatives of unions."""
    return tuple(part for part in location if part not in (ONE, SEVERAL, NONE))


def line_numbers(text: str) -> dict[tuple[Any, ...], int]:
    """Return the line number (from 1) of each key path of a TOML text; elements of arrays of tables are indexed."""
    table: tuple[Any, ...] = ()
    counts: dict[tuple[str, ...], int] = {}
    lines: dict[tuple[Any, ...], int] = {}
    until, depth = "", 0  # the quotes that end a multi-line text, and the number of open brackets
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
    """The dimension in an annotation, or in one of its members, as of an optional quantity."""
    of = (str(item) for item in getattr(annotation, "__metadata__", ()) if isinstance(item, Unit))
    return next(of, None) or next(filter(None, map(_dimension, get_args(annotation))), None)


def _plain(value: Any) -> Any:
    """A value with its sequences as tuples and its NumPy scalars as Python numbers."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    return tuple(map(_plain, value)) if isinstance(value, Sequence) and not isinstance(value, str) else value


def as_tuples(value: Any) -> Any:
    """Return a value with its lists, also nested ones, as tuples."""
    return tuple(map(as_tuples, value)) if isinstance(value, list) else value


def _numbers(value: Any) -> Iterator[float]:
    """The floats of a value, also of nested tuples."""
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
        return value  # left to the type check, which names the key
    try:
        return factor * value + offset
    except OverflowError:  # an integer of hundreds of digits
        return math.inf


def _problem(item: Any, raw: Any, origin: Origin, others: Mapping[str, Origin], expected: Mapping[str, str]) -> Problem:
    location, value, wrong = tuple(item["loc"]), item.get("input"), item["type"] == "value_error"
    message, written = _refusal_words(item, expected), _written(raw, location)
    if isinstance(value, _Wrong):
        message, wrong, written = value.reason, True, (*written[:-1], *filter(None, [value.key]))
    elif wrong:
        message, written = _at_its_key(message, raw, written)
    elif item["type"] == "missing":
        name, wrong, written = location[-1], True, written[:-1]
        message = f"value {name + 1} is missing" if isinstance(name, int) else f"missing: expected {name!r}"
    if item["type"] == "order":
        message += f", found {' and '.join(f'{figure:g}' for figure in _at(raw, written))}"
    elif not wrong:
        message += f", found {_shown(_at(raw, written))}"
    return (others.get(str(location[0]), origin) if location else origin).problem(message, *written)


def _refusal_words(item: Any, expected: Mapping[str, str]) -> str:
    """The message for an item of a pydantic error: that of `expected` for its type, else pydantic's, reworded."""
    message = expected.get(item["type"], "").format(**item.get("ctx", {})) or item["msg"]
    message = re.sub("^Input should be (greater|less)", r"expected a number \1", message)
    return re.sub("^Input should be ", "expected ", message).removeprefix("Value error, ")


def _at_its_key(message: str, raw: Any, location: tuple[Any, ...]) -> tuple[str, tuple[Any, ...]]:
    """A table's message and its location: that of the key, if the message begins with one that the table has."""
    name, _, words = message.partition(": ")
    at = (*location, *_written(_at(raw, location), (name,)))
    return (words, at) if words and _at(raw, at) is not None else (message, location)


def _written(raw: Any, location: tuple[Any, ...]) -> tuple[Any, ...]:
    """A location with its keys as the file spells them, including their units."""
    written: list[Any] = []
    for part in location:
        if isinstance(raw, dict) and part not in raw:
            part = next((key for key in raw if split_unit(key)[0] == part), part)
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
    """A value as TOML spells it, truncated if long."""
    text = str(value).lower() if isinstance(value, bool) else repr(list(value) if isinstance(value, tuple) else value)
    return truncated(text)


def _dotted(location: tuple[Any, ...]) -> str:
    """A location as dotted text; list elements are numbered from 1, as joints are."""
    text = ""
    for part in location:
        text += f"[{part + 1}]" if isinstance(part, int) else (f".{truncated(part)}" if text else truncated(str(part)))
    return text
