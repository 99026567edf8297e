"""Hidden causes of frames in time: sessions, a device that wanders, single parts that warm up. SI units."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hidden.simulator import Array, Robot, Rows

if TYPE_CHECKING:
    from hidden.causes import Hidden

SESSIONS = 4
WARM_UP = 3600.0  # s
CREEPS = 1200.0  # s
STAND = 1.2  # m high
STANDS = 1800.0  # s: between two rows


def sessions(rows: Rows) -> Array:
    """Number of the session (from 0) that each row is of: equally long ones, one after the other."""
    return np.minimum(SESSIONS * rows.time / rows.time.max(), SESSIONS - 1).astype(int)


def session_names(rows: Rows) -> list[str]:
    """What a file calls them."""
    return [f"day {k + 1}" for k in sessions(rows)]


def stepped(h: Hidden, rng: np.random.Generator, rows: Rows) -> Array:
    """1 after a drawn moment between a quarter and three quarters of the measuring time, else 0; by extra "before" 1 less."""
    after = rows.time > rng.uniform(0.25, 0.75) * rows.time.max()
    return after - float(h.extra == "before")


def session_frame(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """Each session but the first has the device elsewhere, by size and turned by a quarter of it a metre, at random;
    with extra a number, it was moved once, before that session, and not turned."""
    shift = h.rng.normal(size=(2, SESSIONS, 3)) / np.sqrt(3) * h.size
    shift[:, 0] = 0.0
    own = sessions(rows)
    if h.extra:
        return point + (own >= h.number - 1)[:, None] * shift[0, 1]
    return point + shift[0][own] + np.cross(shift[1][own] / 4, point)


def wander(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """A smooth random walk of size (rms) that turns around some five times while measuring."""
    rate, phase = h.rng.normal(0, 6, (3, 40)), h.rng.uniform(0, 2 * np.pi, (3, 40))
    share = rows.time / rows.time.max()
    walk = np.cos(share[:, None, None] * rate + phase).sum(axis=2)
    return point + h.size / np.sqrt(3) * (walk - walk.mean(axis=0)) / walk.std(axis=0)


def stand_growth(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """The device's stand bends by size [m] a kelvin where it carries the device, or with extra "settling" creeps by size.

    It leans by as much over its height. What creeps does so by the logarithm of the time.
    """
    crept = np.log1p(rows.time / CREEPS) / np.log1p(rows.time.max() / CREEPS)
    grown = crept if h.extra == "settling" else _warm(h, rows)
    shift, lean = h.size * h.rng.normal(size=(2, 3)) / np.sqrt(3)
    return point + grown[:, None] * (shift + np.cross(lean / STAND, point))


def scale_growth(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """All that the device measures from its own place grows by size a kelvin: its weather station is wrong."""
    return point * (1 + h.size * _warm(h, rows))[:, None]


def link_growth(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """One link grows by size a kelvin above 20 degC, or with extra "warm-up" by size in the end."""
    grown = 1 + h.size * _warm(h, rows)
    a, d = (np.tile(lengths, (len(rows), 1)) for lengths in (robot.a, robot.d))
    d[:, h.joint - 1] *= grown
    if h.joint < robot.n:
        a[:, h.joint] *= grown
    return replace(robot, a=a, d=d)


def bar_growth(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """The loop's crank (joint 1) or rod (2) grows by size a kelvin above 20 degC, and no link does."""
    share = h.size * _warm(h, rows)[:, None] * (np.arange(3) == h.joint - 1)
    return replace(robot, loop=robot.loop and replace(robot.loop, bars=robot.loop.bars * (1 + share)))


def housing_growth(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """One joint's housing grows along its axis by size [m] a kelvin, or with extra "warm-up" by size in the end."""
    d = np.tile(robot.d, (len(rows), 1))
    d[:, h.joint - 1] += h.size * _warm(h, rows)
    return replace(robot, d=d)


def warm_zero(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """One joint's zero turns by size [rad] a kelvin, or with extra "warm-up" by size in the end; a number: so warm at first."""
    theta = np.tile(robot.theta, (len(rows), 1))
    theta[:, h.joint - 1] += h.size * _warm(h, rows)
    return replace(robot, theta=theta)


def _warm(h: Hidden, rows: Rows) -> Array:
    if h.extra == "":
        return rows.temperature - 20
    if isinstance(h.extra, str) and h.extra.startswith("late"):
        return behind(rows.time, rows.temperature, *map(float, h.extra.split()[1:])) - 20
    return warm_up(rows, 0.0 if h.extra == "warm-up" else h.number)


def warm_up(rows: Rows, at_first: float) -> Array:
    """How warm a robot is at each row, over as warm as it gets: it cools while it stands."""
    warm, now = np.empty(len(rows.time)), at_first
    for k, passed in enumerate(np.diff(rows.time, prepend=0.0)):
        end = float(passed < STANDS)
        now = end + (now - end) * np.exp(-passed / WARM_UP)
        warm[k] = now
    return warm


def behind(time: Array, air: Array, constant: float, beyond: float = 0.0) -> Array:
    """Temperature of what follows the air's with a time constant [s], so many kelvin beyond it at the first row.

    The exact solution where the air's temperature is linear between rows, as in a pause.
    """
    warm = np.full(len(time), air[0] + beyond)
    for k in range(1, len(time)):
        passed, rise = time[k] - time[k - 1], air[k] - air[k - 1]
        late = rise * constant / passed  # by which what has followed for long lags behind a steady rise
        warm[k] = air[k] - late + (warm[k - 1] - air[k - 1] + late) * np.exp(-passed / constant)
    return warm


ON_ROBOT = {
    "link-growth": link_growth,
    "bar-growth": bar_growth,
    "housing-growth": housing_growth,
    "warm-zero": warm_zero,
}
ON_DEVICE = {
    "session-frame": session_frame,
    "wander": wander,
    "stand-growth": stand_growth,
    "scale-growth": scale_growth,
}
