"""A cause's form is a guess: what another form of it would explain is no second cause."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.regressors import FORM, form_errors
from calflow.diagnosis.screening import Screening
from diagnosis.found import cause, hidden, start

FIRST, LARGE = cause("joint-eccentricity", "joint2", order=1), (2e-3, -1.5e-3)


def cost(regressors):
    """Twice minus the logarithm of the only candidate's evidence."""
    (score,) = Screening(regressors).scores
    return score.cost


@pytest.mark.parametrize("joint", [0, 1, 3])
def test_forms_differ_by_a_share_of_what_the_cause_does(joint):
    """Fails if a form error is of another size anywhere, or is there where its cause does nothing."""
    acting = np.array([[2.0], [0.0], [-3.0]])
    errors = form_errors(acting, np.random.default_rng(1).uniform(-3, 3, (3, 4)), joint)
    assert np.linalg.norm(errors, axis=1) == pytest.approx(FORM * np.abs(acting[:, 0]))


@pytest.mark.parametrize(("second", "size", "stands"), [
    (cause("joint-eccentricity", "joint2", order=2), (1e-4, 5e-5), False),
    (cause("joint-eccentricity", "joint4", order=2), (3e-4, 2e-4), True),
])  # fmt: skip
def test_another_form_is_no_second_cause(second, size, stands):
    """Fails if a twentieth of a large cause in another shape is a second name, or a cause elsewhere gives way to form errors."""
    known = start(hidden([(FIRST, LARGE), (second, size)])).with_causes([FIRST])
    assert cost(known.independent([second])) < -20
    assert (cost(known.regressors([second])) < -20) == stands
