"""A plate that is not flat (`board-bent`), hidden in photographs by physics of their own; more in benchmarks/slow."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from effects.boards import BOARD, findings_of, of_plates


def bent(by: float) -> np.ndarray:
    """A plate bowed along x by so much at 0.1 m from its middle, and twisted by half of that [m]."""
    x, y = (BOARD[:, :2] - BOARD[:, :2].mean(axis=0)).T / 0.1
    return BOARD + np.column_stack([0 * x, 0 * x, by * (x**2 + 0.5 * x * y)])


def assert_bent_and_stretched(both: pd.DataFrame) -> None:
    """Both errors of the plate are found, and nothing else."""
    assert {*both.index} == {"board-bent", "print-scale"}
    for cause, size, sd in (("board-bent", 4e-4 * np.hypot(1, 0.5), 3e-5), ("print-scale", 3e-3, 3e-4)):
        assert both.loc[cause, "estimate"] == pytest.approx(size, abs=4 * both.loc[cause, "sd"])
        assert both.loc[cause, "sd"] < sd
    assert both.loc["board-bent", "heldout_mean"] < 0.3


def test_the_second_of_two_plates_is_bent_and_stretched(tmp_path):
    """Fails if a bow or a stretched print (`print-scale`) is missed beside the other, taken for another cause, of another size (the
    plate's height, and how much longer the print is one way than the other), or of the plate beside it, which has no errors.
    """
    both = findings_of(tmp_path, of_plates(11, BOARD, bent(4e-4) * [1.0, 1.003, 1.0]))
    assert_bent_and_stretched(both)
    assert both["statement"].str.contains("target board2", regex=False).all()
