"""What a robot file expects of parameters is their prior, wherever a prior counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calflow as cf
from calflow.estimation.fit import fit
from calflow.estimation.parameters import mistaken
from calflow.model import build
from calflow.sampling.log_posterior import Laplace, LogPosterior
from estimation.data import measured, problem
from robots import hh800

EFFECTS = ("geometry", "joint-compliance")


def expecting(robot, spread=0.1):
    """The robot with an expectation of each parameter, and their means in the model's order."""
    model = build(robot, EFFECTS)
    rng = np.random.default_rng(3)
    means = np.clip(0.3 * model.prior_sd * rng.standard_normal(len(model.parameters)), *model.bounds.T)
    own = [
        cf.Expected(one.effect, one.part, one.symbol, one.unit, float(mean), spread * one.prior_sd)
        for one, mean in zip(model.parameters, means, strict=True)
    ]
    return replace(robot, expected=tuple(own)), means


def test_where_the_data_say_nothing_the_estimate_is_what_is_expected():
    """Fails if the prior's mean is lost anywhere between the robot file and the fit, or counts beside its standard deviation."""
    robot, means = expecting(hh800())
    model = build(robot, EFFECTS)
    assert np.array_equal(model.prior_mean, means)
    truth = np.zeros(len(means))
    data = measured(model, truth, 8, np.random.default_rng(1))
    result, _ = fit(problem(model, data, sigma=1e3))
    assert np.abs((result.estimate - means) / model.prior_sd)[~result.at_bound].max() < 1e-3


def test_the_fit_weighs_data_and_expectation_as_two_measurements():
    """Fails if what is expected does not count as much as its standard deviation says: linear algebra tells the same."""
    robot, means = expecting(hh800())
    model = build(robot, EFFECTS)
    data = measured(model, means, 30, np.random.default_rng(2))
    result, _ = fit(problem(model, data))
    (residual, jacobian), *rest = [part.linearised(result.estimate) for part in result.problem.parts()]
    assert not rest
    jacobian, free = jacobian.reshape(-1, len(means)), ~result.at_bound
    gradient = jacobian.T @ residual.ravel() + (result.estimate - means) / model.prior_sd**2
    assert np.abs(gradient * model.prior_sd)[free].max() < 1e-3 * np.abs(residual).sum()
    assert np.abs((result.estimate - means) / model.prior_sd)[free].max() < 4


def test_the_posterior_is_about_what_is_expected():
    """Fails if sampling and the fit have two priors: their log densities have the same slope."""
    robot, means = expecting(hh800())
    model = build(robot, EFFECTS)
    own = problem(model, measured(model, means, 40, np.random.default_rng(4)))
    result, _ = fit(own)
    posterior = LogPosterior.about(own, Laplace.of(own, result.estimate))
    at = np.zeros((1, posterior.n_dimensions))
    prior = posterior.densities(at)[1]
    values = posterior.parameters(at)[0]
    expected = -0.5 * (((values[:-1] - means) / model.prior_sd) ** 2).sum()
    assert prior[0] == pytest.approx(expected, abs=1e-2 + 1e-6 * abs(expected))


def test_an_expectation_of_nothing_is_refused():
    """Fails if a misspelt parameter, a wrong unit or a mean beyond the bounds is passed over in silence."""
    robot = hh800()
    good = cf.Expected("geometry", "joint2", "theta", "rad", 1e-4, 1e-5)
    wrong = [
        (replace(good, effect="geometri"), "unknown effect 'geometri', did you mean 'geometry'?"),
        (
            replace(good, symbol="thetta"),
            "effect 'geometry' has no parameter 'joint2.thetta', did you mean 'joint2.theta'?",
        ),
        (replace(good, part="joint3", unit="m"), "parameter 'joint3.theta' is in rad, not m"),
        (replace(good, part="joint4", mean=9.0), "parameter 'joint4.theta' is between"),
        (good, "parameter 'joint2.theta' of effect 'geometry' is expected twice"),
    ]
    told = list(mistaken(replace(robot, expected=(good, *(one for one, _ in wrong))), EFFECTS))
    assert [k for k, _ in told] == [1, 2, 3, 4, 5]
    for (_, message), (_, start) in zip(told, wrong, strict=True):
        assert message.startswith(start)
    assert not list(mistaken(replace(robot, expected=(replace(good, effect="joint-backlash"),)), EFFECTS))
