"""The order in which poses are measured: a short tour, or one in which drift is not confounded with joint positions.

It includes the bias of the calibration by drift in each order, and via poses, from which each joint approaches from a
known side, from both sides equally often: in a tour the side of approach, which shows backlash and friction, correlates
with the joint's position, since an outward pose is reached from inside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calflow.design.planned import Order, SelectionRequest
from calflow.design.worth import PlanInformation
from calflow.effects.wording import cause_words
from calflow.files.deferred import pd
from calflow.files.tables import column
from calflow.files.units import METRE
from calflow.files.words import listed
from calflow.measurements.rows import sides_and_travel
from calflow.model import Model

BLOCK_POSES = 10  # poses of a block, drawn from all poses and ordered as a short tour
RANDOM_ORDERS = 50  # random orders tried
VIA_TURNS = (np.deg2rad(2.0), np.deg2rad(10.0))  # least and largest travel of a revolute joint from the via
SLIDES = (0.01, 0.05)  # m: the same of a prismatic joint
TRIES = 20  # attempts at drawing sides for a pose before it gets no via


def shortest_tour(readings: np.ndarray) -> np.ndarray:
    """Order poses for short travel: nearest neighbour, then 2-opt on the largest joint's motion; shape (n_poses,)."""
    distance = np.abs(readings[:, None] - readings[None]).max(axis=2).tolist()  # lists: faster for single elements
    tour = [0]
    left = set(range(1, len(readings)))
    while left:
        last = distance[tour[-1]]
        tour.append(min(left, key=lambda j: last[j]))
        left.remove(tour[-1])
    improved = True
    while improved:
        improved = False
        for i in range(1, len(tour) - 2):
            for j in range(i + 1, len(tour) - 1):
                before = distance[tour[i - 1]][tour[i]] + distance[tour[j]][tour[j + 1]]
                after = distance[tour[i - 1]][tour[j]] + distance[tour[i]][tour[j + 1]]
                if after < before - 1e-9:
                    tour[i : j + 1] = tour[i : j + 1][::-1]
                    improved = True
    return np.array(tour)


