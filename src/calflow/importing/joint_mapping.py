"""The joint mapping: which columns are which joints, in what unit and sign, by the robot's forward kinematics.

A hypothesis puts columns in the places of joints. The nominal robot's points are then laid onto the measured ones by a rigid motion
(Kabsch 1976), with the marker free: what is left is large unless every joint is where it belongs, whatever the columns are called.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from calflow.faults.rough import motion
from calflow.model import Model
from calflow.robot.parts import Base
from calflow.robot.robot import Robot

FITS = 0.04  # of the points' spread that the nominal robot may leave, median over the rows
RIVAL = 2.0  # times the best hypothesis' error below which another is as good
BESIDE = 0.02  # m that a marker is at most beside where it is stated
LEAST = 1e-3  # m: errors below it are what nominal robots have
SCREENED, WEIGHED = 14, 60  # rows by which many hypotheses are compared, and few
KEPT = 60  # hypotheses of a family that are weighed with the marker free
MOST_ORDERED = 6  # joints of which every order with every sign is tried
ROUNDS = 15  # in which marker and motion are fitted in turn
CHUNK = 20_000  # rows of hypotheses that are held at once
SCALES = {"mm": 1e-3, "m": 1.0, "in": 0.0254, "cm": 1e-2, "um": 1e-6}
NEAR = 0.15  # by which the scale of points may differ from a unit's


@dataclass(frozen=True)
class JointReading:
    """Which column each driven joint reads, in order, with its sign and the factor to rad or m."""

    columns: tuple[int, ...]
    signs: tuple[int, ...]
    factors: tuple[float, ...]

    def changes(self, plain: JointReading) -> int:
        """Return how many joints it reads otherwise than another."""
        pairs = zip(self.columns, self.signs, plain.columns, plain.signs, strict=True)
        return sum((c, s) != (pc, ps) for c, s, pc, ps in pairs)


@dataclass(frozen=True)
class FittedReading:
    """A hypothesis with what it leaves: the median error [m], the marker (3,) [m] in the flange, and the points' scale."""

    hypothesis: JointReading
    error: float
    marker: np.ndarray
    scale: float


