"""Needed conditions: a prediction without what an effect depends on is refused by name, or honest about it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from applied import predict
from calflow.deployment.compensation import compensate
from calflow.deployment.drift import drift
from calflow.deployment.prediction import predict as predict_arrays
from calflow.deployment.prediction import predict_rows
from calflow.deployment.validation import validate
from calflow.estimation.certainty import then_and_later
from calflow.estimation.extrapolation import Later
from calflow.estimation.needed_conditions import needed_conditions
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.model import build
from estimation.data import calibration
from robots import poses, ur10

X = ["x_mm", "y_mm", "z_mm"]
PLAY = 3e-3  # rad: some 2.5 mm at the tool


def calibrated(effects, values, **conditions):
    """A robot whose parameters are known, its rows (to be fitted), and their conditions without a measured value."""
    robot = ur10()
    q = poses(robot, 40)
    data = Measurements.from_arrays(robot, q, np.zeros((40, 3)), payload="load", split="train", **conditions)
    model = build(robot, effects, data.given)
    names = [parameter.name for parameter in model.parameters]
    estimate = model.nominal.copy()
    for name, value in values.items():
        estimate[names.index(name)] = value
    n = len(names)
    return calibration(model, estimate, 1e-16 * np.eye(n), sigma=1e-5), data


def sides(seed=1):
    return np.random.default_rng(seed).choice([-1, 1], (40, 6))


def test_a_payload_is_asked_for_where_the_robot_gives_way_under_it():
    """Fails if arrays that state no payload count as carrying nothing, or one is asked for that moves or was carried nowhere."""
    soft, data = calibrated(("geometry", "joint-compliance"), {"joint2.s": 1e-5})
    q, target = data.joints[:2], np.array([0.6, 0.2, 0.8])
    bare = Measurements.from_arrays(ur10(), q, np.zeros((2, 3)))
    for asked in (
        lambda known: predict_arrays(known, q),
        lambda known: compensate(known, target, start=q[0]),
        lambda known: validate(known, bare),
        lambda known: drift(known, bare),
    ):
        with pytest.raises(InputError, match=r'^payload: expected load or "" for nothing .* calibrated with load'):
            asked(replace(soft, payloads=("load",)))
    stated = [predict_arrays(replace(soft, payloads=("load",)), q, payload=name).position for name in ("", "load")]
    assert np.abs(stated[1] - stated[0]).max() > 1e-6
    np.testing.assert_array_equal(predict_arrays(soft, q).position, stated[0])  # calibrated with empty hands
    stiff, _ = calibrated(("geometry",), {})
    predict_arrays(replace(stiff, payloads=("load",)), q)


def test_what_is_needed_is_read_off_the_graph():
    """Fails if an effect's condition is missed, one is asked for that nothing depends on, or the wrong effect is named."""
    every = {"approach": sides(), "travel": np.ones((40, 6)), "time": np.arange(40.0), "temperature": 295.0}
    known, data = calibrated(("geometry", "joint-backlash"), {"joint1.joint-backlash.b": PLAY}, **every)
    (one,) = needed_conditions(known.model, known.estimate, data)
    assert (one.condition, one.effects, one.columns) == (
        "approach",
        ("joint-backlash",),
        "columns approach1 … approach6",
    )
    known, data = calibrated(("geometry", "joint-hysteresis", "thermal-growth"), {}, **every)
    assert {one.condition: one.effects for one in needed_conditions(known.model, known.estimate, data)} == {
        "approach": ("joint-hysteresis",), "travel": ("joint-hysteresis",), "temperature": ("thermal-growth",)
    }  # fmt: skip
    assert "columns travel1_rad … travel6_rad" in [
        one.columns for one in needed_conditions(known.model, known.estimate, data)
    ]


def test_the_tracker_s_own_errors_need_nothing():
    """Fails if a drift of the device, which is not where the robot will be, asks for a time."""
    known, data = calibrated(("geometry", "frame-drift"), {}, time=np.arange(40.0))
    assert needed_conditions(known.model, known.estimate, data) == ()


