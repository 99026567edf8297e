"""Compensation: inverse kinematics of the calibrated robot, with the uncertainty of the resulting poses.

Targets are stated in frames; Gauss-Newton on the model's graph finds the joint readings with which the marker lands on
them. Each command comes with its expected error and orientation error, their standard deviations, and the clearance to
joint limits and singular poses. A residual field, which is not in the graph, is corrected by iteration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike

from calflow.deployment.prediction import Missing, StatedModel, as_stated, of_field, rows_at
from calflow.estimation.calibrated_model import (
    CalibratedModel,
    expected_point,
    field_correction,
    position_variance,
    rotation_variance,
    untold_turns,
)
from calflow.estimation.needed_conditions import HOW_TO_GO_ON
from calflow.estimation.noise import members
from calflow.files.deferred import Rotation, pd
from calflow.files.problems import MOST_TOLD, Problem, nearest, refuse, refuse_any
from calflow.files.tables import column, typed
from calflow.files.toml import Seed, checked_arguments
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import approach_and_travel, numbered
from calflow.model import Model, SymbolicPrediction, over_rows
from calflow.observations.pose import Pose
from calflow.robot.formats.frames_file import BASE, MEASURING, TargetFrameTable
from calflow.robot.frames import turning
from calflow.robot.mechanism import READINGS, reachable, reading_columns, shown_readings
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
MOST_UNTOLD = 0.5  # share of a rotation's prior variance left by the measurements, above which a note says so
UNTOLD_ROWS = 100  # rows from which that share is estimated
ELSEWHERE_TRIED = 12  # starts of a target that is not reached from its own
FIELD_ROUNDS = 4  # fixed-point iterations: each reduces the error to about a thousandth
BY_ORDER = f"--in-order derives approach and travel from the order of the targets; {HOW_TO_GO_ON}"
SAME_TRAVEL = 1e-4  # rad or m
SETTLES = 5  # iterations in which approach directions and commands must agree
NEAR_SINGULAR = np.deg2rad(1.0)
MOST_NAMED = 10  # targets that a note names
AXES = ("x", "y", "z")


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


def targets_in_measuring_frame(
    targets: Targets, names: Sequence[str], frames: Mapping[str, TargetFrameTable], calibrated: CalibratedModel,
    conditions: np.ndarray,
) -> Targets:  # fmt: skip
    """Return targets in the measuring frame, each given in the frame of that name.

    Frame "base": the robot's base as calibrated; "measuring" and "": the measuring frame.

    Raises:
        InputError: a frame is unknown.
    """
    every = {"": TargetFrameTable(), MEASURING: TargetFrameTable(), BASE: TargetFrameTable(within="base"), **frames}
    known_names = ", ".join(filter(None, every))
    refuse_any(
        Problem(f"unknown frame '{name}': expected one of {known_names}{nearest(name, every)}", key="frame")
        for name in sorted(set(names) - set(every))[:MOST_TOLD]
    )
    stated = [every[name] for name in names]
    turn = Rotation.from_euler("XYZ", [frame.rotation for frame in stated]).as_matrix()
    placed = np.tile(np.eye(4), (len(targets), 1, 1))
    placed[:, :3, :3], placed[:, :3, 3] = turn, [frame.origin for frame in stated]
    of_base = np.array([frame.within == BASE for frame in stated])
    if of_base.any():
        placed[of_base] = base_placement(calibrated, conditions[:, of_base]) @ placed[of_base]
    turn, origin = placed[:, :3, :3], placed[:, :3, 3]
    position = np.einsum("nij,nj->ni", turn, targets.position) + origin
    return Targets(position, None if targets.rotation is None else turn @ targets.rotation)


def base_placement(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the calibrated pose of the robot's base in the measuring frame, shape (n_rows, 4, 4)."""
    return calibrated.model.figures("base", lambda p, c, at: [at.stands], calibrated.estimate, conditions)[0]


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
    low, high = _bounds(robot)
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


