"""Tables are read as they were written, however many rows they have."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pytest

from calflow.files.tables import csv_text, read_csv, read_texts, write_csv


def test_a_column_that_is_empty_for_long_is_of_one_type(tmp_path):
    """Fails if a text that comes after a hundred thousand empty cells makes a column of two types, of which pandas warns."""
    table = pd.DataFrame({"value": np.linspace(0.0, 1.0, 300_000), "unit": [None] * 299_999 + ["mm"]})
    write_csv(tmp_path / "long.csv", table)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = read_csv(tmp_path / "long.csv")
    assert read["unit"].iloc[-1] == "mm"
    assert read["unit"].iloc[:-1].isna().all()


@pytest.mark.parametrize(
    "text", ["=1+1", "+cmd|' /C calc'!A0", "-1+1", "@SUM(A1)", "=", "'=1", "''@x", "-inf", "\t=1", "- 1"]
)
def test_a_text_that_a_spreadsheet_would_compute_is_quoted(tmp_path, text):
    """Fails if a name in a table is run by the spreadsheet that opens it, or does not read back as it was."""
    table = pd.DataFrame({text: ["a", "b"], "name": [text, "plain"], "gap": [None, text]})
    write_csv(tmp_path / "a.csv", table)
    as_it_stands = pd.read_csv(tmp_path / "a.csv", dtype=str)
    assert [as_it_stands.columns[0], as_it_stands["name"][0], as_it_stands["gap"][1]] == [f"'{text}"] * 3
    pd.testing.assert_frame_equal(read_csv(tmp_path / "a.csv"), table, check_dtype=False)
    assert read_texts(tmp_path / "a.csv")["name"].tolist() == [text, "plain"]


@pytest.mark.parametrize("text", ["-0.5", "+1e-3;-2", "'-0.5", "it's", "'", "a=b", "-.5; 2", ""])
def test_other_cells_are_as_they_are(tmp_path, text):
    """Fails if a number, a list of them or a plain text is written otherwise, or another reader's apostrophe is lost."""
    table = pd.DataFrame({"name": [text, "plain"], "value": [-0.5, 1.0]})
    assert f"\n{text},-0.5\n" in csv_text(table)
    write_csv(tmp_path / "a.csv", table)
    assert read_texts(tmp_path / "a.csv")["name"][0] == text
