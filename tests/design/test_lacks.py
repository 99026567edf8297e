"""What a model may lack, weighed in closed form: against the likelihood of all data at once."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calflow.design.task_error import MissingEffects, TaskSlopes, task_error
from calflow.diagnosis.diagnosis import search_causes
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Catalogue
from calflow.estimation.calibrated_model import Alternative
from calflow.estimation.fit import fit_reweighted
from calflow.estimation.identification import fit_effects
from calflow.estimation.variance_components import LOG_PRIOR, SIZES
from calflow.model import build
from calflow.study import load_study
from estimation.data import POSES, stated, wavering


@pytest.fixture
def missing(small):
    """Of the small robot, whose fit lacks nothing."""
    data = load_study(small.path).measurements()
    found = fit_effects(data, ("geometry", "joint-compliance"), starts=1)
    fitted = search_causes(found.known, found.data).extended.fitted
    return MissingEffects.of(fitted, Catalogue.of(fitted.data, ("geometry", "joint-compliance")))


def log_likelihood(missing, lack):
    """Of the data where each parameter is about its nominal value and a lack about nothing, by their dense covariance."""
    r = missing.screening.regressors
    start = r.pull / r.precision  # estimate minus nominal
    seen = r.residual - r.jacobian @ start
    covariance = (1 + lack.independent**2) * np.eye(len(seen)) + (r.jacobian / r.precision) @ r.jacobian.T
    if len(lack.form.columns):
        waves = r.matrix.values[:, lack.form.columns] * (lack.form.sd * lack.size)
        covariance += waves @ waves.T
    return multivariate_normal(np.zeros(len(seen)), covariance).logpdf(seen)


def test_likelihoods_are_those_of_all_data_at_once(missing):
    """Fails if the likelihood of a lack over nothing, of any kind and size, is not that of a dense normal distribution."""
    nothing = next(one for one in missing.every if one.form.kind == "nothing")
    plain = log_likelihood(missing, nothing)
    for kind in ("cause", "background", "pose"):
        own = [one for one in missing.every if one.form.kind == kind]
        prior = (
            dict(zip(SIZES, LOG_PRIOR, strict=True))
            if kind == "cause"
            else dict.fromkeys((one.size for one in own), 0.0)
        )
        for first, second in ((own[0], own[5]), (own[-6], own[-1])):  # sizes of one form
            apart = log_likelihood(missing, first) - log_likelihood(missing, second)
            weighed = (first.log_weight - prior[first.size]) - (second.log_weight - prior[second.size])
            assert weighed == pytest.approx(apart, abs=1e-4)
    pose = next(one for one in missing.every if one.form.kind == "pose")
    sizes = sum(one.form.kind == "pose" for one in missing.every)
    assert pose.log_weight + np.log(sizes) == pytest.approx(log_likelihood(missing, pose) - plain, abs=1e-4)


def test_amplitudes_are_those_of_a_joint_fit(missing):
    """Fails if mean or covariance of what may be lacking are not those of parameters and amplitudes estimated together."""
    r = missing.screening.regressors
    lack = max((one for one in missing.every if one.form.kind == "background"), key=lambda one: one.log_weight)
    both = np.hstack([r.jacobian, r.matrix.values[:, lack.form.columns]])
    precision = np.diag(np.concatenate([r.precision, (lack.form.sd * lack.size) ** -2.0]))
    scale = np.diag(precision) ** -0.5
    whole = np.linalg.inv(np.outer(scale, scale) * (both.T @ both + precision)) * np.outer(scale, scale)
    pull = np.concatenate([r.pull, np.zeros(len(lack.form.columns))])
    mean = -whole @ (both.T @ r.residual + pull)
    own = slice(r.jacobian.shape[1], None)
    found, covariance = missing.amplitude(lack)
    np.testing.assert_allclose(found, mean[own], atol=1e-6 * np.abs(lack.form.sd * lack.size).max())
    np.testing.assert_allclose(covariance, whole[own, own], atol=1e-6 * np.diag(whole)[own].max())
    response = missing.response(lack.form.columns) @ found + missing.parameters(0.0)[0]
    np.testing.assert_allclose(response, mean[: own.start], atol=1e-4 * np.sqrt(np.diag(whole)[: own.start].max()))


def test_all_are_weighed_once_and_nothing_is_likeliest(missing):
    """Fails if weights do not add up, or a fit that lacks nothing is believed to lack something rather than not."""
    assert missing.weights.sum() == pytest.approx(1.0)
    kinds = [missing.probability(kind) for kind in ("nothing", "cause", "background", "pose")]
    assert sum(kinds) == pytest.approx(1.0)
    assert kinds[0] == max(kinds)


def test_the_task_s_error_is_as_large_as_promised_where_a_misfit_is_smooth():
    """Fails if a misfit that is smooth in several inputs is drawn of one at a time, and as large again at each pose."""
    whole, rows = wavering(16, poses=POSES + 40), np.arange(POSES + 40)
    data, there = (whole.only(part).stating(()) for part in (rows < POSES, rows >= POSES))
    model = build(data.robot, ("geometry",))
    fit, noise, lack, _ = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")
    fitted = Fitted(fit, data, noise, lack, stated(data))
    assert fitted.errors.functions
    missing = MissingEffects.of(fitted, Catalogue.of(data, ("geometry",)))
    site = TaskSlopes(fitted, there.conditions, model.point_jacobian(fit.estimate, there.conditions))
    drawn = task_error(missing, (), site, "rms", np.random.default_rng(1))
    promised = fitted.errors.variance(model, fit.estimate, fitted.covariance, there.conditions)
    assert drawn.quantile(0.5) == pytest.approx(np.sqrt(promised.sum(axis=1).mean()), rel=0.1)


def test_each_cause_has_rivals_of_its_own(missing):
    """Fails if the rivals of all causes together are taken for one choice, whose probabilities then are more than 1."""
    fitted = missing.fitted
    site = TaskSlopes(
        fitted, fitted.data.conditions, fitted.model.point_jacobian(fitted.fit.estimate, fitted.data.conditions)
    )
    off = fitted.fit.estimate.copy()
    off[0] += 0.1  # x of the base
    rivals = (Alternative(fitted.model, off, 0.7),)
    independent, both = (task_error(missing, [rivals] * n, site, "rms", np.random.default_rng(1)).every for n in (1, 2))
    assert np.mean(independent > 0.05) == pytest.approx(0.7, abs=0.04)
    assert np.mean(both > 0.05) == pytest.approx(1 - 0.3**2, abs=0.04)
    assert np.mean(both > 0.15) == pytest.approx(0.7**2, abs=0.04)
