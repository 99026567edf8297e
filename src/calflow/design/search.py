"""The search for optimal poses among candidates, with a bound on the loss of any other choice.

The relaxed design, with fractional weights, proves the bound (equivalence theorem); exact designs follow by rounding
and by greedy addition and exchange, with low-rank updates of all candidates' gains. The minimax criterion of the worst
task point is reduced to a sequence of weighted means.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.design.augmentation import Augmentation
from calflow.design.optimality import Criterion, ToolError, information

GAP = 1e-3  # gap of the squared loss to its bound at which the relaxed design has converged
MOST_ROUNDS = 60
MULTIPLICATIVE_STEPS = 200  # of the multiplicative algorithm in a round
FIRST, ADDED = 500, 300  # candidates in the first round, and those added in each further round
NEGLIGIBLE = 1e-5  # weight below which a pose is dropped from the design
SHORTLIST = 2000  # candidates of largest sensitivity, from which exact designs are chosen
STARTS = 8  # largest number of roundings of the relaxed design
GOOD_GAP = 2e-3  # relative gap to the bound at which rounding ends
LEAST_WEIGHT = 1e-3  # least weight of a candidate in the support of the relaxed design
MINIMAX_ROUNDS = 12  # rounds of reweighting the task points
EAGERNESS = 2.0  # power of a point's variance by which its weight grows in a round
EXCHANGE_PASSES = 20
SMALLEST_GAIN = 1e-6  # relative gain below which an exchange is rounding error


@dataclass(frozen=True, eq=False)
class Relaxed:
    """The weights of a relaxed design, each at most 1, shape (n_candidates,), and the bound that it proves.

    sensitivity (n_candidates,): rate at which the loss falls with each candidate; bound: a lower bound on the loss of
    any exact design of as many poses; loss: the relaxed design's.
    """

    weights: np.ndarray
    sensitivity: np.ndarray
    bound: float
    loss: float


def bound_allows(jacobians: np.ndarray, prior: np.ndarray, number: int, criterion: Criterion, loss: float) -> bool:
    """Return whether the relaxed design's bound permits that a number of poses reaches a loss, as soon as that is decided."""
    for design in relaxed(jacobians, prior, number, criterion):
        if design.bound > loss:
            return False
        if design.loss <= loss:  # no later bound exceeds it
            return True
    return True


def relaxed(
    jacobians: np.ndarray, prior: np.ndarray, number: int, criterion: Criterion, start: np.ndarray | None = None
) -> Iterator[Relaxed]:
    """Yield relaxed designs of a number of poses with the best bound so far, from weights `start` if given; the last is optimal.

    Torsney's multiplicative algorithm (1983) over a few hundred candidates, to which those of largest sensitivity are added until
    the equivalence theorem (Kiefer and Wolfowitz 1960) bounds the gap by a thousandth.
    """
    n = len(jacobians)
    first = min(n, max(FIRST, 3 * number))
    active = np.linspace(0, n - 1, first).astype(int) if start is None else np.flatnonzero(start)
    weights = np.full(first, number / first) if start is None else start[active]
    best = 0.0
    for _ in range(MOST_ROUNDS):
        weights, information_matrix, covariance = _optimised(jacobians[active], prior, number, weights, criterion)
        slope = criterion.slope(covariance)
        sensitivity = sensitivities(jacobians, slope)
        level = criterion.loss(covariance)
        bound = level * np.sqrt(_trace(slope, information_matrix) / _largest_trace(slope, prior, sensitivity, number))
        best, everywhere = max(best, bound), np.zeros(n)
        everywhere[active] = weights
        yield Relaxed(everywhere, sensitivity, best, level)
        if (level / bound) ** 2 < 1 + GAP:
            return
        kept = weights > NEGLIGIBLE
        joining = np.setdiff1d(np.argsort(sensitivity)[-ADDED:], active[kept])
        active = np.concatenate([active[kept], joining])
        weights = _capped(np.append(weights[kept], np.full(len(joining), NEGLIGIBLE * number)), number)


