"""Models in reach: how probable they are, and the tables that say so."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.cause_tables import cause_table, models_table
from calflow.diagnosis.models_in_reach import ModelInReach, probabilities
from calflow.effects import catalogue
from calflow.effects.cause import Cause
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
SECOND = cause("nonlinear-joint-stiffness", "joint2", law="knee", knee=0.2)
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
