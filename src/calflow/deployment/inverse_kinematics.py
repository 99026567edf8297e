"""Inverse kinematics of the calibrated robot: the joint readings with which a marker lands on targets.

Gauss-Newton on the model's graph, from given readings or from the nominal robot's, within the joint limits. A residual
field, which is not in the graph, is corrected by iteration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.noise import members
from calflow.files.deferred import Rotation
from calflow.files.problems import refuse
from calflow.model import Model, SymbolicPrediction
from calflow.robot.frames import turning
from calflow.robot.mechanism import reachable
from calflow.robot.robot import Robot

SQUARE = 1e-3  # largest deviation of R'R from the identity, to admit rounded rotation matrices
LANDED = 1e-6  # m, and rad: remaining error of a target that counts as reached
NEWTON_ROUNDS = 60  # iterations of Gauss-Newton
STALLED = 12  # iterations without progress after which a start is given up
LONGEST_STEP = 0.3  # rad or m that a joint may move per iteration
WITHIN = 1e-9  # rad or m by which a joint counts as past a limit
SETTLED_STEP = 1e-8  # rad or m: step length at convergence
IMMOVABLE = 1e-9  # relative to the largest singular value: directions in which the tool does not move
FULL = 1e-18  # relative to the power of the trace: a determinant above it is not due to rounding
DAMPED = 1e-4  # [m²] damping after the first step that increased the error
ROUNDING = 1e-9  # rad or m
DRAWN = 4000  # poses drawn within the limits
MOST_DRAWN, LEAST_DRAWN = 10 * DRAWN, 500  # over all positions of the external axes, and at each
TRIED = 28  # nearest of the drawn poses, from which a target is approached
POSTURES = 8  # postures of the middle target: as many as an arm of six joints has
HOMES = 20  # targets, from the middle on, of which one must be within reach
SAME_POSTURE = 0.1  # rad or m between readings of one posture
NEARBY = 0.1  # m, and rad: distance of targets between which the arm keeps its posture
FIELD_ROUNDS = 4  # fixed-point iterations: each reduces the error to about a thousandth


@dataclass(frozen=True)
class Targets:
    """Target poses of markers in the measuring frame: position (n, 3) [m]; rotation (n, 3, 3), None: free."""

    position: np.ndarray
    rotation: np.ndarray | None = None

    @classmethod
    def of(cls, targets: ArrayLike) -> Self:
        """Return the targets given by an array: positions (n, 3) or (3,), or transforms (n, 4, 4) or (4, 4).

        Raises:
            InputError: another shape, a value that is not finite, or a matrix that is not a rotation.
        """
        array = np.asarray(targets, dtype=float)
        if array.shape == (3,) or array.shape == (4, 4):
            array = array[None]
        if array.shape[1:] not in ((3,), (4, 4)) or not np.isfinite(array).all():
            raise refuse(
                f"expected finite positions of shape (n, 3) or poses of shape (n, 4, 4), found shape {array.shape}",
                key="targets",
            )
        if array.ndim == 2:
            return cls(array)
        turn = array[:, :3, :3]
        wrong = np.abs(turn.transpose(0, 2, 1) @ turn - np.eye(3)).max(axis=(1, 2)) > SQUARE
        wrong |= np.linalg.det(turn) < 0
        if wrong.any():
            raise refuse(f"number {int(np.flatnonzero(wrong)[0])} (from 0) holds no rotation", key="targets")
        return cls(array[:, :3, 3], Rotation.from_matrix(turn).as_matrix())

    def __len__(self) -> int:
        return len(self.position)

    @cached_property
    def features(self) -> np.ndarray:
        """Coordinates (n, 3 or 12) whose Euclidean distances are those of the targets, with 1 rad counted as 1 m."""
        return features(self.position, self.rotation)

    def only(self, which: np.ndarray) -> Self:
        """Return a subset of the targets."""
        return type(self)(self.position[which], None if self.rotation is None else self.rotation[which])

    def lacking(self, point: np.ndarray, rotation: np.ndarray | None) -> np.ndarray:
        """Return the pose errors of tools (n, 3 or 6) that remain to their targets.

        They are a translation in the measuring frame [m], then a rotation vector in the tool's axes [rad]; or nan.
        """
        shift = self.position - point
        if self.rotation is None or rotation is None:
            return shift
        there = np.isfinite(rotation).all(axis=(1, 2))
        turn = np.full(shift.shape, np.nan)
        if there.any():
            between = rotation[there].transpose(0, 2, 1) @ self.rotation[there]
            turn[there] = Rotation.from_matrix(between).as_rotvec()
        return np.hstack([shift, turn])


def features(position: np.ndarray, rotation: np.ndarray | None) -> np.ndarray:
    """Return coordinates of poses whose distances combine metres and, to first order, angles in rad."""
    return position if rotation is None else np.hstack([position, rotation.reshape(-1, 9) / np.sqrt(2)])


@dataclass(frozen=True)
class Landing:
    """Solution of the inverse kinematics: readings (n, n_joints) [rad, or m], errors, and whether it converged.

    away (n,) [m] and turned (n,) [rad] are the remaining errors, turned 0 where the orientation is free; reached (n,).
    A target out of reach has the readings that come nearest within the joint limits, with 1 rad counted as 1 m.
    """

    readings: np.ndarray
    away: np.ndarray
    turned: np.ndarray
    reached: np.ndarray

    def only(self, which: np.ndarray) -> Landing:
        """Return the landings of a subset of targets."""
        return Landing(**{name: values[which] for name, values in vars(self).items()})

    def with_rows(self, which: np.ndarray, others: Landing) -> Landing:
        """Return the landings with those of a subset of targets replaced."""
        columns = {name: np.array(values) for name, values in vars(self).items()}
        for name, values in vars(others).items():
            columns[name][which] = values
        return Landing(**columns)


def landing(
    model: Model, p: np.ndarray, conditions: np.ndarray, targets: Targets, start: np.ndarray,
    near: np.ndarray | None = None,
) -> Landing:  # fmt: skip
    """Return the readings nearest to a start with which the marker is at the targets.

    Gauss-Newton on the graph: each iteration takes, of all readings that reach the target to first order, those nearest
    to the start. A joint at its limit is fixed there, and the others compensate for it; external axes stay where the
    start has them. A step that increases the error is rejected and damped (Levenberg 1944).

    Args:
        model: the calibrated model.
        p: its parameters (n_parameters,).
        conditions: packed conditions (n_conditions, n), whose readings are replaced.
        targets: the target poses.
        start: readings (n, n_joints) [rad, or m] from which to deviate least.
        near: initial readings of the iteration, where better ones than start are known.
    """
    robot, n = model.robot, model.robot.n_joints
    mixed = robot.angle_matrix
    low, high = robot.stops.T.copy()
    low[robot.external], high[robot.external] = -np.inf, np.inf  # they do not move, even past their limits
    fixed = np.isin(np.arange(n), robot.external)
    name = "point_by_angles" if targets.rotation is None else "tool_by_angles"

    def tool(p: ca.SX, c: ca.SX, at: SymbolicPrediction) -> list[ca.SX]:
        readings, by_angle = c[:n], ca.sparsify(ca.DM(mixed))
        slope = ca.jacobian(at.point, readings)
        if targets.rotation is None:
            return [at.point, slope @ by_angle]
        return [at.point, ca.vertcat(slope, turning(at.rotation, readings)) @ by_angle, at.rotation]

    def at(q: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = np.vstack([(q @ mixed.T).T, conditions[n:, which]])
        point, slope, *rotation = model.figures(name, tool, p, rows)
        return targets.only(which).lacking(point[:, :, 0], rotation[0] if rotation else None), slope

    begun = np.clip(start @ robot.reading_matrix.T, low, high)
    best = begun.copy() if near is None else np.clip(near @ robot.reading_matrix.T, low, high)
    tried, moving = best.copy(), np.arange(len(begun))
    lacking, jacobian = at(best, moving)
    least, damping, waited = np.full(len(begun), np.inf), np.zeros(len(begun)), np.zeros(len(begun), dtype=int)
    for turn in range(NEWTON_ROUNDS):
        if not len(moving):
            break
        miss, slope = (lacking, jacobian) if turn == 0 else at(tried[moving], moving)
        off = np.nan_to_num(np.linalg.norm(miss, axis=1), nan=np.inf)
        led_away = off > np.maximum(least[moving], LANDED)
        waited[moving] = np.where(off < (1 - 1e-3) * least[moving], 0, waited[moving] + 1)
        kept = moving[~led_away]
        best[kept], least[kept] = tried[kept], off[~led_away]
        lacking[kept], jacobian[kept] = miss[~led_away], slope[~led_away]
        damping[moving] = np.where(led_away, np.maximum(10 * damping[moving], DAMPED), damping[moving] / 10)
        here = best[moving]
        missing, slope = np.nan_to_num(lacking[moving]), np.nan_to_num(jacobian[moving])
        step = _aimed(begun[moving], here, missing, slope, low, high, damping[moving], fixed) - here
        longest, allowed = np.abs(step).max(axis=1), LONGEST_STEP / (1 + damping[moving] / DAMPED)
        tried[moving] = here + step * np.minimum(1.0, allowed / np.maximum(longest, WITHIN))[:, None]
        moving = moving[(longest >= SETTLED_STEP) & (waited[moving] < STALLED)]
    remaining = np.nan_to_num(lacking, nan=np.inf)
    away, turned = np.linalg.norm(remaining[:, :3], axis=1), np.linalg.norm(remaining[:, 3:], axis=1)
    readings = best @ mixed.T
    angles = readings @ robot.reading_matrix.T
    there = reachable(robot, angles) & robot.within_limits(angles, WITHIN)
    return Landing(readings, away, turned, (np.maximum(away, turned) < LANDED) & there)


def field_landing(
    calibrated: CalibratedModel, conditions: np.ndarray, targets: Targets, start: np.ndarray,
    begun: np.ndarray | None = None,
) -> Landing:  # fmt: skip
    """Return the readings nearest to a start that reach the targets, with the residual field (see `landing`)."""
    landed = landing(calibrated.model, calibrated.estimate, conditions, targets, start, begun)
    if calibrated.field is None:
        return landed
    for _ in range(FIELD_ROUNDS):
        aims = replace(targets, position=targets.position - calibrated.field.correction(landed.readings))
        landed = landing(calibrated.model, calibrated.estimate, conditions, aims, start, landed.readings)
    return landed


def _aimed(
    begun: np.ndarray, q: np.ndarray, lacking: np.ndarray, jacobian: np.ndarray, low: np.ndarray, high: np.ndarray,
    damping: np.ndarray, fixed: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return angles (n, n_joints) nearest to begun that reach the target by the Jacobian at q, within limits."""
    held, aim, left = np.tile(fixed, (len(q), 1)), q.copy(), np.arange(len(q))
    for _ in range(q.shape[1] + 1):
        still = held[left]
        anchor = np.where(still, np.clip(aim[left], low, high), q[left])
        free = jacobian[left] * ~still[:, None, :]
        missing = lacking[left] - np.einsum("nij,nj->ni", jacobian[left], anchor - q[left])
        aim[left] = anchor + _least_change(free, missing, (begun - q)[left] * ~still, damping[left])
        beyond = ~still & ((aim[left] < low - WITHIN) | (aim[left] > high + WITHIN))
        held[left] |= beyond
        left = left[beyond.any(axis=1)]
        if not len(left):
            break
    return np.asarray(np.clip(aim, low, high))


