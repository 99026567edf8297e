"""Sampling: every mixture of moves recovers a known posterior, and resuming changes nothing."""

from __future__ import annotations

from dataclasses import replace

import emcee
import h5py
import numpy as np
import pytest

from calflow.estimation.error_model import ErrorModel
from calflow.estimation.fit import fit
from calflow.estimation.progress import draws
from calflow.model import build
from calflow.sampling.chain import BLOBS, Chain, ChainLength
from calflow.sampling.log_posterior import Laplace, LogPosterior, log_posterior_of, move_mixture
from calflow.sampling.sample import _autocorrelation_time, _extend, sample
from estimation.data import SIGMA, calibrated, drawn_truth, measured, problem, wavering
from robots import industrial


@pytest.mark.parametrize(("independent", "steps"), [(0.9, 1200), (0.0, 4000)])
def test_moves_recover_a_known_covariance(independent, steps):
    """Fails if a move's acceptance is wrong, as DESnookerMove's is: whitened variances would leave 1 by a quarter."""
    n = 35
    rng = np.random.default_rng(13)
    # in the coordinates that Laplace makes round, what is left of the shape: ten per cent, and weak correlations
    root = np.tril(0.03 * rng.standard_normal((n, n)), -1) + np.diag(rng.uniform(0.9, 1.1, n))
    inverse = np.linalg.inv(root)

    def log_probability(x):
        return -0.5 * ((x @ inverse.T) ** 2).sum(axis=1)

    # walkers start from the target itself, so nothing has to be thrown away
    start = rng.standard_normal((4 * n, n)) @ root.T
    sampler = emcee.EnsembleSampler(4 * n, n, log_probability, vectorize=True, moves=move_mixture(independent))
    sampler.run_mcmc(emcee.State(start, random_state=np.random.RandomState(1).get_state()), steps)
    whitened = sampler.get_chain(flat=True) @ inverse.T
    covariance = np.cov(whitened.T)
    assert np.abs(np.diag(covariance) - 1).max() < 0.1
    assert abs(np.diag(covariance).mean() - 1) < 0.02
    assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 0.1
    assert np.abs(whitened.mean(axis=0)).max() < 0.1


@pytest.fixture(scope="module")
def posterior():
    rng = np.random.default_rng(14)
    model = build(industrial(), ("geometry", "joint-compliance"))
    given = problem(model, measured(model, drawn_truth(model, rng), 50, rng))
    result, _ = fit(given)
    return LogPosterior.about(given, Laplace.of(given, result.estimate))


def test_log_probability_is_the_models(posterior):
    """Fails if the scaling, a prior, the noise's normalisation or a bound is wrong: compared with plain numpy."""
    rng = np.random.default_rng(15)
    u = 0.5 * rng.standard_normal((6, posterior.n_dimensions))
    (block,), model = posterior.problem.blocks, posterior.problem.model
    x = posterior.parameters(u)
    expected = []
    for values, level in zip(x[:, :-1], x[:, -1], strict=True):
        residual = (model.position(values, block.conditions).T - block.reported) / (SIGMA * np.exp(level))
        prior = ((values - model.nominal) / model.prior_sd) ** 2
        expected.append(-0.5 * (residual**2).sum() - residual.size * level - 0.5 * prior.sum() - 0.5 * level**2)
    inside = ((x[:, :-1] >= model.bounds[:, 0]) & (x[:, :-1] <= model.bounds[:, 1])).all(axis=1)
    expected = np.where(inside, expected, -np.inf)
    assert inside.any()
    slope = posterior.coordinates.mapped(u)[1]
    np.testing.assert_allclose(posterior.densities(u)[0] - slope, expected, rtol=1e-9)
    prior, likelihood = posterior.densities(u)[1:]
    levels = x[inside, -1]
    priors = -0.5 * (((x[inside, :-1] - model.nominal) / model.prior_sd) ** 2).sum(axis=1) - 0.5 * levels**2
    np.testing.assert_allclose(prior[inside], priors, rtol=1e-9)
    np.testing.assert_allclose(likelihood[inside], expected[inside] - priors, rtol=1e-9)


@pytest.mark.parametrize("steps", [7, 60, 1000])
def test_the_autocorrelation_time_is_emcees(steps):
    """Fails if walkers' means, the padding of their transforms or the window are others."""
    rng = np.random.default_rng(steps)
    values = np.cumsum(rng.standard_normal((steps, 12)), axis=0) + 100 * rng.standard_normal(12)
    (expected,) = emcee.autocorr.integrated_time(values[..., None], tol=0)
    assert _autocorrelation_time(values) == pytest.approx(expected, rel=1e-9)


def extended(posterior, start, path, lengths, said=lambda line: None):
    """A chain of one ensemble that was lengthened to these numbers of steps, its file opened anew each time."""
    for steps in lengths:
        chain = Chain.open(path, 1, start.shape, 0.9, said)
        _extend(chain, 0, posterior, start, 5, steps)
        chain.save()
    return chain


@pytest.fixture(scope="module")
def start(posterior):
    n = posterior.n_dimensions
    return np.random.default_rng(17).standard_normal((2 * n, n))


def test_interrupted_and_resumed_is_the_same_chain(posterior, start, tmp_path):
    """Fails if the random state, the last positions or what is kept of them are lost between two blocks."""
    whole = extended(posterior, start, tmp_path / "whole.h5", [30])
    parts = extended(posterior, start, tmp_path / "parts.h5", [10, 17, 30])
    np.testing.assert_array_equal(whole.walkers(0, 30), parts.walkers(0, 30))
    np.testing.assert_array_equal(whole.densities(0, 30), parts.densities(0, 30))


