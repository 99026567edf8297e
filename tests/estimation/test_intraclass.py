"""Errors that the markers of a standstill share count once."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.fitted import Fitted
from calflow.estimation.fit import IntraclassLikelihood, fit
from calflow.estimation.least_squares import LeastSquares, SeriesBlock
from calflow.estimation.noise import averaged, measured_noise
from calflow.estimation.probing import probed
from calflow.sampling.log_posterior import LogPosterior, log_posterior_of
from sampling.calibrations import SIGMA, Case, Design

SHARED = Design(poses=15, further=1, markers=3, shared=2 * SIGMA, level=0.0, joints=3)


def errors(case, fitted):
    """Errors of the fit's parameters off their bounds, over their standard deviations."""
    known = fitted
    free = ~known.at_bound
    return (known.estimate - case.truth)[free] / np.sqrt(np.diag(known.covariance)[free])


@pytest.fixture(scope="module")
def calibrations():
    """Calibrations of five robots whose poses shift three markers alike by twice the noise."""
    drawn = [Case.drawn(SHARED, np.random.default_rng([21, k])) for k in range(5)]
    return [(case, case.fitted()) for case in drawn]


def test_independent_errors_have_the_covariance_of_compound_symmetry():
    """Fails if whitening is not a root of the inverse of the covariance that is claimed."""
    rng = np.random.default_rng(1)
    group = np.array([0, 0, 1, 1, 1, 2])
    nothing = np.zeros((1, 6))
    sharing = SeriesBlock(None, None, np.arange(6), *[nothing] * 5, group, 0.7)
    covariance = np.where(group[:, None] == group, 0.7, 0.0) + 0.3 * np.eye(6)
    root = sharing.decorrelated(np.eye(6))
    np.testing.assert_allclose(root.T @ root, np.linalg.inv(covariance), atol=1e-12)
    values = rng.standard_normal((6, 3, 4))
    expected = np.einsum("ias,ij,jas->s", values, np.linalg.inv(covariance), values)
    np.testing.assert_allclose((sharing.decorrelated(values) ** 2).sum(axis=(0, 1)), expected, rtol=1e-12)


def test_what_markers_share_is_found_in_its_size(calibrations):
    """Fails if the parameters' degrees of freedom are not taken from what markers have in common: 0.8 would be found as 0.7."""
    found = [fitted.summary.intraclass for _, fitted in calibrations]
    assert np.mean(found) == pytest.approx(0.8, abs=0.04)


def test_intervals_of_shared_errors_cover(calibrations):
    """Fails if three markers count as three poses: errors would be 1.5 standard deviations, and 80 % in their 95 % intervals."""
    z = np.concatenate([errors(*one) for one in calibrations])
    assert 0.81 < np.sqrt((z**2).mean()) < 1.19
    assert (np.abs(z) < 1.96).mean() > 0.88


def test_the_posterior_and_the_fit_are_of_one_likelihood(calibrations):
    """Fails if the sampler counts squares otherwise than the fit: compared with the fit's own at some draws."""
    _, fitted = calibrations[0]
    posterior, laplace = log_posterior_of(fitted, fitted.data)
    assert isinstance(posterior, LogPosterior)
    assert laplace.variance == pytest.approx(1.0, abs=0.02)
    x = posterior.parameters(0.3 * np.random.default_rng(2).standard_normal((3, posterior.n_dimensions)))[:, :-1]
    expected = [(probed(posterior.problem, one, ())[0] ** 2).sum() for one in x]
    np.testing.assert_allclose(posterior.squares(x.T), expected, rtol=1e-9)


def test_the_diagnosed_model_is_fitted_with_what_markers_share(calibrations):
    """Fails if what diagnose hands on counts each marker as a pose of its own: identify would then be nearer to the truth."""
    off = []
    for case, known in calibrations:
        train = known.data.only(known.data.train)
        alone = Fitted.of(known, *averaged(train, known.noise(train)))
        free = ~known.at_bound
        sd = np.sqrt(np.diag(known.covariance))[free]
        each = [fitted.fit.estimate[free] for fitted in (alone, alone.sharing())]
        np.testing.assert_allclose((each[1] - known.estimate[free]) / sd, 0, atol=0.3)
        off.append([(((estimate - case.truth[free]) / sd) ** 2).mean() for estimate in each])
    apart, together = np.mean(off, axis=0)
    assert together < apart


def test_one_marker_is_fitted_as_if_nothing_could_be_shared():
    """Fails by a bit in which a correlation touches rows that stand alone at their standstill."""
    case = Case.drawn(Design(poses=25, further=1), np.random.default_rng(3))
    fitted = case.fitted()
    known, data = fitted, fitted.data
    assert known.intraclass == 0
    train = data.only(data.train)
    noise = known.noise(train)
    plain = LeastSquares.of(known.model, train, noise)
    other = LeastSquares.of(known.model, train, type(noise)(**{**vars(noise), "intraclass": 0.5}))
    assert not any(block.intraclass for block in other.blocks)
    for one, same in zip(*(probed(problem, known.estimate, ()) for problem in (plain, other)), strict=True):
        assert (one == same).all()


@pytest.mark.parametrize(("shared", "low", "high"), [(2 * SIGMA, 0.6, 0.95), (0.0, 0.0, 0.3)])
def test_few_standstills_tell_it_beside_many_parameters(shared, low, high):
    """Fails if what parameters take of what standstills have in common counts as not there: 0.8 would be found as nothing."""
    found = []
    for k in range(4):
        design = Design(poses=12, further=1, markers=3, shared=shared, level=0.0)
        case = Case.drawn(design, np.random.default_rng([4, k]))
        train = case.data.only(case.data.train)
        noise = measured_noise(train)
        result, _ = fit(LeastSquares.of(case.model, train, noise))
        found.append(IntraclassLikelihood.of(result, train, noise).correlation)
    assert low < min(found)
    assert max(found) < high


@pytest.mark.parametrize("moved", ["together", "each alone"])
def test_parameters_are_counted_where_they_fit(moved):
    """Fails if what is fitted to each tip of a tree counts as fitted to what its tips have in common, or that as theirs."""
    rng = np.random.default_rng(9)
    pose, tip = np.repeat(np.arange(60), 3), np.tile(np.arange(3), 60)
    if moved == "together":
        jacobian = rng.standard_normal((60, 15))[pose]
    else:
        jacobian = (np.eye(3)[tip][:, :, None] * rng.standard_normal((180, 1, 5))).reshape(180, 15)
    gains = []
    for noise in rng.standard_normal((200, 180)):
        left = noise - jacobian @ np.linalg.lstsq(jacobian, noise, rcond=None)[0]
        both = np.column_stack([jacobian, left])
        sums = both.reshape(60, 3, -1).sum(axis=1)
        prior = np.diag(np.append(np.full(15, 1e-6), 0.0))
        gains.append(IntraclassLikelihood(
            both.T @ both, (sums.T @ sums)[None], prior, np.array([3]), np.array([60]), 165.0
        ).gain)  # fmt: skip
    assert 0.3 < np.mean(np.array(gains) > 0) < 0.6  # at none it can go no further
    assert np.mean(np.array(gains) > 5.41) < 0.03  # that is 0.01 of a true null
