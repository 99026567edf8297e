"""What a chain says of measured rows holds the choice of the model."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from calflow.estimation.calibrated_model import Alternative, CalibratedModel, SeriesNoise
from calflow.estimation.error_model import ErrorModel
from calflow.estimation.noise import PerUnit
from calflow.files.units import METRE
from calflow.sampling.posterior import Posterior, predictive_table
from diagnosis.found import cause, hidden, start
from estimation.data import SIGMA

ECCENTRIC = cause("joint-eccentricity", "joint2", order=1)


def calibrated():
    """A model with an eccentricity that is there, and its data."""
    final = start(hidden([(ECCENTRIC, (4e-4, -2e-4))])).with_causes([ECCENTRIC])
    fit, noise = final.fit, (SeriesNoise(SIGMA, "repeats", SIGMA),)
    model = CalibratedModel(
        fit.model, fit.estimate, fit.covariance, fit.at_bound, noise, PerUnit(), "linear", final.errors
    )
    return model, final.data


def predicted(known, data, off=0.0):
    """The table of a chain that stays at the estimate, or each of whose 500 draws (2, 10, 25, n_parameters) is so far off."""
    values = np.tile([*known.estimate, 0.0], (2, 10, 25, 1))
    values[..., :-1] += off
    sampled = SimpleNamespace(points=values, calibrated=known, data=data)
    sampled.drawn = partial(Posterior.drawn, sampled)
    return predictive_table(sampled, np.random.default_rng(1))


def interval(known, data):
    """The mean upper end of the intervals, of a chain that stays at the estimate."""
    return predicted(known, data)["high_mm"].mean()


def test_rivals_of_several_causes_may_all_be_likely():
    """Fails if alternatives whose probabilities add up to more than one end the stage, or leave the intervals as they are."""
    known, data = calibrated()
    bare = replace(known.model, effects=tuple(e for e in known.model.effects if e != ECCENTRIC))
    other = Alternative(bare, known.estimate[: len(bare.parameters)], 0.6)
    assert interval(replace(known, alternatives=(other, other)), data) > 1.5 * interval(known, data)


def test_what_smooth_errors_leave_is_expected_of_poses_held_out():
    """Fails if held-out rows are promised the device's noise alone, or fitted ones what is to be expected elsewhere."""
    known, kept = calibrated()
    known = replace(known, errors=ErrorModel.white(PerUnit(), len(known.estimate)))
    wide = replace(known, errors=ErrorModel.white(PerUnit(((METRE, 3 * SIGMA),)), len(known.estimate)))
    apart = replace(kept, table=kept.table.assign(split="holdout"))
    assert interval(wide, kept) == interval(known, kept)
    assert interval(wide, apart) == pytest.approx(np.sqrt(10) * interval(known, apart), rel=0.1)


@pytest.mark.parametrize("share", [0.0, 0.35])
def test_intervals_end_where_the_law_of_draws_and_noise_says(share):
    """Fails if ends depend on which noise was drawn: three normal axes are as far off as chi has it, of their variances' sum."""
    known, data = calibrated()
    draws = np.random.default_rng(2).standard_normal((500, 3))
    draws -= draws.mean(axis=0)
    draws = draws @ np.linalg.inv(np.linalg.cholesky(draws.T @ draws / 500)).T
    off = np.zeros((500, len(known.estimate)))
    off[:, [[p.name for p in known.model.parameters].index(f"base.{axis}") for axis in "xyz"]] = share * SIGMA * draws
    ends = predicted(known, data, off.reshape(2, 10, 25, -1))[["low_mm", "expected_mm", "high_mm"]]
    law = 1e3 * SIGMA * np.sqrt(1 + share**2) * scipy.stats.chi(3).ppf([0.025, 0.5, 0.975])
    np.testing.assert_allclose(ends, np.tile(law, (len(ends), 1)), rtol=0.01)