def test_a_walker_that_starts_beyond_a_bound_comes_back(posterior, start, tmp_path):
    """Fails if a walker that starts where the posterior is zero stays there: emcee would not complain."""
    lost = np.vstack([np.full_like(start[:1], 50.0), start[1:]])
    assert np.isneginf(posterior.densities(lost)[0]).tolist() == [True, *[False] * (len(start) - 1)]
    chain = extended(posterior, lost, tmp_path / "chain.h5", [20])
    assert np.isfinite(chain.densities(19, 20)["log_prior"]).all()


def test_the_file_is_emcees(posterior, start, tmp_path):
    """Fails if emcee cannot read the file, or go on from it to the same steps."""
    chain = extended(posterior, start, tmp_path / "chain.h5", [10])
    backend = emcee.backends.HDFBackend(str(tmp_path / "chain.h5"), name="ensemble1")
    np.testing.assert_array_equal(backend.get_chain(), chain.walkers(0, 10)[0])
    np.testing.assert_array_equal(backend.get_blobs(), chain.densities(0, 10)[0])
    np.testing.assert_array_equal(backend.accepted, chain.ensembles[0].accepted)

    def densities(u):
        return list(zip(*posterior.densities(u), strict=True))

    sampler = emcee.EnsembleSampler(
        *start.shape, densities, vectorize=True, backend=backend, blobs_dtype=BLOBS, moves=move_mixture(0.9)
    )
    sampler.run_mcmc(None, 5, skip_initial_state_check=True)
    longer = extended(posterior, start, tmp_path / "longer.h5", [15])
    np.testing.assert_array_equal(backend.get_chain(), longer.walkers(0, 15)[0])


def test_a_block_that_was_not_finished_leaves_the_chain_as_it_was(posterior, start, tmp_path, monkeypatch):
    """Fails if a block is written into the chain's own file: killed between two of HDF5's writes, no step of it could be read."""
    path, said = tmp_path / "chain.h5", []
    extended(posterior, start, path, [10])
    before = path.read_bytes()

    def stopped(source, target):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("calflow.files.writing.os.replace", stopped)
        with pytest.raises(KeyboardInterrupt):
            extended(posterior, start, path, [30])
    assert path.read_bytes() == before
    parts = extended(posterior, start, path, [30], said.append)
    assert said == ["resuming after 10 steps"]
    assert [file.name for file in tmp_path.iterdir()] == ["chain.h5"]
    whole = extended(posterior, start, tmp_path / "whole.h5", [30])
    np.testing.assert_array_equal(whole.walkers(0, 30), parts.walkers(0, 30))


def test_prior_and_likelihood_are_kept_of_the_draw_they_belong_to(posterior, start, tmp_path):
    """Fails if a rejected proposal's densities stand beside the draw that was kept, or the two are swapped."""
    chain = extended(posterior, start, tmp_path / "chain.h5", [20])
    prior, likelihood = posterior.densities(chain.walkers(0, 20).reshape(-1, posterior.n_dimensions))[1:]
    kept = chain.densities(0, 20).ravel()
    np.testing.assert_allclose(kept["log_prior"], prior, rtol=1e-9)
    np.testing.assert_allclose(kept["log_likelihood"], likelihood, rtol=1e-9)
    with h5py.File(tmp_path / "chain.h5") as file:
        np.testing.assert_array_equal(file["ensemble1"]["blobs"]["log_prior"].ravel(), kept["log_prior"])


def test_a_likelihood_that_was_changed_is_not_gone_on_from(posterior, start, tmp_path):
    """Fails if the checksum leaves out what is kept of each draw."""
    path, said = tmp_path / "chain.h5", []
    before = extended(posterior, start, path, [10])
    with h5py.File(path, "a") as file:
        kept = file["ensemble1"]["blobs"][:]
        kept["log_likelihood"][3, 2] += 1e-9
        file["ensemble1"]["blobs"][:] = kept
    after = extended(posterior, start, path, [10], said.append)
    (line,) = said
    assert "its checksum is wrong" in line
    np.testing.assert_array_equal(before.densities(0, 10), after.densities(0, 10))


def test_beside_smooth_errors_the_chain_is_as_sure_as_the_fit(tmp_path):
    """Fails if a smooth misfit passes for white noise, of which the chain would be up to twice as sure."""
    data = wavering(1, poses=70)
    known = calibrated(data)
    assert known.errors.functions
    length = ChainLength(max_steps=100, block=100)
    chain = sample(known, data, tmp_path / "chain.h5", length, rng=draws(1))
    points = chain.points[..., :-1].reshape(-1, len(known.estimate))
    sd = np.sqrt(np.diag(known.covariance))
    assert points.std(axis=0) == pytest.approx(sd, rel=0.1)
    assert (np.abs(points.mean(axis=0) - known.estimate) < 0.2 * sd).all()
    white = replace(known, errors=ErrorModel.white(known.errors.rest, len(sd)))
    assert (log_posterior_of(white, data)[1].sd / sd).min() < 0.8
    posterior, laplace = log_posterior_of(known, data)
    far = laplace.estimate + 30 * sd * np.random.default_rng(2).standard_normal((200, len(sd)))
    assert posterior.squares(far.T).min() > posterior.squares(laplace.estimate[:, None]).min()