@dataclass(frozen=True, eq=False)
class FlangeKinematics:
    """Where the flange of a nominal robot, or another link with a marker, is in its base's frame."""

    robot: Robot
    model: Model

    @staticmethod
    def of(robot: Robot, marker: str) -> FlangeKinematics:
        """Return that of the link that a marker is on."""
        place = {marker: replace(robot.markers[marker], point=(0.0, 0.0, 0.0), relative_sd=None)}
        bare = replace(robot, base=Base(), markers=place, payloads={}, expected=(), tool_rotation=(0.0, 0.0, 0.0))
        return FlangeKinematics(robot, Model(bare, ()))

    def at(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origins (…, 3) [m] and rotations (…, 3, 3) for driven joints' readings (…, n)."""
        flat = readings.reshape(-1, readings.shape[-1])
        packed = np.zeros((self.robot.n_joints + 1, len(flat)))
        packed[self.robot.driven] = flat.T
        packed[-1] = 1.0
        none = self.model.nominal
        shape = readings.shape[:-1]
        return self.model.point(none, packed).reshape(*shape, 3), self.model.rotation(none, packed).reshape(
            *shape, 3, 3
        )


def fitted_readings(
    flange: FlangeKinematics,
    hypotheses: Sequence[JointReading],
    figures: np.ndarray,
    points: np.ndarray,
    marker: np.ndarray,
) -> list[FittedReading]:
    """Return what hypotheses leave, marker and rigid motion fitted in turn.

    figures (n_rows, n_columns) are the columns'; points (n_rows, 3) are measured [m]; marker (3,) [m] is where it begins.
    """
    return [_weighed(flange, one, figures, points, marker) for one in hypotheses]


def readings_of(hypothesis: JointReading, figures: np.ndarray) -> np.ndarray:
    """Return the driven joints' readings (n_rows, n) [rad, or m]."""
    return figures[:, hypothesis.columns] * np.array(hypothesis.signs) * np.array(hypothesis.factors)


def _weighed(
    flange: FlangeKinematics, one: JointReading, figures: np.ndarray, points: np.ndarray, marker: np.ndarray
) -> FittedReading:
    origin, turned = flange.at(readings_of(one, figures))
    there = np.isfinite(origin).all(axis=1)
    if there.sum() < 4:
        return FittedReading(one, np.inf, marker, np.nan)
    origin, turned, points = origin[there], turned[there], points[there]
    best = (np.inf, marker)
    for _ in range(ROUNDS):
        predicted = origin + turned @ marker
        turn, _, error = motion(predicted, points, rounds=4)
        if np.median(error) < best[0]:
            best = (float(np.median(error)), marker)
        # For a turn of the base, its shift and the marker are linear in what is left.
        weight = 1 / (1 + (error / max(float(np.median(error)), 1e-9)) ** 2)
        across = (
            np.concatenate([turn @ turned, np.broadcast_to(np.eye(3), turned.shape)], axis=2) * weight[:, None, None]
        )
        left = (points - origin @ turn.T) * weight[:, None]
        solved = np.linalg.lstsq(across.reshape(-1, 6), left.ravel(), rcond=1e-6)[0]
        if np.allclose(solved[:3], marker, atol=1e-6):
            break
        marker = solved[:3]
    predicted = origin + turned @ best[1]
    scale = float(_spread(points) / max(_spread(predicted), 1e-12))
    return FittedReading(one, best[0], best[1], scale)


def _spread(points: np.ndarray) -> float:
    """The median distance of points from the middle one [m]."""
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def closest_readings(
    flange: FlangeKinematics,
    family: Sequence[JointReading],
    figures: np.ndarray,
    points: np.ndarray,
    marker: np.ndarray,
) -> list[JointReading]:
    """Return the hypotheses of a family that leave least with the marker where it is."""
    if len(family) <= KEPT:
        return list(family)
    rows = np.linspace(0, len(points) - 1, min(SCREENED, len(points))).astype(int)
    errors = np.empty(len(family))
    step = max(1, CHUNK // len(rows))
    for start in range(0, len(family), step):
        part = family[start : start + step]
        readings = np.stack([readings_of(one, figures[rows]) for one in part])
        origin, turned = flange.at(readings)
        error = motion(origin + turned @ marker, points[rows], rounds=2)[2]
        errors[start : start + step] = np.median(error, axis=1)
    return [family[k] for k in np.argsort(errors, kind="stable")[:KEPT]]


def family(plain: JointReading, width: int) -> list[JointReading]:
    """Return the hypotheses about a plain one: 0 with other signs, 1 in other orders, 2 both."""
    n = len(plain.columns)
    signs = [replace(plain, signs=sign) for sign in product((1, -1), repeat=n)]
    if width == 0:
        return signs
    orders = list(permutations(plain.columns))
    if width == 1:
        return [replace(plain, columns=order) for order in orders]
    return [replace(one, columns=order) for order in orders for one in signs] if n <= MOST_ORDERED else []


@dataclass(frozen=True)
class JointMapping:
    """The hypothesis that was taken, what it leaves, and what else would leave as little.

    rivals are as near to what names say; untold are joints (from 0, of those driven) that fit as well with their
    signs turned together.
    spread [m] is the points'.
    """

    taken: FittedReading
    rivals: tuple[FittedReading, ...]
    untold: tuple[tuple[int, ...], ...]
    spread: float

    @property
    def fits(self) -> bool:
        """Whether the nominal robot is where the points were measured."""
        return self.taken.error < FITS * self.spread


def mapped(
    flange: FlangeKinematics, plain: JointReading, asked: Sequence[JointReading], figures: np.ndarray, points: np.ndarray,
    marker: np.ndarray, known: bool,
) -> JointMapping:  # fmt: skip
    """Return the mapping nearest to the plain one among those asked for that leave as little as the best.

    plain is what the columns are called, in one unit; known says that the marker is near where it is stated.
    """
    rows = np.unique(np.linspace(0, len(points) - 1, WEIGHED).astype(int))
    figures, points = figures[rows], points[rows]
    spread = _spread(points)
    every = fitted_readings(
        flange, closest_readings(flange, [plain, *asked], figures, points, marker), figures, points, marker
    )
    best = min(every, key=lambda one: one.error)
    as_good = [one for one in every if one.error < max(RIVAL * best.error, best.error + LEAST)]
    near = [one for one in as_good if np.linalg.norm(one.marker - marker) < BESIDE]
    as_good = (near if known else []) or as_good
    ways = [(one.hypothesis.changes(plain), k, one) for k, one in enumerate(as_good)]
    ways.sort(key=lambda way: way[:2])
    fewest = [one for changes, _, one in ways if changes == ways[0][0]]
    taken = min(fewest, key=lambda one: one.error)
    rivals = tuple(one for one in fewest if one is not taken)
    turned = {_turned(one.hypothesis, taken.hypothesis) for one in as_good if one is not taken} - {()}
    untold = tuple(sorted(own for own in turned if not any(set(one) < set(own) for one in turned)))
    return JointMapping(taken, rivals, untold, spread)


def _turned(one: JointReading, other: JointReading) -> tuple[int, ...]:
    """The joints that two readings count in different signs; none where they read different columns."""
    if one.columns != other.columns:
        return ()
    return tuple(k for k, (s, o) in enumerate(zip(one.signs, other.signs, strict=True)) if s != o)


def unit_by_scale(points: np.ndarray, flange: FlangeKinematics, readings: np.ndarray) -> str:
    """Return the unit of points (n_rows, 3) whose spread is the nearest to that of the flange at readings (n_rows, n)."""
    origin = flange.at(readings)[0]
    ratio = np.log(max(_spread(points), 1e-12) / max(_spread(origin[np.isfinite(origin).all(axis=1)]), 1e-12))
    return min(SCALES, key=lambda unit: abs(ratio + np.log(SCALES[unit])))
