"""Trend: by how much what drifts in the course of the measurement would pull the calibration, in each order of the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calflow.design.candidates import pack
from calflow.design.tour import Order, random_blocks, shortest_tour, travel
from calflow.design.worth import PlanInformation
from calflow.files.tables import column

USUAL_DRIFT = 5e-5  # m: of a tracker in an afternoon
DRAWN = 50  # random orders
Drifting = Literal["device", "robot"]


@dataclass(frozen=True, kw_only=True)
class DriftPull:
    """What a steady drift that nobody sees would do, measured in one order."""

    order: Order = column("in which the poses would be measured")
    taken: bool = column("whether it is the order of poses.csv")
    travel: float = column("the way from pose to pose over that of the short order, by the joint that moves most")
    drifting: Drifting = column(
        "what drifts steadily: the `device`, all that it reports one way, the worst; or the `robot`, which grows from its base"
    )
    drift_mm: float = column("by how much, from the first pose to the last (of the robot: at the poses' mean)", "mm")
    tool_pull_mm: float = column("by how much that pulls the predicted tool, root mean square over the task", "mm")
    parameter: str = column("the parameter that is pulled most")
    pull_sd: float = column("by how much", "of its standard deviations")


def orders(plan: PlanInformation, rng: np.random.Generator) -> dict[Order, np.ndarray]:
    """Return the poses' orders (n,): on short ways, and of many in random blocks that in which a drift pulls the tool least.

    Orders that a trend leaves alone: Daniel and Wilcoxon 1966. Where it is not positions that are measured, the first is taken.
    """
    drawn = [random_blocks(plan.readings, rng) for _ in range(DRAWN if _told(plan) else 1)]
    moved = displacements(plan) if _told(plan) else {}
    steady = min(drawn, key=lambda order: max((pulled(plan, order, way)[0] for way in moved.values()), default=0.0))
    return {"short": shortest_tour(plan.readings), "random": steady}


def drift_pulls(
    plan: PlanInformation, every: Mapping[Order, np.ndarray], taken: Order, drift: float
) -> list[DriftPull]:
    """Return what a drift [m] would do in each order (n,) of the poses; nothing where it is not positions that are measured."""
    if not _told(plan):
        return []
    short = max(travel(plan.readings[every["short"]]), np.finfo(float).tiny)
    found = []
    for name, order in every.items():
        for what, moved in displacements(plan).items():
            tool, k, sd = pulled(plan, order, moved)
            found.append(
                DriftPull(order=name, taken=name == taken, travel=travel(plan.readings[order]) / short, drifting=what,
                          drift_mm=1e3 * drift, tool_pull_mm=1e3 * drift * tool, pull_sd=drift * sd,
                          parameter=plan.model.parameters[k].name)
            )  # fmt: skip
    return found


def displacements(plan: PlanInformation) -> dict[Drifting, np.ndarray]:
    """Return in which ways each pose's point would move by 1 m (of the robot: on average), (n, 3, n_ways)."""
    model = plan.model
    rows = pack(model, plan.readings, plan.payload, plan.marker)
    out = model.point(model.nominal, rows) - model.robot.base.origin
    grown = out / np.linalg.norm(out, axis=1).mean()
    return {"device": np.tile(np.eye(3), (len(out), 1, 1)), "robot": grown[:, :, None]}


def pulled(plan: PlanInformation, order: np.ndarray, moved: np.ndarray) -> tuple[float, int, float]:
    """Return by how much the worst of the ways to move (n, 3, n_ways) pulls the tool [m], if it grows steadily in this order.

    And which parameter it pulls most, in its standard deviations.
    """
    time = np.empty(len(order))
    time[order] = np.linspace(-0.5, 0.5, len(order))
    seen = np.einsum("n,nup,nuk->pk", time, plan.own[:, :3], moved, optimize=True) / plan.planned.sigma
    off = plan.covariance @ seen
    _, sizes, ways = np.linalg.svd(plan.tool.root.T @ off, full_matrices=False)
    own = np.abs(off @ ways[0]) / np.sqrt(np.diag(plan.covariance))
    k = int(np.argmax(own))
    return float(sizes[0]), k, float(own[k])


def _told(plan: PlanInformation) -> bool:
    """Whether it is positions that are measured."""
    return plan.planned.observation.units[:3] == ("m",) * 3


def drift_words(pulls: Sequence[DriftPull]) -> list[str]:
    """Say what each drift would pull in the order that was taken, and in the other one."""
    found = []
    for own in (pull for pull in pulls if pull.taken):
        (other,) = (pull for pull in pulls if pull.drifting == own.drifting and not pull.taken)
        found.append(
            f"a {own.drifting} that drifts by {own.drift_mm:.3g} mm would pull the tool by {own.tool_pull_mm:.2g} mm in the "
            f"{own.order} order, by {other.tool_pull_mm:.2g} mm in the {other.order} one, whose ways are "
            f"{other.travel / own.travel:.2g} times as long"
        )
    return found
