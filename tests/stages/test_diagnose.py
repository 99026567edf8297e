"""The stage diagnose sees to the confirming series' own faults, and tells whether the extended fit reached its optimum."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calflow.calibration import _confirmed_tables
from calflow.diagnosis.diagnosis import Diagnosis, diagnosis_summary
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.trial import Linearisation
from calflow.estimation.fit import fit_reweighted
from diagnosis.test_replication import series
from estimation.data import stated

SAME = (2e-4, 1e-4)


@pytest.fixture(scope="module")
def fitted():
    """A periodic error of joint 1 on one series."""
    model, _, data = series(SAME, 1)
    train = data.only(data.train)
    fit, noise, lack, _ = fit_reweighted(model, train, stated(train), model.nominal[None], "linear")
    return Fitted(fit, train, noise, lack, noise)


def test_a_turned_sign_in_the_confirming_series_is_named_and_both_agree(fitted):
    """Fails if the other series is compared as its file has it: half a metre wrong, so that the two do not agree."""
    other, said = series(SAME, 2)[2], []
    other.table["q3"] *= -1
    made = _confirmed_tables(
        fitted, SimpleNamespace(name="other", measurement_paths=(), measurements=lambda: other), said.append
    ).tables
    assert "the same curve" in made["diagnose/confirmation.csv"]["words"].iloc[0]
    faults = made["diagnose/confirmation_faults.csv"]
    assert (faults["cause"].tolist(), faults["joint"].tolist()) == (["joint-sign"], [3])
    assert said[0].startswith("other: joint sign: ")
    assert made["diagnose/confirmation_accuracy.csv"]["heldout_mean_mm"].max() < 1


def test_a_confirming_series_without_faults_is_as_its_file_has_it(fitted):
    """Fails if faults are seen where there are none."""
    other = series(SAME, 2)[2]
    made = _confirmed_tables(
        fitted, SimpleNamespace(name="other", measurement_paths=(), measurements=lambda: other), lambda words: None
    ).tables
    assert made["diagnose/confirmation_faults.csv"].empty


@pytest.mark.parametrize("converged", [True, False])
def test_the_summary_tells_whether_the_extended_fit_converged(fitted, converged):
    """Fails if identify's fit alone is asked, or the extended model's status is lost on the way."""
    last = replace(fitted, fit=replace(fitted.fit, converged=converged, status="Maximum_Iterations_Exceeded"))
    first = Linearisation.at(fitted, ()).screened(np.random.default_rng(1))
    found = Diagnosis(fitted, first, last, last, (), (), None, Catalogue((), {}), 0.01)
    extended = SimpleNamespace(
        device=(), alternatives=(), model=fitted.model, discrepancy=last.noise.discrepancy, errors=last.errors,
        intraclass=0.0, noise_known=True,
    )  # fmt: skip
    told = diagnosis_summary(found, SimpleNamespace(device=[SimpleNamespace(sigma=3e-5)]), extended)
    assert (told.converged, told.solver.status) == (converged, "Maximum_Iterations_Exceeded")
