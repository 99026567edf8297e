"""Orientation: how surely a calibrated model knows how the tool is turned, and what of that nobody measured."""

from __future__ import annotations

import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.certainty import rotation_variance, untold_turns
from calflow.observations.pose import Pose

MOST = 0.5  # share of the variance of a turn that no measurement told of, from which it is said
ROWS = 100  # of which that is worked out


def turn_sd(known: CalibratedModel, rows: np.ndarray) -> np.ndarray:
    """Return the standard deviations of the tool's turn about its own axes (n_rows, 3) [rad]."""
    return np.sqrt(rotation_variance(known, rows))


def not_known(known: CalibratedModel, rows: np.ndarray) -> list[str]:
    """Say what nobody measured of the orientation in rows (n_conditions, n_rows)."""
    if any(isinstance(observation, Pose) for observation in known.model.observations):
        return []
    few = rows[:, np.unique(np.linspace(0, rows.shape[1] - 1, ROWS).astype(int))]
    typical = np.sqrt((turn_sd(known, few) ** 2).mean(axis=0))
    robot = known.model.robot
    turned = "turned by tool_rotation_deg of the robot file" if robot.tool_rotation else "as it is"
    said = [
        f"no orientation was measured, positions only: what meets the targets' orientation is the frame of link {robot.n_joints}, "
        f"{turned}; how the tool sits on it is not checked"
    ]
    untold = untold_turns(known, few)
    said += [
        f"the tool's turn about its own {axis} is known to {1e3 * typical[k]:.2g} mrad only, which is an assumption about "
        "robots like this: no measurement told of it (orientations would)"
        for k, axis in enumerate("xyz") if untold[k] > MOST
    ]  # fmt: skip
    return said
