"""What was moved once, of several devices and a foot; a station in turn with another one is in benchmarks/slow."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import calflow as cf
from first_steps import ARM, head

HEAD = head("tracker.toml", "frame-step", "frame-drift", "joint-step", "tool-slip", "stand-growth")
SHIFT = np.array([4e-4, -3e-4, 3e-4])  # m


def test_stations_in_turn_tell_that_the_foot_moved(tmp_path):
    """Fails if a foot's shift is taken for one of a station, or read in each station's own axes."""
    assert_told_in_turn(tmp_path, "of the robot's foot")


def assert_told_in_turn(tmp_path, moved: str) -> None:
    """Of two stations in turn and the robot's foot the one that moved is told, and predictions are in the first station's frame."""
    rng, text, n = np.random.default_rng(8), HEAD, 120
    stands, late = Rotation.from_euler("z", 1.9).as_matrix(), np.arange(n) >= 60
    q = rng.uniform(ARM["LOW"], ARM["HIGH"], (n, 6))
    ball = ARM["ball"](q)
    foot = late[:, None] * SHIFT * (moved != "of station B")
    in_b = (ball + foot - [5.1, 2.2, 0.1]) @ stands + late[:, None] * SHIFT * (moved == "of station B")
    for k, (name, seen) in enumerate({"A": ball + foot, "B": in_b}.items()):
        table = pd.DataFrame(np.degrees(q), columns=[f"q{i}_deg" for i in range(1, 7)])
        table[["x_mm", "y_mm", "z_mm"]] = 1e3 * (seen + rng.normal(0, 2e-5, (n, 3)))
        table.assign(time_s=60.0 * np.arange(n), split="train")[k::2].to_csv(tmp_path / f"{name}.csv", index=False)
        text += f'[[measurements]]\nname = "{name}"\nfile = "{name}.csv"\nsigma_mm = 0.02\n'
        text += f'[measurements.station]\nname = "{name}"\n'
    (tmp_path / "study.toml").write_text(text)
    run = cf.run(cf.load_study(tmp_path / "study.toml"), tmp_path / "run")
    found = run.tables["diagnose/findings.csv"].query("cause == 'frame-step'")
    assert len(found) == 1
    assert found["detail"].iloc[0].endswith(moved)
    q = rng.uniform(ARM["LOW"], ARM["HIGH"], (50, 6))
    off = cf.Calibration.load(tmp_path / "run").predict(q).position - ARM["ball"](q)
    left = SHIFT * (moved != "of station B")  # in the first station's frame, the foot as it was left
    assert np.linalg.norm(off.mean(axis=0) - left) < 1e-4
