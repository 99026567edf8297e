"""Models in reach: how probable they are, the tables that say so, and draws of a model other than the one that was found."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.effects import catalogue
from calflow.effects.base import Cause
from calflow.estimation.calibrated_model import ModelInReach
from calflow.estimation.fit import fit
from calflow.model import Model
from calflow.sampling.models import cause_table, drawn, models_table, probabilities
from estimation.data import calibration, measured, problem
from robots import robot

JOINTS = [
    {"alpha_deg": 90, "a_m": 0.0, "d_m": 0.3, "limits_deg": (-90, 90), "mass_kg": 20.0, "com_m": (0, 0, 0)},
    {"alpha_deg": 0, "a_m": 0.6, "d_m": 0.0, "limits_deg": (-60, 60), "mass_kg": 15.0, "com_m": (-0.3, 0, 0)},
    {"alpha_deg": 0, "a_m": 0.5, "d_m": 0.0, "limits_deg": (-90, 90), "mass_kg": 10.0, "com_m": (-0.2, 0, 0)},
]
ARM = robot("dh", JOINTS)


def cause(name, part, **variant):
    """A cause of the arm."""
    return Cause(ARM, catalogue()[name](ARM, **variant), part)


BASE, RATIO = cause("gear-ratio-error", "joint1"), cause("gear-ratio-error", "joint2")
STIFF, SECOND = cause("nonlinear-joint-stiffness", "joint2"), cause("nonlinear-joint-stiffness", "joint2", knee=0.2)
FOUND = ModelInReach((RATIO,), "found", -2.0, 0.0)
REACHED = (
    FOUND,
    ModelInReach((BASE,), "instead", -2.0, np.log(0.5)),
    ModelInReach((RATIO, SECOND), "besides", -4.0, np.log(0.25)),
    ModelInReach((), "without", 0.0, np.log(0.25)),
)


def test_a_cause_is_as_probable_as_the_models_that_have_it():
    """Fails if weights are not shares of all models, a place's forms count apart, or what was found is not marked."""
    np.testing.assert_allclose(probabilities(REACHED), [0.5, 0.25, 0.125, 0.125])
    causes = cause_table(REACHED).set_index(["cause", "part"])
    assert causes["probability"].to_dict() == pytest.approx({
        ("gear-ratio-error", "joint2"): 0.625, ("gear-ratio-error", "joint1"): 0.25,
        ("nonlinear-joint-stiffness", "joint2"): 0.125,
    })  # fmt: skip
    assert causes["found"].tolist() == [True, False, False]
    table = models_table(REACHED).set_index("model")
    assert (table["probability"].diff().dropna() <= 0).all()
    assert table.loc[3, "log_evidence"] == pytest.approx(np.log(0.25) + 2.0)
    assert table.loc[4, "log_evidence"] == pytest.approx(np.log(0.25) - 2.0)


def test_nothing_in_reach_is_nothing_to_tell():
    """Fails if a study in which diagnose found nothing ends the stage, or lists models."""
    assert len(probabilities(())) == 0
    assert models_table(()).empty
    assert cause_table(()).empty


@pytest.mark.parametrize(("other", "hidden"), [(RATIO, 2e-4), (STIFF, 2e-5), (SECOND, 0.0)])
def test_draws_of_another_model_are_of_its_own_fit(other, hidden):
    """Fails if draws keep the estimate of what was found, are too narrow, or leave the bounds.

    The second form of the stiffness is one-sided: with nothing hidden its posterior ends at the bound.
    """
    given = measured(Model(ARM, (other,)), np.array([hidden]), 15, np.random.default_rng(1))
    begin = problem(Model(ARM, (BASE,)), given)
    found, _ = fit(begin)
    known = calibration(begin.model, found.estimate, found.covariance, at_bound=found.at_bound)
    model, values = drawn(known, (other,), begin, 4000, np.random.default_rng(3))
    assert model.effects == (other,)
    lower, upper = model.bounds[0]
    assert ((values[:, 0] >= lower) & (values[:, 0] <= upper)).all()
    own, _ = fit(begin.on(model))
    if not own.at_bound.any():
        assert values[:, 0].mean() == pytest.approx(own.estimate[0], abs=0.1 * values[:, 0].std())
        assert values[:, 0].std() == pytest.approx(np.sqrt(own.covariance[0, 0]), rel=0.2)
    assert abs(values[:, 1].mean()) < 0.3
