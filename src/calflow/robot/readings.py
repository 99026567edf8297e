"""Joint readings as tables and people have them: a column each, in degrees or millimetres."""

from __future__ import annotations

import numpy as np

from calflow.robot.robot import Robot

READINGS = "q{joint}_{deg|mm}"  # the columns of joint readings
VIAS = "via{joint}_{deg|mm}"  # the same of a pose on the way


def reading_columns(robot: Robot) -> list[str]:
    """Return the columns of joint readings by their names, e.g. q1_deg; joints that follow others have none."""
    return [f"q{i + 1}_{robot.joints[i].shown[0]}" for i in robot.driven]


def reading_labels(robot: Robot) -> list[str]:
    """Return the same for people, e.g. q1 [deg]."""
    return [f"q{i + 1} [{robot.joints[i].shown[0]}]" for i in robot.driven]


def shown_readings(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Return readings (n, n_joints) [rad, or m] as these columns have them, shape (n, number of columns)."""
    return np.asarray(readings[:, robot.driven] * [robot.joints[i].shown[1] for i in robot.driven])
