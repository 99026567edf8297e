"""The catalogue knows what some data could not test, and what that may be behind."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.screening import Catalogue
from calflow.effects import catalogue
from calflow.model import build
from estimation.data import measured
from robots import industrial


@pytest.fixture(scope="module")
def bare():
    """Poses without a clock, a thermometer, or the sides that joints came from."""
    model = build(industrial(), ("geometry",))
    return Catalogue.of(measured(model, model.nominal, 20, np.random.default_rng(1)), ["geometry"])


@pytest.mark.parametrize(
    ("cause", "untestable"),
    [
        ("frame-drift", {"thermal-growth", "housing-growth"}),
        ("torque-backlash", {"joint-backlash"}),
        ("joint-eccentricity", set()),
        ("gear-ratio-error", set()),
        ("frame-step", set()),
    ],
)
def test_untestable_causes_stand_beside_what_they_may_be_behind(bare, cause, untestable):
    """Fails if what nobody could test is excluded, or is held against causes that it does not resemble."""
    found = bare.untestable(cause)
    assert set(found) == untestable
    assert all(found.values())


def test_effects_name_causes_that_there_are():
    """Fails if an effect is renamed and another still refers to it."""
    for kind in catalogue().values():
        assert set(kind.taken_for) | set(kind.alike) <= set(catalogue())
