"""A tracker's noise along and across its beam: it enters the fit as the covariance it is."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import averaged, stated_noise
from calflow.estimation.probing import probed
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import BeamNoise, Series
from calflow.model import build
from robots import poses, ur10

BEAM = BeamNoise(1.5e-5, 6e-6, 2e-5, (2.0, -1.0, 0.5))


@pytest.fixture
def seen():
    """Rows of a tracker whose noise is stated, and the nominal model."""
    robot = ur10()
    q = poses(robot, 12)
    model = build(robot, ("geometry",))
    data = Measurements.from_arrays(robot, q, np.zeros((12, 3)))
    position = model.position(model.nominal, data.conditions)
    rng = np.random.default_rng(1)
    position += 1e-4 * rng.standard_normal(position.shape)
    data = Measurements.from_arrays(robot, q, position)
    return model, Measurements(robot, data.table.assign(split="train"), series=(Series(beam=BEAM),))


def covariance(position: np.ndarray) -> np.ndarray:
    """Of one position (3,), from the rotation onto the beam."""
    beam = position - np.array(BEAM.device)
    distance = np.linalg.norm(beam)
    axes = np.linalg.svd(beam[None])[2]  # the first along the beam
    sd = np.array([BEAM.floor + BEAM.growth * distance, BEAM.angle * distance, BEAM.angle * distance])
    return axes.T @ np.diag(sd**2) @ axes


def test_residuals_are_whitened_by_the_covariance(seen):
    """Fails if whitened residuals differ from Cholesky's by more than a rotation."""
    model, data = seen
    problem = LeastSquares.of(model, data, stated_noise(data))
    residual, _ = probed(problem, model.nominal, ())
    error = model.position(model.nominal, data.conditions) - data.position
    whitened = np.array(
        [np.linalg.solve(np.linalg.cholesky(covariance(x)), e) for x, e in zip(data.position, error, strict=True)]
    )
    np.testing.assert_allclose(
        np.linalg.norm(residual.reshape(-1, 3), axis=1), np.linalg.norm(whitened, axis=1), rtol=1e-9
    )


def test_a_mean_of_repeats_has_its_share_of_the_covariance(seen):
    """Fails if the mean of four measurements is not twice as sure, in every direction."""
    model, data = seen
    table = data.table.loc[data.table.index.repeat(4)].assign(repeat=np.tile([1, 2, 3, 4], 12)).reset_index(drop=True)
    many = Measurements(data.robot, table, series=data.series)
    means, noise = averaged(many, stated_noise(many))
    assert len(means) == 12
    single = probed(LeastSquares.of(model, data, stated_noise(data)), model.nominal, ())[0]
    mean = probed(LeastSquares.of(model, means, noise), model.nominal, ())[0]
    np.testing.assert_allclose(mean, 2 * single, rtol=1e-6)
