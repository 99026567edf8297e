"""Calibrated robots that several files ask."""

from __future__ import annotations

import numpy as np
import pytest

import calflow as cf
from calflow.estimation.fit import fit
from calflow.estimation.progress import draws
from calflow.model import build
from calflow.sampling.chain import ChainLength
from calflow.sampling.posterior import Posterior
from calflow.sampling.sample import sample
from estimation.data import calibration, drawn_truth, measured, problem
from robots import industrial
from sampling.calibrations import SMALL, Case, sampled


@pytest.fixture(scope="session")
def small_robots() -> list[tuple[Case, cf.Calibration, Posterior, np.random.Generator]]:
    """Five robots of three joints, calibrated and sampled; each with the generator that drew it."""
    found = []
    for number in range(5):
        rng = np.random.default_rng([31, number])
        case = Case.drawn(SMALL, rng)
        found.append((case, *sampled(case, rng, steps=50), rng))
    return found


@pytest.fixture(scope="session")
def arm(tmp_path_factory) -> Posterior:
    """The sampled posterior of an industrial arm with its compliances, the upright first joint's at its bound."""
    rng = np.random.default_rng(14)
    model = build(industrial(), ("geometry", "joint-compliance"))
    data = measured(model, drawn_truth(model, rng), 50, rng)
    found, _ = fit(problem(model, data))
    known = calibration(found.model, found.estimate, found.covariance, source="repeats", at_bound=found.at_bound)
    path = tmp_path_factory.mktemp("arm") / "chain.h5"
    return sample(known, data, path, ChainLength(max_steps=150), rng=draws(14))
