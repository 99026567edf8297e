"""A plate that is not flat (`board-bent`), hidden in photographs by physics of their own."""

from __future__ import annotations

import numpy as np
import pytest

from effects.boards import BOARD, findings_of, of_plate


def bent(by: float) -> np.ndarray:
    """A plate bowed along x by so much at 0.1 m from its middle, and twisted by half of that [m]."""
    x, y = (BOARD[:, :2] - BOARD[:, :2].mean(axis=0)).T / 0.1
    return BOARD + np.column_stack([0 * x, 0 * x, by * (x**2 + 0.5 * x * y)])


def test_a_plate_that_is_not_flat_is_findings_of(tmp_path):
    """Fails if a bowed plate is missed, taken for another cause, or its height is not the plate's."""
    only = findings_of(tmp_path, of_plate(11, bent(3e-4)))
    assert [*only.index] == ["board-bent"]
    assert only.loc["board-bent", "estimate"] == pytest.approx(
        3e-4 * np.hypot(1, 0.5), abs=4 * only.loc["board-bent", "sd"]
    )
    assert only.loc["board-bent", "sd"] < 3e-5
    assert only.loc["board-bent", "heldout_mean"] < 0.3
