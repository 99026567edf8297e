"""The joint mapping: the column, unit and sign of each joint, identified by the robot's forward kinematics.

A hypothesis assigns columns to joints. The nominal robot's positions are then fitted to the measured points by a rigid
motion (Kabsch 1976), with the marker free: the residual is large unless every joint is assigned correctly.
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

FITS = 0.04  # largest median error of the nominal robot, over the points' spread
RIVAL = 2.0  # factor on the best error up to which another hypothesis is as good
BESIDE = 0.02  # m: largest distance of a marker from its stated position
NOMINAL_ERROR = 1e-3  # m: typical error of nominal robots
SCREENED, WEIGHED = 14, 60  # rows used in screening many hypotheses, and in fitting few
KEPT = 60  # hypotheses of a family that are fitted with the marker free
MOST_ORDERED = 6  # joints up to which every order is tried with every sign
FIT_ROUNDS = 15  # alternating fits of marker and rigid motion
CHUNK = 20_000  # rows, over all hypotheses, that are in memory at once
FACTORS = {"deg": np.pi / 180, "rad": 1.0, "mrad": 1e-3, "si": 1.0, "mm": 1e-3, "m": 1.0}
LARGEST_TURN = 2.2 * np.pi  # rad: larger readings are in degrees
SCALES = {"mm": 1e-3, "m": 1.0, "in": 0.0254, "cm": 1e-2, "um": 1e-6}


@dataclass(frozen=True)
class JointReading:
    """A hypothesis: the column of each driven joint, in order, with its sign and the factor to rad or m."""

    columns: tuple[int, ...]
    signs: tuple[int, ...]
    factors: tuple[float, ...]

    def changes(self, plain: JointReading) -> int:
        """Return the number of joints whose column or sign differs from another reading."""
        pairs = zip(self.columns, self.signs, plain.columns, plain.signs, strict=True)
        return sum((c, s) != (pc, ps) for c, s, pc, ps in pairs)


@dataclass(frozen=True)
class FittedReading:
    """A fitted hypothesis: its median error [m], the marker (3,) [m] in the flange frame, and the points' scale."""

    hypothesis: JointReading
    error: float
    marker: np.ndarray
    scale: float


@dataclass(frozen=True, eq=False)
class FlangeKinematics:
    """Forward kinematics, in the base frame, of a nominal robot's link with a marker, usually the flange."""

    robot: Robot
    model: Model

    @staticmethod
    def of(robot: Robot, marker: str) -> FlangeKinematics:
        """Return the kinematics of the link that carries a marker."""
        place = {marker: replace(robot.markers[marker], point=(0.0, 0.0, 0.0), relative_sd=None)}
        bare = replace(robot, base=Base(), markers=place, payloads={}, expected=(), tool_rotation=(0.0, 0.0, 0.0))
        return FlangeKinematics(robot, Model(bare, ()))

    def at(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the link's origins (…, 3) [m] and rotations (…, 3, 3) for readings (…, n) of the driven joints."""
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
    flange: FlangeKinematics, hypotheses: Sequence[JointReading], figures: np.ndarray, points: np.ndarray,
    marker: np.ndarray,
) -> list[FittedReading]:  # fmt: skip
    """Return the fits of hypotheses, each by alternating fits of marker and rigid motion.

    figures (n_rows, n_columns) hold the columns, points (n_rows, 3) [m] are measured, marker (3,) [m] is the start.
    """
    origin, turned = flange.at(np.stack([readings_of(hypothesis, figures) for hypothesis in hypotheses]))
    best_by_column = dict[int, FittedReading]()
    # Hypotheses with the same valid rows (all rows unless a closed loop has no solution) are fitted together.
    patterns, pattern = np.unique(np.isfinite(origin).all(axis=2), axis=0, return_inverse=True)
    for k, there in enumerate(patterns):
        members = np.flatnonzero(pattern.reshape(-1) == k)
        within = np.ix_(members, np.flatnonzero(there))
        fitted = _weighed(
            [hypotheses[i] for i in members.tolist()], origin[within], turned[within], points[there], marker
        )
        best_by_column.update(zip(members, fitted, strict=True))
    return [best_by_column[i] for i in range(len(hypotheses))]


