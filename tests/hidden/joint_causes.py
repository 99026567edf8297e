"""Hidden causes of joints and links that are not as textbooks draw them, each a few lines of physics. SI units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hidden.frame_causes import stepped
from hidden.simulator import Array, Robot, Rows

if TYPE_CHECKING:
    from hidden.causes import Hidden


# --- Joints: rad added to one driven joint (rows,) ---------------------------------------------------


def loaded_transmission_error(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """A wave, extra times a turn ("gear": a turn of the motor), as high as size under the largest torque.

    With extra "warm" once a turn, and as high as size 10 K above 20 °C.
    """
    phase = h.rng.uniform(0, 2 * np.pi)
    share = torque[:, h.joint - 1] / np.abs(torque[:, h.joint - 1]).max()
    order = {"": 1.0, "warm": 1.0, "gear": robot.gears[h.joint - 1]}.get(h.extra)
    order = float(h.extra) if order is None else order
    grows = (rows.temperature - 20) / 10 if h.extra == "warm" else share
    return h.size * np.cos(order * rows.q[:, h.joint - 1] + phase) * grows


def friction_wind_up(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """Friction holds the joint on the side that it came from: extra (a share) of size without load, all under the largest."""
    share = np.abs(torque[:, h.joint - 1]) / np.abs(torque[:, h.joint - 1]).max()
    least = float(h.extra or 0)
    return h.size * (least + (1 - least) * share) * rows.approach[:, h.joint - 1]


def joint_step(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """The zero jumps by size at one moment."""
    return h.size * stepped(h, h.rng, rows)


ON_JOINT = {
    "loaded-transmission-error": loaded_transmission_error, "friction-wind-up": friction_wind_up, "joint-step": joint_step,
}  # fmt: skip
