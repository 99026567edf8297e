"""How to tell a finding from its rivals is asked wherever it was measured, and said where it cannot be asked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

from calflow.design import discrimination
from calflow.design.candidates import packed_conditions
from calflow.design.discrimination import LEAST_EXTENT, NextPose, poses_table, question, separations_table
from calflow.design.planned import Planned
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Family
from calflow.diagnosis.trial import Detection
from calflow.diagnosis.verdict import Rival, Verdict
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.estimation.fit import fit_reweighted
from calflow.files.tables import columns
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from diagnosis.test_verdict import score
from estimation.data import SIGMA, stated
from robots import industrial

ROBOT = industrial()
RATIO, ECCENTRIC = (
    Cause(ROBOT, catalogue()[name](ROBOT), "joint2") for name in ("gear-ratio-error", "joint-eccentricity")
)
MODEL = Model(ROBOT, (*build(ROBOT, ("geometry",)).effects, RATIO))
TRUTH = np.append(np.zeros(len(MODEL.parameters) - 1), 5e-4)
PAYLOAD, MARKER = next(iter(ROBOT.payloads), ""), next(iter(ROBOT.markers))


def position(readings):
    """Where the robot is told to be."""
    return MODEL.position(MODEL.nominal, packed_conditions(MODEL, readings, PAYLOAD, MARKER))


@cache
def in_slab():
    """Readings whose points lie in a horizontal slab 1 mm thick, by Newton's method on joint 3."""
    rng = np.random.default_rng(4)
    drawn = rng.uniform(*(0.6 * ROBOT.limits).T, (2000, ROBOT.n_joints))
    height = float(np.median(position(drawn)[:, 2]))
    for _ in range(12):
        wrong = position(drawn)[:, 2] - height
        moved = drawn.copy()
        moved[:, 2] += 1e-5
        slope = (position(moved)[:, 2] - height - wrong) / 1e-5
        drawn[:, 2] -= np.clip(wrong / np.where(np.abs(slope) > 1e-3, slope, np.inf), -0.2, 0.2)
    low, high = ROBOT.limits.T
    good = (np.abs(position(drawn)[:, 2] - height) < 4e-4) & ((drawn > low) & (drawn < high)).all(axis=1)
    return drawn[good][:80]


@cache
def at_a_point():
    """Readings about one pose, whose points lie within millimetres of each other."""
    return np.mean(ROBOT.limits, axis=1) + 0.3 + 1e-3 * np.random.default_rng(5).standard_normal((80, ROBOT.n_joints))


@cache
def fitted(where):
    """The gear ratio fitted where it was measured: at `in_slab` or `at_a_point`."""
    readings = where()
    rng = np.random.default_rng(2)
    table = pd.DataFrame(readings, columns=[f"q{i + 1}" for i in range(ROBOT.n_joints)])
    table[["x", "y", "z"]] = position(readings) + SIGMA * rng.standard_normal((len(readings), 3))
    table = table.assign(pose=np.arange(len(table)), repeat=1, marker=MARKER, payload=PAYLOAD, split="train",
                         line=np.arange(len(table)) + 2)  # fmt: skip
    data = Measurements(ROBOT, table)
    fit, noise, lack, _ = fit_reweighted(MODEL, data, stated(data), MODEL.nominal[None], "linear")
    return Fitted(fit, data, noise, lack, noise)


def asked(where, rivals=(ECCENTRIC,), size=2e-4, untestable=()):
    """What to measure to tell the gear ratio, fitted there, from rivals, and the tables of it."""
    now = fitted(where)
    scores = [replace(score(bic, cause.id, cause.joint),
                      estimate=np.full(cause.n_parameters, size))
              for cause, bic in ((RATIO, -9.0), *((rival, -7.0) for rival in rivals))]  # fmt: skip
    finding = Detection(RATIO, tuple(scores), Family({}, 1.0))
    others = [Rival(one.cause.id, one.cause.joint, 2.0, one) for one in scores[1:]]
    others += [Rival(name, 0, 0.0, None) for name in untestable]
    verdict = Verdict(**vars(finding), status="one_of", probability=0.7, rivals=tuple(others))
    planned = Planned.like(now.model.observations[0], now.noise, 0, 0.7)
    one = question(verdict, now, planned, np.random.default_rng(1))
    return one, poses_table([one], now), separations_table([one])