def sensitivities(jacobians: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return |J F|² of each candidate, shape (n_candidates,)."""
    return np.asarray(((jacobians @ slope) ** 2).sum(axis=(1, 2)))


def _optimised(
    jacobians: np.ndarray, prior: np.ndarray, number: int, weights: np.ndarray, criterion: Criterion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return weights optimised by the multiplicative algorithm, with information matrix and covariance."""
    information_matrix = information(jacobians, prior, weights)
    for _ in range(MULTIPLICATIVE_STEPS):
        covariance = np.linalg.inv(information_matrix)
        slope = criterion.slope(covariance)
        sensitivity = sensitivities(jacobians, slope)
        if _largest_trace(slope, prior, sensitivity, number) < (1 + GAP / 2) * _trace(slope, information_matrix):
            break
        weights = _capped(weights * sensitivity**criterion.power, number)
        information_matrix = information(jacobians, prior, weights)
    return weights, information_matrix, np.linalg.inv(information_matrix)


def _trace(slope: np.ndarray, information_matrix: np.ndarray) -> float:
    """Return trace(Fᵀ M F) for a design's information M."""
    return float(np.sum(slope * (information_matrix @ slope)))


def _largest_trace(slope: np.ndarray, prior: np.ndarray, sensitivity: np.ndarray, number: int) -> float:
    """Return an upper bound of trace(Fᵀ M' F) for the information M' of any so many candidates.

    Their loss is at least the design's, times the root of its own trace over this bound: det(M⁻¹M') is at most the p-th
    power of its mean eigenvalue, and trace(A C') trace(C A C M') at least the square of trace(A C) (Cauchy-Schwarz).
    """
    return float(np.sum(slope * (prior @ slope)) + np.partition(sensitivity, -number)[-number:].sum())


def _capped(shares: np.ndarray, number: int) -> np.ndarray:
    """Return shares scaled to add up to a number, none above 1."""
    shares = np.maximum(shares, 1e-12 * shares.max())
    falling = np.sort(shares)[::-1]
    rest = np.cumsum(falling[::-1])[::-1]
    full = np.arange(len(shares))
    scale = (number - full[:number]) / rest[:number]  # with so many weights of 1
    fits = scale * falling[:number] <= 1
    return np.minimum(1.0, shares * (scale[np.argmax(fits)] if fits.any() else 1 / falling[number - 1]))


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The indices of the chosen candidates, their loss, and a lower bound on the loss of any other choice."""

    chosen: list[int]
    loss: float
    bound: float

    @property
    def could_gain(self) -> float:
        """The largest relative reduction of the loss by any other choice."""
        return 1 - self.bound / self.loss


def search_poses(
    jacobians: np.ndarray, prior: np.ndarray, number: int, criterion: Criterion, rng: np.random.Generator
) -> SearchResult:
    """Choose poses by rounding the relaxed design several times, followed by exchanges; arguments as of `greedy`."""
    *_, best = relaxed(jacobians, prior, number, criterion)
    # The support of the relaxed design and nearly as good candidates, the best last.
    shortlist = np.lexsort((best.sensitivity, best.weights >= LEAST_WEIGHT))[-max(SHORTLIST, number) :]
    near, weights = jacobians[shortlist], best.weights[shortlist]
    inside = np.flatnonzero((weights >= LEAST_WEIGHT) | (np.arange(len(weights)) >= len(weights) - number))

    def loss(chosen: list[int]) -> float:
        return criterion.loss(np.linalg.inv(information(near[chosen], prior)))

    def exchanged(start: list[int]) -> list[int]:
        return [int(inside[i]) for i in exchange(near[inside], prior, start, criterion)]

    chosen = exchanged(greedy(near[inside], prior, number, criterion))
    for _ in range(STARTS):
        if best.bound > (1 - GOOD_GAP) * loss(chosen):
            break
        chosen = min(chosen, exchanged(_drawn(weights[inside], number, rng)), key=loss)
    chosen = exchange(near, prior, chosen, criterion)
    return SearchResult([int(shortlist[i]) for i in chosen], loss(chosen), best.bound)


def _drawn(weights: np.ndarray, number: int, rng: np.random.Generator) -> list[int]:
    """Draw candidates without replacement, with probabilities by weight (Gumbel's method)."""
    keys = np.log(np.maximum(weights, 1e-9)) + rng.gumbel(size=len(weights)) * (weights < 1 - LEAST_WEIGHT)
    return [int(i) for i in np.argsort(keys)[::-1][:number]]


def search_worst(
    jacobians: np.ndarray, prior: np.ndarray, number: int, tool: ToolError, rng: np.random.Generator
) -> SearchResult:
    """Choose poses that minimise the tool's largest standard deviation over the task; arguments as of `greedy`.

    The largest variance is at least any weighted mean: the weights that maximise the least mean are found by multiplying each with
    its point's variance, and poses are chosen for that mean. Each bound on the mean also bounds the largest.
    """
    shares, weights, bound = tool.shares, None, 0.0
    for _ in range(MINIMAX_ROUNDS):
        *_, design = relaxed(jacobians, prior, number, replace(tool, shares=shares), weights)
        weights, bound = design.weights, max(bound, design.bound)
        held = weights > 0
        variances = tool.variances(np.linalg.inv(information(jacobians[held], prior, weights[held])))
        shares = shares * (variances / variances.max()) ** EAGERNESS
        shares /= shares.sum()
    result = search_poses(jacobians, prior, number, replace(tool, shares=shares), rng)
    variances = tool.variances(np.linalg.inv(information(jacobians[result.chosen], prior)))
    return SearchResult(result.chosen, float(np.sqrt(variances.max())), bound)


def greedy(jacobians: np.ndarray, prior: np.ndarray, number: int, criterion: Criterion) -> list[int]:
    """Return candidates chosen greedily, each the one that lowers the loss most.

    jacobians (n_candidates, n_axes, n_parameters) are whitened, prior (n_parameters, n_parameters) is the prior information.
    """
    added = _augmentation(jacobians, prior, [], criterion)
    chosen: list[int] = []
    for _ in range(number):
        chosen.append(_best(added, chosen, criterion)[0])
        added = added.updated(chosen[-1])
    return chosen


def exchange(jacobians: np.ndarray, prior: np.ndarray, chosen: Sequence[int], criterion: Criterion) -> list[int]:
    """Swap chosen poses for better candidates until no swap lowers the loss (Fedorov 1972, one pose at a time)."""
    chosen = list(chosen)
    for _ in range(EXCHANGE_PASSES):
        before = list(chosen)
        added = _augmentation(jacobians, prior, chosen, criterion)  # recomputed against accumulated rounding
        for k, old in enumerate(before):
            without = added.updated(old, -1)
            best, gains = _best(without, [*chosen[:k], *chosen[k + 1 :]], criterion)
            if gains[best] > (1 + SMALLEST_GAIN) * gains[old]:
                chosen[k], added = best, without.updated(best)
        if chosen == before:
            break
    return chosen


def _best(added: Augmentation, taken: Sequence[int], criterion: Criterion) -> tuple[int, np.ndarray]:
    """Return the candidate of largest gain, except those taken, and the gains of all."""
    gains = criterion.gains(added)
    gains[list(taken)] = -np.inf
    return int(np.argmax(gains)), gains


def _augmentation(
    jacobians: np.ndarray, prior: np.ndarray, chosen: Sequence[int], criterion: Criterion
) -> Augmentation:
    covariance = np.linalg.inv(information(jacobians[list(chosen)], prior))
    return Augmentation.of(jacobians, covariance, jacobians @ (covariance @ criterion.root))
