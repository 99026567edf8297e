"""Errors of many estimates at once are those of each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import calflow as cf
from calflow.estimation.accuracy import errors, errors_of_draws, observing
from calflow.model import build
from calflow.robot.robot import Robot
from hidden.devices import Arm, sockets, written

ROBOT = Path(__file__).parents[2] / "studies" / "ur10-tmac" / "robot.toml"
STUDY = """\
name = "cups"
robot = "robot.toml"
workflow = "diagnose"
seed = 1
effects = ["geometry"]

[[measurements]]
kind = "same-point"
file = "cups.csv"
sigma_mm = 0.05
"""


@pytest.mark.parametrize("known", [("a", "b"), ("a",)], ids=["every socket", "one of two sockets"])
def test_errors_of_draws_are_those_of_each(known, tmp_path):
    """Fails by a bit in which draws are told otherwise than alone, also where each places a socket of its own."""
    rng = np.random.default_rng(1)
    nominal = Robot.from_toml(ROBOT)
    places = {"a": np.array([0.6, 0.2, 0.3]), "b": np.array([0.63, 0.24, 0.3])}
    written(sockets(Arm.drawn(nominal, rng), places, 20, 5e-5, rng)).to_csv(tmp_path / "cups.csv", index=False)
    (tmp_path / "robot.toml").write_text(ROBOT.read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    data = cf.load_study(tmp_path).measurements()
    own = data.only(data.table["socket"].isin(known).to_numpy())
    model = observing(build(data.robot, ["geometry"]), own)
    draws = model.nominal + 0.1 * model.prior_sd * rng.standard_normal((3, len(model.parameters)))
    expected = [errors(model, draw, data) for draw in draws]
    assert np.isfinite(expected).all()
    np.testing.assert_array_equal(errors_of_draws(model, draws, data), expected)
