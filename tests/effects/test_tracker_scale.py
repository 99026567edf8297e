"""A scale that one of two devices has."""

from __future__ import annotations

import numpy as np
import pandas as pd

import calflow as cf
from first_steps import ARM, head

HEAD = head("tracker.toml", "tracker-scale", "tool-slip", "frame-step", "gear-ratio-error", "joint-eccentricity")
ANCHOR = np.array([1.6, 0.4, -0.2])


def test_a_wire_beside_a_tracker_shows_that_its_figures_are_not_the_stated_ones(tmp_path):
    """Fails if a wire's wrong scale is taken for a cause of the robot, or bends it; benchmarks/slow has a wrong zero, and none."""
    assert_told(tmp_path, 1e-3, 0.0, False)


def assert_told(tmp_path, scale: float, zero: float, anchor_known: bool) -> None:
    """A wire's scale and zero are told as large as they are where they are wrong, and the robot is as it is."""
    rng, text = np.random.default_rng(12), HEAD
    q = rng.uniform(ARM["LOW"], ARM["HIGH"], (120, 6))
    ball = ARM["ball"](q)
    length = zero + (1 + scale) * np.linalg.norm(ball - ANCHOR, axis=1) + rng.normal(0, 3e-5, 120)
    seen = 1e3 * (ball + rng.normal(0, 2e-5, ball.shape))
    readings = pd.DataFrame(np.degrees(q), columns=[f"q{i}_deg" for i in range(1, 7)])
    readings[["x_mm", "y_mm", "z_mm"]] = seen
    readings[:50].to_csv(tmp_path / "tracker.csv", index=False)
    readings[50:].drop(columns=["x_mm", "y_mm", "z_mm"]).assign(length_mm=1e3 * length[50:]).to_csv(
        tmp_path / "wire.csv", index=False
    )
    text += '[[measurements]]\nfile = "tracker.csv"\nsigma_mm = 0.02\n'
    text += '[[measurements]]\nname = "wire"\nkind = "distance"\nfile = "wire.csv"\nsigma_mm = 0.03\n'
    text += (
        f"[measurements.settings]\nanchor_mm = {(1e3 * ANCHOR).tolist()}\nanchor_known = {str(anchor_known).lower()}\n"
    )
    text += "offset_mm = 0\nscale_um_per_m = 0\n"
    (tmp_path / "study.toml").write_text(text)
    run = cf.run(cf.load_study(tmp_path / "study.toml"), tmp_path / "run")
    found = run.tables["diagnose/findings.csv"].set_index("cause")
    assert "tool-slip" not in found.index
    assert ("tracker-scale" in found.index) == bool(scale or zero)
    if scale or zero:
        row = found.loc["tracker-scale"]
        assert row["detail"].startswith("of wire" if scale else "zero of wire")
        assert abs(row["estimate"] - (scale or zero)) < 4 * row["sd"]
    new = rng.uniform(ARM["LOW"], ARM["HIGH"], (50, 6))
    off = cf.Calibration.load(tmp_path / "run").predict(new).position - ARM["ball"](new)
    assert np.sqrt((off**2).sum(axis=1).mean()) < 1e-4
