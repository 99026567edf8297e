"""Simulated causes of a size are detected as often as their detection limit promises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.amplitude import amplitude
from calflow.diagnosis.cause_tables import detection_limits, noncentrality
from calflow.diagnosis.regressors import Candidate, Regressors, TallMatrix
from calflow.diagnosis.screening import Family, Screening, f_threshold
from calflow.diagnosis.stepwise import CauseAcceptance
from calflow.diagnosis.trial import Screened
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from diagnosis.test_screening import with_residual
from robots import industrial

ROBOT = industrial()
ACCEPTANCE = CauseAcceptance(0.01, 10)
CAUSES = {
    "one figure": ("gear-ratio-error", {}, "joint1"),
    "a wave": ("joint-eccentricity", {}, "joint2"),
    "a size that is a sum, of two figures that cannot be negative": ("tool-sag", {}, "tool"),
    "six figures": ("tool-sag", {"shape": "symmetric"}, "tool"),
}


def regressors(cause: Cause, rows: int) -> Regressors:
    """Random ones of a cause, of whose figures the data show one ten times better than another."""
    rng = np.random.default_rng(1)
    sd = np.array([parameter.prior_sd for parameter in cause.declared])
    matrix = rng.standard_normal((rows, len(sd))) * np.geomspace(1.0, 0.1, len(sd)) / sd
    candidate = Candidate(cause, np.arange(len(sd)))
    jacobian, precision = rng.standard_normal((rows, 5)), np.full(5, 0.1)
    return Regressors(np.zeros(rows), jacobian, precision, np.zeros(5), 0.0, TallMatrix.held(matrix), sd, (candidate,))


def replaced(problem: Regressors, residual: np.ndarray) -> Regressors:
    """The same problem with another residual, which its own parameters have settled on."""
    along = problem.jacobian.T
    step = np.linalg.solve(along @ problem.jacobian + np.diag(problem.precision), along @ residual)
    pull = -problem.precision * step
    rest = residual - problem.jacobian @ step
    return with_residual(problem, rest, pull=pull, prior_rss=float((pull**2 / problem.precision).sum()))


@pytest.mark.parametrize(("rows", "name"), [(300, name) for name in CAUSES] + [(6000, "one figure")])
def test_a_cause_at_its_detection_limit_is_found_95_times_in_100(name: str, rows: int) -> None:
    """Breaks if the limit forgets the number of tests, the degrees of freedom, the prior's units or the material share."""
    effect, variant, part = CAUSES[name]
    cause, family, draws = Cause(ROBOT, catalogue()[effect](ROBOT, **variant), part), Family({}, 30.0), 400
    problem, rng = regressors(cause, rows), np.random.default_rng(3)
    at_rest = Screening.of(replace(problem, residual=rng.standard_normal(rows)))
    screened = Screened(tuple(at_rest.scores), family, at_rest.degrees_of_freedom)
    (limit,) = detection_limits(screened.scores, screened, ACCEPTANCE.false_alarm, rng)
    found = 0
    for _ in range(draws):
        values = rng.standard_normal(len(cause.declared)) * problem.prior_sd
        values = np.where(cause.bounds[0] == 0, np.abs(values), values)
        values *= limit / abs(amplitude(cause, values, np.eye(len(values)))[0])
        residual = rng.standard_normal(rows) - problem.matrix.times(values)  # of the model, less what is measured
        found += ACCEPTANCE.accepts(Screening.of(replaced(problem, residual)).scores[0], family)
    assert 0.91 < found / draws < 0.985


def test_the_power_of_an_f_test_is_that_of_textbooks() -> None:
    """Breaks if one test of one figure among many rows needs other than 2.58 + 1.64 standard deviations."""
    assert np.isnan(noncentrality(f_threshold(0.01, 1e4, 1, 1.0), 1, 1.0))  # too few rows to show anything
    assert noncentrality(f_threshold(0.01, 1.0, 1, 1e6), 1, 1e6) == pytest.approx((2.5758 + 1.6449) ** 2, rel=1e-3)
