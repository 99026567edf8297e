"""A cause as large as its detection limit, by the figure that findings state, is found as often as promised."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from calflow.diagnosis.amplitude import amplitude
from calflow.diagnosis.cause_tables import detection_limits
from calflow.diagnosis.regressors import Candidate
from calflow.diagnosis.screening import Family, Score
from calflow.diagnosis.trial import Screened
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.measurements.measurements import Measurements
from effects.bench import UNSHOWN, waves

FAMILY, ALARM, LEFT = Family({}, 30.0), 0.01, 400.0
DRAWS = 400


def drawn(cause: Cause, limit: float, rng: np.random.Generator, count: int) -> np.ndarray:
    """Parameters (count, n) in proportion to draws from the priors, of causes whose stated size is the limit."""
    values = rng.standard_normal((count, len(cause.declared)))
    for k, parameter in enumerate(cause.declared):
        values[:, k] *= parameter.prior_sd
        if parameter.lower == parameter.nominal:
            values[:, k] = np.abs(values[:, k])
    if travel := cause.effect.travel(cause.joint) if cause.joint else None:
        curves = values @ waves(cause.effect, cause.joint, np.linspace(travel.low, travel.high, 400)).T
        sizes = np.sqrt((curves**2).mean(axis=1))
    else:
        sizes = np.array([abs(amplitude(cause, row, np.eye(len(row)))[0]) for row in values])
    return values * (limit / sizes)[:, None]


def scored(cause: Cause, rng: np.random.Generator) -> Score[Cause]:
    """A score whose data show some directions of the prior well and others hardly."""
    n = len(cause.declared)
    sd = np.array([parameter.prior_sd for parameter in cause.declared])
    turned = np.linalg.qr(rng.standard_normal((n, n)))[0]
    information = (turned * np.geomspace(30.0, 3.0, n)) @ turned.T / np.outer(sd, sd)
    return Score(Candidate(cause, np.arange(n)), 0.0, 0.0, 1.0, 0.0, 1.0, np.zeros(n), np.eye(n), information, n, LEFT)


@pytest.mark.parametrize("name", [name for name in catalogue() if name not in UNSHOWN])
def test_a_limit_is_of_the_size_that_findings_state(full: Measurements, name: str) -> None:
    """Breaks if a limit is of another figure of a cause's parameters than its stated size, or forgets how these vary."""
    rng = np.random.default_rng(5)
    variants = catalogue()[name].variants(full.robot, full)
    for effect in [] if catalogue()[name].is_noise() else dict.fromkeys((variants[0], variants[-1])):
        cause = Cause(full.robot, effect, list(effect.parts)[-1])
        score = scored(cause, rng)
        screened = Screened((score,), FAMILY, LEFT + score.shown)
        (limit,) = detection_limits([score], screened, ALARM, np.random.default_rng(6))
        values = drawn(cause, limit, rng, DRAWS)
        seen = np.minimum(np.einsum("ni,ij,nj->n", values, score.information, values), 1e5)
        threshold = scipy.stats.f.isf(1 - (1 - ALARM) ** (1 / 30), score.shown, LEFT)
        assert scipy.stats.ncf.sf(threshold, score.shown, LEFT, seen).mean() == pytest.approx(0.95, abs=0.03), (
            effect.detail
        )
