"""How many poses: the fewest that meet a tolerance, the fewest that any choice could meet it with, and what ten more are worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.design.exchange import greedy
from calflow.design.optimality import ToolError
from calflow.design.relaxation import relaxed, sensitivities
from calflow.design.search import SHORTLIST, search
from calflow.files.tables import column

FURTHER = 10  # poses more, of which the worth is told
MOST = 1000  # poses: nobody measures more


@dataclass(frozen=True, kw_only=True)
class HowMany:
    """How many poses are worth their time: the knee of the curve, what ten more are worth, and how many meet the tolerance."""

    n_poses: int = column("number of poses chosen")
    expected_sd_mm: float = column(
        "root mean square over the task of the predicted position's standard deviation with them", "mm"
    )
    next_ten_mm: float = column("by how much ten more of the candidates would lower it", "mm")
    knee_poses: int = column("where the curve of `observability.csv` bends most: fewer cost much, more gain little")
    tolerance_mm: float | None = column("the standard deviation that the study asks for", "mm", default=None)
    enough_poses: int | None = column(
        "poses with which it is met; null: no tolerance, or not with as many as there are", default=None
    )
    needed_poses: int | None = column("no choice of fewer of these candidates meets it", default=None)


def next_best(jacobians: np.ndarray, known: np.ndarray, chosen: list[int], tool: ToolError) -> np.ndarray:
    """Return the ten candidates, besides those chosen, with which the tool's error falls most, the best one after the other."""
    promise = sensitivities(jacobians, tool.slope(np.linalg.inv(known)))
    promise[chosen] = -np.inf
    near = np.argsort(promise)[len(chosen) :][-SHORTLIST:]
    return np.asarray(near[greedy(jacobians[near], known, min(FURTHER, len(near)), tool)])


def knee(numbers: np.ndarray, errors: np.ndarray) -> int:
    """Return the number where a falling curve is furthest below its chord (Satopää et al. 2011)."""
    across = (numbers - numbers[0]) / max(1, numbers[-1] - numbers[0])
    up = (errors - errors[-1]) / max(errors[0] - errors[-1], 1e-300)
    return int(numbers[np.argmax(1 - across - up)])


def enough(
    jacobians: np.ndarray, prior: np.ndarray, tool: ToolError, tolerance: float, rng: np.random.Generator
) -> tuple[int | None, int | None]:
    """Return with how many poses the tool's error [m] meets a tolerance, and how many any choice needs; None where none do.

    The second is the least number whose bound meets it; from there on poses are chosen until they do.
    """

    def possible(number: int) -> bool:
        return relaxed(jacobians, prior, number, tool).bound <= tolerance

    if tool.loss(np.linalg.inv(prior)) <= tolerance:
        return 0, 0
    most = min(MOST, len(jacobians))
    low, high = 0, 1  # of low poses none meet it
    while not possible(high):
        if high == most:
            return None, None
        low, high = high, min(2 * high, most)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if possible(middle) else (middle, high)
    chosen = (n for n in range(high, most + 1) if search(jacobians, prior, n, tool, rng).loss <= tolerance)
    return next(chosen, None), high
