"""Noise and the model's own discrepancy are told apart, and a lack of fit is claimed as rarely as promised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from calflow.model import build
from calflow.stages.fit import Problem, fit
from calflow.stages.noise import averaged, lack_of_fit, noise
from robots import industrial
from stages.data import SIGMA, drawn_truth, measured, stated


@pytest.fixture(scope="module")
def model():
    return build(industrial(), ("geometry",))


def test_repeats_give_the_devices_noise(model):
    """Fails if the spread between poses, or held-out rows, leak into the noise."""
    rng = np.random.default_rng(8)
    data = measured(model, drawn_truth(model, rng), 40, rng, repeats=5)
    data.table.loc[data.table["pose"] > 30, "split"] = "holdout"
    data.table.loc[data.table["pose"] > 30, "x"] += rng.normal(scale=1e-3, size=(data.table["pose"] > 30).sum())
    level = noise(data)
    assert level.source == "repeats"
    assert level.sigma[0] == pytest.approx(SIGMA, rel=0.12)


def test_without_repeats_the_file_is_believed_and_else_the_fit(model):
    """Fails if the order of the sources changes."""
    rng = np.random.default_rng(9)
    data = measured(model, model.nominal, 20, rng)
    assert noise(data).source == "estimated"
    data.table["sigma"] = 2e-5
    assert noise(data).source == "file"


def test_p_values_of_a_true_model_are_uniform(model):
    """Fails if a lack of fit is claimed more or less often than its p-value says."""
    rng = np.random.default_rng(10)
    p = []
    for _ in range(60):
        data = measured(model, drawn_truth(model, rng), 40, rng, repeats=2)
        means, level = averaged(data, stated(data))
        result, _ = fit(Problem.of(model, means, level))
        error = model.position(result.estimate, means.rows) - means.position
        p.append(lack_of_fit(error, level, result.effective_parameters).p)
    assert kstest(p, "uniform").pvalue > 1e-3


def test_the_discrepancy_of_a_model_is_found(model):
    """Fails if repeats are counted as independent evidence of a model error, or the discrepancy is misjudged."""
    rng = np.random.default_rng(11)
    truth = drawn_truth(model, rng)
    data = measured(model, truth, 120, rng, repeats=8)
    own = 1e-4 * rng.standard_normal((120, 3))
    data.table[["x", "y", "z"]] += own[data.table["pose"]]
    means, level = averaged(data, stated(data))
    assert len(means) == 120
    for _ in range(3):
        result, _ = fit(Problem.of(model, means, level))
        error = model.position(result.estimate, means.rows) - means.position
        lack = lack_of_fit(error, level, result.effective_parameters)
        level = replace(level, discrepancy=lack.discrepancy)
    assert lack.p < 1e-6
    assert lack.discrepancy == pytest.approx(1e-4, rel=0.15)
    sd = np.sqrt(np.diag(result.covariance))
    assert (np.abs(result.estimate - truth) < 1.96 * sd).mean() > 0.8


def test_repeats_under_other_conditions_stay_apart(model):
    """Fails if rows of one pose that were measured at another time or marker are averaged."""
    rng = np.random.default_rng(21)
    data = measured(model, model.nominal, 10, rng, repeats=3)
    data.table["time"] = np.where(data.table["repeat"] == 3, 60.0, 0.0)
    means, level = averaged(data, stated(data))
    assert len(means) == 20
    assert sorted(np.unique(level.sigma)) == pytest.approx([SIGMA / np.sqrt(2), SIGMA])
