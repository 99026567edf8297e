"""The search: so many poses of the candidates, and how much better any others could be.

The worst case: poses for the point of the task at which the tool is least sure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calflow.design.exchange import exchange, greedy, information
from calflow.design.optimality import Criterion, ToolError
from calflow.design.relaxation import Relaxed, relaxed

SHORTLIST = 2000  # candidates, those to which the loss is most sensitive, that whole poses are chosen of
STARTS = 8  # designs drawn from the relaxed one at most
GOOD = 2e-3  # share of the loss that could be gained at which no more are drawn
PART = 1e-3  # share of a pose that the relaxed design takes at least of a candidate that it is made of


@dataclass(frozen=True, eq=False)
class Found:
    """The candidates chosen, by their numbers, the loss with them, and a loss below which no others of as many get."""

    chosen: list[int]
    loss: float
    bound: float

    @property
    def could_gain(self) -> float:
        """By what share of it the loss of any other choice could at most be lower."""
        return 1 - self.bound / self.loss


def search(
    jacobians: np.ndarray, prior: np.ndarray, number: int, criterion: Criterion, rng: np.random.Generator
) -> Found:
    """Choose poses by rounding the relaxed design several times and exchanging what was rounded.

    jacobians (n_candidates, n_axes, n_parameters) are whitened, prior (n_parameters, n_parameters) is the information
    before any pose.
    """
    best = relaxed(jacobians, prior, number, criterion)
    shortlist = _shortlist(best, number)
    near, weights = jacobians[shortlist], best.weights[shortlist]
    inside = np.flatnonzero((weights >= PART) | (np.arange(len(weights)) >= len(weights) - number))

    def loss(chosen: list[int]) -> float:
        return criterion.loss(np.linalg.inv(information(near[chosen], prior)))

    def exchanged(start: list[int]) -> list[int]:
        return [int(inside[i]) for i in exchange(near[inside], prior, start, criterion)]

    chosen = exchanged(greedy(near[inside], prior, number, criterion))
    for _ in range(STARTS):
        if best.bound > (1 - GOOD) * loss(chosen):
            break
        chosen = min(chosen, exchanged(_drawn(weights[inside], number, rng)), key=loss)
    chosen = exchange(near, prior, chosen, criterion)
    return Found([int(shortlist[i]) for i in chosen], loss(chosen), best.bound)


def _shortlist(best: Relaxed, number: int) -> np.ndarray:
    """The candidates that the relaxed design is made of, and those that are nearly as good, the best last."""
    order = np.lexsort((best.sensitivity, best.weights >= PART))
    return np.asarray(order[-max(SHORTLIST, number) :])


def _drawn(weights: np.ndarray, number: int, rng: np.random.Generator) -> list[int]:
    """Candidates drawn without repetition, the more of a one is taken the surer: those of largest weight first (Gumbel)."""
    keys = np.log(np.maximum(weights, 1e-9)) + rng.gumbel(size=len(weights)) * (weights < 1 - PART)
    return [int(i) for i in np.argsort(keys)[::-1][:number]]


ROUNDS = 12  # in which points that are less sure come to count more
EAGERNESS = 2.0  # power of a point's variance by which its share grows in a round


def search_worst(
    jacobians: np.ndarray, prior: np.ndarray, number: int, tool: ToolError, rng: np.random.Generator
) -> Found:
    """Choose poses so that the tool's largest standard deviation over the task is small; arguments as of `search`.

    The largest variance is at least any weighted mean of all: the shares with which the least mean is largest are looked for
    by multiplying each with its point's variance, and poses are chosen for that mean. Each round's bound on the mean is one
    on the largest.
    """
    shares, weights, bound = tool.shares, None, 0.0
    for _ in range(ROUNDS):
        design = relaxed(jacobians, prior, number, replace(tool, shares=shares), weights)
        weights, bound = design.weights, max(bound, design.bound)
        held = weights > 0
        variances = tool.variances(np.linalg.inv(information(jacobians[held], prior, weights[held])))
        shares = shares * (variances / variances.max()) ** EAGERNESS
        shares /= shares.sum()
    found = search(jacobians, prior, number, replace(tool, shares=shares), rng)
    variances = tool.variances(np.linalg.inv(information(jacobians[found.chosen], prior)))
    return Found(found.chosen, float(np.sqrt(variances.max())), bound)
