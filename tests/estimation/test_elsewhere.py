"""What a model errs by at poses that it was not fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.leverage import left_out
from calflow.model import build
from estimation.data import SIGMA, measured, stated
from robots import industrial

POSES = 60


def bent(data, wrong):
    """Measurements whose points are off by so much [m], smooth in the joints."""
    off = wrong * np.column_stack([np.sin(2 * data.joints[:, 1] + k) * np.cos(data.joints[:, 3 + k]) for k in range(3)])
    table = data.table.copy()
    table[["x", "y", "z"]] += off
    return replace(data, table=table)


def fitted(rng, wrong=0.0, poses=POSES):
    """A robot's geometry fitted to a few poses whose points are besides off by so much [m]."""
    model = build(industrial(), ("geometry",))
    data = bent(measured(model, model.nominal, poses, rng), wrong)
    found, _ = fit(LeastSquares.of(model, data, stated(data)))
    return found, data


def without(found, data, pose):
    """The errors of one pose, all others fitted anew."""
    model, rest = found.model, data.only(np.arange(len(data)) != pose)
    again, _ = fit(LeastSquares.of(model, rest, stated(rest)))
    return (model.point(again.estimate, data.conditions) - data.position)[pose]


def test_it_is_what_refits_without_each_pose_err_by():
    """Fails if errors of left-out poses are not those of refits, or what noise and parameters explain is not taken off."""
    found, data = fitted(np.random.default_rng(1), wrong=3 * SIGMA)
    missed = np.array([without(found, data, pose) for pose in range(POSES)])
    covered = []
    for pose in range(POSES):
        jacobian = found.model.point_jacobian(found.estimate, data.conditions[:, [pose]])[0] / SIGMA
        covered.append(np.trace(np.linalg.inv(np.eye(3) - jacobian @ found.covariance @ jacobian.T)) / 3)
    more = (missed**2).mean() / (SIGMA**2 * np.mean(covered)) - 1
    expected = SIGMA * np.sqrt(more * np.median(covered))
    assert left_out(found, np.arange(POSES)).excess() == pytest.approx(expected, rel=0.02)


def test_it_is_little_where_the_model_lacks_nothing():
    """Fails if poses that hang on few others are taken for a model that lacks something."""
    sizes = [left_out(fitted(np.random.default_rng(seed))[0], np.arange(POSES)).excess() for seed in range(20)]
    assert np.mean(np.square(sizes)) < (0.35 * SIGMA) ** 2


def test_rows_of_one_pose_are_left_out_together():
    """Fails if a pose that was measured twice vouches for itself."""
    found, data = fitted(np.random.default_rng(2), wrong=3 * SIGMA)
    twice = replace(data, table=data.table.loc[np.repeat(np.arange(POSES), 2)].reset_index(drop=True))
    pairs, _ = fit(LeastSquares.of(found.model, twice, stated(twice)))
    apart, together = (
        left_out(pairs, np.arange(2 * POSES)).excess(),
        left_out(pairs, np.repeat(np.arange(POSES), 2)).excess(),
    )
    assert together > 1.1 * apart


@pytest.mark.parametrize(("wrong", "noise_tells", "widest"), [(3 * SIGMA, False, 2.2), (0.0, True, 1.8)])
def test_few_poses_promise_a_limit_that_robots_keep(wrong, noise_tells, widest):
    """Fails if page one's limit is what is expected, which many robots exceed, or so wide that it says nothing."""
    kept, width = [], []
    for seed in range(30):
        rng = np.random.default_rng(100 + seed)
        found, _ = fitted(rng, wrong, 18)
        fresh = bent(measured(found.model, found.model.nominal, 200, rng, sigma=0.0), wrong)
        off = found.model.point(found.estimate, fresh.conditions) - fresh.position
        missed = np.sqrt((off**2).sum(axis=1).mean())
        left = left_out(found, np.arange(18))
        limit = left.upper_limit(noise_tells)
        kept.append((missed <= left.at_new_poses, missed <= limit))
        width.append(limit / missed)
    expected, limited = np.mean(kept, axis=0)
    assert limited > 0.85 > expected
    assert np.median(width) < widest


@pytest.mark.parametrize(("poses", "noisier"), [(18, 1.0), (36, 8.0)])
def test_new_poses_are_missed_as_often_as_is_said(poses, noisier):
    """Fails if the error at new poses is that of fitted ones, holds the device's noise, or is not what few poses leave open.

    Where every other pose was measured with more noise, it is not the error of the accurate ones at that noise.
    """
    promised, missed = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        model = build(industrial(), ("geometry",))
        data = measured(model, model.nominal, poses, rng, sigma=0.0)
        sigma = SIGMA * np.where(np.arange(poses) % 2, noisier, 1.0)
        data.table[["x", "y", "z"]] += sigma[:, None] * rng.standard_normal((poses, 3))
        found, _ = fit(LeastSquares.of(model, data, replace(stated(data), sigma=sigma)))
        fresh = measured(model, model.nominal, 100, rng)
        off = model.point(found.estimate, fresh.conditions) - model.point(model.nominal, fresh.conditions)
        promised.append(left_out(found, np.arange(poses)).at_new_poses)
        missed.append(np.sqrt((off**2).sum(axis=1).mean()))
    ratio = np.sqrt(np.mean(np.square(promised)) / np.mean(np.square(missed)))
    assert 0.8 < ratio < 1.4
    assert np.mean(missed) > SIGMA