def _least_change(slope: np.ndarray, missing: np.ndarray, back: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Return the step (n, n_joints) that removes the error missing (n, k), with the null-space part of back."""
    if slope.shape[1] != slope.shape[2]:
        return _by_values(slope, missing, back, damping)
    # A square Jacobian of full rank has no null space; factorising takes a fifth of the time of an SVD.
    turned = slope.transpose(0, 2, 1)
    square = turned @ slope + np.maximum(damping, np.finfo(float).tiny)[:, None, None] * np.eye(slope.shape[2])
    plain = np.abs(np.linalg.det(square)) > FULL * np.trace(square, axis1=1, axis2=2) ** slope.shape[2]
    step = np.empty_like(back)
    step[plain] = np.linalg.solve(square[plain], (turned @ missing[:, :, None])[plain])[:, :, 0]
    step[~plain] = _by_values(*(values[~plain] for values in (slope, missing, back, damping)))
    return step


def _by_values(slope: np.ndarray, missing: np.ndarray, back: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Return the same step by singular value decomposition."""
    u, s, vt = np.linalg.svd(slope, full_matrices=False)
    moves = s > IMMOVABLE * s[:, :1]
    inverse = np.divide(s, s**2 + damping[:, None], out=np.zeros_like(s), where=moves)
    across = np.einsum("nij,nj->ni", vt, back) * moves
    along = inverse * np.einsum("nij,ni->nj", u, missing) - across
    return np.asarray(back + np.einsum("nij,ni->nj", vt, along))


def nominal_readings(
    model: Model, conditions: np.ndarray, targets: Targets, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nominal robot's readings (n, n_joints) at the targets, and which share the common posture (n,).

    The middle target is approached from the nearest of many poses drawn within the limits. Of its postures, that is
    kept from which most targets are reached, each starting from the nearest target reached so far. The other targets
    take the solution furthest from the limits, or the nearest pose. conditions (n_conditions, n) are packed; of their
    readings only those of external axes are used, which stay.
    """
    robot = model.robot
    rigid = Model(robot, (), model.given)
    close = near(rigid, conditions, targets, rng)

    def landed(which: np.ndarray, starts: np.ndarray) -> Landing:
        starts[:, robot.external] = conditions[robot.external][:, which].T
        return landing(rigid, np.zeros(0), conditions[:, which], targets.only(which), starts)

    readings, common = close[:, 0].copy(), np.zeros(len(targets), dtype=bool)
    for posture in _postures(robot, targets, close, landed):
        found, reached = _spread(targets, *posture, landed)
        if reached.sum() > common.sum():
            readings, common = np.where(reached[:, None], found, readings), reached
        if common.all():
            break
    left = np.flatnonzero(~common)
    if len(left):
        alone = landed(np.repeat(left, TRIED), close[left].reshape(-1, robot.n_joints))
        readings[left] = alone.readings[best_of(robot, alone, TRIED)]
    return readings, common


Lands = Callable[[np.ndarray, np.ndarray], Landing]


def _postures(robot: Robot, targets: Targets, close: np.ndarray, landed: Lands) -> Iterator[tuple[int, np.ndarray]]:
    """Yield a target near the middle and its solutions, those furthest from limits first, each posture once."""
    middle = targets.features.mean(axis=0)
    for home in np.argsort(np.linalg.norm(targets.features - middle, axis=1), kind="stable")[:HOMES]:
        there = landed(np.full(close.shape[1], home), close[home].copy())
        ways = there.readings[there.reached]
        if len(ways):
            free = room(robot, ways @ robot.reading_matrix.T).min(axis=1)
            ways = ways[np.argsort(-free, kind="stable")]
            alike = np.abs(ways[:, None] - ways).max(axis=2) < SAME_POSTURE
            firsts = np.flatnonzero(alike.argmax(axis=1) == np.arange(len(ways)))
            yield from ((int(home), ways[k]) for k in firsts[:POSTURES])
            return


def _spread(targets: Targets, home: int, readings: np.ndarray, landed: Lands) -> tuple[np.ndarray, np.ndarray]:
    """Return readings of targets reached from one, each from the nearest reached before, and which were reached."""
    place = targets.features
    found, reached = np.tile(readings, (len(targets), 1)), np.zeros(len(targets), dtype=bool)
    reached[home], tried = True, np.full(len(targets), -1)
    while not reached.all():
        there, left = np.flatnonzero(reached), np.flatnonzero(~reached)
        far, which = scipy.spatial.KDTree(place[there]).query(place[left])
        new = tried[left] != there[which]
        if not new.any():
            break
        now = new & (far <= max(2 * far[new].min(), NEARBY))
        left, before = left[now], there[which[now]]
        tried[left] = before
        step = landed(left, found[before])
        found[left[step.reached]], reached[left] = step.readings[step.reached], step.reached
    return found, reached


def near(rigid: Model, conditions: np.ndarray, targets: Targets, rng: np.random.Generator) -> np.ndarray:
    """Return starting readings whose poses are near each target, the nearest first, shape (n, TRIED, n_joints)."""
    robot = rigid.robot
    places, of = np.zeros((1, 0)), np.zeros(len(targets), dtype=int)
    if robot.external:
        places, of = np.unique(conditions[robot.external].T, axis=0, return_inverse=True)
    number = int(np.clip(MOST_DRAWN // len(places), LEAST_DRAWN, DRAWN))
    starts = np.empty((len(targets), TRIED, robot.n_joints))
    for place, rows in zip(places, members(of.ravel()), strict=True):
        readings = drawn_readings(robot, place, number, rng)
        nearest = _nearest(rigid, readings, conditions[:, rows], targets.only(rows))
        starts[rows] = readings[np.resize(nearest.T, (TRIED, len(rows))).T]
    return starts


def _nearest(rigid: Model, readings: np.ndarray, conditions: np.ndarray, targets: Targets) -> np.ndarray:
    """Return the indices of the poses nearest to each target, the nearest first, shape (n, at most TRIED)."""
    n = rigid.robot.n_joints
    first = n + len(rigid.robot.payloads)
    marker = conditions[first : first + len(rigid.robot.markers)].argmax(axis=0)
    nearest = np.empty((len(targets), min(TRIED, len(readings))), dtype=int)
    for name in np.unique(marker):
        which = np.flatnonzero(marker == name)
        there = np.vstack([readings.T, np.repeat(conditions[n:, which[:1]], len(readings), axis=1)])
        turned = None if targets.rotation is None else rigid.rotation(np.zeros(0), there)
        tree = scipy.spatial.KDTree(features(rigid.point(np.zeros(0), there), turned))
        nearest[which] = tree.query(targets.features[which], k=np.arange(1, nearest.shape[1] + 1))[1]
    return nearest


def drawn_readings(robot: Robot, place: ArrayLike, number: int, rng: np.random.Generator) -> np.ndarray:
    """Return random readings (n, n_joints) within limits, external axes at a place, with loops closed if possible."""
    low, high = robot.limits.T
    readings = rng.uniform(low, high, (number, robot.n_joints)) @ robot.angle_matrix.T
    readings[:, robot.external] = place
    angles = readings @ robot.reading_matrix.T
    possible = reachable(robot, angles) & robot.within_limits(angles, ROUNDING)
    return readings[possible] if possible.any() else readings


def room(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return the distance of each joint to its nearer limit as a share of its travel, shape of q (n, n_joints).

    A joint without limits counts as in the middle.
    """
    low, high = robot.stops.T
    travel = np.where(np.isfinite(high - low), high - low, 1.0)
    return np.where(np.isfinite(high - low), np.minimum(q - low, high - q) / travel, 0.5)


def best_of(robot: Robot, landed: Landing, tries: int) -> np.ndarray:
    """Return the index of each target's best try: of those that reach it the furthest from limits, else the nearest."""
    free = room(robot, landed.readings @ robot.reading_matrix.T).min(axis=1)
    worth = np.where(landed.reached, 1 + free, -(landed.away + landed.turned)).reshape(-1, tries)
    return np.asarray(worth.argmax(axis=1) + tries * np.arange(len(worth)))


def landing_from_elsewhere(
    calibrated: CalibratedModel, conditions: np.ndarray, targets: Targets, rng: np.random.Generator
) -> tuple[Landing, np.ndarray]:
    """Return each target's best landing from starts anywhere within limits, and the nominal robot's readings."""
    rigid = Model(calibrated.model.robot, (), calibrated.model.given)
    starts = near(rigid, conditions, targets, rng)
    every = np.repeat(np.arange(len(targets)), starts.shape[1])
    landed = field_landing(calibrated, conditions[:, every], targets.only(every), starts.reshape(len(every), -1))
    best = landed.only(best_of(calibrated.model.robot, landed, starts.shape[1]))
    return best, landing(rigid, np.zeros(0), conditions, targets, best.readings).readings
