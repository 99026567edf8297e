"""What a position is said to be certain to holds all that the model is known to err by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.estimation.error_model import ErrorModel
from calflow.estimation.identification import fit_effects
from calflow.estimation.noise import PerUnit
from calflow.files.units import METRE
from calflow.model import build
from estimation.data import SIGMA, measured
from robots import industrial


@pytest.fixture(scope="module")
def data():
    """Poses of the nominal robot whose points are off by 0.2 mm that nothing explains."""
    model = build(industrial(), ("geometry",))
    rng = np.random.default_rng(71)
    data = measured(model, model.nominal, 120, rng)
    data.table[["x", "y", "z"]] += 2e-4 * rng.standard_normal((120, 3))
    return data


def test_what_the_model_leaves_is_in_its_certainty(data):
    """Fails if positions are said to be certain to the parameters alone where the fit leaves ten times the noise."""
    known = fit_effects(replace(data, table=data.table.assign(sigma=SIGMA)), ("geometry",), starts=1).known
    sd = np.sqrt(known.position_variance(data.conditions))
    assert known.discrepancy[METRE] == pytest.approx(2e-4, rel=0.2)
    assert np.sqrt((sd**2).mean()) > 0.95 * known.discrepancy[METRE]  # what is smooth in it is not alike everywhere
    assert (sd > 0.9 * known.discrepancy[METRE]).all()
    assert (sd < 2 * known.discrepancy[METRE]).all()


def test_a_noise_that_only_the_fit_tells_is_in_it_too(data):
    """Fails if an incomplete model looks certain because its errors pass for noise."""
    known = fit_effects(data, ("geometry",), starts=1).known
    assert (np.sqrt(known.position_variance(data.conditions)) > 1.5e-4).all()


def test_a_gain_is_certain_where_the_correction_is_told_whatever_else_is_not(data):
    """Fails if what neither robot knows (a height, say) denies a gain along what was measured, or a doubtful one is certain."""
    known = fit_effects(replace(data, table=data.table.assign(sigma=SIGMA)), ("geometry",), starts=1).known
    names = [parameter.name for parameter in known.model.parameters]
    x, z = names.index("base.x"), names.index("base.z")
    moved = np.where(np.arange(len(names)) == x, 1e-3, 0.0)
    for sd, certain in ((3e-4, True), (4e-4, False)):  # half the correction is 1.645 times 0.304 mm
        variance = np.zeros(len(names))
        variance[[x, z]] = sd**2, 0.02**2  # the height is as open as before
        told = replace(
            known, estimate=moved, covariance=np.diag(variance), errors=ErrorModel.white(PerUnit(), len(names))
        )
        assert (told.gain_is_certain(data.conditions) == certain).all()
