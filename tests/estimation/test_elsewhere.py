"""What a model errs by at poses that it was not fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.leverage import elsewhere
from calflow.model import build
from estimation.data import SIGMA, measured, stated
from robots import industrial

POSES = 60


def fitted(rng, wrong=0.0):
    """A robot's geometry fitted to a few poses whose points are besides off by so much [m], smooth in the joints."""
    model = build(industrial(), ("geometry",))
    data = measured(model, model.nominal, POSES, rng)
    off = wrong * np.column_stack([np.sin(2 * data.joints[:, 1] + k) * np.cos(data.joints[:, 3 + k]) for k in range(3)])
    table = data.table.copy()
    table[["x", "y", "z"]] += off
    data = replace(data, table=table)
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
    assert elsewhere(found, np.arange(POSES)) == pytest.approx(expected, rel=0.02)


def test_it_is_little_where_the_model_lacks_nothing():
    """Fails if poses that hang on few others are taken for a model that lacks something."""
    sizes = [elsewhere(fitted(np.random.default_rng(seed))[0], np.arange(POSES)) for seed in range(20)]
    assert np.mean(np.square(sizes)) < (0.35 * SIGMA) ** 2


def test_rows_of_one_pose_are_left_out_together():
    """Fails if a pose that was measured twice vouches for itself."""
    found, data = fitted(np.random.default_rng(2), wrong=3 * SIGMA)
    twice = replace(data, table=data.table.loc[np.repeat(np.arange(POSES), 2)].reset_index(drop=True))
    pairs, _ = fit(LeastSquares.of(found.model, twice, stated(twice)))
    apart, together = elsewhere(pairs, np.arange(2 * POSES)), elsewhere(pairs, np.repeat(np.arange(POSES), 2))
    assert together > 1.1 * apart
