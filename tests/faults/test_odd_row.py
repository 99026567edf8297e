"""Outliers by the final model: told with their lines, and never left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.fitted import Fitted
from calflow.estimation import leverage
from calflow.estimation.identification import fit_effects
from calflow.estimation.leverage import Studentised, judged_table
from calflow.faults import as_table, corrected
from calflow.faults.outlier import odd_rows
from calflow.measurements.measurements import Measurements
from calflow.study import load_study
from hidden.case import Case, write_case


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A robot whose study has all that it does."""
    folder = tmp_path_factory.mktemp("odd")
    write_case(folder, Case(poses=90, columns=(), workflow="paper-table"), np.random.default_rng(21))
    return load_study(folder).measurements()


def judged(data):
    """Which rows are odd by the model that a robust fit identifies, the fault, and the table of residuals."""
    found = fit_effects(data, ("geometry", "joint-compliance"), starts=1)
    known, data = found.known, found.data
    final = Fitted.of(known, data.only(data.train), known.noise(data).only(data.train))
    noise = replace(known.noise(data), discrepancy=final.noise.discrepancy)
    studentised = Studentised.of(final.fit, data, noise)
    odd, told = odd_rows(final.fit, data, studentised)
    return odd, told, judged_table(final.fit, data, studentised, odd)


def test_a_row_fifteen_standard_deviations_off_is_told_and_stays(measured):
    """Fails if rows below what is gross before the fit are passed over, others are named, or a row is left out."""
    table = measured.table.copy()
    rows = [np.flatnonzero(measured.train)[7], np.flatnonzero(measured.held_out)[3]]
    table.loc[rows, "y"] += 15 * 4e-5 * np.array([1.0, -1.4])
    data = Measurements(measured.robot, table, measured.notes)
    odd, told, residuals = judged(data)
    assert np.flatnonzero(odd).tolist() == sorted(rows)
    assert [(one.cause, one.action) for one in told] == [("outlier", "told")]
    assert told[0].lines == tuple(table["line"].iloc[sorted(rows)])
    assert residuals["flagged"].sum() == 2
    assert corrected(data, as_table(told, data)).table.equals(data.table)


def test_a_row_of_another_payload_than_is_written_is_told_with_that_payload(measured):
    """Fails if exchanged payloads pass for bad measurements, which would be made again, or good rows beside them are named."""
    rows, table = np.sort(np.flatnonzero(measured.table["payload"] == "full")[[2, 9, 10]]), measured.table.copy()
    table.loc[rows, "payload"] = "none"
    odd, told, _ = judged(Measurements(measured.robot, table, measured.notes))
    assert np.flatnonzero(odd).tolist() == rows.tolist()
    assert [(one.cause, one.action, one.lines) for one in told] == [
        ("name-mistyped", "told", tuple(table["line"].iloc[rows]))
    ]
    assert "fits payload 'full', which is not what is written" in told[0].statement


def test_good_rows_are_not_odd(measured):
    """Fails if noise is called an outlier."""
    odd, told, _ = judged(measured)
    assert not odd.any()
    assert told == ()


def test_a_row_that_the_fit_follows_is_no_odder_where_the_estimate_is_less_sure(measured):
    """Fails if errors that the fit did not count narrow what its own rows may err by: a small residual would be a gross one."""
    found = fit_effects(measured, ("geometry", "joint-compliance"), starts=1)
    data, noise = found.data, found.known.noise(found.data)
    own, beside = (Studentised.of(found.fit, data, noise, wider) for wider in (None, 30 * found.fit.covariance))
    np.testing.assert_array_equal(beside.values[data.train], own.values[data.train])
    assert (np.abs(beside.values[data.held_out]) < np.abs(own.values[data.held_out])).all()


def test_identify_flags_no_row_that_its_fit_follows_where_the_estimate_is_less_sure(measured):
    """Fails if smooth errors beside the fit, which make it less sure, pass for its leverage: small residuals were flagged."""
    found = fit_effects(measured, ("geometry", "joint-compliance"), starts=1)
    less_sure = replace(found.fit, information=found.fit.information / 4)
    assert not leverage.judged(less_sure, found.data, found.noise)["flagged"].any()
