"""What cannot be named can still be predicted, as far as the data show it."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.unexplained import predicted
from calflow.estimation.accuracy import errors
from calflow.estimation.error_model import usual_sizes
from calflow.estimation.smooth_functions import Shift
from calflow.model import Model
from diagnosis.test_unexplained import fitted
from estimation.data import SIGMA


def wave(table):
    """A shift that goes with joint 1."""
    return 2e-4 * np.outer(np.sin(3 * table["q1"]), [0, 0, 1])


def by_joint1(known):
    """The decoy."""
    return Shift(known.model.robot, (0,))


def test_unnamed_structure_is_predicted_where_it_was_not_measured():
    """Breaks if the process acts with the wrong sign or size, or repeats the rows it was fitted to."""
    known, other = fitted(wave), fitted(wave, seed=9, poses=60)
    before = errors(known.model, known.fit.estimate, other.data)
    after = before + predicted(known, [by_joint1(known)], other.data)
    assert np.linalg.norm(after, axis=1).mean() < 0.6 * np.linalg.norm(before, axis=1).mean()


def test_noise_is_not_predicted():
    """Breaks if the size of the process is not judged by the data."""
    known = fitted()
    assert np.abs(predicted(known, [by_joint1(known)], known.data)).max() < SIGMA


def test_the_process_is_the_gaussian_process_of_its_covariance():
    """Breaks if waves, their size or the model's parameters enter otherwise than in the textbook's function space."""
    known = fitted(wave)
    model, fit, decoy = known.model, known.fit, by_joint1(known)
    both = Model(model.robot, (*model.effects, decoy), model.given)
    n = len(fit.estimate)
    slopes = both.position_jacobian(np.append(fit.estimate, np.zeros(len(decoy.declared))), known.data.conditions)
    own, waves = (part.reshape(len(known.data) * 3, -1) / SIGMA for part in (slopes[:, :, :n], slopes[:, :, n:]))
    pull = own @ (model.nominal - fit.estimate)
    left = errors(model, fit.estimate, known.data).ravel() / SIGMA + pull
    base = np.eye(len(left)) + (own * model.prior_sd**2) @ own.T
    kernel = (waves * usual_sizes(model, [decoy]) ** 2) @ waves.T

    def evidence(size):
        whole = base + size**2 * kernel
        return -0.5 * (np.linalg.slogdet(whole)[1] + len(left) * np.log(left @ np.linalg.solve(whole, left)))

    sizes = np.append(0.0, np.geomspace(0.01, 10.0, 61))
    size = max(sizes, key=evidence)
    weights = np.linalg.solve(base + size**2 * kernel, left)
    settled = model.nominal - model.prior_sd**2 * (own.T @ weights) - fit.estimate
    expected = SIGMA * (own @ settled - size**2 * kernel @ weights)
    found = predicted(known, [decoy], known.data).ravel()
    assert 0 < size < sizes[-1]
    assert found == pytest.approx(expected, abs=0.1 * np.abs(expected).max())
