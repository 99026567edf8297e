"""Compensation: joint readings with which the true tool, by the calibrated model, lands on a target."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.deployment.targets import Targets
from calflow.model import Model, over_rows
from calflow.robot.loop import reachable
from calflow.robot.robot import Robot
from calflow.robot.transforms import turning

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
    model: Model, p: np.ndarray, rows: np.ndarray, targets: Targets, start: np.ndarray, near: np.ndarray | None = None
) -> Landing:
    """Return the readings nearest to a start that land on the targets.

    Gauss-Newton on the graph: of all readings that land there, by its slope, each round takes those with the smallest change
    from the start; a joint that would pass its limit stays there, and the others make up for it. External axes stay where the
    start has them. A round that leads away is
    taken back, and damped (Levenberg 1944).

    Args:
        model: the calibrated model.
        p: its parameters (n_parameters,).
        rows: packed conditions (n_conditions, n), whose readings are replaced.
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
        pose, slope = over_rows(graph, p, np.vstack([(q @ mixed.T).T, rows[n:, which]]))
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
