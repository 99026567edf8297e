"""Very many rows: their Jacobian is never there at once, and where its parts end does not show."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from calflow.estimation import calibrated_model as certainty
from calflow.estimation import least_squares
from calflow.estimation.fit import Fit, IntraclassLikelihood, fit, fit_to_all
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.leverage import Studentised, left_out
from calflow.estimation.noise import AT_LEAST, Noise, members, representative
from calflow.measurements.measurements import Measurements
from calflow.sampling.log_posterior import Laplace, LogPosterior
from estimation.data import calibration
from sampling.calibrations import SIGMA, Case, Design

FEW, ALL = 64, 10**9  # rows of a part: of some thousand rows many parts, or one
TIMES = (10, 20)  # as many rows as a calibration, two sizes
MORE = 4  # at other TIMES


@pytest.fixture(scope="module")
def small() -> tuple[Measurements, Fit]:
    """Thirty poses of three markers each, all to be fitted, and a fit in which a pose's markers err alike."""
    case = Case.drawn(Design(poses=30, further=1, markers=3, shared=2 * SIGMA, level=0.0), np.random.default_rng(5))
    data = case.data.only(case.data.train)
    result, _ = fit(LeastSquares.of(case.model, data, noise(data)))
    return data, result


def noise(data: Measurements) -> Noise:
    """The noise as it is stated; markers of a standstill share half of what they err by."""
    return Noise(np.full(len(data), SIGMA), ("file",), intraclass=0.5)


def many(small: tuple[Measurements, Fit], times: int) -> tuple[Measurements, Fit]:
    """The same poses measured so many times as others, marker after marker: those of a standstill stand far apart."""
    data, result = small
    tables = [data.table.assign(pose=len(data) * k + data.table["pose"]) for k in range(times)]
    whole = replace(data, table=pd.concat(tables).sort_values("marker", kind="stable").reset_index(drop=True))
    return whole, replace(result, problem=LeastSquares.of(result.model, whole, noise(whole)))


def poses(data: Measurements) -> np.ndarray:
    """The number of each row's pose."""
    return np.unique(data.table["pose"], return_inverse=True)[1]


def expanded(data: Measurements, result: Fit) -> tuple[np.ndarray, ...]:
    found = Fit.at(result.problem, result.estimate)
    return found.gradient, found.information, found.residual


def without_each(data: Measurements, result: Fit) -> tuple[np.ndarray, ...]:
    found = left_out(result, poses(data))
    return np.array([found.sum_of_squares, found.expected, found.number, found.share]), np.zeros(0)


def products(data: Measurements, result: Fit) -> tuple[np.ndarray, ...]:
    found = IntraclassLikelihood.of(result, data, noise(data))
    return found.each, found.summed, found.markers, found.number


def studentised(data: Measurements, result: Fit) -> tuple[np.ndarray, ...]:
    found = Studentised.of(result, data, noise(data))
    return found.squared, found.values, found.whitened


def squares(data: Measurements, result: Fit) -> tuple[np.ndarray, ...]:
    posterior = LogPosterior.about(result.problem, Laplace.of(result.problem, result.estimate))
    near = result.estimate + 0.1 * result.model.prior_sd * np.array([[0.0], [1e-3], [2e-3]])
    return (posterior.squares(near.T),)


ASKED = [expanded, without_each, products, studentised, squares]


@pytest.mark.parametrize("asked", ASKED)
def test_where_parts_end_does_not_show(small, asked: Callable[..., tuple[np.ndarray, ...]], monkeypatch):
    """Fails if a standstill or a pose is cut in two, rows are given back in another order, or a part is left out."""
    found = []
    for size in (ALL, FEW):
        monkeypatch.setattr(least_squares, "LINEARISED_ROWS", size)
        found.append(asked(*many(small, MORE)))
    for whole, in_parts in zip(*found, strict=True):
        assert_allclose(in_parts, whole, rtol=1e-8, atol=1e-8 * np.nanmax(np.abs(whole), initial=0.0))


