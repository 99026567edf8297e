"""A lack of fit is told with the place where it is largest, and an even one, or none, as what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.misfit import MisfitRegion, largest_misfit
from diagnosis.test_unexplained import fitted

RNG = 3


def rng():
    """The same draws each time."""
    return np.random.default_rng(RNG)


def test_what_the_noise_explains_is_no_misfit():
    """Fails if a model that leaves its noise is said to lack something."""
    assert not fitted().lacks_fit


def rough(where, size=4e-4):
    """A shift that no smooth function describes, of rows that a function of the table picks."""

    def shift(table):
        own = np.random.default_rng(12).standard_normal((len(table), 3))
        return size * own * np.asarray(where(table), dtype=float)[:, None]

    return shift


@pytest.mark.parametrize(
    ("where", "name"),
    [
        (lambda t: (t["q3"] > np.quantile(t["q3"], 0.5)) & (t["q3"] < np.quantile(t["q3"], 0.75)), "q3"),
        (lambda t: t["time"] > np.quantile(t["time"], 0.75), "time"),
    ],
)
def test_a_misfit_is_told_with_where_it_is_largest(where, name):
    """Fails if the lack of fit is silent, or put down to another place than the one where it is."""
    model = fitted(rough(where))
    assert model.lacks_fit
    assert (model.lack.p < 1e-6, model.lack.reduced_chi2 > 1.7) == (True, True)
    region = largest_misfit(model, rng())
    assert region.input == name
    assert region.there > 3 * region.elsewhere


def test_an_even_misfit_has_no_place():
    """Fails if chance is told as a place: errors that are alike everywhere have none."""
    even = fitted(rough(lambda t: t["q1"] == t["q1"], 2e-4))
    assert even.lacks_fit
    places = [largest_misfit(fitted(rough(lambda t: t["q1"] == t["q1"], 2e-4), seed=seed), rng()) for seed in range(8)]
    assert sum(place is not None for place in places) <= 2


def test_a_misfit_is_told_along_what_unexplained_structure_depends_on():
    """Fails if an error that depends on joint 3 is said to be largest in a range of another input, or has none."""
    model = fitted(rough(lambda t: (t["q3"] > np.quantile(t["q3"], 0.5)) & (t["q3"] < np.quantile(t["q3"], 0.75))))
    assert largest_misfit(model, rng(), {"q3"}).input == "q3"
    for along in ({"q1"}, {"tau1"}):
        region = largest_misfit(model, rng(), along)
        assert region is None or region.input in along


def test_one_of_several_payloads_or_markers_is_named():
    """Fails if only ranges are looked at."""
    labels = np.where(np.arange(100) % 3 == 1, "full", "none")
    data = fitted(rough(lambda t: labels == "full"))
    data.data.table["payload"] = labels
    found = largest_misfit(data, rng())
    assert (found.input, found.value) == ("payload", "full")
    assert found.where == "payload is full"


@pytest.mark.parametrize("rougher", [0.4, 0.7])
def test_a_session_of_other_noise_is_named(rougher):
    """Fails if a day on which the device scattered more is told as a range of places in measuring order, or not if it was long."""
    days = np.where(np.arange(100) < 100 * (1 - rougher), "mon", "tue")
    data = fitted(rough(lambda t: days == "tue"))
    data.data.table["session"] = days
    found = largest_misfit(data, rng())
    assert (found.input, found.value, found.is_of_measuring) == ("session", "tue", True)
    assert found.where == "the session is tue"


def test_a_region_is_told_in_words():
    """Fails if a place is told without its unit, its figures or its joint."""
    there = MisfitRegion(input="q3", low=20.3, high=44.8, unit="deg", error_unit="mm", there=0.2134, elsewhere=0.0811)
    assert there.words == "largest where joint 3 is between 20 and 45 deg: 0.213 mm against 0.0811 mm elsewhere"


def test_a_joint_that_stood_still_is_no_place():
    """Fails if an input of one value, which has no regions, ends the diagnosis."""
    known = fitted(rough(lambda t: t["time"] > np.quantile(t["time"], 0.75)))
    table = known.data.table.assign(q6=0.3)
    still = replace(known, data=replace(known.data, table=table))
    found = largest_misfit(still, rng())
    assert found is None or found.input != "q6"
