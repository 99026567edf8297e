"""Tables and documents: what a dataclass declares is what stands in the file, and comes back as it was."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd
import pytest

from calflow.files.data_package import table_schema
from calflow.files.problems import InputError
from calflow.files.tables import column, from_document, from_frame, to_document, to_frame, typed


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A row of every kind."""

    name: str = column("a name", default="")
    count: int = column("how many")
    joint: int | None = column("a joint", default=None)
    size_mm: float = column("how large", "mm", default=float("nan"))
    good: bool = column("whether it is good", default=True)
    kind: Literal["a", "b"] = column("what it is", default="a")
    rivals: tuple[str, ...] = column("others", name="from", separator="; ", default=())
    lines: tuple[int, ...] = column("lines", default=())
    readings: Mapping[str, float] = column("reading", "as named", name="q{joint}_{deg|mm}")
    of: Mapping[str, int] = column("side", name="approach{joint}")


FULL = Sample(name="1", count=3, joint=2, size_mm=0.25, good=False, kind="b", rivals=("x 1", "y"), lines=(4, 5),
              readings={"q1_deg": 1.5, "q2_mm": -2.0}, of={"approach1": -1})  # fmt: skip
BARE = Sample(count=0, readings={"q1_deg": 0.0, "q2_mm": 0.0}, of={"approach1": 1})


def through_csv(frame: pd.DataFrame) -> pd.DataFrame:
    """A table as a run reads it."""
    return pd.read_csv(io.StringIO(frame.to_csv(index=False)))


def same(found: Sample, expected: Sample) -> bool:
    """Whether two rows are alike, nan like nan."""
    sizes = np.array_equal([found.size_mm], [expected.size_mm], equal_nan=True)
    return sizes and replace(found, size_mm=0.0) == replace(expected, size_mm=0.0)


def test_rows_come_back_as_they_were():
    """Fails if a gap, a list, a number in a text or the columns of a pattern change on the way through a file."""
    for rows in ([FULL, BARE], [FULL], [BARE], [BARE, BARE]):
        frame = to_frame(rows, Sample)
        for read in (frame, through_csv(frame)):
            assert all(same(found, row) for found, row in zip(from_frame(read, Sample), rows, strict=True))


def test_columns_stand_in_the_order_declared_with_their_types():
    """Fails if an empty table lacks its header, or a column of whole numbers and gaps becomes one of floats."""
    plain = ["name", "count", "joint", "size_mm", "good", "kind", "from", "lines"]
    assert list(to_frame([], Sample)) == plain
    frame = to_frame([FULL, BARE], Sample)
    assert list(frame) == [*plain, "q1_deg", "q2_mm", "approach1"]
    assert [str(frame[name].dtype) for name in ("count", "joint", "size_mm", "good")] == [
        "int64",
        "Int64",
        "float64",
        "bool",
    ]
    assert frame["from"].tolist() == ["x 1; y", ""]


def test_what_is_not_declared_is_no_table():
    """Fails if a column can be forgotten, or slip into a file without a meaning."""
    frame = to_frame([FULL], Sample)
    with pytest.raises(TypeError, match="missing \\['count'\\]"):
        typed(frame.drop(columns="count"), Sample)
    with pytest.raises(TypeError, match="not declared \\['more'\\]"):
        typed(frame.assign(more=1), Sample)
    with pytest.raises(InputError, match="lacks columns: count"):
        from_frame(frame.drop(columns="count"), Sample)
    with pytest.raises(InputError, match="was changed"):
        from_frame(frame.assign(count="many"), Sample)


def test_a_schema_tells_every_column():
    """Fails if another program cannot learn a column's type, unit and meaning from the schema."""
    fields = {field["name"]: field for field in table_schema(to_frame([FULL], Sample), Sample)["fields"]}
    assert list(fields) == list(to_frame([FULL], Sample))
    assert fields["size_mm"] == {"name": "size_mm", "type": "number", "description": "how large", "unit": "mm"}
    assert fields["kind"]["constraints"] == {"enum": ["a", "b"]}
    assert (fields["lines"]["type"], fields["lines"]["itemType"], fields["lines"]["delimiter"]) == (
        "list",
        "integer",
        ";",
    )
    assert fields["q2_mm"]["description"] == "reading"


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of a document."""

    of: str = column("a name")


@dataclass(frozen=True, kw_only=True)
class Whole:
    """A document of every kind."""

    size_mm: float = column("how large", "mm")
    chance: float | None = column("null: cannot be told")
    ranks: dict[str, int] = column("by name")
    parts: tuple[Part, ...] = column("parts", default=())


def test_documents_hold_values_and_come_back():
    """Fails if a number becomes text, what cannot be told a number, or a document that was changed passes."""
    whole = Whole(size_mm=np.float64(0.125), chance=float("nan"), ranks={"a-b": 3}, parts=(Part(of="x"),))
    document = to_document(whole)
    assert document == {"size_mm": 0.125, "chance": None, "ranks": {"a-b": 3}, "parts": [{"of": "x"}]}
    assert from_document(document, Whole) == replace(whole, chance=None)
    with pytest.raises(InputError, match="size_mm"):
        from_document({**document, "size_mm": "large"}, Whole)
