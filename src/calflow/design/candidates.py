"""Candidate poses within limits, visible to the device; for contact or cameras, with the marker on the surface or in the image."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import scipy

from calflow.design.cell import Cell, refused_words
from calflow.estimation.progress import Say, nobody
from calflow.files.problems import refuse
from calflow.model import Model
from calflow.observations import Observation
from calflow.robot.mechanism import reachable

CONTACT_ROUNDS = 30
CONTACT_TOLERANCE = 1e-6  # m: tolerance of contact
LONGEST_STEP = 0.3  # rad, or m
LARGEST_DRAW = 1 << 15  # poses drawn at once
ROUNDING = 1e-9  # rad or m
MAX_DRAWS = 40  # rounds of sampling before the region counts as unreachable
CELL_FACTOR = 5  # factor of the number of rounds if there is a cell


def in_contact(
    model: Model, observation: Observation, readings: np.ndarray, conditions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return readings (n, n_joints) near given ones at which the nominal robot is in contact, and which converged, (n,).

    Minimum-norm Gauss-Newton from packed conditions, the readings first, cycling through surfaces (see `Observation.touched`).
    """
    point = model.nominal
    reported = observation.touched(model.point(point, conditions), model.rotation(point, conditions))
    conditions, n = conditions.copy(), readings.shape[1]

    def contact(p: ca.SX, c: ca.SX, error: ca.SX) -> list[ca.SX]:
        return [error, ca.jacobian(error, c)[:, :n]]

    for _ in range(CONTACT_ROUNDS):
        left, jacobian = model.observed("contact", contact, observation, point, conditions, reported)
        step = -np.einsum("rnu,ru->rn", np.linalg.pinv(jacobian, rcond=1e-4), left[:, :, 0])
        largest = np.maximum(np.abs(step).max(axis=1), 1e-12)
        conditions[:n] += (step * np.minimum(1.0, LONGEST_STEP / largest)[:, None]).T
    left = model.observed_error(observation, point, conditions, reported)
    return conditions[:n].T, np.linalg.norm(left, axis=1) < CONTACT_TOLERANCE


def candidates(
    model: Model,
    number: int,
    payload: str,
    marker: str,
    region: np.ndarray | None,
    rng: np.random.Generator,
    observation: Observation | None = None,
    cell: Cell | None = None,
    say: Say = nobody,
) -> tuple[np.ndarray, np.ndarray]:
    """Return joint readings (number, n_joints) [rad, or m] and their packed conditions (n_conditions, number), by a Sobol sequence.

    region is a box (2, 3) [m] in the measuring frame that must contain the nominal marker. If an observation requires contact, all
    poses make it. Poses that the cell forbids are rejected, and their number is reported to say.

    Raises:
        InputError: hardly any pose within the joints' ranges reaches the region, or is allowed by the cell.
    """
    sobol = scipy.stats.qmc.Sobol(model.robot.n_joints, rng=rng)
    size = min(LARGEST_DRAW, 1 << int(np.ceil(np.log2(4 * number))))
    rigid = replace(model, effects=(), observations=(), probes=())  # the nominal robot, at a fifth of the cost
    low, high = model.robot.limits.T  # one turn for a joint without limits
    touches = observation is not None and observation.touches
    kept: list[np.ndarray] = []
    refusals: list[np.ndarray] = []
    rounds = MAX_DRAWS * max(1, number // size) * (CELL_FACTOR if cell else 1)
    for _ in range(rounds):
        readings = scipy.stats.qmc.scale(sobol.random(size), low, high) @ model.robot.angle_matrix.T
        if observation is not None and touches:
            conditions = packed_conditions(model, readings, payload, marker)
            readings, touching = in_contact(model, observation, readings, conditions)
            angles = readings @ model.robot.reading_matrix.T
            readings = readings[touching & ((angles >= low) & (angles <= high)).all(axis=1)]
        conditions = packed_conditions(rigid, readings, payload, marker)
        good, refusals_of = admissible(rigid, conditions, marker, None if touches else region, cell, observation)
        kept.append(readings[good])
        refusals.append(refusals_of)
        if sum(map(len, kept)) >= number:
            readings = np.vstack(kept)[:number]
            if cell is not None:
                say(f"of those drawn within joint limits and region {refused_words(np.concatenate(refusals))}")
            return readings, packed_conditions(model, readings, payload, marker)
    left, refused = "reach the region", ""
    if cell is not None:
        left, refused = "are left", f" Of those there {refused_words(np.concatenate(refusals))}"
    base = ", ".join(f"{1e3 * value:z.0f}" for value in model.robot.base.origin)
    loop = ", and does its four-bar loop close there" if model.robot.loop else ""
    asked = f"is the region within the robot's reach{loop}? It is in the measuring frame, with the base at ({base}) mm."
    if observation is not None and touches:  # there is no region then
        left, asked = "can be measured" if cell is None else left, observation.asked
    raise refuse(
        f"of {rounds * size} poses within the joint limits only {sum(map(len, kept))} {left}, {number} are needed: {asked}{refused}"
    )


def admissible(
    model: Model,
    conditions: np.ndarray,
    marker: str,
    region: np.ndarray | None,
    cell: Cell | None,
    observation: Observation | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return which rows (n_conditions, n) are within limits and region, seen and allowed, and the cell's refusals of them."""
    robot, point = model.robot, model.nominal
    angles = conditions[: robot.n_joints].T @ robot.reading_matrix.T
    good = robot.within_limits(angles, ROUNDING)
    if region is not None:
        position = model.position(point, conditions)
        good &= ((position > region[0]) & (position < region[1])).all(axis=1)
    good[good] = reachable(robot, angles[good])
    if observation is not None:
        seen = observation.sees(partial(model.link, p=point, conditions=conditions[:, good]))
        good[good] = True if seen is None else seen
    refusals = np.zeros(good.sum(), dtype=int) if cell is None else cell.refusals(model, conditions[:, good], marker)
    good[good] = refusals == 0
    return good, refusals


def packed_conditions(model: Model, readings: np.ndarray, payload: str | np.ndarray, marker: str) -> np.ndarray:
    """Return packed conditions (n_conditions, n_rows) of readings (n_rows, n_joints), for a marker and payloads, or one."""
    robot, n = model.robot, len(readings)
    payloads = [np.broadcast_to(np.asarray(payload) == name, n) for name in robot.payloads]
    markers = [np.full(n, float(name == marker)) for name in robot.markers]
    rest = model.n_conditions - robot.n_joints - len(payloads) - len(markers)
    return np.vstack([*readings.T, *payloads, *markers, *np.zeros((rest, n))])
