"""Causes many times their usual size, what was knocked, and gains where there is noise alone: more of what tests ask of one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calflow as cf
from calflow.diagnosis.background import BackgroundBasis, background
from calflow.diagnosis.unexplained import _together
from calflow.estimation.field_gain import gain_of
from deployment.test_figures_alone import SIGMA as OF_LEVELS
from deployment.test_figures_alone import worn
from diagnosis.test_far_larger import assert_comes_back, assert_held
from diagnosis.test_noise_model import assert_no_joint
from diagnosis.test_objects_moved import assert_knocked, first_steps, lengths
from diagnosis.test_unexplained import fitted
from estimation.test_residual_field import HIGH, LOW, NOISE


@pytest.mark.parametrize(("over_usual", "over_error"), [(1.0, 5.0), (3.0, 6.0), (8.0, 8.0), (20.0, 100.0)])
def test_intervals_hold_sizes_beyond_the_usual(over_usual, over_error):
    """Fails if a block many times its usual size is missed, or its amplitudes lie outside their intervals, as shrunken ones do."""
    assert_held(over_usual, over_error)


@pytest.mark.parametrize("cause", ["joint-eccentricity", "tool-deflection"])
def test_an_arm_s_cause_many_times_its_usual_size_comes_back(cause, tmp_path):
    """Fails if an encoder or an adapter, ten or twenty times off what is usual, are missed, or told as far less."""
    assert_comes_back(tmp_path, cause)


def test_a_wire_s_anchor_may_be_knocked(tmp_path):
    """Fails if a wire's anchor that moved once is missed, or taken for joints whose zeros jumped."""
    assert_knocked(tmp_path, "wire", lengths, 70)


def test_noise_alone_is_corrected_no_more_often_than_said():
    """Fails if what is left by chance is taken for a gain more often than once in a hundred cases."""
    for seed in range(20):
        rng = np.random.default_rng([5, seed])
        q = rng.uniform(LOW, HIGH, (40, 4))
        assert not gain_of(q, NOISE * rng.standard_normal((40, 3)), NOISE, rng).gains


def test_held_out_rows_about_a_step_are_not_judged(tmp_path):
    """Fails if held-out rows of which the fitted ones do not tell whether the anchor had been knocked count as errors."""
    folder = first_steps(tmp_path)
    row = np.arange(140)
    held = (row % 4 == 0) | (abs(row - 70) < 5)
    lengths(np.random.default_rng(2)).assign(split=np.where(held, "holdout", "train")).to_csv(
        folder / "wire.csv", index=False
    )
    tables = cf.run(cf.load_study(folder / "wire.toml"), tmp_path / "run").tables
    assert (tables["diagnose/findings.csv"]["cause"] == "frame-step").any()
    accuracy = tables["diagnose/accuracy.csv"]
    last = accuracy[accuracy["split"] == "holdout"].iloc[-1]
    assert last["n"] == held.sum() - 9
    assert last["max_mm"] < 0.3


def test_rows_that_may_be_before_a_step_judge_no_level():
    """Fails if held-out rows, of which no fitted one tells whether the device had moved, count as what commands miss by, or are
    drawn as its errors."""
    robot, data = worn()
    row = np.arange(len(data))
    aside = (row % 5 == 0) | ((row >= 55) & (row < 75))
    table = data.table.assign(
        split=np.where(aside, "holdout", "train"), order=row + 1.0, x=data.table.x + 2e-3 * (row >= 70)
    )
    found = cf.identify(robot, replace(data, table=table), ["geometry"], starts=1).diagnose(catalogue=["frame-step"])
    assert [finding.cause for finding in found.findings] == ["frame-step"]
    judged = [row for row in found.accuracy if row.split == "holdout"][-1]
    assert found.levels.by("commands").mean == pytest.approx(judged.mean_mm)
    assert found.levels.by("commands").mean < 3e3 * OF_LEVELS
    assert found.material().largest.max() == pytest.approx(judged.max_mm)
    assert np.nanmax(np.linalg.norm(found.material().values, axis=1)) < 10 * 1e3 * OF_LEVELS


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("seed", range(3))
def test_a_device_noisier_along_one_axis_is_no_joint_that_does_not_repeat(axis, seed):
    """Fails if the depth of a camera, which scatters more than its image, is told as a joint that moves the tool that way."""
    assert_no_joint(axis, seed)


def test_noise_looks_unexplained_as_often_as_stated():
    """Fails if the lengths of a process, which are chosen as they explain most, cost nothing: 5 of 12 were below 0.05."""
    chances = []
    for seed in range(12):
        known = fitted(seed=1000 + seed, poses=60)
        left = _together(replace(known, background=background(known, BackgroundBasis.of(known))))
        chances += [structure.p for structure in left]
    assert sum(p < 0.05 for p in chances) <= 2
