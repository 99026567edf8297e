"""Tables are read as they were written, however many rows they have."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd

from calflow.files.csv import read_csv, write_csv


def test_a_column_that_is_empty_for_long_is_of_one_type(tmp_path):
    """Fails if a text that comes after a hundred thousand empty cells makes a column of two types, of which pandas warns."""
    table = pd.DataFrame({"value": np.linspace(0.0, 1.0, 300_000), "unit": [None] * 299_999 + ["mm"]})
    write_csv(tmp_path / "long.csv", table)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = read_csv(tmp_path / "long.csv")
    assert read["unit"].iloc[-1] == "mm"
    assert read["unit"].iloc[:-1].isna().all()
