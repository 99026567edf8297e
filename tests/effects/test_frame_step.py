"""A device of several that was moved once."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pandas as pd

import calflow as cf

FIRST_STEPS = Path(__file__).parents[2] / "studies" / "first-steps"
ARM = runpy.run_path(str(FIRST_STEPS / "measured.py"))  # an arm by NumPy and SciPy alone
HEAD = (
    (FIRST_STEPS / "tracker.toml")
    .read_text()
    .split("[measurements]")[0]
    .replace("arm.toml", str(FIRST_STEPS / "arm.toml"))
)
SHIFT = np.array([4e-4, -3e-4, 3e-4])  # m


def test_a_station_that_moved_moves_no_other(tmp_path):
    """Fails if the first station, used before the second one and still standing, is taken to have moved with it."""
    rng, text = np.random.default_rng(5), HEAD
    for k, name in enumerate("AB"):
        q = rng.uniform(ARM["LOW"], ARM["HIGH"], (60, 6))
        seen = ARM["ball"](q) + k * np.array([0.5, 2.0, 0.1]) + rng.normal(0, 2e-5, (60, 3))
        seen += k * (np.arange(60) >= 30)[:, None] * SHIFT
        table = pd.DataFrame(np.degrees(q), columns=[f"q{i}_deg" for i in range(1, 7)])
        table[["x_mm", "y_mm", "z_mm"]] = 1e3 * seen
        table.assign(split=np.where(np.arange(60) % 5 == 2, "holdout", "train")).to_csv(
            tmp_path / f"{name}.csv", index=False
        )
        text += f'[[measurements]]\nkind = "position"\nname = "{name}"\nfile = "{name}.csv"\nsigma_mm = 0.02\n'
        text += f'[measurements.station]\nname = "{name}"\n'
    (tmp_path / "study.toml").write_text(text)
    run = cf.run(cf.load_study(tmp_path / "study.toml"), tmp_path / "run")
    assert "frame-step" in set(run.tables["diagnose/findings.csv"]["cause"])
    q = rng.uniform(ARM["LOW"], ARM["HIGH"], (50, 6))
    off = cf.Calibration.load(tmp_path / "run").predict(q).position - ARM["ball"](q)
    assert np.linalg.norm(off.mean(axis=0)) < 1e-4  # in the first station's frame
