"""What is found stays beside what nobody can name, unless that explains it better."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.search.acceptance import Acceptance
from calflow.diagnosis.search.decoys import JointField
from calflow.diagnosis.search.extension import Extended
from calflow.diagnosis.search.linearisation import Linearisation
from calflow.diagnosis.search.narrowing import narrowed
from calflow.effects.cause import Cause
from diagnosis.found import cause, hidden, start
from robots import industrial

GATE = Acceptance(0.01, 4)
FIELD = Cause(industrial(), JointField(industrial(), (1,)), "joint2")
WAVES = (0.0, 0.0, 0.0, 0.0, 3e-4, -2e-4, 2e-4, 3e-4, 0.0, 0.0, 0.0, 0.0)


def extended(begun, catalogue, *causes):
    """A model in which these causes were found."""
    first = Linearisation.at(begun, catalogue).screened(np.random.default_rng(1))
    path = tuple(begun.with_causes(causes[: k + 1]) for k in range(len(causes)))
    return Extended(path[-1], tuple(Linearisation.at(path[-1], catalogue).findings(first.family)), path, first)


def narrow(values, *causes):
    """Narrow a model with these causes, fitted to data of others, beside a field over the angle of joint 2."""
    begun = start(hidden(values))
    catalogue = Catalogue.of(begun.data, ("geometry",), ("joint-eccentricity", "gear-ratio-error"))
    found = extended(begun, catalogue, *causes)
    return found, narrowed(begun, found, [FIELD], catalogue, GATE)


def test_a_makeshift_for_what_nobody_can_name_goes():
    """Breaks if a cause is named that stands only because a field over the same joint is not in the catalogue."""
    wrong, right = cause("joint-eccentricity", "joint2", order=2), cause("gear-ratio-error", "joint3")
    found, left = narrow([(FIELD, WAVES), (right, (8e-4,))], wrong, right)
    assert [finding.cause for finding in found.findings] == [wrong, right]
    assert [finding.cause for finding in left.findings] == [right]
    assert left.path[-1] is left.fitted
    assert left.fitted.fit.estimate[-1] == pytest.approx(8e-4, abs=2e-4)


def test_a_right_cause_stays_beside_a_field_that_could_imitate_it():
    """Breaks if a cause goes because something without a meaning explains it no better."""
    right = cause("joint-eccentricity", "joint2", order=2)
    found, left = narrow([(right, (3e-4, -2e-4))], right)
    assert left is found
