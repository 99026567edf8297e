"""Stated lens: one that images contradict is found with the rest, whatever the robot does, and no other is."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from calflow.faults.base import correct
from calflow.faults.stated_lens import stated_lens
from observations.photographed import UR5E, Optics, Photographs, board, photographed
from observations.test_camera import lens_stated, study

TRUE = Optics()
TOO_LONG = replace(TRUE, focal=(1.02 * TRUE.focal[0], 1.02 * TRUE.focal[1]))
STRAIGHT = replace(TRUE, bend=(0.0, 0.0, 0.0, 0.0, 0.0))
READINGS = [f"q{i + 1}_rad" for i in range(6)]


def turned(q: np.ndarray) -> np.ndarray:
    """Where the joints stand that read q (n, 6): the third is not on its axis."""
    return q + np.outer(1.5e-3 * np.cos(q[:, 2] + 0.7), np.arange(6) == 2)


def seen(n: int, hidden: bool, bow: float = 0.0) -> Photographs:
    """Photographs by a worn arm, whose readings may say another angle of the third joint, of a board bowed by so many metres."""
    flat = board(6, 4, 0.04)
    points = flat + np.outer((2 * flat[:, 0] / flat[:, 0].max() - 1) ** 2, [0, 0, bow])
    made = photographed(UR5E, True, n, np.random.default_rng(11), points=points)
    made.rows["px_z_mm"] = 0.0
    true = made.rows[READINGS].to_numpy()
    made.rows[READINGS] = 2 * true - turned(true) if hidden else true
    return made


@pytest.mark.parametrize(("hidden", "bow"), [(True, 0.0), (False, 1e-3)])
def test_only_a_lens_that_images_contradict_is_called_wrong(tmp_path, hidden, bow):
    """Fails if 2 % of focal length or no distortion pass unsaid, or a robot's cause, a bowed board or wrong points do not."""
    made = seen(12, hidden, bow)
    made.rows.loc[made.rows["pose"] == 4, ["u_px", "v_px"]] += np.random.default_rng(2).uniform(-50, 50, 2)
    made.rows.loc[::97, "u_px"] += 80.0
    whole = {"focal", "centre", "distortion"}
    for lens, sd, wrong in (
        (TRUE, "", set()),
        (TOO_LONG, "", whole),
        (STRAIGHT, "", whole),
        (TOO_LONG, "focal_sd_px = 20.0\n", set()),
    ):
        data = study(tmp_path, made, "ur5e", True, lens_stated(lens) + sd).measurements()
        faults = stated_lens(data)
        assert {one.quantity for fault in faults for one in fault.corrections} == wrong
        assert (reduce(correct, faults, data).series[0].setting("focal") is None) == bool(wrong)
