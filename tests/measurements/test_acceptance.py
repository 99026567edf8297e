"""The table `[acceptance]` of a study: read in SI, and refused where it cannot be right."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest

from calflow.files.problems import InputError
from calflow.files.toml import read_toml
from calflow.study import Acceptance


def read(folder: Path, text: str) -> Acceptance:
    path = folder / "acceptance.toml"
    path.write_text(text, encoding="utf-8")
    return read_toml(path, Acceptance)


def test_what_is_stated_is_read(tmp_path: Path) -> None:
    """Fails if a quantity does not come in SI, or a date is taken for text."""
    found = read(tmp_path, 'date = 2025-11-20\ntemperature_degC = 21.4\ntolerance_mm = 0.15\noperator = "王"')
    assert (found.date, found.operator) == (datetime.date(2025, 11, 20), "王")
    assert (found.temperature, found.tolerance) == pytest.approx((294.55, 0.15e-3))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('date = "2025-11-20"', "expected a date without quotes"),
        ("tolerance_mm = 0", "greater than 0"),
        ("tolerance = 0.1", "needs its unit in the key"),
        ('serial = "7"', "unknown key"),
        ("", "expected one or more of serial_number"),
    ],
)
def test_what_cannot_be_right_is_refused(tmp_path: Path, text: str, said: str) -> None:
    """Fails if a tolerance of nothing, a misspelt key or a date in words passes."""
    with pytest.raises(InputError, match=said):
        read(tmp_path, text)
