"""Rows that are off by less than what shows before a fit are found by the final model, from end to end."""

from __future__ import annotations

import numpy as np
import pandas as pd

from conftest import in_process
from hidden.case import Case, write_case

FEW = "[stages.identify]\nstarts = 1\n\n"
FEW += '[stages.diagnose]\ncatalogue = ["joint-backlash", "joint-eccentricity", "frame-step", "link-torsion"]\n'
ROWS, SIGMAS = (37, 90), (12.0, 30.0)


def test_rows_twelve_and_thirty_standard_deviations_off_are_found(tmp_path):
    """Fails if one of two bad rows of 120 is missed, a good one is flagged, lines are wrong, or a cause is blamed for them."""
    case = Case(columns=("approach",), payloads=("none",), effects=("geometry",), settings=FEW)
    write_case(tmp_path / "case", case, np.random.default_rng(51))
    path = tmp_path / "case" / "measurements.csv"
    table, rng = pd.read_csv(path), np.random.default_rng(52)
    for row, size in zip(ROWS, SIGMAS, strict=True):
        way = rng.standard_normal(3)
        table.loc[row, ["x_mm", "y_mm", "z_mm"]] += 1e3 * case.sigma * size * way / np.linalg.norm(way)
    table.to_csv(path, index=False)
    answer = in_process("run", tmp_path / "case", "--out", tmp_path / "run")
    assert answer.code == 0, answer.err
    diagnosed = tmp_path / "run" / "diagnose"
    faults, findings = pd.read_csv(diagnosed / "faults.csv"), pd.read_csv(diagnosed / "findings.csv")
    assert sorted(faults["line"]) == [row + 2 for row in ROWS]
    assert set(zip(faults["cause"], faults["action"], strict=True)) == {("outlier", "told")}
    assert list(findings["cause"]) == ["outlier"]
    assert list(findings["status"]) == ["data_fault"]
    assert f"lines {ROWS[0] + 2}, {ROWS[1] + 2}" in findings["statement"][0]
    residuals = pd.read_csv(diagnosed / "residuals.csv")
    assert np.flatnonzero(residuals["flagged"]).tolist() == list(ROWS)
