"""The worst case: poses for the point of the task at which the tool is least sure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.design.search.exchange import information
from calflow.design.search.optimality import ToolError
from calflow.design.search.relaxation import relaxed
from calflow.design.search.search import Found, search

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
