"""Deployed causes: a doubtful cause goes back to the robot only where it helps at poses that were left out.

What is the measuring device's goes back to no robot, and stays.
"""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from calflow.diagnosis.amplitude import Amplitude
from calflow.diagnosis.diagnosis import search_causes
from calflow.diagnosis.verdict import deployed_model
from diagnosis.found import hidden, start
from estimation.data import SIGMA, calibration

SURE, UNSURE = Amplitude(5.0, 1.0, 3.0, 7.0), Amplitude(1.0, 1.0, -1.0, 3.0)
SIZES = {"named": SURE, "vague": UNSURE, "one_of": SURE}


@pytest.fixture(autouse=True)
def _sized(monkeypatch):
    """Findings whose sizes are told."""
    monkeypatch.setattr("calflow.diagnosis.verdict.found_amplitude", lambda finding, fitted: SIZES[finding.told])


class Named(str):
    """A cause by its letter: a capital is the device's."""

    __slots__ = ()

    def of_measuring(self) -> bool:
        """Whether it is."""
        return self.isupper()


class Missing:
    """A model whose left-out poses are missed by what is said of its causes, a parameter each."""

    def __init__(self, misses: dict[str, float], causes: str) -> None:
        self.misses, self.causes = misses, causes

    @property
    def left_out(self) -> SimpleNamespace:
        """What its causes leave."""
        return SimpleNamespace(of_new_measurements=self.misses[self.causes])

    def with_causes(self, causes: list[str]) -> Missing:
        """The same robot's model with others."""
        return Missing(self.misses, "".join(causes))

    def sharing(self) -> Missing:
        """The same model where its markers share no errors."""
        return self


@pytest.mark.parametrize(
    ("told", "misses", "without", "stay"),
    [
        ({"a": "named", "b": "one_of"}, {"ab": 2.0, "a": 1.0}, 5.0, "a"),
        ({"a": "named", "b": "vague"}, {"ab": 2.0, "a": 1.0}, 5.0, "a"),
        ({"a": "named", "b": "one_of"}, {"ab": 1.0, "a": 1.2}, 0.5, "ab"),
        ({"a": "one_of", "b": "one_of"}, {"ab": 2.0, "a": 1.5}, 1.0, ""),
        ({"a": "one_of"}, {"a": 1.0}, 1.2, "a"),
        ({"a": "one_of"}, {"a": 1.0}, float("nan"), "a"),
        ({"a": "named"}, {"a": 2.0}, 1.0, "a"),
        ({"a": "named", "D": "one_of"}, {"aD": 1.0, "a": 1.0}, 5.0, "aD"),
        ({"a": "vague", "D": "vague"}, {"aD": 2.0, "a": 1.0, "D": 1.0}, 0.5, "D"),
    ],
)
def test_what_helps_nowhere_else_stays_a_suspicion(told, misses, without, stay):
    """Fails if a doubtful cause is deployed by which left-out poses are missed no less, or one that helps or is certain is not.

    One of the device is, whatever is missed.
    """
    verdicts = [
        SimpleNamespace(status=one.replace("vague", "named"), cause=Named(name), told=one) for name, one in told.items()
    ]
    used = deployed_model(Missing(misses | {"": without}, "".join(told)), verdicts)
    assert (used.causes if used else "") == stay


def test_where_nothing_was_found_the_identified_model_stays():
    """Fails if a fit of the search, which counts markers as if they shared nothing, goes to the robot for no cause."""
    data = hidden([], poses=40)
    begun = start(data)
    known = calibration(begun.model, begun.fit.estimate, begun.fit.covariance, SIGMA)
    diagnosis = search_causes(known, data, catalogue=("gear-ratio-error",))
    assert not diagnosis.verdicts
    assert diagnosis.final is None
