"""Drift: whether anything has moved since a robot was calibrated, by a few check poses.

What the check poses miss the calibrated robot by is normal with the device's noise, the model's discrepancy and what the
calibration itself did not know of the parameters. Every movement is tested against that; the smallest p-value of all is
compared with those of draws where nothing moved, so that false alarms are as rare as asked for; where that is rarer than draws
can tell, with the number of tests times itself (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from calflow.deployment.check import Check
from calflow.deployment.movements import Movement

FALSE_ALARM = 0.01
DRAWS = 4000  # of check poses where nothing moved
MOST_MOVED = 3  # things that are told to have moved at once
FOUND = 0.95  # share of movements that a detection limit is found of
WITHIN = 5.0  # in logarithms of evidence: what is nearer to the best is not told from it


@dataclass(frozen=True)
class Explained:
    """A movement since a session (counted from 0): its size (k,) with covariance, p-value, and logarithm of its evidence.

    limit (k,) is the size that would be found in FOUND of cases, of each number alone.
    """

    movement: Movement
    since: int
    size: np.ndarray
    covariance: np.ndarray
    p: float
    evidence: float
    limit: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the size (k,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class Step:
    """One round of the search: every movement explained, best first, and the chance of so small a p-value where nothing moved."""

    explained: tuple[Explained, ...]
    family_p: float

    @property
    def best(self) -> Explained:
        """The movement that explains most."""
        return self.explained[0]

    @property
    def probabilities(self) -> np.ndarray:
        """The probability of each, one of them being true, shape (n,)."""
        evidence = np.array([one.evidence for one in self.explained])
        share = np.exp(evidence - evidence.max())
        return np.asarray(share / share.sum())

    @property
    def names(self) -> dict[str, float]:
        """The probability of each movement by name, since whenever, the largest first."""
        found: dict[str, float] = {}
        for one, probability in zip(self.explained, self.probabilities, strict=True):
            found[one.movement.name] = found.get(one.movement.name, 0.0) + float(probability)
        return dict(sorted(found.items(), key=lambda item: -item[1]))


def searched(check: Check, every: Sequence[Movement], alarm: float, rng: np.random.Generator) -> tuple[Step, ...]:
    """Return the rounds of the search: the last found nothing, or is the one after which no more is told."""
    found: list[Step] = []
    for _ in range(MOST_MOVED):
        step = explained(check, every, alarm, rng)
        found.append(step)
        if step.family_p >= alarm:
            break
        check = check.without(step.best.movement, step.best.since)
        every = [one for one in every if one.name != step.best.movement.name]
    return tuple(found)


def explained(check: Check, every: Sequence[Movement], alarm: float, rng: np.random.Generator) -> Step:
    """Test every movement since every session against all at once.

    A movement explains q of the error's whitened square Q with k numbers; q is divided by what is left per degree of freedom
    where that is more than 1, so that a device that scatters more than stated raises no alarm.
    """
    factor = np.linalg.inv(np.linalg.cholesky(check.covariance))
    whitened, n = factor @ check.error, len(check.error)
    tested, bases = [], []
    for movement in every:
        for since in range(check.sessions):
            slope = factor @ check.columns(movement, since)
            basis = _basis(slope)
            if 0 < basis.shape[1] < n - 1:
                bases.append(basis)
                p = float(chi2.sf(_taken(whitened[:, None], basis)[0], basis.shape[1]))
                tested.append((movement, since, slope, p))
    if not tested:
        return Step((), 1.0)
    least = _least_p(rng.standard_normal((n, DRAWS)), bases)
    threshold = max(float(np.quantile(least, alarm)), alarm / len(tested))
    results = sorted((_explained(whitened, *one, threshold) for one in tested), key=lambda one: -one.evidence)
    smallest = min(one.p for one in results)
    counted = (1 + (least <= smallest).sum()) / (1 + DRAWS)
    return Step(tuple(results), float(min(counted, len(tested) * smallest)))


def together(check: Check, steps: Sequence[Step]) -> tuple[Explained, ...]:
    """Return the best movement of each round, the sizes of all of them estimated together."""
    if not steps:
        return ()
    best = [step.best for step in steps]
    sd = np.concatenate([one.movement.sd for one in best])
    factor = np.linalg.cholesky(check.covariance)
    columns = np.hstack([check.columns(one.movement, one.since) for one in best]) * sd
    scaled, whitened = np.linalg.solve(factor, columns), np.linalg.solve(factor, check.error)
    inverse = np.linalg.inv(scaled.T @ scaled + np.eye(len(sd)))
    size, covariance = sd * (inverse @ scaled.T @ whitened), np.outer(sd, sd) * inverse
    ends = np.cumsum([len(one.size) for one in best])
    spans = [slice(end - len(one.size), end) for one, end in zip(best, ends, strict=True)]
    return tuple(
        replace(one, size=size[own], covariance=covariance[own, own]) for one, own in zip(best, spans, strict=True)
    )


def unexplained(check: Check, step: Sequence[Step]) -> float:
    """Return the chance of so much error where nothing moved but what was found (chi² test of all coordinates)."""
    taken = 0
    for one in step:
        check = check.without(one.best.movement, one.best.since)
        taken += len(one.best.size)
    return float(chi2.sf(check.square, max(1, len(check.error) - taken)))


def _basis(slope: np.ndarray) -> np.ndarray:
    """Orthonormal directions (n, rank) that a movement's columns span."""
    scale = np.linalg.norm(slope, axis=0)
    if not (scale > 0).any():
        return np.zeros((len(slope), 0))
    left, values, _ = np.linalg.svd(slope[:, scale > 0] / scale[scale > 0], full_matrices=False)
    return np.asarray(left[:, values > 1e-6 * values[0]])


def _taken(whitened: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """What of whitened errors (n, m) lies along a basis (n, k), over what is left a degree of freedom where that is more than 1."""
    k, n = basis.shape[1], len(whitened)
    taken = ((basis.T @ whitened) ** 2).sum(axis=0)
    left = ((whitened**2).sum(axis=0) - taken) / (n - k)
    return np.asarray(taken / np.maximum(1.0, left))


def _least_p(drawn: np.ndarray, bases: Sequence[np.ndarray]) -> np.ndarray:
    """The smallest p-value of all bases for each draw (n, m), shape (m,): of bases of one rank it is that of the largest share."""
    most: dict[int, np.ndarray] = {}
    for basis in bases:
        k = basis.shape[1]
        most[k] = np.maximum(most.get(k, 0.0), _taken(drawn, basis))
    return np.min([chi2.sf(taken, k) for k, taken in most.items()], axis=0)


def _explained(
    whitened: np.ndarray, movement: Movement, since: int, slope: np.ndarray, p: float, threshold: float
) -> Explained:
    """A movement's size by generalised least squares with its usual size as prior, and its evidence beside none."""
    scaled = slope * movement.sd
    information = scaled.T @ scaled + np.eye(scaled.shape[1])
    moment = scaled.T @ whitened
    inverse = np.linalg.inv(information)
    size = movement.sd * (inverse @ moment)
    evidence = 0.5 * float(moment @ inverse @ moment) - 0.5 * float(np.linalg.slogdet(information)[1])
    seen = norm.isf(threshold / 2) + norm.ppf(FOUND)
    strength = np.linalg.norm(slope, axis=0)
    limit = np.divide(seen, strength, out=np.full(len(strength), np.inf), where=strength > 0)
    covariance = np.outer(movement.sd, movement.sd) * inverse
    return Explained(movement, since, size, covariance, p, evidence + float(np.log(movement.odds)), limit)
