"""The fit finds the truth, its intervals cover it as often as they say, and bounds and outliers are handled."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calflow.estimation.fit import draw_starts, fit
from calflow.estimation.identifiability import KNOWN
from calflow.model import build
from estimation.data import SIGMA, drawn_truth, measured, problem
from robots import hh800, industrial

EFFECTS = ("geometry", "joint-compliance")


@pytest.fixture(scope="module")
def model():
    return build(hh800(), EFFECTS)


def reduced_chi2(result):
    """Chi² per degree of freedom."""
    return (result.residual**2).sum() / (result.residual.size - result.effective_parameters)


def test_intervals_cover_the_truth(model):
    """Fails if the covariance is too narrow or too wide, or the estimate biased."""
    rng = np.random.default_rng(1)
    inside, chi2 = [], []
    for _ in range(40):
        truth = drawn_truth(model, rng)
        result, _ = fit(problem(model, measured(model, truth, 60, rng)))
        sd = np.sqrt(np.diag(result.covariance))
        known = ~result.at_bound & (sd < model.prior_sd / KNOWN)
        inside.append((np.abs(result.estimate - truth) < 1.96 * sd)[known])
        chi2.append(reduced_chi2(result))
    assert 0.93 < np.concatenate(inside).mean() < 0.97
    assert abs(np.mean(chi2) - 1) < 0.04


def test_all_starts_agree(model):
    """Fails if the fit stops early or finds a local optimum from a start half a prior away."""
    rng = np.random.default_rng(2)
    data = measured(model, drawn_truth(model, rng), 80, rng)
    _, agree = fit(problem(model, data), draw_starts(model, 5, rng))
    assert agree == 5


@pytest.mark.parametrize("sigma", [5e-6, 3e-6, 2e-6, 1e-6, 1e-7])
def test_data_almost_without_noise_are_fitted_as_fast(model, sigma):
    """Breaks if IPOPT goes on for what the round-off of metres hides, as it did for hundreds of iterations below 1 um."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = drawn_truth(model, rng)
        result, _ = fit(problem(model, data := measured(model, truth, 80, rng, sigma=sigma), sigma))
        assert result.converged
        assert result.iterations < 50
        left = model.position(result.estimate, data.conditions) - model.position(truth, data.conditions)
        assert np.abs(left).max() < 3 * sigma


@pytest.mark.parametrize("sigma", [1e-6, 1e-7])
def test_low_noise_does_not_lift_a_parameter_off_its_bound(model, sigma):
    """Breaks if IPOPT's last barrier, in units of chi2, grows as the noise falls."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        truth = drawn_truth(model, rng)
        stiff = model.columns(model.effects[1])
        truth[stiff] = 0.0
        rigid, precise = (
            fit(problem(model, measured(model, truth, 60, np.random.default_rng(seed), sigma=s), s))[0]
            for s in (SIGMA, sigma)
        )
        assert np.count_nonzero(precise.at_bound[stiff]) >= np.count_nonzero(rigid.at_bound[stiff]) - 1


def test_a_bound_that_the_truth_passes_is_reported(model):
    """Fails if an active bound goes unnoticed or keeps a symmetric standard deviation."""
    rng = np.random.default_rng(3)
    truth = drawn_truth(model, rng, 0.1)
    index = [p.name for p in model.parameters].index("joint4.a")
    truth[index] = 1.5 * model.bounds[index, 1]
    result, _ = fit(problem(model, measured(model, truth, 60, rng)))
    assert result.at_bound[index]
    assert result.estimate[index] <= model.bounds[index, 1]
    assert result.covariance[index, index] == 0


@pytest.mark.parametrize("loss", ["soft_l1", "cauchy"])
def test_robust_losses_withstand_outliers(model, loss):
    """Fails if a robust loss weighs gross errors like good rows."""
    rng = np.random.default_rng(4)
    truth = drawn_truth(model, rng)
    data = measured(model, truth, 100, rng)
    data.table.loc[:4, ["x", "y", "z"]] += 5e-3
    probe = measured(model, truth, 50, rng, sigma=0.0)

    def error(result):
        return np.linalg.norm(model.position(result.estimate, probe.conditions) - probe.position, axis=1).mean()

    plain, robust = fit(problem(model, data))[0], fit(problem(model, data), loss=loss)[0]
    assert error(robust) < 3 * SIGMA
    assert error(plain) > 5 * error(robust)


def test_a_full_pose_fixes_the_tools_orientation():
    """Fails if measured rotations are ignored, transposed, or weighed in other units than their own."""
    rng = np.random.default_rng(5)
    robot = industrial(tool_rotation_deg=(10.0, -20.0, 30.0))
    model = build(robot, ("geometry",))
    truth = drawn_truth(model, rng)
    data = measured(model, truth, 40, rng)
    turned = Rotation.from_matrix(model.rotation(truth, data.conditions)) * Rotation.from_rotvec(
        1e-4 * rng.standard_normal((40, 3))
    )
    data.table[["rx", "ry", "rz"]] = turned.as_euler("XYZ")
    data.table["sigma_rotation"] = 1e-4
    result, _ = fit(problem(model, data))
    fresh = measured(model, truth, 30, rng).conditions
    off = Rotation.from_matrix(model.rotation(result.estimate, fresh)).inv() * Rotation.from_matrix(
        model.rotation(truth, fresh)
    )
    assert off.magnitude().max() < 1e-4
    assert abs(reduced_chi2(result) - 1) < 0.3
    assert np.abs((result.estimate - truth) / np.sqrt(np.diag(result.covariance)))[~result.at_bound].max() < 5
