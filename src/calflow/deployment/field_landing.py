"""Landing beside a target by what a residual field will add: the field has no part in the model's graph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.deployment.compensation import Landing, landing
from calflow.deployment.targets import Targets
from calflow.estimation.calibrated import Identified

ROUNDS = 4  # each leaves of the field what it changes by over its own correction: a thousandth or so


def field_landing(
    known: Identified, rows: np.ndarray, targets: Targets, start: np.ndarray, near: np.ndarray | None = None
) -> Landing:
    """Return the readings nearest to a start that land on targets, by the model and its residual field (see `landing`)."""
    found = landing(known.model, known.estimate, rows, targets, start, near)
    if known.field is None:
        return found
    for _ in range(ROUNDS):
        aims = replace(targets, position=targets.position - known.field.correction(found.readings))
        found = landing(known.model, known.estimate, rows, aims, start, found.readings)
    return found
