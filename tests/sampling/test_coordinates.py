"""Coordinates about bounds: the map, and posteriors at their bounds against dense numerical integration."""

from __future__ import annotations

import emcee
import numpy as np
import pytest
from scipy.stats import truncnorm

from calflow.estimation.fit import fit
from calflow.model import build
from calflow.sampling.log_posterior import Coordinates, Laplace, LogPosterior, move_mixture
from estimation.data import SIGMA, measured, problem
from robots import robot

LEVELS = (0.025, 0.25, 0.5, 0.75, 0.975)
CHANCE = 4.5  # Monte Carlo standard errors that are still an accident, of some dozens


def correlated(n, rng):
    """A covariance with strong correlations, in units that differ by orders of magnitude."""
    root = rng.standard_normal((n, n)) + np.eye(n)
    scale = 10.0 ** rng.uniform(-6, 0, n)
    return root @ root.T * np.outer(scale, scale)


def drawn(coordinates, log_density, rng, steps=1500):
    """A chain (n_steps, n_walkers, n) of a density of parameters, sampled in these coordinates."""
    n = len(coordinates.mean)

    def in_coordinates(u):
        x, log_slope = coordinates.mapped(u)
        return log_density(x) + log_slope

    sampler = emcee.EnsembleSampler(4 * n, n, in_coordinates, vectorize=True, moves=move_mixture(0.9))
    state = emcee.State(
        rng.standard_normal((4 * n, n)), random_state=np.random.RandomState(rng.integers(2**31)).get_state()
    )
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    return coordinates.mapped(sampler.get_chain(discard=steps // 10))[0]


def assert_agrees(chain, grid, mass):
    """Compare a chain (n_steps, n_walkers) with masses on a grid: mean, sd and quantiles, by its own Monte Carlo error."""
    tau = float(emcee.autocorr.integrated_time(chain[..., None], tol=0)[0])
    n = chain.size / max(tau, 1.0)
    mean = mass @ grid
    sd = np.sqrt(mass @ (grid - mean) ** 2)
    kurtosis = mass @ (grid - mean) ** 4 / sd**4
    step = grid[1] - grid[0]
    assert abs(chain.mean() - mean) < CHANCE * sd / np.sqrt(n) + step / 10
    assert abs(chain.std() / sd - 1) < CHANCE * np.sqrt((kurtosis - 1) / n) / 2 + 0.1 * step / sd
    below, edges = np.append(0.0, np.cumsum(mass)), np.append(grid - step / 2, grid[-1] + step / 2)
    for level in LEVELS:  # whether the share below the exact quantile is what it should be
        exact = np.interp(level, below, edges)
        assert abs((chain < exact).mean() - level) < CHANCE * np.sqrt(level * (1 - level) / n) + 0.02 * mass.max()


def test_the_map_stretches_as_it_says():
    """Fails if the logarithm of the slope, which is part of the density, is not the derivative's determinant."""
    rng = np.random.default_rng(1)
    covariance = correlated(4, rng)
    sd = np.sqrt(np.diag(covariance))
    bounds = np.array([(-0.5, 9.0), (2.0, 9.0), (-0.3, 0.4), (-99, 99)]) * sd[:, None]
    coordinates = Coordinates.about(np.clip(np.zeros(4), *bounds.T), np.zeros(4), covariance, bounds)
    assert coordinates.n_cut == 3
    for u in 1.5 * rng.standard_normal((20, 4)):
        x, log_slope = coordinates.mapped(u)
        assert (x >= bounds[:, 0]).all()
        assert (x <= bounds[:, 1]).all()
        steps = 1e-6 * np.eye(4)
        jacobian = (coordinates.mapped(u + steps)[0] - coordinates.mapped(u - steps)[0]) / 2e-6
        expected = np.linalg.slogdet(jacobian / sd)[1] + np.log(sd).sum()
        assert log_slope + np.log(np.diag(coordinates.factor)).sum() == pytest.approx(expected, abs=1e-4)


def test_what_is_far_from_its_bounds_stays_as_it_is():
    """Fails if the fit does not decide what is transformed: far from all bounds the map is linear, and exactly so."""
    rng = np.random.default_rng(2)
    covariance, mean = correlated(5, rng), rng.standard_normal(5)
    sd = np.sqrt(np.diag(covariance))
    bounds = mean[:, None] + 30 * sd[:, None] * np.array([-1.0, 1.0])
    coordinates = Coordinates.about(mean, mean, covariance, bounds)
    u = rng.standard_normal((1000, 5))
    x, log_slope = coordinates.mapped(u)
    assert coordinates.n_cut == 0
    assert not log_slope.any()
    np.testing.assert_allclose(np.linalg.solve(np.linalg.cholesky(covariance), (x - mean).T), u.T, atol=1e-6)


@pytest.mark.parametrize("beyond", [0.0, 1.0, 4.0])
def test_a_normal_cut_in_three_dimensions_is_sampled_exactly(beyond):
    """Fails if a slope is forgotten, or what bounds cut off is piled up on them: against a sum over a dense grid.

    The normal's mode is so many sd beyond two bounds, and the covariance of the coordinates is off by a third.
    """
    rng = np.random.default_rng(3)
    covariance = np.array([[1.0, 0.7, -0.3], [0.7, 1.5, 0.2], [-0.3, 0.2, 0.8]])
    mean = np.array([-beyond, 0.3, beyond])
    bounds = np.array([(0.0, 6.0), (-0.5, 8.0), (-7.0, 0.2)])
    precision = np.linalg.inv(covariance)

    def log_density(x):
        return -0.5 * np.einsum("...i,ij,...j->...", x - mean, precision, x - mean)

    rough = Coordinates.about(
        np.clip(mean, *bounds.T), mean + 0.2, covariance * np.outer([1.15] * 3, [1.15] * 3), bounds
    )
    chain = drawn(rough, log_density, rng)
    reach = 6 * np.sqrt(np.diag(covariance))
    ends = [(max(low, m - r), min(high, m + r)) for (low, high), m, r in zip(bounds, mean, reach, strict=True)]
    axes = [low + (high - low) * (np.arange(160) + 0.5) / 160 for low, high in ends]
    logs = log_density(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    mass = np.exp(logs - logs.max())
    mass /= mass.sum()
    for k, grid in enumerate(axes):
        assert_agrees(chain[..., k], grid, mass.sum(axis=tuple({0, 1, 2} - {k})))


def test_springs_that_do_not_give_way_are_sampled_as_integrated():
    """Fails if a real posterior at two bounds has another mean, sd or quantile than a sum over a dense grid says."""
    rng = np.random.default_rng(4)
    arm = robot("dh", [
        {"alpha_deg": 90, "a_m": 0.0, "d_m": 0.3, "limits_deg": (-90, 90), "mass_kg": 20.0, "com_m": (0, 0, 0)},
        {"alpha_deg": 0, "a_m": 0.6, "d_m": 0.0, "limits_deg": (-60, 60), "mass_kg": 15.0, "com_m": (-0.3, 0, 0)},
        {"alpha_deg": 0, "a_m": 0.5, "d_m": 0.0, "limits_deg": (-90, 90), "mass_kg": 10.0, "com_m": (-0.2, 0, 0)},
    ])  # fmt: skip
    model = build(arm, ("joint-compliance",))
    given = problem(model, measured(model, np.zeros(3), 12, rng, sigma=SIGMA))
    found, _ = fit(given)
    posterior = LogPosterior.about(given, Laplace.of(given, found.estimate))
    assert posterior.coordinates.n_cut == 3  # the first turns about an upright axis: its prior alone

    def log_density(x):
        return np.sum(posterior.densities_at(x), axis=0)

    chain = drawn(posterior.coordinates, lambda x: log_density(x.reshape(-1, 4)).reshape(x.shape[:-1]), rng, steps=800)
    prior_sd = model.prior_sd[0]
    ends = [(0.0, 5 * prior_sd), *((0.0, chain[..., k].max() * 1.3) for k in (1, 2)),
            (chain[..., 3].min() - 0.2, chain[..., 3].max() + 0.2)]  # fmt: skip
    axes = [low + (high - low) * (np.arange(40) + 0.5) / 40 for low, high in ends]
    second, third, level = np.meshgrid(*axes[1:], indexing="ij")
    points = np.column_stack([np.zeros(second.size), second.ravel(), third.ravel(), level.ravel()])
    logs = log_density(points).reshape(second.shape)
    mass = np.exp(logs - logs.max())
    mass /= mass.sum()
    for k in range(3):
        assert_agrees(chain[..., k + 1], axes[k + 1], mass.sum(axis=tuple({0, 1, 2} - {k})))
    half = np.exp(-0.5 * (axes[0] / prior_sd) ** 2)
    assert_agrees(chain[..., 0], axes[0], half / half.sum())


def test_the_upright_joints_spring_is_the_half_normal_of_its_prior(arm):
    """Fails if a parameter at its bound that no data reach is not sampled as its prior is, cut at the bound, in the tables too."""
    row = arm.table.set_index("parameter").loc["joint1.s"]
    (own,) = [p for p in arm.calibrated.model.parameters if p.name == "joint1.s"]
    exact = truncnorm(0, own.upper / own.prior_sd, scale=own.prior_sd)
    error = own.prior_sd / np.sqrt(row["ess"])
    assert row["mean"] == pytest.approx(exact.mean(), abs=CHANCE * error)
    assert row["sd"] == pytest.approx(exact.std(), abs=CHANCE * error)
    for name, share in (("q025", 0.025), ("q500", 0.5), ("q975", 0.975)):
        density = exact.pdf(exact.ppf(share))
        assert row[name] == pytest.approx(
            exact.ppf(share), abs=CHANCE * np.sqrt(share * (1 - share) / row["ess"]) / density
        )
    assert "joint1.s" in [one.parameter for one in arm.summary.cut]
