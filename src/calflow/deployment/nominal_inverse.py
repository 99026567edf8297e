"""Nominal inverse: joint readings that the nominal robot would be sent to, where nobody gives them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calflow.deployment.compensation import Landing, landing
from calflow.deployment.targets import Targets, features
from calflow.estimation.groups import members
from calflow.model import Model
from calflow.robot.loop import reachable
from calflow.robot.robot import Robot

ROUNDING = 1e-9  # rad or m
DRAWN = 4000  # poses drawn within the limits
MOST_DRAWN, LEAST_DRAWN = 10 * DRAWN, 500  # of all places of external axes together, and at each
TRIED = (0, 4, 12, 28)  # how many of the nearest of them a target is approached from, as long as none leads there
BLOCK = 500  # targets whose distances from all poses are worked out at once


def nominal_readings(model: Model, rows: np.ndarray, targets: Targets, rng: np.random.Generator) -> np.ndarray:
    """Return readings (n, n_joints) with which the nominal robot lands on the targets, or comes nearest to them.

    It approaches each target from the nearest of many poses drawn within the limits, and takes what lands there furthest
    from the limits. rows are packed conditions (n_conditions, n), of whose readings only those of external axes count: these
    stay.
    """
    robot = model.robot
    rigid, none = Model(robot, (), model.given), np.zeros(0)
    close = near(rigid, rows, targets, rng)
    found = close[:, 0].copy()
    left = np.arange(len(targets))
    for first, last in pairwise(TRIED):
        tried = close[left, first:last]
        if not tried.size:
            break
        every = np.repeat(left, tried.shape[1])
        landed = landing(rigid, none, rows[:, every], targets.only(every), tried.reshape(len(every), -1))
        best = best_of(robot, landed, tried.shape[1])
        found[left], reached = landed.readings[best], landed.reached[best]
        left = left[~reached]
    return np.asarray(found)


def near(rigid: Model, rows: np.ndarray, targets: Targets, rng: np.random.Generator) -> np.ndarray:
    """Return readings at which the tool is near each target, the nearest first, shape (n, most tried, n_joints)."""
    robot = rigid.robot
    places, of = np.zeros((1, 0)), np.zeros(len(targets), dtype=int)
    if robot.external:
        places, of = np.unique(rows[robot.external].T, axis=0, return_inverse=True)
    number = int(np.clip(MOST_DRAWN // len(places), LEAST_DRAWN, DRAWN))
    found = np.empty((len(targets), TRIED[-1], robot.n_joints))
    for place, own in zip(places, members(of.ravel()), strict=True):
        readings = _drawn(robot, place, number, rng)
        nearest = _nearest(rigid, readings, rows[:, own], targets.only(own))
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


def _nearest(rigid: Model, readings: np.ndarray, rows: np.ndarray, targets: Targets) -> np.ndarray:
    """Which of the poses are nearest to each target, the nearest first, shape (n, most tried)."""
    n = rigid.robot.n_joints
    first = n + len(rigid.robot.payloads)
    marker = rows[first : first + len(rigid.robot.markers)].argmax(axis=0)
    found = np.empty((len(targets), min(TRIED[-1], len(readings))), dtype=int)
    for own in np.unique(marker):
        which = np.flatnonzero(marker == own)
        there = np.vstack([readings.T, np.repeat(rows[n:, which[:1]], len(readings), axis=1)])
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
