"""A robot calibrated by an inclinometer alone: nothing after the graph asks what was observed."""

from __future__ import annotations

import numpy as np
import pandas as pd

from hidden.causes import Hidden
from observations.inclinometer import Inclinometer
from observations.newcomer import all_the_way, simulated, study

NOISE, ODD = 5e-5, 17  # rad, and the row that was misread
ZERO = (0.004, -0.003)  # rad
ECCENTRIC = 6e-4  # rad


def angles(made):
    """What the inclinometer on link 3 shows, in degrees."""
    up = made.found.tips[2][:, 2, :3]  # of the base's z axis, along the link's axes
    shown = np.column_stack([np.arctan2(up[:, 0], up[:, 1]), np.arcsin(up[:, 2])]) + ZERO
    shown += NOISE * np.random.default_rng(6).standard_normal(shown.shape)
    shown[ODD, 0] += 0.05
    return pd.DataFrame(np.rad2deg(shown), columns=["pitch_deg", "tilt_deg"])


def test_an_inclinometer_goes_all_the_way(small, tmp_path):
    """Fails if anything between the graph and page one asks whether it was lengths that were measured."""
    made = simulated(90, 5, Hidden("joint-eccentricity", 2, ECCENTRIC, 2))
    settings = "sigma_urad = 50\n\n[measurements.settings]\nlink = 3\n"
    environment = study(small, tmp_path / "site", Inclinometer, made, angles(made), settings)
    found = all_the_way(small, environment, made, ODD, "mrad", ECCENTRIC)
    assert 1.0 < found.nominal < 10.0
    assert found.left < 3 * 1e3 * NOISE
    for name, zero in zip(("pitch", "tilt"), ZERO, strict=True):
        own = found.parameters.loc[f"inclinometer.{name}"]
        assert abs(own["estimate"] - zero) < 3 * own["sd"]
    _holds_in_its_unit(small, environment)


VALIDATED = """
import calflow as cf
from calflow.reporting.validation_report import validation_report, verdict_lines

calibration = cf.Calibration.load("runs")
data = calibration.data
new = data.only(~data.train & (data.table["pose"].astype(str) != "18").to_numpy())  # a row that was misread
found = calibration.validate(new, tolerance=1e-3)
assert validation_report(found, "tilt", "new.csv")
assert all("mm" not in line and "–" not in line and "mrad" in line for line in verdict_lines(found)[2:]), verdict_lines(found)
found.results.tables["accuracy.csv"].to_csv("validated.csv", index=False)
found.results.tables["poses.csv"].to_csv("poses.csv", index=False)
try:
    calibration.drift(data)
except cf.InputError as error:
    assert "expected a measured position in every row" in str(error)
else:
    raise AssertionError("drift took angles for positions")
print(found.summary.status, found.summary.unit, found.summary.tolerance, found.summary.tolerance_mm, found.summary.station)
"""


def _holds_in_its_unit(folder, environment):
    """Rows that were held out are judged in mrad, and err by what was promised of them."""
    done = folder.forked("-c", VALIDATED, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["met", "mrad", "1.0", "None", "known"]
    models = pd.read_csv(folder / "validated.csv").set_index("model")
    assert set(models["unit"]) == {"mrad"}
    assert models.filter(like="_mm").isna().all(axis=None)
    assert models.loc["calibrated", "max"] < 6 * 1e3 * NOISE < models.loc["nominal", "mean"]
    poses = pd.read_csv(folder / "poses.csv")
    assert (len(poses), set(poses["unit"]), poses["within"].all()) == (
        models.loc["calibrated", "poses"],
        {"mrad"},
        True,
    )
    assert 0.5 < np.sqrt(np.mean((poses["calibrated"] / poses["promised"]) ** 2)) < 1.6


def test_a_noise_in_a_unit_that_was_not_measured_is_refused(small, tmp_path):
    """Fails if a noise of angles is taken for one of lengths, or the message does not name the units that do."""
    small.edit("study.toml", ('file = "measurements.csv"\n', 'file = "measurements.csv"\nsigma_urad = 50\n'))
    (said,) = small.refused()
    assert "sigma_urad" in said
    assert "sigma_mm" in said
