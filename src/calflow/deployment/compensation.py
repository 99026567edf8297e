"""Compensation: joint readings whose true tool position, by the calibrated model, lands on a target."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.model import Model, over_rows
from calflow.robot.loop import reachable

LANDED = 1e-6  # m: what is as near as this is there
TURNS = 60  # rounds of Gauss-Newton
LONGEST_STEP = 0.3  # rad or m that a joint may move in a round
DRAWN, TRIED = 2000, 12  # poses drawn within the limits, and how many of the nearest a target is approached from
WITHIN = 1e-9  # rad or m


@dataclass(frozen=True)
class Landing:
    """Joint readings (n, n_joints) [rad, or m], how far from the targets they land (n,) [m], and whether that is on them (n,).

    A target that is out of reach has the readings that come nearest to it within the joint limits.
    """

    readings: np.ndarray
    remaining: np.ndarray
    reached: np.ndarray


def landing(model: Model, p: np.ndarray, rows: np.ndarray, targets: np.ndarray, start: np.ndarray) -> Landing:
    """Return the readings nearest to a start that land on the targets.

    Gauss-Newton on the graph: of all readings that land there, by its slope, each round takes those with the smallest change
    from the start; a joint that would pass its limit stays there, and the others make up for it.

    Args:
        model: the calibrated model.
        p: its parameters (n_parameters,).
        rows: packed conditions (n_conditions, n), whose readings are replaced.
        targets: positions (n, 3) [m] in the measuring frame.
        start: readings (n, n_joints) [rad, or m].
    """
    robot, n = model.robot, model.robot.n_joints
    mixed = np.linalg.inv(robot.reading_matrix)  # readings of joint angles
    low, high = robot.limits.T
    parameters, c, predicted = model.symbols
    slope = ca.jacobian(predicted.point, c[:n]) @ ca.sparsify(ca.DM(mixed))
    graph = ca.Function("landing", [parameters, c], [ca.densify(predicted.point), ca.densify(slope).T])

    def at(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        point, jacobian = over_rows(graph, p, np.vstack([(q @ mixed.T).T, rows[n:]]))
        return targets - point.T, jacobian.T.reshape(len(q), 3, n)

    begun = np.clip(start @ robot.reading_matrix.T, low, high)
    q = begun
    best, least = begun, np.full(len(q), np.inf)
    for _ in range(TURNS):
        lacking, jacobian = at(q)
        distance = np.linalg.norm(np.nan_to_num(lacking, nan=np.inf), axis=1)
        nearer = distance < least
        best, least = np.where(nearer[:, None], q, best), np.minimum(distance, least)
        aim = _aimed(begun, q, lacking, jacobian, low, high)
        step = aim - q
        longest = np.abs(step).max(axis=1)
        if (longest < WITHIN).all():
            break
        q = q + step * np.minimum(1.0, LONGEST_STEP / np.maximum(longest, WITHIN))[:, None]
        q = np.where(np.isfinite(q).all(axis=1)[:, None], q, best)
    lacking, _ = at(q)
    last = np.linalg.norm(np.nan_to_num(lacking, nan=np.inf), axis=1)
    kept = last < LANDED  # the last round changes the least from the start
    q, remaining = np.where(kept[:, None], q, best), np.where(kept, last, least)
    return Landing(q @ mixed.T, remaining, (remaining < LANDED) & reachable(robot, q))


def nominal_readings(model: Model, rows: np.ndarray, targets: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return readings (n, n_joints) with which the nominal robot lands on the targets (n, 3) [m], or comes nearest to them.

    It approaches each target from the nearest of many poses drawn within the limits, and takes what lands there furthest
    from the limits.
    """
    robot, p = model.robot, model.nominal
    low, high = robot.limits.T
    drawn = rng.uniform(low, high, (DRAWN, robot.n_joints))
    drawn = drawn[reachable(robot, drawn)]
    mixed = np.linalg.inv(robot.reading_matrix)
    points = model.point(p, np.vstack([(drawn @ mixed.T).T, np.tile(rows[robot.n_joints :, :1], len(drawn))]))
    nearest = np.argsort(np.linalg.norm(points[None] - targets[:, None], axis=2), axis=1)[:, :TRIED]
    n_tried = nearest.shape[1]
    every = landing(
        model,
        p,
        np.repeat(rows, n_tried, axis=1),
        np.repeat(targets, n_tried, axis=0),
        drawn[nearest.ravel()] @ mixed.T,
    )
    room = _room(every.readings @ robot.reading_matrix.T, low, high).reshape(-1, n_tried)
    reached, remaining = every.reached.reshape(-1, n_tried), every.remaining.reshape(-1, n_tried)
    best = np.where(reached.any(axis=1), np.where(reached, room, -np.inf).argmax(axis=1), remaining.argmin(axis=1))
    return every.readings.reshape(len(targets), n_tried, -1)[np.arange(len(targets)), best]


def _aimed(
    begun: np.ndarray, q: np.ndarray, lacking: np.ndarray, jacobian: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Angles (n, n_joints) nearest to those begun with that land by the slope at q, within the limits."""
    held = np.zeros(q.shape, dtype=bool)
    aim = begun
    for _ in range(q.shape[1]):
        free = jacobian * ~held[:, None, :]
        anchor = np.where(held, np.clip(aim, low, high), begun)
        left = lacking - np.einsum("nij,nj->ni", jacobian, anchor - q)
        aim = anchor + np.einsum("nji,ni->nj", np.linalg.pinv(free), left)
        beyond = ~held & ((aim < low - WITHIN) | (aim > high + WITHIN))
        if not beyond.any():
            break
        held |= beyond
    return np.clip(aim, low, high)


def _room(q: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """How far the joint nearest to a limit is from it, as a share of its travel (n,)."""
    return np.asarray((np.minimum(q - low, high - q) / (high - low)).min(axis=1))
