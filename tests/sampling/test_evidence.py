"""Evidence and probabilities of models: against dense numerical integration, and what they claim of data made apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import logsumexp
from scipy.stats import norm

from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.estimation.calibrated_model import CalibratedModel, ModelInReach, SeriesNoise
from calflow.estimation.fit import fit
from calflow.estimation.noise import PerUnit
from calflow.model import Model
from calflow.sampling.log_posterior import Laplace, LogPosterior
from calflow.sampling.models import WeighedModels, cause_table, integrated_evidence, models_table, weighed_models
from estimation.data import SIGMA, measured, problem
from robots import robot

JOINTS = [
    {"alpha_deg": 90, "a_m": 0.0, "d_m": 0.3, "limits_deg": (-90, 90), "mass_kg": 20.0, "com_m": (0, 0, 0)},
    {"alpha_deg": 0, "a_m": 0.6, "d_m": 0.0, "limits_deg": (-60, 60), "mass_kg": 15.0, "com_m": (-0.3, 0, 0)},
    {"alpha_deg": 0, "a_m": 0.5, "d_m": 0.0, "limits_deg": (-90, 90), "mass_kg": 10.0, "com_m": (-0.2, 0, 0)},
]
ARM = robot("dh", JOINTS)


def cause(name, part, **variant):
    """A cause of the arm."""
    return Cause(ARM, catalogue()[name](ARM, **variant), part)


BASE, RATIO = cause("gear-ratio-error", "joint1"), cause("gear-ratio-error", "joint2")
STIFF, SECOND = cause("nonlinear-joint-stiffness", "joint2"), cause("nonlinear-joint-stiffness", "joint2", knee=0.2)
TWO_SIDED, ONE_SIDED = 61, 401  # points of a parameter: sums of what is smooth are exact, but at a bound


def data(sizes, seed=1, poses=15):
    """Poses of the arm with causes of these sizes; nothing else is unknown of it."""
    model = Model(ARM, tuple(sizes))
    return measured(
        model, np.concatenate([np.atleast_1d(size) for size in sizes.values()]), poses, np.random.default_rng(seed)
    )


def integrated(given):
    """The logarithm of a model's evidence, as a sum over a dense grid of each parameter and an integral over the noise level.

    Written apart: residuals by the model's position, priors normalised over their bounds.
    """
    (block,), model = given.blocks, given.model
    numbers = [ONE_SIDED if one.lower == 0 else TWO_SIDED for one in model.parameters]
    axes = [
        low + (high - low) * (np.arange(n) + 0.5) / n for (low, high), n in zip(_narrow(given), numbers, strict=True)
    ]
    cells = float(np.prod([axis[1] - axis[0] for axis in axes]))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    squares = np.array(
        [(((model.position(p, block.conditions).T - block.reported) / SIGMA) ** 2).sum() for p in points]
    )
    prior = np.zeros(len(points))
    for k, one in enumerate(model.parameters):
        whole = np.diff(norm.cdf([(one.lower - one.nominal) / one.prior_sd, (one.upper - one.nominal) / one.prior_sd]))[
            0
        ]
        prior += norm.logpdf(points[:, k], one.nominal, one.prior_sd) - np.log(whole)
    n = block.reported.size
    best = 0.5 * np.log(squares.min() / n)

    def density(level):
        logs = -0.5 * squares * np.exp(-2 * level) - n * level + prior
        peak = -0.5 * squares.min() * np.exp(-2 * best) - n * best
        return np.exp(logsumexp(logs) - peak + norm.logpdf(level))

    value, _ = quad(density, best - 0.8, best + 0.8, epsrel=1e-6)
    return np.log(value * cells) - 0.5 * squares.min() * np.exp(-2 * best) - n * best


def _narrow(given):
    """Within the bounds, where the posterior is: nine standard deviations of the fit about it."""
    found, _ = fit(given)
    sd = np.sqrt(np.diag(np.linalg.inv(found.information)))
    return np.clip(found.estimate[:, None] + 9 * sd[:, None] * [-1, 1], *given.model.bounds.T[:, :, None])


@pytest.mark.parametrize("causes", [(BASE,), (RATIO,), (STIFF,), (SECOND,), (RATIO, SECOND)])
@pytest.mark.parametrize("size", [2e-4, 0.0])
def test_evidence_is_the_integral_over_all_parameters(causes, size):
    """Fails if a prior is not normalised over its bounds, a slope or a determinant is lost, or a bound is counted twice.

    The second form of the stiffness is one-sided: with nothing hidden its posterior ends at the bound.
    """
    model = Model(ARM, causes)
    given = problem(model, data({RATIO: size}))
    found, _ = fit(given)
    posterior = LogPosterior.about(given, Laplace.of(given, found.estimate, found.at_bound))
    told = integrated_evidence(posterior, np.random.default_rng(2), exact=0.01)
    assert told.error < 0.02
    assert told.log == pytest.approx(integrated(given), abs=4 * told.error + 0.01)


def weighed(given, *models):
    """Models in reach, each with a prior of its own, weighed on the data; the first is what was found."""
    first = Model(ARM, models[0][0])
    found, _ = fit(problem(first, given))
    noise = (SeriesNoise(SIGMA, "file"),)
    reached = tuple(ModelInReach(tuple(causes), "found", log_prior, 0.0) for causes, log_prior in models)
    known = CalibratedModel(
        first, found.estimate, found.covariance, found.at_bound, noise, PerUnit(), "linear", in_reach=reached
    )
    return weighed_models(known, problem(first, given), np.random.default_rng(3), exact=0.01)


def test_probabilities_are_those_of_exhaustive_evidence():
    """Fails if models are not compared on the same data and weights, or their priors do not count."""
    given = data({RATIO: 2e-5})
    models = [((RATIO,), -2.0), ((BASE,), 0.0), ((STIFF,), -2.0), ((RATIO, SECOND), -4.0)]
    found = weighed(given, *models)
    logs = np.array([integrated(problem(Model(ARM, causes), given)) + prior for causes, prior in models])
    exact = np.exp(logs - logsumexp(logs))
    assert 0.02 < exact[0] < 0.98  # else there is nothing to tell
    np.testing.assert_allclose(found.probabilities, exact, atol=0.01)
    causes = cause_table(found).set_index(["cause", "part"])["probability"]
    assert causes["gear-ratio-error", "joint2"] == pytest.approx(exact[0] + exact[3], abs=0.01)
    assert causes["nonlinear-joint-stiffness", "joint2"] == pytest.approx(exact[2] + exact[3], abs=0.01)
    table = models_table(found)
    assert table["probability"].sum() == pytest.approx(1)
    assert (table["probability"].diff().dropna() <= 0).all()


def test_probabilities_are_promises():
    """Fails if a probability does not hold as often as it says: truths are drawn from the priors, and counted."""
    rng, stated, true = np.random.default_rng(5), [], []
    (own,) = RATIO.declared
    for _ in range(40):
        there = rng.random() < 0.5
        size = 3e-5 * rng.standard_normal() if there else 0.0
        prior = Cause(ARM, RATIO.effect, RATIO.part)
        vars(prior)["declared"] = (replace(own, prior_sd=3e-5),)  # what is usual here
        given = data({RATIO: size}, seed=rng.integers(2**31))
        found = weighed(given, ((BASE, prior), 0.0), ((BASE,), 0.0))
        stated.append(found.probabilities[0])
        true.append(there)
    stated, true = np.array(stated), np.array(true)
    expected, error = stated.sum(), np.sqrt((stated * (1 - stated)).sum())
    assert error > 1.0
    assert abs(true.sum() - expected) < 3 * error
    unsure = (stated > 0.1) & (stated < 0.9)
    assert abs(true[unsure].sum() - stated[unsure].sum()) < 3 * np.sqrt((stated * (1 - stated))[unsure].sum())


def test_where_errors_are_not_independent_the_tests_count():
    """Fails if evidence that takes a wander for independent noise is stated as a probability."""
    given = data({RATIO: 2e-5})
    found = weighed(given, ((RATIO,), -2.0), ((BASE,), 0.0))
    models = tuple(
        replace(one, reached=replace(one.reached, independent=False, log_weight=weight))
        for one, weight in zip(found.models, (0.0, -1.0), strict=True)
    )
    shared = WeighedModels(models)
    np.testing.assert_allclose(shared.probabilities, np.exp([0, -1]) / np.exp([0, -1]).sum())
    assert models_table(shared)["log_evidence"].isna().all()


def test_nothing_in_reach_is_nothing_to_tell():
    """Fails if a study in which diagnose found nothing ends the stage, or lists models."""
    assert len(WeighedModels().probabilities) == 0
    assert models_table(WeighedModels()).empty
    assert cause_table(WeighedModels()).empty