def random_blocks(readings: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Order poses (n_poses,) in blocks drawn at random, each on a short tour: drift is then uncorrelated with joint positions."""
    blocks = np.array_split(rng.permutation(len(readings)), max(1, round(len(readings) / BLOCK_POSES)))
    return np.concatenate([block[shortest_tour(readings[block])] for block in blocks])


def travel(readings: np.ndarray) -> float:
    """Return the total travel in this order: the largest joint motion between consecutive poses, summed [rad or m]."""
    return float(np.abs(np.diff(readings, axis=0)).max(axis=1, initial=0.0).sum())


Drifting = Literal["device", "robot"]


@dataclass(frozen=True, kw_only=True)
class DriftPull:
    """The effect of an unmodelled steady drift on the calibration, for one order of the poses."""

    order: Order = column("measuring order of the poses")
    taken: bool = column("whether it is the order of poses.csv")
    travel: float = column("travel between poses relative to the short order, by the joint that moves most")
    drifting: Drifting = column(
        "what drifts steadily: the `device`, in its worst direction; or the `robot`, which expands from its base"
    )
    drift_mm: float = column("the drift from the first pose to the last (of the robot: at the poses' mean)", "mm")
    tool_pull_mm: float = column("resulting bias of the predicted tool position, root mean square over the task", "mm")
    parameter: str = column("the parameter with the largest bias")
    pull_sd: float = column("that bias", "of its standard deviations")


def orders(plan: PlanInformation, rng: np.random.Generator) -> dict[Order, np.ndarray]:
    """Return orders (n,): a short tour, and of many random ones that with the least bias by drift (Daniel and Wilcoxon 1966)."""
    moved = displacements(plan)
    drawn = [random_blocks(plan.readings, rng) for _ in range(RANDOM_ORDERS if moved else 1)]
    steady = min(drawn, key=lambda order: max((drift_bias(plan, order, way)[0] for way in moved.values()), default=0.0))
    return {"short": shortest_tour(plan.readings), "random": steady}


def drift_pulls(plan: PlanInformation, every: Mapping[Order, np.ndarray]) -> list[DriftPull]:
    """Return the bias by the plan's drift in each order (n,) of the poses; none if no positions are measured."""
    drift, moves = plan.request.drift, displacements(plan)
    short = max(travel(plan.readings[every["short"]]), np.finfo(float).tiny)
    pulls = []
    for name, order in every.items():
        for what, moved in moves.items():
            tool, k, sd = drift_bias(plan, order, moved)
            pulls.append(
                DriftPull(order=name, taken=name == plan.request.order, travel=travel(plan.readings[order]) / short, drifting=what,
                          drift_mm=1e3 * drift, tool_pull_mm=1e3 * drift * tool, pull_sd=drift * sd,
                          parameter=plan.model.parameters[k].name)
            )  # fmt: skip
    return pulls


def displacements(plan: PlanInformation) -> dict[Drifting, np.ndarray]:
    """Return displacements (n, 3, n_ways) of poses' points by a drift of 1 m, of the robot on average; none without positions."""
    if plan.request.planned.observation.units[:3] != (METRE,) * 3:
        return {}
    model = plan.model
    out = model.point(model.nominal, plan.request.rows(model, plan.readings)) - model.robot.base.origin
    grown = out / np.linalg.norm(out, axis=1).mean()
    return {"device": np.tile(np.eye(3), (len(out), 1, 1)), "robot": grown[:, :, None]}


def drift_bias(plan: PlanInformation, order: np.ndarray, moved: np.ndarray) -> tuple[float, int, float]:
    """Return the tool's bias [m] by the worst steady displacement (n, 3, n_ways), the parameter moved most, and by how many sd."""
    time = np.empty(len(order))
    time[order] = np.linspace(-0.5, 0.5, len(order))
    seen = np.einsum("n,nup,nuk->pk", time, plan.own[:, :3], moved, optimize=True) / plan.request.planned.sigma
    off = plan.covariance @ seen
    _, sizes, ways = np.linalg.svd(plan.tool.root.T @ off, full_matrices=False)
    pull = np.abs(off @ ways[0]) / np.sqrt(np.diag(plan.covariance))
    k = int(np.argmax(pull))
    return float(sizes[0]), k, float(pull[k])


def drift_words(pulls: Sequence[DriftPull]) -> list[str]:
    """Return in words the bias by each drift in the chosen order, and in the other one."""
    sentences = []
    for worst in (pull for pull in pulls if pull.taken):
        (other,) = (pull for pull in pulls if pull.drifting == worst.drifting and not pull.taken)
        sentences.append(
            f"a drift of the {worst.drifting} by {worst.drift_mm:.3g} mm would move the tool by {worst.tool_pull_mm:.2g} mm in the "
            f"{worst.order} order and by {other.tool_pull_mm:.2g} mm in the {other.order} one, which takes "
            f"{other.travel / worst.travel:.2g} times the travel"
        )
    return sentences


def vias(model: Model, request: SelectionRequest, readings: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the via (n, n_joints) from which every joint moves straight to each pose, from either side equally often.

    Where limits, loop or cell allow one side only it is that; where they allow none, the via is the pose itself.
    """
    robot, (n, n_joints) = model.robot, readings.shape
    sides = np.stack([rng.permutation(np.where(np.arange(n) % 2, 1.0, -1.0)) for _ in range(n_joints)], axis=1)
    least, most = np.array([SLIDES if joint.kind == "prismatic" else VIA_TURNS for joint in robot.joints]).T
    ways = rng.uniform(least, most, readings.shape) * np.isin(np.arange(n_joints), robot.driven)
    points, left = readings.copy(), np.arange(n)
    for _ in range(TRIES):
        angles = (readings[left] - sides * ways[left]) @ robot.reading_matrix.T
        via = readings[left] - np.where(robot.past_limits(angles), -sides, sides) * ways[left]
        good = replace(request, region=None).allowed(model, via)
        points[left[good]] = via[good]
        left = left[~good]
        if not len(left):
            break
        sides = rng.choice([-1.0, 1.0], (len(left), n_joints))
    return points


def reached(readings: np.ndarray, reached_from: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return each joint's direction of approach and travel since it last reversed, (n, n_joints), in order, from vias if any."""
    if reached_from is None:
        return sides_and_travel(readings)
    whole = np.stack([reached_from, readings], axis=1).reshape(-1, readings.shape[1])
    came, travel = sides_and_travel(whole)
    return came[1::2], travel[1::2]


def sides_words(poses: pd.DataFrame, effects: Sequence[str]) -> list[str]:
    """Return in words the sides of approach in poses.csv, if any effect depends on them."""
    if not effects:
        return []
    names = listed([cause_words(effect).name for effect in effects])
    up = (poses[[name for name in poses if str(name).startswith("approach")]] > 0).sum()
    return [
        f"for {names} each joint comes from a via: {up.min()} to {up.max()} times of {len(poses)} upwards, by joint"
    ]
