"""Nominal misfit: a robot file and measurements that are not of one robot, which no calibration can mend."""

from __future__ import annotations

import numpy as np

from calflow.faults.reference import Models, chosen, motion, rough
from calflow.measurements.measurements import Measurements

FAR, SHARE = 0.1, 0.1  # m, and of its reach: no robot is built so far from what its maker says
FEWEST = 8  # poses: fewer are met by placing base and tool
ROWS = 400  # that are compared


def nominal_misfit(data: Measurements) -> str:
    """Say how far the nominal robot is from positions, base and tool placed where they fit best; empty where it may be right.

    Half of all rows must be farther off than a robot can be, so that single ones do not decide.
    """
    train = data.only(chosen(np.flatnonzero(data.train), ROWS, len(data)))
    if train.table["pose"].nunique() < FEWEST:
        return ""
    models = Models.of(train)
    nominal = models.nominal
    points = nominal.position(nominal.nominal, train.rows)
    turn, shift, _ = motion(points, train.position)
    placed = rough(models.placed, train.rows, train.position, turn, shift)
    far = float(np.median(placed.miss(train)))
    reach = float(np.nanmax(np.linalg.norm(points, axis=1)))
    limit = min(FAR, SHARE * reach)
    if far <= limit:
        return ""
    return (
        f"the nominal robot, with base and tool placed where they fit best, misses half of all positions by {1e3 * far:.3g} mm or "
        f"more, which no calibration mends (at most {1e3 * limit:.3g} mm): check the units of readings and positions, the order "
        "and the signs of the joints, their zeros (theta), the convention (dh or modified-dh), the order of the rows, and that "
        "x, y, z are a right-handed frame"
    )
