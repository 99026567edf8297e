"""Calibrated robots that several files ask."""

from __future__ import annotations

import numpy as np
import pytest

import calflow as cf
from calflow.sampling.posterior import Posterior
from sampling.calibrations import SMALL, Case, sampled


@pytest.fixture(scope="session")
def small_robots() -> list[tuple[Case, cf.Calibration, Posterior, np.random.Generator]]:
    """Nine robots of three joints, calibrated and sampled; each with the generator that drew it."""
    found = []
    for number in range(9):
        rng = np.random.default_rng([31, number])
        case = Case.drawn(SMALL, rng)
        found.append((case, *sampled(case, rng, steps=50), rng))
    return found
