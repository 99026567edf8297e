"""A robot calibrated by one camera's pixels alone: nothing after the graph asks what was observed; see test_inclinometer.py."""

from __future__ import annotations

import numpy as np
import pandas as pd

from hidden.causes import Hidden
from observations.newcomer import calibrated, simulated, study
from observations.pinhole import Pinhole

NOISE, ODD = 0.05, 23  # px, and the row whose marker was mistaken
FOCAL, MIDDLE = 3000.0, (1024.0, 768.0)  # px
ECCENTRIC = 6e-4  # rad
ORIGIN = np.array([3.5, 0.4, 0.9])  # m; it looks along -x, with its y axis down
AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # of the camera, as rows


def image(made):
    """Where the camera sees the marker."""
    x, y, z = AXES @ (made.point - ORIGIN).T
    seen = np.column_stack([FOCAL * x / z, FOCAL * y / z]) + MIDDLE
    seen += NOISE * np.random.default_rng(9).standard_normal(seen.shape)
    seen[ODD, 1] += 40.0
    return pd.DataFrame(seen, columns=["u_px", "v_px"])


def test_pixels_find_what_is_hidden(small, tmp_path):
    """Fails if anything between the graph and the findings asks whether it was lengths that were measured."""
    made = simulated(90, 8, Hidden("joint-eccentricity", 2, ECCENTRIC, 2))
    settings = (
        f"sigma_px = {NOISE}\n\n[measurements.settings]\nfocal_px = {FOCAL}\nmiddle_px = {list(MIDDLE)}\n"
        "origin_mm = [3500, 400, 900]\nrotation_deg = [-90, -90, 0]\n"
    )
    environment = study(small, tmp_path / "site", Pinhole, made, image(made), settings, ("identify", "diagnose"))
    found = calibrated(small, environment, made, ODD, "px", ECCENTRIC)
    assert 0.3 < found.nominal < 5.0
    assert found.left < 3 * NOISE
