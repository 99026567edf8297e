"""What is made of calibrations in which parameters are held: what was held is compared with nobody's, and stays as it is."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from applied import compare, export_run, history
from calflow.calibration import Calibration
from calflow.robot.robot import Robot

HELD = {"joint2.theta": "value_deg = 0.01", "joint3.a": "value_mm = 0.2", "payloads.payload-mass.e": ""}


@pytest.fixture
def held(small):
    """A study with three parameters held, run on two series of measurements, and on the second with one of them held elsewhere."""
    study = (small / "study.toml").read_text(encoding="utf-8")
    study = study.replace('"joint-compliance"]', '"joint-compliance", "payload-mass"]')
    stated = "".join(f"\n[parameters.{name}]\nfixed = true\n{value}\n" for name, value in HELD.items())
    (small / "study.toml").write_text(study + stated, encoding="utf-8")
    small.edit("truth.toml", ("a_mm = 0.5", "a_mm = 0.5\ntheta_deg = 0.01"))
    with (small / "truth.toml").open("a") as file:
        file.write("\n[values.joint3]\na_mm = 0.2\n")
    assert small.calflow("simulate", small / "truth.toml", "--out", small / "measurements.csv", "--force").code == 0
    assert small.calflow("run", "--stage", "identify").code == 0
    small.edit("truth.toml", ("seed = 3", "seed = 5"))
    assert small.calflow("simulate", small / "truth.toml", "--out", small / "measurements.csv", "--force").code == 0
    assert small.calflow("run", "--stage", "identify", "--out", small / "second").code == 0
    small.edit("study.toml", ("value_mm = 0.2", "value_mm = 0.6"))
    assert small.calflow("run", "--stage", "identify", "--out", small / "elsewhere").code == 0
    return small


def test_held_parameters_are_of_no_comparison(held):
    """Fails if a held parameter counts as calibrated, or two runs that hold it at different values are compared in silence."""
    assert all(Calibration.load(held / "runs").parameters[name].fixed for name in HELD)
    compared = compare(held / "runs", held / "second")
    names = {row.parameter for row in compared.parameters}
    assert names
    assert not names & set(HELD)
    assert not any(row.setting.startswith("parameters.") for row in compared.settings)
    assert compared.pairs[0].p > 1e-3
    found = history(held / "runs", held / "second")
    assert not found.moved
    assert not {row.parameter for row in found.parameters} & set(HELD)
    assert not any("held" in note for note in found.notes)
    (setting,) = (row for row in compare(held / "runs", held / "elsewhere").settings if "joint3" in row.setting)
    assert set(setting.of.values()) == {"0.2", "0.6"}
    (note,) = (note for note in history(held / "runs", held / "elsewhere").notes if "held" in note)
    assert note.startswith("joint3.a is held at 0.0002 m in runs and 0.0006 m in elsewhere")


def test_a_robot_with_held_parameters_is_checked_and_exported(held):
    """Fails if what is held ends a drift check, or counts as movable there, or an export has the maker's figure in its place."""
    answer = held.calflow("drift", held / "runs", held / "measurements.csv", "--out", held / "d")
    assert answer.code == 0, answer
    tested = set(pd.read_csv(held / "d" / "candidates.csv")["movement"])
    assert {"joint2.zero", "temperature", "joint2.a"} <= tested
    assert not tested & {"payload", *HELD}
    maker = Robot.from_toml(held / "robot.toml")
    out = held / "exported.toml"
    out.write_text(export_run(held / "runs", "dh").text, encoding="utf-8")
    theta, a = (
        robot.joints[i].frame.step(symbol).value
        for i, symbol in ((1, "theta"), (2, "a"))
        for robot in (Robot.from_toml(out),)
    )
    assert theta - maker.joints[1].frame.step("theta").value == pytest.approx(np.deg2rad(0.01), rel=1e-9)
    assert a - maker.joints[2].frame.step("a").value == pytest.approx(2e-4, rel=1e-9)
    document = json.loads(export_run(held / "runs", "json").text)
    assert not {one["parameter"] for one in document["parameters"]} & set(HELD)
    for form in ("urdf", "xacro-properties", "controller"):
        assert export_run(held / "runs", form).text
