"""Rows that were written several times count once; honest repeats stay."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from calflow.faults import as_table, corrected, examined
from calflow.faults.duplicate import duplicate
from calflow.measurements.measurements import Measurements
from calflow.study import load_study
from hidden.case import Case, write_case


def measured(folder, copies=(), decimals=4, repeats=1):
    """A case's measurements read from its file, in which rows (from 0) were written again under another repeat."""
    case = Case(poses=40, repeats=repeats, sigma=2e-5, effects=("geometry",), workflow="paper-table")
    write_case(folder, case, np.random.default_rng(4))
    table = pd.read_csv(folder / "measurements.csv").round(dict.fromkeys(("x_mm", "y_mm", "z_mm"), decimals))
    if "repeat" not in table:
        table["repeat"] = 1
    again = table.iloc[list(copies)].assign(repeat=lambda rows: rows["repeat"] + 10)
    pd.concat([table, again]).to_csv(folder / "measurements.csv", index=False)
    return load_study(folder).measurements()


@pytest.mark.parametrize("repeats", [1, 3])
def test_copies_count_once_and_are_told_with_their_lines(tmp_path, repeats):
    """Fails if a copy counts as a repeat without scatter, its original is left out, or a line is not told."""
    data = measured(tmp_path, (3, 20), repeats=repeats)
    n = len(data)
    after, found = examined(data)
    assert [(one.cause, one.action, one.lines) for one in found] == [("duplicate", "left out", (n, n + 1))]
    assert "lines 5, 22" in found[0].statement
    assert np.flatnonzero(~after.train & ~after.held_out).tolist() == [n - 2, n - 1]
    assert corrected(data, as_table(found, data)).table.equals(after.table)


def test_repeats_of_a_coarse_device_are_honest(tmp_path):
    """Fails if rounding that makes repeats alike is taken for copies, which would leave only those that differ."""
    data = measured(tmp_path, decimals=1, repeats=4)
    assert data.table.duplicated(["pose", "x", "y", "z"]).sum() > 20
    assert duplicate(data) == ()


def test_another_payload_or_marker_is_another_observation(tmp_path):
    """Fails if rows are told by their measured values alone."""
    data = measured(tmp_path, (3,))
    table = data.table.copy()
    table.loc[len(table) - 1, "payload"] = next(
        name for name in data.robot.payloads if name != table["payload"].iloc[3]
    )
    assert duplicate(Measurements(data.robot, table, data.notes)) == ()
