"""A cause carries over to blocks that were left out if it is there, and these are predicted from the others alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.diagnosis.background import BackgroundBasis, background
from calflow.diagnosis.cross_validation import LeftOutBlock, carried_over, pose_blocks
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.linear_model import LinearModel
from diagnosis.found import cause, hidden, start
from diagnosis.test_unexplained import fitted
from estimation.data import SIGMA


def left_by(known: Fitted) -> LinearModel:
    """The model linearised with the background that it leaves."""
    return LinearModel(replace(known, background=background(known, BackgroundBasis.of(known))).beside)


def test_a_true_cause_carries_over_to_blocks_that_were_left_out():
    """Fails if left-out blocks are not predicted from the others alone, or a needless cause is said to help there."""
    eccentric, needless = cause("joint-eccentricity", "joint1", order=2), cause("gear-ratio-error", "joint4")
    known = start(hidden([(eccentric, (1.5e-4, -1e-4))])).with_causes([eccentric, needless])
    beside, kinds = left_by(known), pose_blocks(known)
    left_out = [LeftOutBlock.each(beside, kind) for kind in kinds]
    assert all(len(set(kind)) > 3 for kind in kinds)
    found, not_there = (carried_over(known, one, beside, left_out) for one in known.causes)
    assert found.holds
    assert found.gain[0] > 20 > abs(not_there.gain[0])


def test_a_smooth_error_does_not_decide_whether_a_cause_carries_over():
    """Fails if blocks are predicted without the smooth error that the others show, five times as large as the noise."""
    eccentric, size = cause("joint-eccentricity", "joint3", order=2), 4e-5
    gained, without = 0.0, 0.0
    for seed in range(3, 7):
        data, rng = hidden([(eccentric, (size, size))], poses=120), np.random.default_rng(seed)
        near = np.exp(-0.5 * ((data.joints[:, None, :3] - data.joints[None, :, :3]) ** 2).sum(axis=2))
        smooth = np.linalg.cholesky(near + 1e-8 * np.eye(len(near))) @ rng.standard_normal((len(near), 3))
        data.table[["x", "y", "z"]] += 5 * SIGMA * smooth
        known = start(data).with_causes([eccentric])
        alone, beside = (
            carried_over(known, eccentric, model, [LeftOutBlock.each(model, kind) for kind in pose_blocks(known)])
            for model in (LinearModel(known.alone), left_by(known))
        )
        assert beside.holds
        gained, without = gained + beside.gain[0], without + alone.gain[0]
    assert gained > 1.3 * without


def test_what_is_missed_is_that_of_a_fit_to_the_other_rows():
    """Fails if what follows from the fit to all rows is not what a fit without the left-out rows tells, with a cause or without."""
    eccentric, needless = cause("joint-eccentricity", "joint1", order=2), cause("gear-ratio-error", "joint4")
    known = start(hidden([(eccentric, (1.5e-4, -1e-4))])).with_causes([eccentric, needless])
    gone = np.array([0, 3])
    value = known.fit.estimate[np.flatnonzero(~known.fit.at_bound)][gone]
    whole = left_by(known)
    along = whole.root_covariance(gone)
    for kind in pose_blocks(known):
        for number, block in zip(np.unique(kind), LeftOutBlock.each(whole, kind), strict=True):
            there = kind == number
            for model, missed in (
                (whole.regressors, block.error),
                (whole.regressors.without(gone, value), block.without(along, value + whole.change[gone])),
            ):
                j, e = model.jacobian[~there], model.residual[~there]
                change = np.linalg.solve(j.T @ j + np.diag(model.precision), j.T @ e + model.pull)
                assert np.allclose(missed, model.residual[there] - model.jacobian[there] @ change, atol=1e-6)


def test_a_curve_in_time_is_not_asked_for_times_that_were_left_out():
    """Fails if a device that is bumped twice must be foreseen by a curve in time from other times, where that has no value."""

    def bumped(table):
        row = np.arange(len(table)) / len(table)
        return np.outer((row > 0.3) & (row < 0.6), [8 * SIGMA, 0.0, 0.0])

    before = fitted(bumped)
    curve = cause("frame-drift", "device", length=0.15, end=float(before.data.table["time"].max()))
    known = before.with_causes([curve])
    row, (in_joints,) = np.arange(len(known.data)), pose_blocks(known)
    in_time = (8 * row // len(row))[known.problem.row]
    beside = left_by(known)
    told = carried_over(known, curve, beside, [LeftOutBlock.each(beside, kind) for kind in (in_joints, in_time)])
    assert told.holds
    assert told.gain == carried_over(known, curve, beside, [LeftOutBlock.each(beside, in_joints)]).gain
