"""Validation by whatever the robot was calibrated with: a wire, sockets and a tracker, simulated by NumPy alone."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from applied import validate
from conftest import Folder, without_data
from first_steps import ARM, FIRST_STEPS, touching

ANCHOR, WIRE, TOUCH = np.array([1.9, 0.3, -0.2]), 5e-5, 3e-5  # m: of the wire; noise
Q = [f"q{k}_deg" for k in range(1, 7)]
STUDY = """
name = "cell"
robot = "arm.toml"
workflow = "diagnose"
seed = 1
effects = ["geometry"]

[[measurements]]
kind = "distance"
file = "wire.csv"
sigma_mm = 0.05

[measurements.settings]
anchor_mm = [1900, 300, -200]
anchor_known = false
offset_mm = 0

[[measurements]]
kind = "same-point"
file = "sockets.csv"
sigma_mm = 0.03

[measurements.settings]
distance_mm = 50
"""


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """The arm of the first steps, calibrated by its wire and its sockets together."""
    folder = Folder(tmp_path_factory.mktemp("kinds"))
    for name in ("arm.toml", "arm.urdf", "wire.csv", "sockets.csv"):
        (folder / name).write_bytes((FIRST_STEPS / name).read_bytes())
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    with without_data():
        answer = folder.calflow("run", "--stage", "identify")
    assert answer.code == 0, answer
    return folder


def lengths(q, seed, zero=0.0):
    """What the wire shows at readings (n, 6), joint 2 having moved by zero [rad] since."""
    there = ARM["ball"](q + np.array([0, zero, 0, 0, 0, 0]))
    shown = np.linalg.norm(there - ANCHOR, axis=1) + WIRE * np.random.default_rng(seed).standard_normal(len(q))
    return pd.DataFrame(np.degrees(q), columns=Q).assign(length_mm=1e3 * shown)


def touches(placements, each, seed):
    """Readings with which the ball is in both sockets of pairs that no fit has seen, from several sides."""
    rng = np.random.default_rng(seed)
    right = np.tile(np.repeat([0, 1], each), len(placements))
    at = np.repeat(rng.uniform([0.3, -0.6, 0.3], [0.8, 0.6, 0.8], (len(placements), 3)), 2 * each, axis=0)
    q = touching(at + np.outer(right, ARM["BESIDE"]) + TOUCH * rng.standard_normal(at.shape), rng)
    named = {"placement": np.repeat(placements, 2 * each), "socket": np.where(right, "right", "left")}
    return pd.DataFrame(named | dict(zip(Q, np.degrees(q).T, strict=True)))


def test_a_wire_judges_the_robot_that_it_calibrated(calibrated):
    """Fails if lengths are refused, are judged as positions, or show no joint that moved by 4 mrad."""
    q = np.random.default_rng(8).uniform(ARM["LOW"], ARM["HIGH"], (20, 6))
    calibrated.measure(lengths(q, 9), "lengths.csv")
    sound = calibrated.calflow("validate", calibrated / "runs", calibrated / "lengths.csv", "--tolerance-mm", 1)
    assert (sound.code, sound.out.splitlines()[0]) == (0, "The tolerance is met.")
    assert "more than chance allows" not in sound.out
    assert "ISO 9283" not in sound.out
    assert "read as rows of the series 'distance'" in sound.err
    found = validate(calibrated / "runs", calibrated / "lengths.csv")
    assert (found.summary.unit, found.summary.rp_mm, found.summary.freedom_lost) == ("mm", None, 0)
    assert found.summary.ap_mm is None
    assert np.isnan(found.poses[0].dx_mm)
    assert found.of("nominal").rms_mm > 5 * found.judged.rms_mm
    calibrated.measure(lengths(q, 9, zero=4e-3), "moved.csv")
    asked = ("validate", calibrated / "runs", calibrated / "moved.csv", "--tolerance-mm", 1)
    moved = calibrated.calflow(*asked)
    assert moved.code == 3
    assert "more than chance allows" in moved.out
    assert calibrated.refused(*asked, "--tolerance", 2)[-1].startswith("--tolerance-mm: is stated twice")


def test_new_sockets_are_placed_by_their_own_rows(calibrated):
    """Fails if a pair of sockets that no fit has seen is refused, or what placing it takes off the errors flatters the robot."""
    calibrated.measure(touches([f"new {k}" for k in range(40)], 2, 10), "touches.csv")
    found = validate(calibrated / "runs", calibrated / "touches.csv")
    assert found.summary.freedom_lost == 40 * 5
    assert any("were placed by these rows" in note for note in found.summary.notes)
    noise = (
        1e3 * TOUCH * np.sqrt(3)
    )  # of which the sample's scatter is 4 %; without the leverage 0.76 of it would be left
    assert 0.86 * noise < found.judged.rms_mm < 1.2 * found.summary.promised_mm


def test_a_socket_that_was_touched_once_shows_no_error(calibrated):
    """Fails if the zero that is left of a touch that its socket's place follows counts as a robot without error."""
    once = touches(["alone"], 1, 11).assign(socket=["a", "b"], placement=["one", "other"])
    calibrated.measure(once, "once.csv")
    (told,) = calibrated.refused("validate", calibrated / "runs", calibrated / "once.csv")
    assert "more rows of each object" in told


def test_rows_are_of_the_series_that_is_named(calibrated):
    """Fails if a file is read as another series than --series names, a wrong name passes, or a right one is told to name it."""
    q = np.random.default_rng(12).uniform(ARM["LOW"], ARM["HIGH"], (6, 6))
    calibrated.measure(lengths(q, 13), "few.csv")
    ask = ("validate", calibrated / "runs", calibrated / "few.csv", "--series")
    assert any("length_mm" in told for told in calibrated.refused(*ask, "same-point"))
    (told,) = calibrated.refused(*ask, "distanse")
    assert "expected distance or same-point, found distanse" in told
    named = calibrated.calflow(*ask, "distance")
    assert (named.code, "--series says otherwise" in named.err) == (0, False)
    assert "--series says otherwise" in calibrated.calflow(*ask[:-1]).err