@pytest.mark.parametrize("asked", ASKED)
def test_no_jacobian_of_all_rows_is_there(small, asked: Callable[..., tuple[np.ndarray, ...]], monkeypatch):
    """Fails if memory grows by a row of the Jacobian with each row of the data."""
    monkeypatch.setattr(least_squares, "LINEARISED_ROWS", FEW)
    jacobian = 8 * 3 * len(small[1].estimate)
    sizes = {k: many(small, k) for k in TIMES}
    assert growth(lambda k: asked(*sizes[k]), len(small[0])) < 0.8 * jacobian


def test_predictions_take_no_jacobian_of_all_rows(small, monkeypatch):
    """Fails if a file of a million rows to predict is refused by the machine's memory, or its parts are not those of the rows."""
    data, result = small
    known = calibration(result.model, result.estimate, result.covariance, at_bound=result.at_bound)
    conditions = {k: np.tile(data.conditions, (1, k)) for k in TIMES}
    monkeypatch.setattr(certainty, "PART_ROWS", ALL)
    whole = known.parameter_variance(conditions[TIMES[0]])
    monkeypatch.setattr(certainty, "PART_ROWS", FEW)
    assert_allclose(known.parameter_variance(conditions[TIMES[0]]), whole, rtol=1e-9)
    assert growth(lambda k: known.parameter_variance(conditions[k]), len(data)) < 8 * 3 * len(result.estimate) / 2


def growth(done: Callable[[int], object], n_rows: int) -> float:
    """Bytes of the peak by which it grows with a row, from one of TIMES to the other."""
    peaks = []
    for times in TIMES:
        done(times)  # what is made once and kept
        tracemalloc.start()
        done(times)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    return (peaks[1] - peaks[0]) / (n_rows * (TIMES[1] - TIMES[0]))


def test_members_are_found_in_their_order():
    """Fails if a row is lost, or those of a group are not in the order of the rows."""
    found = members(np.array([2, 0, 1, 0, 2, 2]))
    assert [own.tolist() for own in found] == [[1, 3], [2], [0, 4, 5]]


def test_rows_that_stand_for_all_are_whole_standstills_of_every_payload(small: tuple[Measurements, Fit]) -> None:
    """Fails if a standstill is torn apart, rows are not drawn evenly, or a payload that was seldom carried has too few."""
    data, _ = many(small, 40)
    pose = data.table["pose"].to_numpy()
    seldom = pose >= np.quantile(pose, 0.9)
    data = replace(data, table=data.table.assign(payload=np.where(seldom, "seldom", "often")))
    some = representative(data, 900)
    assert len(np.unique(data.standstill[some])) + len(np.unique(data.standstill[~some])) == 40 * 30
    assert some[seldom].sum() >= 0.9 * AT_LEAST
    assert 0.2 < some[~seldom].mean() < 0.3
    assert_allclose([some[~seldom & (pose % 4 == k)].mean() for k in range(4)], some[~seldom].mean(), rtol=0.2)
    assert representative(data, len(data)).all()


def test_a_fit_to_all_rows_from_some_of_them_is_that_to_all(small: tuple[Measurements, Fit]) -> None:
    """Fails if what all rows tell is lost where the fit begins with some, or weights are not those of the rows."""
    data, result = many(small, 20)
    some, stated = representative(data, 600), noise(data)
    part, settled = stated.only(some), replace(stated.only(some), sigma=1.5 * stated.sigma[some])
    begun, _ = fit(LeastSquares.of(result.model, data.only(some), settled))
    found, every = fit_to_all(begun, part, settled, data, stated)
    expected, _ = fit(LeastSquares.of(result.model, data, every))
    assert_allclose(every.sigma, 1.5 * SIGMA)
    sd = np.sqrt(np.diag(expected.covariance))
    assert (
        np.abs(found.estimate - expected.estimate) <= 1e-3 * np.where(found.at_bound, result.model.prior_sd, sd)
    ).all()
    assert_allclose(found.covariance, expected.covariance, rtol=1e-3, atol=1e-3 * np.outer(sd, sd).max())
    assert (np.abs(begun.estimate - expected.estimate) > 0.5 * sd).any()