def test_a_validation_promises_what_the_device_wanders_by_at_its_hour():
    """Fails if rows seen a day later are promised as if the device stood still, as rows without their hour are on average."""
    known, data = calibrated(("geometry",), {}, time=np.arange(40.0))
    sd = np.full(3, 2e-5)  # of what is reported in as long again as was measured [m]
    wander = [Later(data.robot, "shift", begin=0.0, end=39.0)]
    known = replace(known, errors=known.errors.with_functions(wander, sd))
    seen = known.model.point(known.estimate, data.conditions)

    def promised(time):
        rows = Measurements.from_arrays(data.robot, data.joints, seen, payload="load", time=time, time_origin=0.0)
        return validate(known, rows, station="known").summary.promised_mm

    then, later = promised(np.arange(40.0)), promised(np.full(40, 39.0 + 100 * 39.0))
    assert later**2 - then**2 == pytest.approx(3 * 100 * 0.02**2, rel=1e-6)
    *_, in_a_day = then_and_later(known, data)
    assert in_a_day**2 - then**2 == pytest.approx(3 * 86400 / 39 * 0.02**2, rel=1e-2)


def test_a_validation_names_no_option_that_it_has_not():
    """Fails if a user is sent to --without-conditions, which `validate` does not know."""
    known, data = calibrated(("geometry", "joint-backlash"), {"joint1.joint-backlash.b": PLAY}, approach=sides())
    bare = Measurements.from_arrays(known.model.robot, data.joints, np.zeros((40, 3)), payload="load", split="train")
    with pytest.raises(InputError, match=r"needs columns approach1 … approach6, which the rows lack$"):
        validate(replace(known, needed=needed_conditions(known.model, known.estimate, data)), bare)


def test_backlash_without_a_side_is_refused_or_widened():
    """Fails if backlash is dropped in silence: millimetres off with a stated deviation of hundredths."""
    known, data = calibrated(("geometry", "joint-backlash"), {"joint1.joint-backlash.b": PLAY}, approach=sides())
    known = replace(known, needed=needed_conditions(known.model, known.estimate, data))
    truth = predict_rows(known, data).position
    asked = Measurements.from_arrays(known.model.robot, data.joints, None, payload="load")
    with pytest.raises(
        InputError, match="effect 'joint-backlash' needs columns approach1 … approach6, which the rows lack"
    ):
        predict_rows(known, asked)
    told = predict_rows(known, asked, "widen")
    off = truth - told.position
    assert np.abs(off).max() > 1e-3
    assert 0.5 < np.sqrt((off[:, :2] ** 2).mean()) / told.sd[:, :2].mean() < 1.2
    assert "nothing is predicted of joint-backlash" in told.notes[0]


def test_conditions_that_nothing_needs_change_nothing():
    """Fails if rows that state more than the fitted ones did are refused, or predicted by another model."""
    known, data = calibrated(("geometry", "joint-compliance"), {"joint2.s": 1e-6})
    more = Measurements.from_arrays(
        known.model.robot, data.joints, None, payload="load", approach=sides(), torque=np.zeros((40, 6))
    )
    known = replace(known, needed=needed_conditions(known.model, known.estimate, data))
    assert known.needed == ()
    np.testing.assert_array_equal(predict_rows(known, more).position, predict_rows(known, data).position)


def test_a_run_and_the_command_line_do_the_same(small):
    """Fails if a run folder forgets what its model needs, or --without-conditions goes on as if nothing were missing."""
    small.edit("truth.toml", ('"joint-compliance"]', '"joint-compliance", "joint-backlash"]\napproach = true'))
    with (small / "truth.toml").open("a", encoding="utf-8") as file:
        file.write("\n[values.joint1]\nb_rad = 3e-3\n")
    assert small.calflow("simulate", small / "truth.toml", "--force").code == 0
    small.edit("study.toml", ('"joint-compliance"]', '"joint-compliance", "joint-backlash"]'))
    assert small.calflow("run", "--stage", "identify").code == 0
    rows = small.rows.drop(columns=[*X, "sigma_mm"])
    small.measure(rows, "whole.csv")
    small.measure(rows.drop(columns=[name for name in rows if name.startswith("approach")]), "asked.csv")
    (told,) = small.refused("predict", small / "runs", small / "asked.csv")
    assert "effect 'joint-backlash' needs columns approach1 … approach3" in told
    answer = small.calflow(
        "predict", small / "runs", small / "asked.csv", "--without-conditions", "--out", small / "p.csv"
    )
    assert answer.code == 0, answer
    assert "nothing is predicted of joint-backlash" in answer.err
    widened, whole = pd.read_csv(small / "p.csv"), predict(str(small / "runs"), str(small / "whole.csv"))
    off = np.abs(widened[X].to_numpy() - whole[X].to_numpy())
    assert off.max() > 0.5
    assert widened["sd_x_mm"].min() > 0.3 > whole["sd_x_mm"].max()
