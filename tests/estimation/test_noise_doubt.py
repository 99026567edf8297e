"""A stated noise that the measurements contradict is told, either way, and one that they do not is not."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.identification import fit_effects
from calflow.estimation.lack_of_fit import NoiseDoubt, doubts_of_repeats
from calflow.model import build
from estimation.data import SIGMA, measured
from robots import industrial


def repeated(stated, seed=61, poses=40, repeats=3):
    """Repeats of the nominal robot with a stated noise, and their errors."""
    model = build(industrial(), ("geometry",))
    rng = np.random.default_rng(seed)
    data = measured(model, model.nominal, poses, rng, repeats=repeats)
    data.table["sigma"] = stated
    return data, model.position(model.nominal, data.conditions) - data.position


@pytest.mark.parametrize("times", [1000.0, 2.0, 0.5, 0.02])
def test_repeats_contradict_a_stated_noise(times):
    """Fails if a noise that is too large or too small by a factor is believed without a word."""
    data, error = repeated(times * SIGMA)
    (doubt,) = doubts_of_repeats(data, error, (False,))
    assert doubt.times == pytest.approx(max(times, 1 / times), rel=0.2)
    assert f"too {'large' if times > 1 else 'small'}" in doubt.statement
    assert doubt.shown == pytest.approx(1e3 * SIGMA, rel=0.2)
    assert not doubt.useless


def test_a_right_noise_is_not_doubted():
    """Fails if repeats of a well stated noise raise doubts more often than promised."""
    for seed in range(10):
        assert not doubts_of_repeats(*repeated(SIGMA, seed, 30), (True,))


def test_a_fit_that_leaves_far_less_contradicts_a_stated_noise():
    """Fails if a sigma a hundred times too large passes where nothing was repeated, or a right one is doubted."""
    told = []
    for times in (1.0, 100.0):
        data, _ = repeated(times * SIGMA, repeats=1)
        found = fit_effects(data, ("geometry",), starts=1)
        told.append(found.summary.noise_doubts)
    assert told[0] == ()
    (doubt,) = told[1]
    assert doubt.shown_by == "residuals"
    assert doubt.times > 10
    assert doubt.useless


def test_words_say_what_is_wrong_and_what_was_done():
    """Fails if the sentence lacks its figures, its direction or what the fit used."""
    doubt = NoiseDoubt(series="left", unit="mm", stated=40.0, shown=0.04, shown_by="repeats", believed=False, p=0.0)
    assert doubt.words == (
        "The stated noise of left, 40 mm per axis, is 1,000 times too large: repeats of one pose scatter by 0.04 mm. "
        "Correct sigma. The fit used the repeats' instead."
    )
