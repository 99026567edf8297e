"""What a model may lack though unproven: causes and smooth errors, and the task's error with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.design.task_error import TaskSlopes, lacking_causes, task_error
from calflow.diagnosis.diagnosis import search_causes
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Catalogue
from calflow.estimation.calibrated_model import Alternative
from calflow.estimation.fit import fit_reweighted
from calflow.estimation.identification import fit_effects
from calflow.estimation.variance_components import SIZES
from calflow.model import build
from calflow.study import load_study
from estimation.data import POSES, stated, variance, wavering


@pytest.fixture
def fitted(small):
    """The small robot's, whose fit lacks nothing."""
    data = load_study(small.path).measurements()
    found = fit_effects(data, ("geometry", "joint-compliance"), starts=1)
    return search_causes(found.known, found.data).extended


@pytest.fixture
def causes(fitted):
    """Those it may lack."""
    return lacking_causes(fitted, Catalogue.of(fitted.data, ("geometry", "joint-compliance")))


def at_its_poses(fitted):
    """Return the measured poses as a task."""
    slopes = fitted.model.point_jacobian(fitted.fit.estimate, fitted.data.conditions)
    return TaskSlopes(fitted, fitted.data.conditions, slopes)


def test_a_lacking_cause_is_that_of_a_joint_fit(fitted, causes):
    """Fails if a cause's amplitude, or what it changes of the parameters, is not that of a fit of both together."""
    lacking = max(causes, key=lambda cause: cause.probability)
    r = fitted.regressors([lacking.cause])
    x, n = r.matrix.times(np.eye(r.matrix.shape[1])), len(r.precision)
    both = np.hstack([r.jacobian, x])
    for size, found, covariance in zip(SIZES, lacking.mean, lacking.covariance, strict=True):
        precision = np.concatenate([r.precision, (size * r.prior_sd) ** -2.0])
        scale = precision**-0.5
        whole = np.linalg.inv(np.outer(scale, scale) * (both.T @ both + np.diag(precision))) * np.outer(scale, scale)
        mean = -whole @ (both.T @ r.residual + np.concatenate([r.pull, np.zeros(x.shape[1])]))
        np.testing.assert_allclose(found, mean[n:], atol=1e-3 * np.sqrt(np.diag(whole)[n:]).max())
        np.testing.assert_allclose(covariance, whole[n:, n:], rtol=1e-3)
    alone = np.linalg.inv((np.outer(scale, scale) * (both.T @ both + np.diag(precision)))[:n, :n])
    response = -(np.outer(scale, scale)[:n, :n] * alone) @ r.jacobian.T @ x
    np.testing.assert_allclose(lacking.response, response, rtol=1e-3, atol=1e-6 * np.abs(response).max())
    drawn = lacking.drawn(20_000, np.random.default_rng(1))
    second = np.einsum("ki,kj->ij", drawn, drawn) / len(drawn)
    np.testing.assert_allclose(second, lacking.root @ lacking.root.T, rtol=0.2, atol=0.05 * np.diag(second).max())


def test_a_fit_that_lacks_nothing_is_believed_to(fitted, causes):
    """Fails if causes are believed to be lacking rather than not, or any smooth error is."""
    assert sum(cause.probability for cause in causes) < 0.5
    assert max(fitted.smooth.probabilities.values()) < 0.5


def test_sizes_of_smooth_errors_are_drawn_from_the_posterior_of_their_mean(fitted):
    """Fails if the sizes that draws have are not on average those that predictions have."""
    drawn = fitted.smooth.components.drawn(fitted.smooth.accepted, 20_000, np.random.default_rng(1))
    mean = fitted.smooth.components.expected(fitted.smooth.accepted)
    np.testing.assert_allclose(drawn.mean(axis=0), mean, atol=5 * float(drawn.std(axis=0).max()) / np.sqrt(len(drawn)))


@pytest.mark.parametrize(("stated_as", "larger"), [(1.0, 1.0), (0.5, 2.0)])
def test_noise_beyond_the_stated_is_an_error_of_each_pose(fitted, stated_as, larger):
    """Fails if a robot that scatters more than its device does is taken for as good as the device, or the reverse."""
    noise = replace(fitted.noise, sigma=stated_as * fitted.noise.sigma, sources=("study",))
    louder = replace(fitted, noise=noise, visited={})
    louder = replace(louder, fit=replace(fitted.fit, problem=louder.problem))
    site = at_its_poses(louder)
    _, lacking = task_error(louder, (), (), site, "rms", np.random.default_rng(1))
    extra = np.sqrt(3) * fitted.problem.scatter() * np.sqrt(1 - 1 / larger**2)
    assert np.median(lacking) == pytest.approx(extra, abs=0.35 * np.sqrt(3) * fitted.problem.scatter())


def test_the_task_s_error_is_as_large_as_promised_where_a_misfit_is_smooth():
    """Fails if a misfit that is smooth in several inputs is drawn of one at a time, and as large again at each pose."""
    whole, rows = wavering(16, poses=POSES + 40), np.arange(POSES + 40)
    data, there = (whole.only(part).stating(()) for part in (rows < POSES, rows >= POSES))
    model = build(data.robot, ("geometry",))
    fit, noise, lack, _ = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")
    fitted = Fitted(fit, data, noise, lack, stated(data))
    assert fitted.errors.functions
    site = TaskSlopes(fitted, there.conditions, model.point_jacobian(fit.estimate, there.conditions))
    drawn, _ = task_error(fitted, (), (), site, "rms", np.random.default_rng(1))
    promised = variance(fitted.errors, model, fit.estimate, fitted.covariance, there.conditions)
    assert np.median(drawn) == pytest.approx(np.sqrt(promised.sum(axis=1).mean()), rel=0.1)


def test_each_cause_has_rivals_of_its_own(fitted):
    """Fails if the rivals of all causes together are taken for one choice, whose probabilities then are more than 1."""
    site = at_its_poses(fitted)
    off = fitted.fit.estimate.copy()
    off[0] += 0.1  # x of the base
    rivals = (Alternative(fitted.model, off, 0.7),)
    independent, both = (task_error(fitted, (), [rivals] * n, site, "rms", np.random.default_rng(1))[0] for n in (1, 2))
    assert np.mean(independent > 0.05) == pytest.approx(0.7, abs=0.04)
    assert np.mean(both > 0.05) == pytest.approx(1 - 0.3**2, abs=0.04)
    assert np.mean(both > 0.15) == pytest.approx(0.7**2, abs=0.04)
