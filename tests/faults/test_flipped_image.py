"""Flipped image: images whose points are numbered from another end are told by their rows, and renumbered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.faults import examined
from observations.photographed import UR5E, photographed
from observations.test_camera import study


def test_an_image_that_is_counted_from_the_wrong_end_is_told(tmp_path):
    """Fails if its rows are called outliers alone, or those of other images are with it, or single outliers are forgotten."""
    assert_told(tmp_path, ["px_x_mm", "px_y_mm"], "opposite corner")


def assert_told(tmp_path, columns: list[str], words: str) -> None:
    """An image whose points count the other way is told as such, with its own rows; benchmarks/slow has a mirrored one."""
    made = photographed(UR5E, True, 24, np.random.default_rng(3))
    rows, wrong = made.rows.copy(), made.rows["pose"].to_numpy() == 9
    rows.loc[wrong, columns] = rows[columns].max() - rows.loc[wrong, columns]
    rows.loc[5, "u_px"] += 300
    data, faults = examined(study(tmp_path, replace(made, rows=rows), "ur5e", True).measurements())
    found = {fault.cause: fault for fault in faults}
    assert words in found["flipped-image"].statement
    assert {one.row - 1 for one in found["flipped-image"].corrections} == {*np.flatnonzero(wrong)}
    assert [one.row for one in found["outlier"].corrections] == [6]
    assert len(faults) == 2
    np.testing.assert_allclose(1e3 * data.table[["px_x", "px_y"]], made.rows[["px_x_mm", "px_y_mm"]], atol=1e-9)
