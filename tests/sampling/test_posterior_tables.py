"""What a chain says of measured rows holds the choice of the model."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calflow.estimation.calibrated_model import Alternative, CalibratedModel, SeriesNoise
from calflow.estimation.error_model import ErrorModel
from calflow.estimation.noise import PerUnit
from calflow.sampling.posterior import predictive_table
from diagnosis.found import cause, hidden, start
from estimation.data import SIGMA

ECCENTRIC = cause("joint-eccentricity", "joint2", order=1)


def interval(known, data):
    """The mean upper end of the intervals, of a chain that stays at the estimate."""
    values = np.tile([*known.estimate, 0.0], (2, 10, 8, 1))
    sampled = SimpleNamespace(points=values, calibrated=known, data=data)
    return predictive_table(sampled, np.random.default_rng(1))["high_mm"].mean()


def test_rivals_of_several_causes_may_all_be_likely():
    """Fails if alternatives whose probabilities add up to more than one end the stage, or leave the intervals as they are."""
    final = start(hidden([(ECCENTRIC, (4e-4, -2e-4))])).with_causes([ECCENTRIC])
    fit, data = final.fit, final.data
    noise = (SeriesNoise(SIGMA, "repeats"),)
    known = CalibratedModel(
        fit.model, fit.estimate, fit.covariance, fit.at_bound, noise, PerUnit(), "linear", final.errors
    )
    bare = replace(fit.model, effects=final.plain)
    other = Alternative(bare, fit.estimate[: len(bare.parameters)], 0.6)
    assert interval(replace(known, alternatives=(other, other)), data) > 1.5 * interval(known, data)


def test_what_smooth_errors_leave_is_expected_of_poses_held_out():
    """Fails if held-out rows are promised the device's noise alone, or fitted ones what is to be expected elsewhere."""
    final = start(hidden([(ECCENTRIC, (4e-4, -2e-4))])).with_causes([ECCENTRIC])
    fit, noise = final.fit, (SeriesNoise(SIGMA, "repeats"),)
    known = CalibratedModel(
        fit.model, fit.estimate, fit.covariance, fit.at_bound, noise, PerUnit(), "linear", final.errors
    )
    known = replace(known, errors=ErrorModel.white(0.0, len(fit.estimate)))
    wide = replace(known, errors=ErrorModel.white(3 * SIGMA, len(fit.estimate)))
    kept = final.data
    apart = replace(kept, table=kept.table.assign(split="holdout"))
    assert interval(wide, kept) == interval(known, kept)
    assert interval(wide, apart) == pytest.approx(np.sqrt(10) * interval(known, apart), rel=0.1)