def readings_of(hypothesis: JointReading, figures: np.ndarray) -> np.ndarray:
    """Return the readings (n_rows, n) [rad or m] of the driven joints under a hypothesis."""
    return figures[:, hypothesis.columns] * np.array(hypothesis.signs) * np.array(hypothesis.factors)


def _weighed(
    hypotheses: Sequence[JointReading], origin: np.ndarray, turned: np.ndarray, points: np.ndarray, marker: np.ndarray
) -> list[FittedReading]:
    """The converged fits of n hypotheses, given the flange's origins (n, n_rows, 3) and rotations (n, n_rows, 3, 3)."""
    if len(points) < 4:
        return [FittedReading(hypothesis, np.inf, marker, np.nan) for hypothesis in hypotheses]
    least, best = np.full(len(hypotheses), np.inf), np.tile(marker, (len(hypotheses), 1))
    turns = np.tile(np.eye(3), (len(hypotheses), 1, 1))
    markers, moving = best.copy(), np.arange(len(hypotheses))
    for _ in range(FIT_ROUNDS):
        turn, _, error = motion(_placed(origin[moving], turned[moving], markers[moving]), points, rounds=4)
        middle = np.median(error, axis=1)
        better = middle < least[moving]
        least[moving[better]], turns[moving[better]] = middle[better], turn[better]
        best[moving[better]] = markers[moving[better]]
        # For a given rotation of the base, the residual is linear in its translation and the marker.
        weight = 1 / (1 + (error / np.maximum(middle, 1e-9)[:, None]) ** 2)
        by_marker = turn[:, None] @ turned[moving]
        by_shift = np.broadcast_to(np.eye(3), by_marker.shape)
        across = np.concatenate([by_marker, by_shift], axis=3) * weight[..., None, None]
        left = (points - origin[moving] @ np.swapaxes(turn, 1, 2)) * weight[..., None]
        solved = np.array(
            [
                np.linalg.lstsq(slopes.reshape(-1, 6), aim.ravel(), rcond=1e-6)[0][:3]
                for slopes, aim in zip(across, left, strict=True)
            ]
        )
        settled = np.isclose(solved, markers[moving], atol=1e-6).all(axis=1)
        markers[moving] = solved
        moving = moving[~settled]
        if not len(moving):
            break
    predicted = _placed(origin, turned, best) @ np.swapaxes(turns, 1, 2)
    return [
        FittedReading(hypothesis, float(error), marker_at, float(spread_of(points) / max(spread_of(there), 1e-12)))
        for hypothesis, error, marker_at, there in zip(hypotheses, least, best, predicted, strict=True)
    ]


def _placed(origin: np.ndarray, turned: np.ndarray, marker: np.ndarray) -> np.ndarray:
    """The positions (n, n_rows, 3) of markers (n, 3) given in the flange frame."""
    return np.asarray(origin + (turned @ marker[:, None, :, None])[..., 0])


