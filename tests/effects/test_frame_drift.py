"""A device that wanders within each of several days."""

from __future__ import annotations

import numpy as np
import pandas as pd

import calflow as cf
from first_steps import ARM, head

HEAD = head("tracker.toml")
DAY, POSES, BETWEEN = 86400.0, 45, 100.0  # s between two days, and two rows


def test_a_device_that_wanders_within_days_is_named(tmp_path):
    """Fails if what happens within an hour of a day is too fast for a curve over all days, nights included."""
    rng = np.random.default_rng(21)
    q = rng.uniform(ARM["LOW"], ARM["HIGH"], (3 * POSES, 6))
    within = np.tile(np.arange(POSES) * BETWEEN, 3)
    day = np.repeat(np.arange(3), POSES)
    phases = rng.uniform(0, 2 * np.pi, (3, 3))
    wander = 1.5e-4 * np.sin(2 * np.pi * within[:, None] / 4000.0 + phases[day])
    table = pd.DataFrame(np.degrees(q), columns=[f"q{i}_deg" for i in range(1, 7)])
    table[["x_mm", "y_mm", "z_mm"]] = 1e3 * (ARM["ball"](q) + wander + rng.normal(0, 2e-5, (3 * POSES, 3)))
    table.assign(time_s=day * DAY + within, session=[f"day{k}" for k in day]).to_csv(tmp_path / "days.csv", index=False)
    text = '[[measurements]]\nfile = "days.csv"\nsigma_mm = 0.02\n[measurements.station]\nby_session = true\n'
    (tmp_path / "study.toml").write_text(HEAD + text)
    run = cf.run(cf.load_study(tmp_path / "study.toml"), tmp_path / "run")
    found = run.tables["diagnose/findings.csv"].set_index("cause")
    assert "without pauses" in found.loc["frame-drift", "detail"]
    final = run.tables["diagnose/accuracy.csv"].query("split == 'holdout'")["mean_mm"]
    assert final.iloc[-1] < 0.5 * run.tables["identify/accuracy.csv"].query("split == 'holdout'")["mean_mm"].iloc[-1]