def _bounds(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of the iteration; external axes do not move and are unbounded, even past their limits."""
    low, high = robot.stops.T.copy()
    low[robot.external], high[robot.external] = -np.inf, np.inf
    return low, high


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


def best_of(robot: Robot, landed: Landing, tries: int) -> np.ndarray:
    """Return the index of each target's best try: of those that reach it the furthest from limits, else the nearest."""
    free = room(robot, landed.readings @ robot.reading_matrix.T).min(axis=1)
    worth = np.where(landed.reached, 1 + free, -(landed.away + landed.turned)).reshape(-1, tries)
    return np.asarray(worth.argmax(axis=1) + tries * np.arange(len(worth)))


def turn_sd(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the standard deviations of the tool's rotation about its own axes (n_rows, 3) [rad]."""
    return np.sqrt(rotation_variance(calibrated, conditions))


def not_known(calibrated: CalibratedModel, conditions: np.ndarray) -> list[str]:
    """Return notes on the parts of the orientation in rows (n_conditions, n_rows) that no measurement determined."""
    if any(isinstance(observation, Pose) for observation in calibrated.model.observations):
        return []
    few = conditions[:, np.unique(np.linspace(0, conditions.shape[1] - 1, UNTOLD_ROWS).astype(int))]
    typical = np.sqrt((turn_sd(calibrated, few) ** 2).mean(axis=0))
    robot = calibrated.model.robot
    turned = "turned by tool_rotation_deg of the robot file" if robot.tool_rotation else "as it is"
    problems = [
        f"no orientation was measured, positions only: targets turn the frame of link {robot.n_joints}, {turned}; how the tool "
        "sits on it is not checked"
    ]
    untold = untold_turns(calibrated, few)
    problems += [
        f"the tool's turn about its own {axis} is known to {1e3 * typical[k]:.2g} mrad only, which is an assumption about "
        "robots like this: only measured orientations would show it"
        for k, axis in enumerate("xyz")
        if untold[k] > MOST_UNTOLD
    ]
    return problems


@dataclass(frozen=True)
class Clearance:
    """Clearance of poses to joint limits and singularities.

    joint (n,): index of the joint nearest to a limit, by share of its travel; limit (n,) [rad, or m]: its distance;
    singular (n,) [rad, 1 m of a prismatic joint as 1 rad]: distance in joint space to the nearest singularity.
    """

    joint: np.ndarray
    limit: np.ndarray
    singular: np.ndarray


def clearance(model: Model, conditions: np.ndarray, oriented: bool) -> Clearance:
    """Return the clearance of packed rows (n_conditions, n) by the nominal robot.

    The distance to a singularity is to first order: the least singular value of the tool's Jacobian over the norm of
    its gradient. It is accurate near a singularity, and large elsewhere. Without orientations only position counts.
    """
    robot = model.robot
    q = conditions[: robot.n_joints].T @ robot.reading_matrix.T
    share = room(robot, q)
    joint = share.argmin(axis=1)
    low, high = robot.stops.T
    limit = np.take_along_axis(np.minimum(q - low, high - q), joint[:, None], axis=1)[:, 0]
    return Clearance(joint, limit, _to_singularity(Model(robot, (), model.given), conditions, oriented))


def _to_singularity(rigid: Model, conditions: np.ndarray, oriented: bool) -> np.ndarray:
    p, c, predicted = rigid.symbols
    readings = c[: rigid.robot.n_joints]
    moved = np.where(np.isin(np.arange(rigid.robot.n_joints), rigid.robot.external), 0.0, 1.0)
    mixed = ca.sparsify(ca.DM(rigid.robot.angle_matrix * moved))
    slope = ca.jacobian(predicted.point, readings) @ mixed
    if oriented:
        slope = ca.vertcat(slope, turning(predicted.rotation, readings) @ mixed)
    u, v = ca.SX.sym("u", slope.shape[0]), ca.SX.sym("v", slope.shape[1])
    steepest = ca.gradient(ca.dot(u, slope @ v), readings).T @ mixed
    jacobian = ca.Function("jacobian", [p, c], [ca.densify(slope.T)])
    change = ca.Function("change", [p, c, ca.vertcat(u, v)], [ca.densify(steepest.T)])
    none = np.zeros(0)
    slope_of_rows = over_rows(jacobian, none, conditions)[0].T.reshape(conditions.shape[1], *slope.shape)
    left, sizes, right = np.linalg.svd(slope_of_rows, full_matrices=False)
    directions = np.hstack([left[:, :, -1], right[:, -1]])
    slopes = np.linalg.norm(over_rows(change, none, conditions, directions.T)[0], axis=0)
    return np.asarray(np.divide(sizes[:, -1], slopes, out=np.full(len(slopes), np.inf), where=slopes > 0))


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


def landing_from_elsewhere(
    calibrated: CalibratedModel, conditions: np.ndarray, targets: Targets, rng: np.random.Generator
) -> tuple[Landing, np.ndarray]:
    """Return each target's best landing from starts anywhere within limits, and the nominal robot's readings."""
    rigid = Model(calibrated.model.robot, (), calibrated.model.given)
    starts = near(rigid, conditions, targets, rng)[:, :ELSEWHERE_TRIED]
    every = np.repeat(np.arange(len(targets)), starts.shape[1])
    landed = field_landing(calibrated, conditions[:, every], targets.only(every), starts.reshape(len(every), -1))
    best = landed.only(best_of(calibrated.model.robot, landed, starts.shape[1]))
    return best, landing(rigid, np.zeros(0), conditions, targets, best.readings).readings


@dataclass(frozen=True)
class Compensation:
    """Joint readings (n, n_joints) [rad, or m] that reach targets by the calibrated model.

    remaining (n,) [m], turned (n,) [rad]: remaining errors by the model; reached (n,): whether these vanish, else the
    readings come nearest. sd (n, 3) [m]: standard deviations of the position in the measuring frame; turn_sd (n, 3)
    [rad]: of the rotation about the tool's axes, None for free orientations. nominal (n, n_joints): the nominal robot's
    readings, with errors nominal_miss (n,) [m] and nominal_turned (n,) [rad]. data: rows at the readings; notes:
    targets out of reach, unknown quantities. not_physical (n, 3) [m]: the residual field's part, None without a field.
    """

    readings: np.ndarray
    remaining: np.ndarray
    turned: np.ndarray
    reached: np.ndarray
    sd: np.ndarray
    turn_sd: np.ndarray | None
    nominal: np.ndarray
    nominal_miss: np.ndarray
    nominal_turned: np.ndarray
    clearance: Clearance
    data: Measurements
    notes: tuple[str, ...] = ()
    not_physical: np.ndarray | None = None

    @property
    def expected(self) -> np.ndarray:
        """Expected root mean square distance from the target (n,) [m]: remaining error and sd combined."""
        return np.sqrt(self.remaining**2 + (self.sd**2).sum(axis=1))


@checked_arguments
def compensate(
    calibrated: CalibratedModel, targets: ArrayLike, *, start: ArrayLike | None = None,
    payload: str | Sequence[str] | None = None, marker: str | Sequence[str] | None = None, in_order: bool = False,
    missing: Missing = "refuse", seed: Seed = 1, **conditions: ArrayLike,
) -> Compensation:  # fmt: skip
    """Return joint readings with which the marker lands on the targets (see `compensate_rows`).

    They are those nearest to start, which should be the nominal robot's readings. Without start, nominal solutions
    within the joint limits are used, all in one posture of the arm where one reaches all targets. Where targets are
    positions, the orientation stays as near as possible to that of the start; without a start it is free.

    Args:
        calibrated: the calibrated model.
        targets: positions (n, 3), or (3,), or poses (n, 4, 4), or (4, 4), in the measuring frame [m]. A pose has the
            marker's position and the orientation of the last link's frame, with any tool_rotation of the robot.
        start: readings (n, n_joints), or (n_joints,) for all [rad, or m]; a robot with external axes needs theirs, and
            the arm's may be nan.
        payload: name of the payload, for all targets or one per target.
        marker: name of the marker, likewise.
        in_order: the robot goes from target to target, so that approach directions follow from the commands.
        missing: as in `predict`.
        seed: of the random poses from which nominal solutions are searched.
        conditions: as in `predict`; approach is the direction from which each joint will arrive.

    Raises:
        InputError: a condition that an effect needs is missing, or an array is invalid.
    """
    asked, robot = Targets.of(targets), calibrated.model.robot
    n = robot.n_joints
    given = np.full(n, np.nan) if start is None else np.asarray(start, dtype=float)
    if given.shape not in ((n,), (len(asked), n)):
        raise refuse(f"expected shape ({n},) or ({len(asked)}, {n}), found {given.shape}", key="start")
    begun = np.broadcast_to(given, (len(asked), n))
    if np.isnan(begun[:, robot.external]).any():
        named = ", ".join(str(i + 1) for i in robot.external)
        raise refuse(f"expected readings of the external axes (joints {named}): they stay where they are", key="start")
    data = rows_at(calibrated, np.nan_to_num(begun), payload, marker, conditions)
    whole = None if np.isnan(begun).any() else begun
    return compensate_rows(calibrated, data, asked, start=whole, in_order=in_order, missing=missing, seed=seed)


def compensate_rows(
    calibrated: CalibratedModel, data: Measurements, targets: Targets, *, start: np.ndarray | None = None,
    in_order: bool = False, missing: Missing = "refuse", seed: int = 1,
) -> Compensation:  # fmt: skip
    """Return the joint readings, nearest to the nominal robot's, with which the calibrated robot reaches the targets.

    Args:
        calibrated: the calibrated model.
        data: one row per target with payload, marker and conditions; its readings are ignored.
        targets: the target poses.
        start: readings of the nominal robot (n, n_joints) [rad, or m]; None: those of `nominal_readings`.
        in_order: commands follow each other, so that approach directions and travel of the joints follow from them.
        missing: as in `predict_rows`.
        seed: of the random poses from which nominal readings are searched.

    Raises:
        InputError: a condition that an effect needs is missing.
    """
    ways = in_order and "approach" not in data.given
    unknown = np.zeros((len(data), 1))
    if ways:
        unknown[0] = as_stated(calibrated, data, "widen").widened  # nothing says where the first is reached from
        data = _on_the_way(data, data.joints if start is None else start)
    stated = as_stated(calibrated, data, missing, BY_ORDER)
    ways = ways and bool({"approach", "travel"} & set(stated.data.given))
    rng, free, common = np.random.default_rng(seed), start is None, np.ones(len(data), dtype=bool)
    if start is None:
        start, common = nominal_readings(stated.calibrated.model, stated.data.conditions, targets, rng)
    stated = _led(stated, start, ways)
    landed = field_landing(stated.calibrated, stated.data.conditions, targets, start)
    elsewhere = np.zeros(len(data), dtype=bool)
    if not landed.reached.all():
        left = np.flatnonzero(~landed.reached)
        other, nominal = landing_from_elsewhere(
            stated.calibrated, stated.data.conditions[:, left], targets.only(left), rng
        )
        got = left[other.reached]
        if free:
            landed, start = landed.with_rows(got, other.only(other.reached)), start.copy()
            start[got] = nominal[other.reached]
        elsewhere[got] = not free
    settled = np.ones(len(data), dtype=bool)
    for _ in range(SETTLES if ways else 0):
        before, stated = stated, _led(stated, landed.readings, ways)
        settled = _same_way(before.data, stated.data)
        if settled.all():
            break
        conditions, aims = stated.data.conditions[:, ~settled], targets.only(~settled)
        again = field_landing(stated.calibrated, conditions, aims, start[~settled], landed.readings[~settled])
        landed = landed.with_rows(~settled, again)
    found = _judged(stated, targets, start, landed, ways, settled, elsewhere, common)
    return replace(found, sd=np.sqrt(found.sd**2 + unknown))


def _led(stated: StatedModel, readings: np.ndarray, ways: bool) -> StatedModel:
    """Return the rows at readings, with approach and travel where these follow from the order."""
    names = numbered("q", stated.data.robot.n_joints)
    data = replace(stated.data, table=stated.data.table.assign(**dict(zip(names, readings.T, strict=True))))
    return replace(stated, data=_on_the_way(data, readings).stating(stated.data.given) if ways else data)


def _on_the_way(data: Measurements, readings: np.ndarray) -> Measurements:
    """Return the rows with approach and travel of each joint for readings commanded one after another."""
    n = data.robot.n_joints
    names = numbered("q", n)
    came, far = approach_and_travel(pd.DataFrame(readings, columns=names).assign(order=np.arange(len(readings))), names)
    columns = dict(zip([*numbered("approach", n), *numbered("travel", n)], np.hstack([came, far]).T, strict=True))
    return replace(data, table=data.table.assign(**columns))


def _same_way(first: Measurements, other: Measurements) -> np.ndarray:
    """Return whether each row has the same approach in both, and the same travel where that is given (n,)."""
    n, same = first.robot.n_joints, np.ones(len(first), dtype=bool)
    for names, within in ((numbered("approach", n), 0.0), (numbered("travel", n), SAME_TRAVEL)):
        if names[0] in first.table:
            same &= (np.abs(first.table[names].to_numpy() - other.table[names].to_numpy()) <= within).all(axis=1)
    return same


def _judged(
    stated: StatedModel, targets: Targets, start: np.ndarray, landed: Landing, ways: bool, settled: np.ndarray,
    elsewhere: np.ndarray, common: np.ndarray,
) -> Compensation:  # fmt: skip
    """Return the compensation with predicted errors of the readings found and of the nominal ones."""
    calibrated, model = stated.calibrated, stated.calibrated.model
    oriented = targets.rotation is not None

    def misses(conditions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rotation = model.rotation(calibrated.estimate, conditions) if oriented else None
        lacking = targets.lacking(expected_point(calibrated, conditions), rotation)
        return np.linalg.norm(lacking[:, :3], axis=1), np.linalg.norm(lacking[:, 3:], axis=1)

    data = _led(stated, landed.readings, ways).data
    remaining, turned = misses(data.conditions)
    nominal_miss, nominal_turned = misses(_led(stated, start, ways).data.conditions)
    clear = clearance(model, data.conditions, oriented)
    names, lost = data.table["pose"].astype(str).to_numpy(), ~landed.reached
    notes = [
        *_of_rows(f"not reached within the joint limits, from {ELSEWHERE_TRIED} other starts neither", lost & ~elsewhere, names),
        *_of_rows(
            "not reached from the readings given, but from others, with the arm in another posture: give readings near such a "
            "one, or none", lost & elsewhere, names,
        ),
        *_of_rows(
            "reached with the arm in another posture than at the others: it turns over on the way there and back",
            landed.reached & ~common, names,
        ),
        *_of_rows(
            f"nearer than {np.rad2deg(NEAR_SINGULAR):.0f} deg to a singularity, where small corrections turn joints far",
            landed.reached & (clear.singular < NEAR_SINGULAR), names,
        ),
        *_of_rows("a joint moves there by so little that its side of approach depends on the correction itself", ~settled, names),
        *stated.notes,
        *of_field(calibrated, data.conditions),
        *(not_known(calibrated, data.conditions) if oriented else ()),
    ]  # fmt: skip
    return Compensation(
        landed.readings, remaining, turned, landed.reached,
        np.sqrt(position_variance(calibrated, data.conditions) + stated.widened),
        turn_sd(calibrated, data.conditions) if oriented else None,
        start, nominal_miss, nominal_turned, clear, data, tuple(notes),
        field_correction(calibrated, data.conditions) if calibrated.field else None,
    )  # fmt: skip


def _of_rows(what: str, which: np.ndarray, names: np.ndarray) -> list[str]:
    """Return a note that names the targets concerned; nothing where there are none."""
    if not which.any():
        return []
    more = f" and {which.sum() - MOST_NAMED} more" if which.sum() > MOST_NAMED else ""
    return [f"{which.sum()} of {len(which)} targets: {what}: pose {', '.join(names[which][:MOST_NAMED])}{more}"]


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command that reaches a target, with its predicted errors; the targets' own columns precede these."""

    reached: bool = column("whether the robot lands on the target, by the model; else no command is given")
    q: Mapping[str, float] = column("joint readings to command; empty where the target is out of reach", name=READINGS)
    expected_mm: float = column(
        "root mean square distance from the target to expect: remaining_mm and the standard deviations together", "mm"
    )
    remaining_mm: float = column(
        "distance from the target, by the model; out of reach: of the nearest pose within the limits", "mm"
    )
    remaining_mrad: float = column("the same of the orientation; empty: none was asked for", "mrad")
    sd_x_mm: float = column("standard deviation of the tool's position along the measuring frame's x", "mm")
    sd_y_mm: float = column("the same along y", "mm")
    sd_z_mm: float = column("the same along z", "mm")
    sd_rx_mrad: float = column(
        "standard deviation of the tool's rotation about its own x; empty: not asked for", "mrad"
    )
    sd_ry_mrad: float = column("the same about its own y", "mrad")
    sd_rz_mrad: float = column("the same about its own z", "mrad")
    nominal_q: Mapping[str, float] = column("readings of the nominal robot for the target", name=f"nominal_{READINGS}")
    nominal_miss_mm: float = column("distance from the target with these, by the calibrated model", "mm")
    nominal_miss_mrad: float = column("the same of the orientation; empty: none was asked for", "mrad")
    not_physical: Mapping[str, float] = column(
        "the residual field's part of the position, which is not physical; only where the run has such a field",
        "mm",
        name="not_physical_{x|y|z}_mm",
    )
    limit_joint: int = column("the joint nearest to a limit, by share of its travel")
    to_limit: Mapping[str, float] = column(
        "its distance to the limit; empty: the joint is of the other kind, or no joint has limits",
        name="to_limit_{deg|mm}",
    )
    to_singularity_deg: float = column(
        "distance in joint space, to first order, to a singularity, where the tool cannot move in some direction", "deg"
    )
    approach: Mapping[str, int] = column(
        "with --in-order: direction from which each joint arrives, by the order of the commands", name="approach{joint}"
    )


def command_table(compensation: Compensation, in_order: bool) -> pd.DataFrame:
    """Return the table of `Command`s, one row per target."""
    found, robot, clear = compensation, compensation.data.robot, compensation.clearance
    names, nominal = reading_columns(robot), shown_readings(robot, found.nominal)
    given = shown_readings(robot, np.where(found.reached[:, None], found.readings, np.nan))
    oriented, none = found.turn_sd is not None, np.full((len(given), 3), np.nan)
    turns = none if found.turn_sd is None else 1e3 * found.turn_sd
    columns: dict[str, object] = {
        "reached": found.reached,
        **dict(zip(names, given.T, strict=True)),
        "expected_mm": 1e3 * found.expected,
        "remaining_mm": 1e3 * found.remaining,
        "remaining_mrad": 1e3 * found.turned if oriented else none[:, 0],
        **{f"sd_{axis}_mm": 1e3 * found.sd[:, k] for k, axis in enumerate(AXES)},
        **{f"sd_r{axis}_mrad": turns[:, k] for k, axis in enumerate(AXES)},
        **{f"nominal_{name}": values for name, values in zip(names, nominal.T, strict=True)},
        "nominal_miss_mm": 1e3 * found.nominal_miss,
        "nominal_miss_mrad": 1e3 * found.nominal_turned if oriented else none[:, 0],
        "limit_joint": clear.joint + 1,
    }
    if found.not_physical is not None:
        columns |= {f"not_physical_{axis}_mm": 1e3 * found.not_physical[:, k] for k, axis in enumerate(AXES)}
    units, factors = (np.array(figures) for figures in zip(*(joint.shown for joint in robot.joints), strict=True))
    for unit in dict.fromkeys(units):
        rows = (units[clear.joint] == unit) & np.isfinite(clear.limit)
        columns[f"to_limit_{unit}"] = np.where(rows, clear.limit * factors[clear.joint], np.nan)
    columns["to_singularity_deg"] = np.rad2deg(clear.singular)
    sides = [f"approach{i + 1}" for i in robot.driven]
    if in_order and sides[0] in found.data.table:
        columns |= {name: found.data.table[name].astype(int).to_numpy() for name in sides}
    return typed(pd.DataFrame(columns), Command)
