"""Deviations of tables and documents: how much, where, and in what measure."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd
import pytest

from calflow.files.deviations import agreeing_digits, document_deviations, table_deviations
from calflow.files.tables import column


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row."""

    name: str = column("a name")
    estimate: float = column("a figure", "m", sd="sd")
    sd: float = column("its standard deviation", "m")


WAS = pd.DataFrame({"name": ["a", "b", "c"], "estimate": ["1.0", "2.0", ""], "sd": ["0.1", "0.5", ""]})


def test_a_figure_is_told_in_its_own_sd():
    """Fails if the largest difference is another cell's, or is divided by another row's standard deviation."""
    now = WAS.assign(estimate=["1.01", "2.03", ""])
    (one,) = table_deviations("t.csv", WAS, now, Row)
    assert (one.name, one.cells, one.was, one.now) == ("estimate", 2, "2", "2.03")
    assert one.absolute == pytest.approx(0.03)
    assert one.relative == pytest.approx(0.03 / 2.03)
    assert one.in_sd == pytest.approx(0.1)  # of the first row, whose difference is the smaller one


@pytest.mark.parametrize(
    ("now", "told"),
    [
        (WAS.assign(name=["a", "x", "c"]), ("name", 1, "b", "x")),
        (WAS.assign(estimate=["1.0", "2.0", "3.0"]), ("estimate", 1, "", "3.0")),
        (WAS[:2], ("rows", 1, "3", "2")),
        (WAS[::-1].reset_index(drop=True), ("order of rows", 2, "a 1.0", "c ")),
        (WAS.drop(columns="sd"), ("sd", 3, "there", "not there")),
    ],
)
def test_what_has_no_size_is_told_by_its_cells(now, told):
    """Fails if a changed text, an emptied cell, a lost row or column passes for none, or for a number."""
    (one,) = table_deviations("t.csv", WAS, now, Row)
    assert (one.name, one.cells, one.was, one.now) == told
    assert (one.absolute, one.in_sd) == (None, None)
    assert agreeing_digits([one]) is None


def test_equal_tables_and_documents_differ_nowhere():
    """Fails if anything is told of the same."""
    assert not table_deviations("t.csv", WAS, WAS.copy(), Row)
    assert not document_deviations("s.json", {"a": [1, {"b": None}]}, {"a": [1, {"b": None}]})


def test_a_document_is_told_by_its_keys():
    """Fails if a nested key is not named, or a number is told as a text."""
    one, other = document_deviations("s.json", {"a": [1.0, {"b": "x"}]}, {"a": [1.5, {"b": "y"}]})
    assert (one.name, one.absolute) == ("a.1", 0.5)
    assert (other.name, other.was, other.now) == ("a.2.b", "x", "y")


@dataclass(frozen=True, kw_only=True)
class Mixed:
    """A row whose number is of a unit of its own, with a count and a share."""

    unit: str = column("of value")
    value: float = column("a figure", "as `unit` says")
    count: int = column("how many")
    share: float = column("of all")


MIXED = pd.DataFrame(
    {"unit": ["m", "rad/Nm"], "value": ["2", "1e-9"], "count": ["1000000", "2"], "share": ["0.9", "1e-32"]}
)


@pytest.mark.parametrize(
    ("now", "digits"),
    [
        (MIXED.assign(value=["2.00000001", "1e-9"]), 8),
        (MIXED.assign(value=["2", "1.1e-9"]), None),
        (MIXED.assign(value=["2", "1.00000002e-9"]), 7),
        (MIXED.assign(count=["1000001", "2"]), None),
        (MIXED.assign(share=["0.9", "1e-29"]), 15),
        (MIXED.assign(share=["0.9", "0.001"]), None),
        (MIXED.assign(value=["2.0", "1e-9"]), 15),
    ],
)
def test_agreement_is_told_in_digits(now, digits):
    """Fails if numbers of different units are held against each other, or a change of a count or figure passes for rounding."""
    assert agreeing_digits(table_deviations("t.csv", MIXED, now, Mixed)) == digits
