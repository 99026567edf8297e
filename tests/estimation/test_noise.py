"""Noise and the model's own discrepancy are told apart, and a lack of fit is claimed as rarely as promised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from calflow.estimation.fit import fit, fit_reweighted
from calflow.estimation.lack_of_fit import Evidence, LackOfFit, lack_of_fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import PerUnit, averaged, measured_noise
from calflow.files.problems import InputError
from calflow.files.units import METRE, RADIAN
from calflow.model import build
from estimation.data import SIGMA, drawn_truth, measured, stated
from robots import industrial


@pytest.fixture(scope="module")
def model():
    return build(industrial(), ("geometry",))


def lack_of(error: np.ndarray, sigma: np.ndarray, determined: float) -> LackOfFit:
    """The lack of fit of errors of stated noise, each a pose of its own."""
    rows, nothing = np.arange(len(error)), np.zeros(len(error))
    evidence = Evidence(nothing, nothing, rows, nothing + 1, 0 * rows)
    return lack_of_fit(error, sigma, determined, rows, evidence)


def test_repeats_give_the_devices_noise(model):
    """Fails if the spread between poses, or held-out rows, leak into the noise."""
    rng = np.random.default_rng(8)
    data = measured(model, drawn_truth(model, rng), 40, rng, repeats=5)
    data.table.loc[data.table["pose"] > 30, "split"] = "holdout"
    data.table.loc[data.table["pose"] > 30, "x"] += rng.normal(scale=1e-3, size=(data.table["pose"] > 30).sum())
    level = measured_noise(data)
    assert level.sources == ("repeats",)
    assert level.sigma[0] == pytest.approx(SIGMA, rel=0.12)


def test_without_repeats_the_file_is_believed_and_else_the_fit(model):
    """Fails if the order of the sources changes."""
    rng = np.random.default_rng(9)
    data = measured(model, model.nominal, 20, rng)
    assert measured_noise(data).sources == ("estimated",)
    data.table["sigma"] = 2e-5
    assert measured_noise(data).sources == ("file",)


def test_p_values_of_a_true_model_are_uniform(model):
    """Fails if a lack of fit is claimed more or less often than its p-value says."""
    rng = np.random.default_rng(10)
    p = []
    for _ in range(60):
        data = measured(model, drawn_truth(model, rng), 40, rng, repeats=2)
        means, level = averaged(data, stated(data))
        result, _ = fit(LeastSquares.of(model, means, level))
        error = model.position(result.estimate, means.conditions) - means.position
        p.append(lack_of(error.ravel(), np.repeat(level.sigma, 3), result.effective_parameters).p)
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
        result, _ = fit(LeastSquares.of(model, means, level))
        error = model.position(result.estimate, means.conditions) - means.position
        lack = lack_of(error.ravel(), np.repeat(level.sigma, 3), result.effective_parameters)
        level = replace(level, discrepancy=PerUnit().having(METRE, lack.discrepancy))
    assert lack.p < 1e-6
    assert lack.discrepancy == pytest.approx(1e-4, rel=0.15)
    sd = np.sqrt(np.diag(result.covariance))
    assert (np.abs(result.estimate - truth) < 1.96 * sd).mean() > 0.8


def test_repeats_under_other_conditions_stay_apart(model):
    """Fails if a pose's rows that came from another side are averaged, or the clock and encoder jitter keep rows apart."""
    rng = np.random.default_rng(21)
    data = measured(model, model.nominal, 10, rng, repeats=3)
    data.table["time"] = np.arange(30.0)
    for i in range(6):
        data.table[f"q{i + 1}"] += 1e-5 * rng.standard_normal(30)
        data.table[f"approach{i + 1}"] = np.where(data.table["repeat"] == 3, 1, -1)
    means, level = averaged(data, stated(data))
    assert len(means) == 20
    assert sorted(np.unique(level.sigma)) == pytest.approx([SIGMA / np.sqrt(2), SIGMA])
    assert means.table["time"].iloc[0] == pytest.approx(5.0)


def test_moving_a_little_between_repeats_is_not_noise(model):
    """Fails if encoder readings that differ between the repeats of a pose count as scatter of the device."""
    rng = np.random.default_rng(22)
    data = measured(model, model.nominal, 40, rng, repeats=4, sigma=0.0)
    data.table[[f"q{i + 1}" for i in range(6)]] += 1e-3 * rng.standard_normal((160, 6))
    data.table[["x", "y", "z"]] = model.position(model.nominal, data.conditions) + SIGMA * rng.standard_normal((160, 3))
    assert measured_noise(data).sigma[0] == pytest.approx(SIGMA, rel=0.15)


def test_a_source_that_is_not_there_is_refused(model):
    """Fails if the noise asked for is quietly replaced by another."""
    data = measured(model, model.nominal, 10, np.random.default_rng(23))
    for source in ("repeats", "file"):
        with pytest.raises(InputError, match=source):
            measured_noise(data, source)


def test_full_poses_have_a_discrepancy_of_their_own(model):
    """Fails if an orientation error of the model widens positions, or is not seen at all."""
    rng = np.random.default_rng(24)
    robot = industrial(tool_rotation_deg=(0.0, 90.0, 0.0))
    turning = build(robot, ("geometry",))
    truth = drawn_truth(turning, rng)
    data = measured(turning, truth, 80, rng)
    off = Rotation.from_rotvec(3e-4 * rng.standard_normal((80, 3)))
    data.table[["rx", "ry", "rz"]] = (Rotation.from_matrix(turning.rotation(truth, data.conditions)) * off).as_euler(
        "XYZ"
    )
    data.table["sigma_rotation"] = 1e-4
    settled = fit_reweighted(turning, data, stated(data), turning.nominal[None], "linear")[1]
    assert settled.discrepancy[METRE] == 0
    assert settled.discrepancy[RADIAN] == pytest.approx(np.sqrt(3e-4**2 - 1e-4**2), rel=0.2)


def test_orientations_without_their_noise_are_refused(model):
    """Fails if orientations that a notebook gives without saying how sure they are end in a traceback."""
    data = measured(model, drawn_truth(model, np.random.default_rng(8)), 4, np.random.default_rng(8))
    turned = replace(data, table=data.table.assign(**{f"q{axis}": 0.0 for axis in "xyz"}, qw=1.0))
    with pytest.raises(InputError, match="sigma_rotation: expected how sure the measured orientations are"):
        measured_noise(turned)
