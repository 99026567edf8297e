"""Inverse kinematics: targets, the frames they are stated in, and the joint readings with which a model's tool lands on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Literal, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.groups import members
from calflow.files.problems import MOST_TOLD, InputError, Problem, nearest, refuse
from calflow.files.toml import Angles3, FileModel, Lengths3, read_toml
from calflow.model import Model, over_rows
from calflow.robot.chain import reachable
from calflow.robot.robot import Robot
from calflow.robot.transforms import placement, turning

SQUARE = 1e-3  # by which a rotation's columns may miss length 1 and right angles: digits that a file left out


@dataclass(frozen=True)
class Targets:
    """Where tools are to be in the measuring frame: position (n, 3) [m] and, where it counts, rotation (n, 3, 3)."""

    position: np.ndarray
    rotation: np.ndarray | None = None

    @classmethod
    def of(cls, targets: ArrayLike) -> Self:
        """Return what an array asks for: positions (n, 3) or (3,), poses (n, 4, 4) or (4, 4).

        Raises:
            InputError: it has another shape, or what is no number or no rotation.
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
        """Coordinates (n, 3 or 12) whose distances are those of the targets, a radian counted as a metre."""
        return features(self.position, self.rotation)

    def only(self, which: np.ndarray) -> Self:
        """Return these of the targets."""
        return type(self)(self.position[which], None if self.rotation is None else self.rotation[which])

    def lacking(self, point: np.ndarray, rotation: np.ndarray | None) -> np.ndarray:
        """Return what takes tools to their targets, shape (n, 3 or 6).

        It is a shift in the measuring frame [m], then a turn about the tool's own axes [rad]; nan where the tool is nowhere.
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
    """Return coordinates of poses whose distances are metres, and about the radians between their rotations."""
    return position if rotation is None else np.hstack([position, rotation.reshape(-1, 9) / np.sqrt(2)])


MEASURING, BASE = "measuring", "base"


class TargetFrameTable(FileModel):
    """Where a frame stands, in the measuring frame or in the robot's base."""

    origin: Lengths3 = (0.0, 0.0, 0.0)
    rotation: Angles3 = (0.0, 0.0, 0.0)
    within: Literal["measuring", "base"] = "measuring"


class FramesFile(FileModel):
    """A file of frames by name: fixtures, work objects."""

    frames: dict[str, TargetFrameTable]


def read_frames(path: Path) -> dict[str, TargetFrameTable]:
    """Read a file of frames.

    Raises:
        InputError: with all that is wrong in it, or it states a frame that has its name already.
    """
    frames = read_toml(path, FramesFile).frames
    taken = [name for name in frames if name in ("", MEASURING, BASE)]
    if taken:
        raise refuse(f"frame '{taken[0]}' is known without being stated: expected another name", path)
    return frames


