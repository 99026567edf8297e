"""Base elsewhere: a base whose place the robot file states as known, where the positions say that it does not stand."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.effects.geometry import PLACED_BOUND
from calflow.faults.nominal_misfit import FEWEST, ROWS
from calflow.faults.reference import Models, chosen, lengths, motion, rough
from calflow.measurements.measurements import Measurements
from calflow.robot.transforms import angles

FAR_BETTER = 3.0  # times by which the positions must be met better than with the base as stated


def base_elsewhere(data: Measurements) -> str:
    """Say where the positions have the base, if that is farther from where it is stated than any fit may move it; else nothing."""
    train = data.only(chosen(np.flatnonzero(data.train), ROWS, len(data)))
    base = data.robot.base
    if not base.known or base.fixed or train.table["pose"].nunique() < FEWEST:
        return ""
    models = Models.of(train)
    points = models.nominal.position(models.nominal.nominal, train.rows)
    turn, shift, _ = motion(points, train.position)
    placed = rough(models.placed, train.rows, train.position, turn, shift)
    as_stated = Rotation.from_euler("XYZ", base.rotation)
    angle = float((as_stated.inv() * Rotation.from_matrix(placed.turn)).magnitude())
    distance = float(np.linalg.norm(placed.shift - base.origin))
    if max(angle, distance) <= PLACED_BOUND:
        return ""
    stated = points @ as_stated.as_matrix().T + base.origin
    before, after = float(np.nanmedian(lengths(train.position - stated))), float(np.median(placed.miss(train)))
    if before < FAR_BETTER * after:
        return ""
    origin = ", ".join(f"{1e3 * value:.4g}" for value in placed.shift)
    degrees = ", ".join(f"{value:.4g}" for value in np.rad2deg(angles(Rotation.from_matrix(placed.turn))) + 0.0)
    return (
        f"the base does not stand where the robot file says: with it the positions are missed by {1e3 * before:.3g} mm, with a "
        f"base turned by {np.rad2deg(angle):.3g} deg and shifted by {1e3 * distance:.3g} mm from there by {1e3 * after:.3g} mm: "
        f"expected about origin_mm = [{origin}], rotation_deg = [{degrees}] in [base] (a turn about joint 1's axis may as well be "
        "that joint's zero), or known = false, for the poses to say where it stands"
    )
