"""Devices that see less than a position, in plain numpy: a wire, sockets, a surface, a tracker that stands anywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import numbered
from calflow.measurements.series import Series
from calflow.robot.parts import Base
from calflow.robot.robot import Robot
from robots import figures, marker_position

Array = np.ndarray
STEP, TURNS = 1e-6, 12  # of differences [rad], and of Newton's method
MET = 1e-9  # m
UNITS = {"q": "rad", "length": "m", "reading": "m", "x": "m", "y": "m", "z": "m"}


@dataclass(frozen=True)
class Arm:
    """A robot as it truly is; its base stands where the measuring frame is."""

    robot: Robot
    figures: dict[str, Array]

    @staticmethod
    def drawn(nominal: Robot, rng: np.random.Generator, length: float = 5e-4, angle: float = 1e-3) -> Arm:
        """Draw errors of every length [m] and angle [rad], of the marker too."""
        robot = replace(nominal, base=Base())
        true = figures(robot)
        for name, size in (("alpha", angle), ("theta", angle), ("a", length), ("d", length), ("markers", length)):
            true[name] = true[name] + size * rng.standard_normal(true[name].shape)
        return Arm(robot, true)

    def tool(self, q: Array, marker: int = 0) -> Array:
        """Return the marker's points (n, 3) at joint angles q (n, n_joints)."""
        return marker_position(self.robot, q, self.figures, marker)

    def random(self, n: int, rng: np.random.Generator, reach: float = np.pi) -> Array:
        """Draw joint angles (n, n_joints) within the limits, and within a reach [rad] of nought."""
        low, high = np.clip(self.robot.limits.T, -reach, reach)
        return rng.uniform(low, high, (n, self.robot.n_joints))

    def brought(self, off: Callable[[Array], Array], q: Array) -> Array:
        """Return those of joint angles (n, n_joints) that, moved as little as it takes, leave nothing of off(points) (n, k)."""
        n = q.shape[1]
        for _ in range(TURNS):
            left = off(self.tool(q))
            slope = np.stack([(off(self.tool(q + STEP * e)) - left) / STEP for e in np.eye(n)], axis=2)
            step = -np.einsum("rnk,rk->rn", np.linalg.pinv(slope, rcond=1e-3), left)
            q = q + step * np.minimum(1, 0.3 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
        low, high = self.robot.limits.T
        good = (np.linalg.norm(off(self.tool(q)), axis=1) < MET) & ((q > low) & (q < high)).all(axis=1)
        return q[good]

    def touching(self, point: Array, n: int, rng: np.random.Generator, noise: float) -> Array:
        """Return joint angles (n, n_joints) that put the marker at a point, but for noise [m] an axis."""
        start = self.random(6 * n, rng)
        meant = point + noise * rng.standard_normal((6 * n, 3))
        found: list[Array] = []
        for k in range(0, len(start), 60):
            part = slice(k, k + 60)
            found.append(self.brought(_from(meant[part]), start[part]))
            if sum(map(len, found)) >= n:
                break
        return np.vstack(found)[:n]


def _from(points: Array) -> Callable[[Array], Array]:
    return lambda at: at - points[: len(at)]


def wire(
    arm: Arm, q: Array, anchor: Array, noise: float, rng: np.random.Generator, offset: float = 0.0
) -> pd.DataFrame:
    """Return the lengths of a wire from an anchor [m]."""
    length = np.linalg.norm(arm.tool(q) - anchor, axis=1) + offset + noise * rng.standard_normal(len(q))
    return rows(q).assign(length=length)


def sockets(arm: Arm, points: dict[str, Array], n: int, noise: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return n touches of each socket; the noise [m] is how the ball sits in it."""
    every = [rows(arm.touching(point, n, rng, noise)).assign(socket=name) for name, point in points.items()]
    return pd.concat(every, ignore_index=True)


def surface(arm: Arm, point: Array, normal: Array, n: int, noise: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return n touches of a flat surface through a point."""
    start = arm.random(4 * n, rng)
    heights = noise * rng.standard_normal(len(start))
    found = arm.brought(lambda at: ((at - point) @ normal - heights)[:, None], start)
    return rows(found[:n])


@dataclass(frozen=True)
class Tracker:
    """A tracker at a place (origin and angles, 6) in the measuring frame; noise along its beam floor + growth · range [m],
    across it an angle [rad]."""

    place: Array
    floor: float = 1e-5
    growth: float = 1e-6
    angle: float = 5e-6

    def sees(self, points: Array, rng: np.random.Generator) -> Array:
        """Return points (n, 3) in its own frame, with noise."""
        turn = Rotation.from_euler("XYZ", self.place[3:])
        true = turn.inv().apply(points - self.place[:3])
        range_ = np.linalg.norm(true, axis=1, keepdims=True)
        beam = true / range_
        along = (self.floor + self.growth * range_) * rng.standard_normal(range_.shape)
        free = self.angle * range_ * rng.standard_normal(true.shape)
        return true + along * beam + free - (free * beam).sum(axis=1, keepdims=True) * beam


def seen(arm: Arm, q: Array, tracker: Tracker, rng: np.random.Generator) -> pd.DataFrame:
    """Return positions as a tracker reports them."""
    return pd.concat([rows(q), pd.DataFrame(tracker.sees(arm.tool(q), rng), columns=["x", "y", "z"])], axis=1)


def rows(q: Array) -> pd.DataFrame:
    """Return joint angles as columns."""
    return pd.DataFrame(q, columns=numbered("q", q.shape[1]))


def written(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table as a file states it, units in its column names."""
    return table.rename(
        columns={n: f"{n}_{UNITS[n.rstrip('0123456789')]}" for n in table if n.rstrip("0123456789") in UNITS}
    )


def measured(robot: Robot, table: pd.DataFrame, series: Series, sigma: float | None = None) -> Measurements:
    """Return rows as one series of measurements, all to be fitted."""
    marker, payload = next(iter(robot.markers)), ""
    number = np.arange(len(table))
    whole = table.assign(pose=number, repeat=1, marker=marker, payload=payload, split="train", line=number + 2,
                         order=number + 1.0)  # fmt: skip
    return Measurements(robot, whole if sigma is None else whole.assign(sigma=sigma), series=(series,))
