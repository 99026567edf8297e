"""Errors that rows share are taken out of what tests go by, exactly as their covariance says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from calflow.diagnosis.regressors import Background, Candidate, Regressors, TallMatrix, principal
from calflow.diagnosis.screening import Screening

N, WAVES = 300, 7
RNG = np.random.default_rng(3)
PARTS = RNG.standard_normal((N, WAVES)), 0.5 * RNG.standard_normal((N, 3))
WEIGHT = RNG.uniform(0.5, 2.0, N)
BACKGROUND = Background((("q1",), ("time",)), (), principal(np.eye(N), PARTS), WEIGHT, 18.0, 8)
JACOBIAN, PRECISION, PULL = (
    RNG.standard_normal((N, 4)),
    np.array([1e-6, 0.3, 2.0, 1e-6]),
    np.array([0.0, 0.4, -1.0, 0.0]),
)


@dataclass(frozen=True)
class Pair:
    """A cause of two parameters."""

    id: str = "pair"
    part: str = ""
    place = ("pair", "")
    bounds = np.array([[-np.inf] * 2, [np.inf] * 2])


def linearised(matrix: np.ndarray, residual: np.ndarray) -> Regressors:
    """A linear model with priors, and the columns that are tested beside it."""
    candidates = (Candidate(Pair(), np.arange(2)),)
    rss = float(PULL**2 @ (1 / PRECISION))
    return Regressors(residual, JACOBIAN, PRECISION, PULL, rss, TallMatrix.held(matrix), np.full(2, 0.7), candidates)


def beside(covariance: np.ndarray, matrix: np.ndarray, residual: np.ndarray) -> Screening:
    """The same by the textbook: all rows whitened by their covariance (Aitken 1936)."""
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    rows = linearised(root @ matrix, root @ residual)
    return Screening.of(Regressors(**vars(rows) | {"jacobian": root @ JACOBIAN}))


@pytest.mark.parametrize("factor", [np.ones(N), np.linspace(1.0, 3.0, N)], ids=["as weighed", "weighed otherwise"])
def test_tests_are_those_by_the_covariance(factor):
    """Fails if what rows share is left in, or costs freedom, or later weights of rows do not reach it, or their level does."""
    scaled = 1 / factor / np.median(1 / factor)
    shared = scaled[:, None] * np.hstack(PARTS)
    covariance = np.eye(N) + shared @ shared.T
    residual = np.linalg.cholesky(covariance) @ RNG.standard_normal(N)
    matrix = RNG.standard_normal((N, 2))
    one = Screening.of(linearised(matrix, residual).beside(BACKGROUND, WEIGHT / factor * 5))
    other = beside(covariance, matrix, residual)
    assert one.chi2 == pytest.approx(other.chi2)
    assert one.degrees_of_freedom == pytest.approx(other.degrees_of_freedom)
    assert one.model.change[:4] == pytest.approx(other.model.change)
    assert one.scores[0].estimate == pytest.approx(other.scores[0].estimate)
    assert one.scores[0].covariance == pytest.approx(other.scores[0].covariance)
    assert one.scores[0].cost == pytest.approx(other.scores[0].cost, abs=1e-6)
