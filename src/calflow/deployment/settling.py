"""Settling: the few further poses that tell what has moved from what else may have, or by how much."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calflow.deployment.alignment import rigid_slope
from calflow.deployment.check import ANYWHERE, Check
from calflow.deployment.drift import Explained
from calflow.deployment.movements import Movement, movements
from calflow.design.candidates import candidates
from calflow.design.isolability.t_optimality import TCriterion, propose
from calflow.design.search.exchange import greedy
from calflow.design.search.optimality import Parameters
from calflow.estimation.calibrated import Identified
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements

CANDIDATES = 300  # poses to choose from
FEW = 4  # poses that are proposed
MOST_RIVALS = 3  # the nearest, of which the poses tell


@dataclass(frozen=True)
class Settling:
    """Poses to measure next: joint readings (n, n_joints), and the chance that the rivals are excluded after them."""

    readings: np.ndarray
    payload: str
    marker: str
    chance: float


@dataclass(frozen=True)
class _Slopes:
    """Whitened derivatives by what the calibration left open: of the check's coordinates (n, k), and of candidates (m, 3, k)."""

    seen: np.ndarray
    new: np.ndarray


def settling(
    known: Identified, data: Measurements, check: Check, best: Explained, rivals: list[Explained], fitted: bool,
    rng: np.random.Generator,
) -> Settling | None:  # fmt: skip
    """Choose a few poses by which the best explanation is told from its rivals (T-optimality), or known better where it has none.

    None where no poses can be drawn.
    """
    payload, marker = (str(data.table[name].iloc[0]) for name in ("payload", "marker"))
    bare = replace(known, model=replace(known.model, given=()), alternatives=())
    try:
        readings, rows = candidates(bare.model, CANDIDATES, payload, marker, None, rng)
    except InputError:
        return None
    model = bare.model
    new = Measurements.from_arrays(model.robot, readings, None, payload=payload, marker=marker)
    there = {one.name: one for one in movements(bare, new, not fitted)}
    sigma = float(np.sqrt(check.own.mean()))
    if not rivals or best.movement.name not in there:
        own = there.get(best.movement.name)
        if own is None:
            return None
        slope = own.slope * own.sd / sigma
        chosen = greedy(slope, np.diag((own.sd / best.sd) ** 2), FEW, Parameters(len(own.sd)))
        return Settling(readings[chosen], payload, marker, float("nan"))
    open_ = _left_open(known, data, check, bare, rows, sigma, fitted)
    every = [best, *rivals[:MOST_RIVALS]]
    criteria, pairs = {}, []
    for k, rival in enumerate(every[1:], start=1):
        if rival.movement.name in there:
            pairs.append((0, k))
            for one, other in ((0, k), (k, 0)):
                criteria[one, other] = _criterion(check, open_, every[one], every[other], there, sigma)
    if not pairs:
        return None
    chosen, after = propose(criteria, pairs, FEW)
    return Settling(readings[chosen], payload, marker, min(one.chance for one in after.values()))


def _left_open(
    known: Identified, data: Measurements, check: Check, bare: Identified, rows: np.ndarray, sigma: float, fitted: bool
) -> _Slopes:
    """The parameters in units of what the calibration knows of them, and the device's frame where it is fitted."""
    values, vectors = np.linalg.eigh(known.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    before = data.stating(known.model.given).on(known.model.robot).rows
    slope = np.einsum("nm,mai->nai", check.share, known.model.point_jacobian(known.estimate, before)) @ root
    seen = slope.reshape(len(check.error), -1) / np.sqrt(np.repeat(check.own, 3))[:, None]
    new = bare.model.point_jacobian(known.estimate, rows) @ root / sigma
    if fitted:  # the further poses are measured in a frame of their own
        frame = rigid_slope(bare.model.point(known.estimate, rows)) * ANYWHERE / sigma
        seen = np.hstack([seen, np.zeros((len(seen), 6))])
        new = np.concatenate([new, frame], axis=2)
    return _Slopes(seen, new)


def _criterion(
    check: Check, open_: _Slopes, true: Explained, other: Explained, there: dict[str, Movement], sigma: float
) -> TCriterion:
    """What the true movement does, and how well the other one and what is left open can imitate it."""
    whitening = np.sqrt(np.repeat(check.own, 3))
    imitates = check.columns(other.movement, other.since) * other.movement.sd / whitening[:, None]
    seen = np.hstack([open_.seen, imitates])
    effect = check.columns(true.movement, true.since) @ true.size / whitening
    new = there[other.movement.name]
    further = np.concatenate([open_.new, new.slope * new.sd / sigma], axis=2)
    return TCriterion.of(
        np.eye(seen.shape[1]) + seen.T @ seen, seen.T @ effect, float(effect @ effect),
        there[true.movement.name].slope @ true.size / sigma, further, 0.0,
    )  # fmt: skip