def test_points_in_a_slab_do_not_end_the_search():
    """Fails if a region 1 mm thick, which no random pose meets, counts as one where nothing can be measured."""
    readings = in_slab()
    assert len(readings) == 80
    assert np.ptp(position(readings)[:, 2]) < 1e-3
    one, poses, told = asked(in_slab)
    assert [separation.unasked for separation in one.separations] == [""]
    assert told["separation_after_sd"].iloc[0] > told["separation_before_sd"].iloc[0]
    if len(poses):
        proposed = position(np.deg2rad(poses[[f"q{i + 1}_deg" for i in range(ROBOT.n_joints)]].to_numpy()))
        assert np.ptp(proposed[:, 2]) < LEAST_EXTENT + 0.01


def test_a_question_that_cannot_be_asked_is_said():
    """Fails if the diagnosis ends where no pose can be drawn, or its tables do not say that none could be looked for."""
    one, poses, told = asked(at_a_point)
    assert one.plan is None
    (row,) = told.to_dict("records")
    assert "reach the region" in row["unasked"]
    assert row["means"].startswith("measure in a wider region")
    assert row["words"].startswith("no further poses could be sought in the measured region")
    assert (row["rival"], row["proposed"], row["separation_after_sd"]) == ("joint-eccentricity", False, 0.0)
    assert poses.empty
    assert {column.name for column in columns(NextPose) if "{" not in column.name} <= set(poses)
    assert "q1_deg" in poses


@pytest.mark.parametrize(
    "failure", [np.linalg.LinAlgError("singular matrix"), ArithmeticError("bounds"), MemoryError("too large")]
)
def test_a_question_that_fails_never_ends_the_diagnosis(monkeypatch, failure):
    """Fails if what goes wrong where further poses are looked for loses the diagnosis, or is not said."""

    def failing(*_):
        raise failure

    monkeypatch.setattr(discrimination, "candidates", failing)
    one, poses, told = asked(at_a_point)
    assert one.plan is None
    assert poses.empty
    (row,) = told.to_dict("records")
    assert str(failure) in row["unasked"]
    assert str(failure) in row["words"]
    assert "wider region" not in row["words"]


def test_a_mistake_of_the_program_is_no_advice(monkeypatch):
    """Fails if a mistake in the program passes for something that the measurements do not tell."""

    def failing(*_):
        raise KeyError("mass")

    monkeypatch.setattr(discrimination, "candidates", failing)
    with pytest.raises(KeyError):
        asked(at_a_point)


def test_figures_that_are_no_numbers_make_no_question():
    """Fails if a cause whose size is not known is told from others by poses and chances of nothing."""
    one, poses, told = asked(in_slab, size=np.nan)
    assert poses.empty
    assert "not finite" in one.separations[0].unasked
    assert np.isfinite(told["chance_after"]).all()


def test_a_rival_that_is_no_effect_is_kept():
    """Fails if a rival that nobody can name ends the diagnosis, or is lost."""
    _, _, told = asked(at_a_point, rivals=(), untestable=("unexplained",))
    assert told["rival"].tolist() == ["unexplained"]
    assert told["means"].iloc[0]


def test_poses_are_asked_for_the_nearest_of_many_rivals(monkeypatch):
    """Fails if the pairs of many rivals, each of which takes its time, are all asked for, or rivals are lost."""
    monkeypatch.setattr(discrimination, "MOST_RIVALS", 2)
    monkeypatch.setattr(discrimination, "CANDIDATES", 60)
    many = [Cause(ROBOT, catalogue()["joint-eccentricity"](ROBOT), f"joint{k}") for k in (2, 3, 4)]
    one, _, told = asked(in_slab, rivals=many)
    assert told["rival_joint"].tolist() == [2, 3, 4]
    assert (told["unasked"].fillna("") != "").tolist() == [False, False, True]
    assert all(asked.separation_before_sd > 0 for asked in one.separations[:2])
