"""Which of several devices stands elsewhere or measures wrongly, and what is known of it before and after: at length."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import calflow as cf
from effects import test_session_frame, test_tracker_scale
from first_steps import ARM, head
from hidden.test_steps import DATED, assert_predicted_as_of_then

HEAD = head("tracker.toml", "frame-step", "frame-drift", "joint-step", "tool-slip", "stand-growth")
SHIFT = np.array([4e-4, -3e-4, 3e-4])  # m


@pytest.mark.parametrize("moved", ["of station B", "of the robot's foot"])
def test_of_two_stations_in_turn_and_the_foot_what_moved_is_told(moved, tmp_path):
    """Fails if a foot's shift is taken for one of a station or read in each station's own axes, if one of two stations in turn
    moves the other too, or if predictions are not in the first station's frame.
    """
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


@pytest.mark.parametrize("moved", ["of wire", "turned"])
def test_of_a_wire_and_a_robot_the_one_that_stands_elsewhere_is_told(moved, tmp_path):
    """Fails if an anchor that was moved is taken for a tracker set up anew, or a robot that moved is not one shift for both."""
    test_session_frame.assert_told(tmp_path, moved)


@pytest.mark.parametrize("anchor_known", [True, False])
def test_the_zero_of_a_wire_is_told(anchor_known, tmp_path):
    """Fails if a wire's wrong zero is taken for a cause of the robot, or bends it, whether or not its anchor's place is known."""
    test_tracker_scale.assert_told(tmp_path, 0.0, 1.2e-3, anchor_known)


@pytest.mark.parametrize("cause", DATED)
def test_a_row_that_states_a_time_is_predicted_as_of_then(cause, tmp_path):
    """Fails if the robot before its step is predicted as it was left, after it or without a time as before it, or if nothing is
    promised of a row between the last one before the step and the first after it.
    """
    assert_predicted_as_of_then(tmp_path, cause)


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


def test_a_wire_that_is_right_has_no_scale(tmp_path):
    """Fails if a scale or a zero of a wire is told where there is none."""
    test_tracker_scale.assert_told(tmp_path, 0.0, 0.0, False)