def targets_in_measuring_frame(
    targets: Targets,
    names: Sequence[str],
    frames: Mapping[str, TargetFrameTable],
    calibrated: CalibratedModel,
    conditions: np.ndarray,
) -> Targets:
    """Return targets, each stated in the frame of a name, in the measuring frame.

    The frame "base" is the robot's base where the calibration found it; "measuring" and "" are the measuring frame.

    Raises:
        InputError: a frame is unknown.
    """
    every = {"": TargetFrameTable(), MEASURING: TargetFrameTable(), BASE: TargetFrameTable(within="base"), **frames}
    unknown = sorted(set(names) - set(every))
    if unknown:
        known_names = ", ".join(name for name in every if name)
        raise InputError(
            Problem(f"unknown frame '{name}': expected one of {known_names}{nearest(name, every)}", key="frame")
            for name in unknown[:MOST_TOLD]
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
    """Return where the calibration found the robot's base in the measuring frame, shape (n_rows, 4, 4)."""
    p, c, predicted = calibrated.model.symbols
    base = calibrated.model.robot.base
    stands = placement(ca.DM([*base.origin, *base.rotation])) @ placement(predicted.dims.base)
    function = ca.Function("base", [p, c], [ca.densify(ca.vec(stands))])
    return over_rows(function, calibrated.estimate, conditions)[0].T.reshape(-1, 4, 4).transpose(0, 2, 1)


LANDED = 1e-6  # m, and rad: what is as near as this is there
TURNS = 60  # rounds of Gauss-Newton
STALLED = 12  # rounds without getting nearer after which a target is given up from there
LONGEST_STEP = 0.3  # rad or m that a joint may move in a round
WITHIN = 1e-9  # rad or m by which a joint counts as past a limit
SETTLED = 1e-8  # rad or m: a round that changes the readings by less was the last
FLAT = 1e-9  # of the largest singular value, below which the tool does not move at all
DAMPED = 1e-4  # [m²] damping after the first step that led away


@dataclass(frozen=True)
class Landing:
    """Joint readings (n, n_joints) [rad, or m], how far from the targets they land, and whether that is on them (n,).

    away (n,) [m] and turned (n,) [rad] is what remains; turned is 0 where no orientation is asked for. A target that is out of
    reach has the readings that come nearest to it within the joint limits, a radian counted as a metre.
    """

    readings: np.ndarray
    away: np.ndarray
    turned: np.ndarray
    reached: np.ndarray

    def only(self, which: np.ndarray) -> Landing:
        """Return the landings of some targets."""
        return Landing(**{name: values[which] for name, values in vars(self).items()})

    def with_rows(self, which: np.ndarray, others: Landing) -> Landing:
        """Return the landings with those of some targets in the place of their own."""
        own = {name: np.array(values) for name, values in vars(self).items()}
        for name, values in vars(others).items():
            own[name][which] = values
        return Landing(**own)


def landing(
    model: Model,
    p: np.ndarray,
    conditions: np.ndarray,
    targets: Targets,
    start: np.ndarray,
    near: np.ndarray | None = None,
) -> Landing:
    """Return the readings nearest to a start that land on the targets.

    Gauss-Newton on the graph: of all readings that land there, by its slope, each round takes those with the smallest change
    from the start; a joint that would pass its limit stays there, and the others make up for it. External axes stay where the
    start has them. A round that leads away is
    taken back, and damped (Levenberg 1944).

    Args:
        model: the calibrated model.
        p: its parameters (n_parameters,).
        conditions: packed conditions (n_conditions, n), whose readings are replaced.
        targets: where to land.
        start: readings (n, n_joints) [rad, or m] that should change least.
        near: readings from which the rounds begin, where better ones than start are known.
    """
    robot, n = model.robot, model.robot.n_joints
    mixed = robot.angle_matrix
    low, high = _bounds(robot)
    fixed = np.isin(np.arange(n), robot.external)
    graph = _tool(model, mixed, targets.rotation is not None)

    def at(q: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pose, slope = over_rows(graph, p, np.vstack([(q @ mixed.T).T, conditions[n:, which]]))
        rotation = pose[3:].T.reshape(-1, 3, 3).transpose(0, 2, 1) if len(pose) > 3 else None
        return targets.only(which).lacking(pose[:3].T, rotation), slope.T.reshape(len(q), -1, n)

    begun = np.clip(start @ robot.reading_matrix.T, low, high)
    best = begun.copy() if near is None else np.clip(near @ robot.reading_matrix.T, low, high)
    tried, moving = best.copy(), np.arange(len(begun))
    lacking, jacobian = at(best, moving)
    least, damping, waited = np.full(len(begun), np.inf), np.zeros(len(begun)), np.zeros(len(begun), dtype=int)
    for turn in range(TURNS):
        if not len(moving):
            break
        found, slope = (lacking, jacobian) if turn == 0 else at(tried[moving], moving)
        off = np.nan_to_num(np.linalg.norm(found, axis=1), nan=np.inf)
        led_away = off > np.maximum(least[moving], LANDED)
        waited[moving] = np.where(off < (1 - 1e-3) * least[moving], 0, waited[moving] + 1)
        kept = moving[~led_away]
        best[kept], least[kept] = tried[kept], off[~led_away]
        lacking[kept], jacobian[kept] = found[~led_away], slope[~led_away]
        damping[moving] = np.where(led_away, np.maximum(10 * damping[moving], DAMPED), damping[moving] / 10)
        here = best[moving]
        missing, slope = np.nan_to_num(lacking[moving]), np.nan_to_num(jacobian[moving])
        step = _aimed(begun[moving], here, missing, slope, low, high, damping[moving], fixed) - here
        longest, allowed = np.abs(step).max(axis=1), LONGEST_STEP / (1 + damping[moving] / DAMPED)
        tried[moving] = here + step * np.minimum(1.0, allowed / np.maximum(longest, WITHIN))[:, None]
        moving = moving[(longest >= SETTLED) & (waited[moving] < STALLED)]
    remaining = np.nan_to_num(lacking, nan=np.inf)
    away, turned = np.linalg.norm(remaining[:, :3], axis=1), np.linalg.norm(remaining[:, 3:], axis=1)
    readings = best @ mixed.T
    angles = readings @ robot.reading_matrix.T
    there = reachable(robot, angles) & robot.within_limits(angles, WITHIN)
    return Landing(readings, away, turned, (np.maximum(away, turned) < LANDED) & there)


def _bounds(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """The limits within which joints are moved: external axes are not, and stay also where they are past theirs."""
    low, high = robot.stops.T.copy()
    low[robot.external], high[robot.external] = -np.inf, np.inf
    return low, high


def _tool(model: Model, mixed: np.ndarray, oriented: bool) -> ca.Function:
    """Return the function (p, row) -> where the tool is (3,), or that and its rotation (12,); and its slopes by joint angle."""
    p, c, predicted = model.symbols
    readings = c[: model.robot.n_joints]
    point, rotation = predicted.point, predicted.rotation
    slope, pose = ca.jacobian(point, readings), point
    if oriented:
        slope, pose = ca.vertcat(slope, turning(rotation, readings)), ca.vertcat(point, ca.vec(rotation))
    return ca.Function("tool", [p, c], [ca.densify(pose), ca.densify(slope @ ca.sparsify(ca.DM(mixed))).T])


def _aimed(
    begun: np.ndarray, q: np.ndarray, lacking: np.ndarray, jacobian: np.ndarray, low: np.ndarray, high: np.ndarray,
    damping: np.ndarray, fixed: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Angles (n, n_joints) nearest to those begun with that land by the slope at q, within the limits; fixed ones stay."""
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
    """The step (n, n_joints) that makes up for what is missing (n, k), and goes back as far as that leaves it free to."""
    u, s, vt = np.linalg.svd(slope, full_matrices=False)
    moves = s > FLAT * s[:, :1]
    inverse = np.divide(s, s**2 + damping[:, None], out=np.zeros_like(s), where=moves)
    across = np.einsum("nij,nj->ni", vt, back) * moves
    along = inverse * np.einsum("nij,ni->nj", u, missing) - across
    return np.asarray(back + np.einsum("nij,ni->nj", vt, along))


ROUNDING = 1e-9  # rad or m
DRAWN = 4000  # poses drawn within the limits
MOST_DRAWN, LEAST_DRAWN = 10 * DRAWN, 500  # of all places of external axes together, and at each
TRIED = (0, 4, 12, 28)  # how many of the nearest of them a target is approached from, as long as none leads there
BLOCK = 500  # targets whose distances from all poses are worked out at once


def nominal_readings(model: Model, conditions: np.ndarray, targets: Targets, rng: np.random.Generator) -> np.ndarray:
    """Return readings (n, n_joints) with which the nominal robot lands on the targets, or comes nearest to them.

    It approaches each target from the nearest of many poses drawn within the limits, and takes what lands there furthest
    from the limits. conditions (n_conditions, n) are packed, of whose readings only those of external axes count: these
    stay.
    """
    robot = model.robot
    rigid, none = Model(robot, (), model.given), np.zeros(0)
    close = near(rigid, conditions, targets, rng)
    found = close[:, 0].copy()
    left = np.arange(len(targets))
    for first, last in pairwise(TRIED):
        tried = close[left, first:last]
        if not tried.size:
            break
        every = np.repeat(left, tried.shape[1])
        landed = landing(rigid, none, conditions[:, every], targets.only(every), tried.reshape(len(every), -1))
        best = best_of(robot, landed, tried.shape[1])
        found[left], reached = landed.readings[best], landed.reached[best]
        left = left[~reached]
    return np.asarray(found)


def near(rigid: Model, conditions: np.ndarray, targets: Targets, rng: np.random.Generator) -> np.ndarray:
    """Return readings at which the tool is near each target, the nearest first, shape (n, most tried, n_joints)."""
    robot = rigid.robot
    places, of = np.zeros((1, 0)), np.zeros(len(targets), dtype=int)
    if robot.external:
        places, of = np.unique(conditions[robot.external].T, axis=0, return_inverse=True)
    number = int(np.clip(MOST_DRAWN // len(places), LEAST_DRAWN, DRAWN))
    found = np.empty((len(targets), TRIED[-1], robot.n_joints))
    for place, own in zip(places, members(of.ravel()), strict=True):
        readings = _drawn(robot, place, number, rng)
        nearest = _nearest(rigid, readings, conditions[:, own], targets.only(own))
        found[own] = readings[np.resize(nearest.T, (TRIED[-1], len(own))).T]
    return found


def _drawn(robot: Robot, place: np.ndarray, number: int, rng: np.random.Generator) -> np.ndarray:
    """Readings (n, n_joints) within the limits, the external axes at one place; of so many those at which a loop closes."""
    low, high = robot.limits.T
    readings = rng.uniform(low, high, (number, robot.n_joints)) @ robot.angle_matrix.T
    readings[:, robot.external] = place
    angles = readings @ robot.reading_matrix.T
    possible = reachable(robot, angles) & robot.within_limits(angles, ROUNDING)
    return readings[possible] if possible.any() else readings


def room(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return how far each joint is from the nearer of its limits, as a share of its travel, shape as q (n, n_joints).

    A joint without limits is always in the middle.
    """
    low, high = robot.stops.T
    travel = np.where(np.isfinite(high - low), high - low, 1.0)
    return np.where(np.isfinite(high - low), np.minimum(q - low, high - q) / travel, 0.5)


def _nearest(rigid: Model, readings: np.ndarray, conditions: np.ndarray, targets: Targets) -> np.ndarray:
    """Which of the poses are nearest to each target, the nearest first, shape (n, most tried)."""
    n = rigid.robot.n_joints
    first = n + len(rigid.robot.payloads)
    marker = conditions[first : first + len(rigid.robot.markers)].argmax(axis=0)
    found = np.empty((len(targets), min(TRIED[-1], len(readings))), dtype=int)
    for own in np.unique(marker):
        which = np.flatnonzero(marker == own)
        there = np.vstack([readings.T, np.repeat(conditions[n:, which[:1]], len(readings), axis=1)])
        turned = None if targets.rotation is None else rigid.rotation(np.zeros(0), there)
        place = features(rigid.point(np.zeros(0), there), turned)
        for block in np.array_split(which, len(which) // BLOCK + 1):
            far = (place**2).sum(axis=1) - 2 * targets.features[block] @ place.T
            near = np.argpartition(far, found.shape[1] - 1, axis=1)[:, : found.shape[1]]
            order = np.argsort(np.take_along_axis(far, near, axis=1), axis=1)
            found[block] = np.take_along_axis(near, order, axis=1)
    return found


def best_of(robot: Robot, landed: Landing, tries: int) -> np.ndarray:
    """Return each target's best of so many tries: of those that land the one furthest from the limits, else the nearest."""
    free = room(robot, landed.readings @ robot.reading_matrix.T).min(axis=1)
    worth = np.where(landed.reached, 1 + free, -(landed.away + landed.turned)).reshape(-1, tries)
    return np.asarray(worth.argmax(axis=1) + tries * np.arange(len(worth)))
