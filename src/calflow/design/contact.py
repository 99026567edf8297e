"""Contact: joint readings that bring the marker to what must be touched."""

from __future__ import annotations

import casadi as ca
import numpy as np

from calflow.model import Model, over_rows
from calflow.observations import Observation

ROUNDS = 30
MET = 1e-6  # m: how near counts as touching
LONGEST_STEP = 0.3  # rad, or m


def brought(
    model: Model, observation: Observation, readings: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return readings (n, n_joints) near those given at which the nominal robot touches, and which of them do, (n,).

    rows (n_conditions, n) are the packed conditions, the readings first. Gauss-Newton with the least motion of the joints,
    things touched in turn (see `Observation.touched`).
    """
    y, error = model.error(observation)
    p, c, _ = model.symbols
    slope = ca.jacobian(error, c)[:, : readings.shape[1]]
    function = ca.Function("contact", [p, c, y], [ca.densify(error), ca.densify(slope.T)])
    point = model.nominal
    reported = observation.touched(model.point(point, rows), model.rotation(point, rows))
    rows, n = rows.copy(), readings.shape[1]
    for _ in range(ROUNDS):
        left, slopes = over_rows(function, point, rows, reported)
        jacobian = slopes.T.reshape(rows.shape[1], len(observation.units), n)
        step = -np.einsum("rnu,ru->rn", np.linalg.pinv(jacobian, rcond=1e-4), left.T)
        largest = np.maximum(np.abs(step).max(axis=1), 1e-12)
        rows[:n] += (step * np.minimum(1.0, LONGEST_STEP / largest)[:, None]).T
    left = over_rows(function, point, rows, reported)[0]
    return rows[:n].T, np.linalg.norm(left, axis=0) < MET
