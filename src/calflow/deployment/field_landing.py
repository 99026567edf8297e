"""Landing beside a target by what a residual field will add: the field has no part in the model's graph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.deployment.compensation import Landing, landing
from calflow.deployment.nominal_inverse import best_of, near
from calflow.deployment.targets import Targets
from calflow.estimation.calibrated import Identified
from calflow.model import Model

ELSEWHERE_TRIED = 12  # starts of a target that is not reached from its own
ROUNDS = 4  # each leaves of the field what it changes by over its own correction: a thousandth or so


def field_landing(
    known: Identified, rows: np.ndarray, targets: Targets, start: np.ndarray, begun: np.ndarray | None = None
) -> Landing:
    """Return the readings nearest to a start that land on targets, by the model and its residual field (see `landing`)."""
    found = landing(known.model, known.estimate, rows, targets, start, begun)
    if known.field is None:
        return found
    for _ in range(ROUNDS):
        aims = replace(targets, position=targets.position - known.field.correction(found.readings))
        found = landing(known.model, known.estimate, rows, aims, start, found.readings)
    return found


def landing_from_elsewhere(
    known: Identified, rows: np.ndarray, targets: Targets, rng: np.random.Generator
) -> tuple[Landing, np.ndarray]:
    """Return the best landing of each target from starts anywhere within the limits, and the nominal robot's readings beside it."""
    rigid = Model(known.model.robot, (), known.model.given)
    starts = near(rigid, rows, targets, rng)[:, :ELSEWHERE_TRIED]
    every = np.repeat(np.arange(len(targets)), starts.shape[1])
    landed = field_landing(known, rows[:, every], targets.only(every), starts.reshape(len(every), -1))
    found = landed.only(best_of(known.model.robot, landed, starts.shape[1]))
    return found, landing(rigid, np.zeros(0), rows, targets, found.readings).readings
