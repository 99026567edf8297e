"""A cause's amplitude is as sure as all forms of it that explain the data leave it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calflow.diagnosis.amplitude import Amplitude, amplitude, found_amplitude, same_quantities
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.trial import Linearisation
from calflow.diagnosis.verdict import no_surer_than_its_size, verdict
from diagnosis.found import cause, hidden, start

FIRST, SECOND = (cause("joint-eccentricity", "joint2", order=order) for order in (1, 2))


@pytest.fixture(scope="module")
def fitted():
    """A model with a joint that runs out of true twice a turn, found as such."""
    begun = start(hidden([(SECOND, (3e-4, -2e-4))]))
    return begun.with_causes([SECOND])


@pytest.fixture(scope="module")
def finding(fitted):
    """The finding, with its other order."""
    linearisation = Linearisation.at(fitted, Catalogue.of(fitted.data, ("geometry",), ("joint-eccentricity",)).effects)
    return linearisation.finding(linearisation.causes[0], linearisation.screened(np.random.default_rng(1)).family)


def with_evidence(finding, change):
    """The finding with the first order's cost set beside that of the second."""
    scores = [
        replace(score, cost=finding.own.cost + change) if score.cause.place == SECOND.place
        and score.cause.detail == FIRST.detail else score
        for score in finding.scores
    ]  # fmt: skip
    return replace(finding, scores=tuple(scores))


def test_the_figure_of_two_waves_is_their_length(fitted):
    """Breaks if the spread of a length is not that of a linear combination at its estimate."""
    own = fitted.model.columns(SECOND)
    values, covariance = fitted.fit.estimate[own], fitted.fit.covariance[np.ix_(own, own)]
    size, sd = amplitude(SECOND, values, covariance)
    drawn = np.random.default_rng(2).multivariate_normal(values, covariance, 20000)
    assert size == pytest.approx(np.hypot(3e-4, 2e-4), abs=4 * sd)
    assert sd == pytest.approx(np.linalg.norm(drawn, axis=1).std(), rel=0.03)


def test_one_form_alone_is_as_sure_as_its_fit(fitted, finding):
    """Breaks if forms that the data exclude widen the interval."""
    own = fitted.model.columns(SECOND)
    alone = amplitude(SECOND, fitted.fit.estimate[own], fitted.fit.covariance[np.ix_(own, own)])
    size = found_amplitude(finding, fitted)
    assert (size.estimate, size.sd) == pytest.approx(alone, rel=1e-6)
    assert (size.low, size.high) == pytest.approx(alone[0] + 1.96 * alone[1] * np.array([-1, 1]), abs=0.15 * alone[1])


def test_two_forms_alike_leave_the_amplitude_open(fitted, finding):
    """Breaks if the amplitude of the better of two orders is told as if the other were excluded."""
    even = with_evidence(finding, 0.0)
    other = next(s for s in even.scores if s.cause.place == SECOND.place and s.cause.detail == FIRST.detail)
    told, alone = found_amplitude(even, fitted), found_amplitude(finding, fitted)
    size, spread = amplitude(other.cause, other.estimate, other.covariance)
    assert told.sd**2 == pytest.approx((alone.sd**2 + spread**2 + (size - told.estimate) ** 2) / 2, rel=1e-6)
    assert told.sd > found_amplitude(with_evidence(finding, 6.0), fitted).sd > alone.sd


def test_a_size_that_cannot_be_zero_is_not_said_to_be_perhaps_zero(fitted, finding):
    """Breaks if two forms of different lengths, or a length that the data hardly show, count as normal about the estimate."""
    even = with_evidence(finding, 0.0)
    far = [
        replace(score, estimate=100 * score.estimate) if score.cause.detail == FIRST.detail else score
        for score in even.scores
    ]
    told = found_amplitude(replace(even, scores=tuple(far)), fitted)
    (other,) = (s for s in far if s.cause.place == SECOND.place and s.cause.detail == FIRST.detail)
    assert told.estimate - 1.96 * told.sd < 0 < told.low < told.estimate < told.high
    assert not told.differs_from_zero  # by its deviation: it is held against poses that were left out
    assert told.low == pytest.approx(told.estimate, rel=0.2)
    assert told.high == pytest.approx(amplitude(other.cause, other.estimate, other.covariance)[0], rel=0.2)
    curve = Amplitude.of_squares(3e-4, 2e-4)
    drawn = curve.estimate * np.sqrt(np.random.default_rng(3).chisquare(9 / 8, 100_000) / (9 / 8))
    assert (curve.low, curve.high) == pytest.approx(np.quantile(drawn, [0.025, 0.975]), rel=0.05)


def test_a_cause_at_its_bound_has_no_spread(fitted, finding):
    """Breaks if other forms lend a deviation to a value that a bound has stopped, or count that mean another quantity."""
    model = fitted.model
    bounded = replace(fitted, fit=replace(fitted.fit, estimate=np.where(np.isin(np.arange(len(model.parameters)),
                      model.columns(SECOND)), model.bounds[:, 1], fitted.fit.estimate)))  # fmt: skip
    assert found_amplitude(with_evidence(finding, 0.0), bounded).sd == 0
    knee, cubic = (
        cause("nonlinear-joint-stiffness", "joint2", law="knee", knee=0.3),
        cause("nonlinear-joint-stiffness", "joint2"),
    )
    assert not same_quantities(knee, cubic)
    assert same_quantities(FIRST, SECOND)


@pytest.mark.parametrize(("distance", "doubted"), [(1.0, True), (9.0, True), (11.0, False)])
def test_a_cause_is_no_surer_than_its_size(fitted, finding, distance, doubted):
    """Breaks if a cause is called certain, or more probable than its size is unlike zero, where smooth errors may be all of it."""
    own = fitted.model.columns(SECOND)
    value, covariance = fitted.fit.estimate[own], fitted.covariance
    wider = value @ np.linalg.solve(covariance[np.ix_(own, own)], value) / distance
    told = no_surer_than_its_size(
        finding, SimpleNamespace(model=fitted.model, fit=fitted.fit, covariance=wider * covariance)
    )
    sized, before = verdict(told), verdict(finding)
    assert ("unexplained" in [rival.id for rival in sized.rivals]) == doubted
    assert sized.probability <= min(before.probability, 1 / (1 + np.exp(-distance / 2)))
    assert sized.probability == pytest.approx(1 / (1 / before.probability + np.exp(-distance / 2)), rel=0.01)
    assert no_surer_than_its_size(replace(finding, unnamed=-1.0), fitted).unnamed == -1.0
