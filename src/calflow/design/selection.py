"""Selection: which poses to measure so that they tell the most, by D-optimality, and what every number of them is worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calflow.design.candidates import READINGS, candidates, reading_columns, shown_readings
from calflow.design.optimality import exchange, greedy, indices, log_determinant
from calflow.design.planned import Planned
from calflow.estimation.identifiability import NULL
from calflow.estimation.progress import SAME, Advance, Draws, Say, nobody
from calflow.files.tables import column, to_frame, typed
from calflow.measurements.series import Series
from calflow.model import Model
from calflow.observations.position import Position

USUAL_SIGMA = 5e-5  # m, of a laser tracker on a large robot
TASK_POSES = 400  # candidates over which the tool's expected error is averaged


@dataclass(frozen=True, kw_only=True)
class PlannedPose:
    """A chosen pose, in measuring order: joints, the side each comes from, and where the tool will be."""

    pose: int = column("its number in measuring order")
    readings: Mapping[str, float] = column("reading of each joint", "as named", name=READINGS)
    approach: Mapping[str, int] = column(
        "side each joint comes from: -1, +1; 0 at the first pose, which is reached from anywhere",
        name="approach{joint}",
    )
    nominal_x_mm: float = column("where the nominal robot's marker will be, in the measuring frame", "mm")
    nominal_y_mm: float = column("the same along y", "mm")
    nominal_z_mm: float = column("the same along z", "mm")
    marker: str = column("its name")
    payload: str = column("the load; empty: none")


@dataclass(frozen=True, kw_only=True)
class Observability:
    """What a number of poses, the most telling first, is worth."""

    n_poses: int = column("number of poses")
    indices: Mapping[str, float] = column(
        "observability indices O1 to O5, parameters scaled by their priors", name="O{1|2|3|4|5}"
    )
    expected_sd_mm: float = column(
        "root mean square over the workspace of the predicted position's standard deviation", "mm"
    )


@dataclass(frozen=True)
class Selection:
    """The poses chosen, in measuring order, and what every number of them is worth."""

    poses: pd.DataFrame
    observability: pd.DataFrame


def select(
    model: Model,
    number: int = 100,
    *,
    payload: str = "",
    marker: str = "",
    region: np.ndarray | None = None,
    planned: Planned | None = None,
    of: int = 2000,
    rng: Draws = SAME,
    say: Say = nobody,
    advance: Advance = nobody,
) -> Selection:
    """Choose poses by D-optimal greedy addition and exchange, and tell what every number of them is worth.

    Args:
        model: whose parameters the poses are to tell; it observes what is planned.
        number: of poses.
        payload: the load they are measured under; empty: none.
        marker: what is measured; the first where it is empty.
        region: a box (2, 3) [m] in the measuring frame that the marker must be in.
        planned: how they will be measured; as positions, 50 µm per axis, where nothing is said.
        of: number of candidates.
        rng: draws the candidates.
        say: is told what was gained.
        advance: is told the share of work done.

    Raises:
        InputError: hardly any pose reaches the region.
    """
    marker = marker or next(iter(model.robot.markers))
    planned = planned or Planned(Position.planned(Series()), USUAL_SIGMA)
    if not model.observations:
        model = replace(model, observations=(planned.observation,))
    readings, rows = candidates(model, of, payload, marker, region, rng("candidates"), planned.observation)
    whitened = planned.whitened(model, model.nominal, rows) * model.prior_sd
    prior = np.eye(len(model.parameters))
    say(f"{len(readings)} candidates, {len(model.parameters)} parameters")

    order = greedy(whitened, prior, number)
    advance(0.3)
    best = exchange(whitened, prior, order)
    advance(0.9)
    gained = log_determinant(whitened[best], prior) - log_determinant(whitened[order], prior)
    say(f"exchange gained {gained:.3g} in log det over greedy choice")

    travel = _shortest_tour(readings[best])
    chosen = np.array(best)[travel]
    task = model.point_jacobian(model.nominal, rows[:, :TASK_POSES]) * model.prior_sd / planned.sigma
    worth = _observability(whitened, greedy_order(whitened, prior, best), task, planned.sigma)
    return Selection(_poses(model, readings[chosen], rows[:, chosen], payload, marker), worth)


def greedy_order(whitened: np.ndarray, prior: np.ndarray, chosen: list[int]) -> list[int]:
    """Return the chosen poses, the most telling first."""
    return [chosen[i] for i in greedy(whitened[chosen], prior, len(chosen))]


def _observability(whitened: np.ndarray, order: list[int], task: np.ndarray, sigma: float) -> pd.DataFrame:
    """Indices and the tool's expected standard deviation against the number of poses.

    Parameters are scaled by their priors, so an index compares what the data say with what was known before. The
    standard deviation is the root mean square over the task's poses of the predicted position's, all three axes.
    """
    n_parameters = whitened.shape[2]
    singular = np.linalg.svd(whitened.reshape(-1, n_parameters), compute_uv=False)
    rank = int((singular > NULL * singular[0]).sum())
    first = min(len(order), -(-rank // whitened.shape[1]))
    rows = []
    for n in sorted({*range(first, len(order) + 1, max(1, (len(order) - first) // 30)), len(order)}):
        part = whitened[order[:n]]
        covariance = np.linalg.inv(np.eye(n_parameters) + np.einsum("cai,caj->ij", part, part))
        variance = np.einsum("cai,ij,caj->c", task, covariance, task)
        expected = 1e3 * sigma * np.sqrt(variance.mean())
        own = indices(part.reshape(-1, n_parameters), rank)
        named = {f"O{k}": value for k, value in enumerate(own, start=1)}
        rows.append(Observability(n_poses=n, indices=named, expected_sd_mm=expected))
    return to_frame(rows, Observability)


def _poses(model: Model, readings: np.ndarray, rows: np.ndarray, payload: str, marker: str) -> pd.DataFrame:
    """What a robot programmer needs: joints in measuring order, the side each comes from, and where the tool will be.

    The first pose comes from wherever the robot is, so its approach is 0.
    """
    robot = model.robot
    table: dict[str, object] = {"pose": np.arange(1, len(readings) + 1)}
    table |= dict(zip(reading_columns(robot), np.round(shown_readings(robot, readings), 4).T, strict=True))
    came = np.sign(np.diff(readings, axis=0, prepend=readings[:1])).astype(int)
    for i in robot.driven:
        table[f"approach{i + 1}"] = came[:, i]
    position = 1e3 * model.position(model.nominal, rows)
    table |= {f"nominal_{axis}_mm": np.round(position[:, i], 1) for i, axis in enumerate("xyz")}
    return typed(pd.DataFrame({**table, "marker": marker, "payload": payload}), PlannedPose)


def _shortest_tour(readings: np.ndarray) -> np.ndarray:
    """Order poses for short travel: nearest neighbour, then 2-opt on the largest joint's motion; shape (n_poses,)."""
    distance = np.abs(readings[:, None] - readings[None]).max(axis=2)
    tour = [0]
    left = set(range(1, len(readings)))
    while left:
        tour.append(min(left, key=lambda j: distance[tour[-1], j]))
        left.remove(tour[-1])
    improved = True
    while improved:
        improved = False
        for i in range(1, len(tour) - 2):
            for j in range(i + 1, len(tour) - 1):
                before = distance[tour[i - 1], tour[i]] + distance[tour[j], tour[j + 1]]
                after = distance[tour[i - 1], tour[j]] + distance[tour[i], tour[j + 1]]
                if after < before - 1e-9:
                    tour[i : j + 1] = tour[i : j + 1][::-1]
                    improved = True
    return np.array(tour)
