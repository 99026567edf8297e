"""Hidden causes of flange, tool and markers: what gives way under its own weight or the payload's, and turns. SI units."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from hidden.frame_causes import stepped
from hidden.simulator import WEIGHT, Array, Motion, Robot, Rows, State, carried

if TYPE_CHECKING:
    from hidden.causes import Hidden

LENGTH = 0.4  # m: of a bracket
Z = np.array([0.0, 0.0, 1.0])


def tool_sag(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A bracket along the flange's axis sags by size across it and turns; with extra "bar" one in a drawn direction sags.

    With extra "loose" the tool lies by size on its lower side, and turns as much as the bracket.

    With extra a number, from 0, only that marker's mount sags, a bar in a drawn direction.
    """
    down = _in_flange(state, WEIGHT / np.linalg.norm(WEIGHT))
    if h.extra == "loose":
        down = _across(down, Z) / np.linalg.norm(_across(down, Z), axis=1, keepdims=True)
    if h.extra in ("", "loose"):
        return _moved(robot, rows, h.size * _across(down, Z), h.size * 1.5 / LENGTH * np.cross(Z, down))
    own = np.ones(len(rows)) if h.extra == "bar" else rows.marker == int(h.extra)
    return _moved(robot, rows, own[:, None] * h.size * _across(down, _drawn(h.rng)), 0 * down)


def bracket(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A bracket along the flange's axis gives way under the payload by size [m/N] across it, and turns."""
    weight = _in_flange(state, WEIGHT) * carried(robot, rows)[:, None]
    return _moved(robot, rows, h.size * _across(weight, Z), h.size * 1.5 / LENGTH * np.cross(Z, weight))


def adapter(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A thin adapter on the flange tilts by size [rad/Nm] under the payload's moment about it, half as much about y."""
    weight = _in_flange(state, WEIGHT) * carried(robot, rows)[:, None]
    moment = np.cross(robot.payload_com[rows.payload], weight)
    return _moved(robot, rows, 0 * weight, h.size * np.array([1.0, 0.5, 0.0]) * moment)


def tool_slip(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """The tool slips by size at one moment, in a drawn direction.

    With extra "turning" it turns about its flange by size over 0.3 m; with extra a number, from 0, that marker alone slips.
    """
    rng = h.rng
    after, nothing = stepped(h, rng, rows), np.zeros((len(rows), 3))
    if h.extra == "turning":
        return _moved(robot, rows, nothing, after[:, None] * h.size / 0.3 * _drawn(rng))
    own = after if h.extra in ("", "before") else after * (rows.marker == int(h.extra))
    return _moved(robot, rows, own[:, None] * h.size * _drawn(rng), nothing)


def _in_flange(state: State, vector: Array) -> Array:
    return np.asarray(vector @ state.frames.tips[-1][:, :3, :3])


def _across(vector: Array, axis: Array) -> Array:
    return np.asarray(vector - (vector @ axis)[:, None] * axis)


def _drawn(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _moved(robot: Robot, rows: Rows, shift: Array, turn: Array) -> Motion:
    """The motion of each row's own marker: what is nowhere else on the tool is of no interest."""
    motion = Motion.none(len(rows), robot.n)
    motion.tool[:] = shift + np.cross(turn, robot.markers[rows.marker])
    return motion


ON_TOOL: dict[str, Callable[[Hidden, Robot, Rows, State], Motion]] = {
    "tool-sag": tool_sag,
    "tool-bracket": bracket,
    "tool-adapter": adapter,
    "tool-slip": tool_slip,
}