def spread_of(points: np.ndarray) -> float:
    """Return the median distance [m] of points (n, 3) from their median."""
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def screened_errors(
    flange: FlangeKinematics, hypotheses: Sequence[JointReading], figures: np.ndarray, points: np.ndarray,
    marker: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return the median errors (n_hypotheses,) [m] over a subset of rows, marker fixed (see `fitted_readings`)."""
    rows = np.linspace(0, len(points) - 1, min(SCREENED, len(points))).astype(int)
    errors = np.empty(len(hypotheses))
    step = max(1, CHUNK // len(rows))
    for start in range(0, len(hypotheses), step):
        part = hypotheses[start : start + step]
        origin, turned = flange.at(np.stack([readings_of(hypothesis, figures[rows]) for hypothesis in part]))
        error = motion(origin + turned @ marker, points[rows], rounds=2)[2]
        errors[start : start + step] = np.median(error, axis=1)
    return errors


def family(plain: JointReading, width: int) -> list[JointReading]:
    """Return the variants of a reading: width 0 varies the signs, 1 the order of columns, 2 both."""
    n = len(plain.columns)
    signs = [replace(plain, signs=sign) for sign in product((1, -1), repeat=n)]
    if width == 0:
        return signs
    orders = list(permutations(plain.columns))
    if width == 1:
        return [replace(plain, columns=order) for order in orders]
    return [replace(hypothesis, columns=order) for order in orders for hypothesis in signs] if n <= MOST_ORDERED else []


@dataclass(frozen=True)
class JointMapping:
    """The selected hypothesis with its fit, and the alternatives that fit as well.

    rivals deviate as little from the columns' names; untold are sets of driven joints (from 0) that fit as well with
    their signs reversed together.
    spread [m] is that of the points (see `spread_of`).
    """

    taken: FittedReading
    rivals: tuple[FittedReading, ...]
    untold: tuple[tuple[int, ...], ...]
    spread: float

    @property
    def fits(self) -> bool:
        """Whether the nominal robot fits the measured points."""
        return self.taken.error < FITS * self.spread


def mapped(
    flange: FlangeKinematics, plain: JointReading, asked: Sequence[JointReading], figures: np.ndarray, points: np.ndarray,
    marker: np.ndarray, marker_known: bool,
) -> JointMapping:  # fmt: skip
    """Return the mapping that deviates least from the plain reading among all that fit as well as the best.

    plain follows the columns' names, in one unit; marker_known says that the marker is near its stated position.
    """
    rows = np.unique(np.linspace(0, len(points) - 1, WEIGHED).astype(int))
    figures, points = figures[rows], points[rows]
    every = [plain, *asked]
    if len(every) > KEPT:
        errors = screened_errors(flange, every, figures, points, marker)
        every = [every[k] for k in np.argsort(errors, kind="stable")[:KEPT]]
    fitted = fitted_readings(flange, every, figures, points, marker)
    best = min(fitted, key=lambda reading: reading.error)
    as_good = [reading for reading in fitted if reading.error < max(RIVAL * best.error, best.error + NOMINAL_ERROR)]
    near = [reading for reading in as_good if np.linalg.norm(reading.marker - marker) < BESIDE]
    as_good = (near if marker_known else []) or as_good
    ways = [(reading.hypothesis.changes(plain), k, reading) for k, reading in enumerate(as_good)]
    ways.sort(key=lambda way: way[:2])
    fewest = [reading for changes, _, reading in ways if changes == ways[0][0]]
    taken = min(fewest, key=lambda reading: reading.error)
    rivals = tuple(reading for reading in fewest if reading is not taken)
    turned = {_turned(reading.hypothesis, taken.hypothesis) for reading in as_good if reading is not taken} - {()}
    untold = tuple(sorted(joints for joints in turned if not any(set(other) < set(joints) for other in turned)))
    return JointMapping(taken, rivals, untold, spread_of(points))


def _turned(reading: JointReading, other: JointReading) -> tuple[int, ...]:
    """The joints whose signs differ between two readings; empty if the columns differ."""
    if reading.columns != other.columns:
        return ()
    return tuple(k for k, (s, o) in enumerate(zip(reading.signs, other.signs, strict=True)) if s != o)


def unit_by_scale(points: np.ndarray, flange: FlangeKinematics, readings: np.ndarray) -> str:
    """Return the unit in which the spread of points (n_rows, 3) is nearest to the flange's at readings (n_rows, n)."""
    origin = flange.at(readings)[0]
    ratio = np.log(max(spread_of(points), 1e-12) / max(spread_of(origin[np.isfinite(origin).all(axis=1)]), 1e-12))
    return min(SCALES, key=lambda unit: abs(ratio + np.log(SCALES[unit])))
