"""Joint sign: a joint whose readings count the other way, in every row."""

from __future__ import annotations

from itertools import combinations
from typing import ClassVar

import numpy as np

from calflow.faults.base import Check, Correction, Fault, correct, fault
from calflow.faults.reference import Reference, chosen_rows, lengths, level, motion, rough
from calflow.measurements.measurements import Measurements

ROWS = 60  # that tell joint signs apart
FAR_OFF = 0.02  # share of the measured space from which a nominal robot's error makes several wrong signs thinkable
CLOSE = 2.0  # times the error as read up to which another sign is worth a fit, where that error is small
TRIED = 8  # combinations of signs that are placed at most, besides single ones
FITTED, NEARLY = 3, 4.0  # that are fitted at most, and times by which the best of them may be better placed
FEWEST = 3  # poses that are grossly off as read
CLEAR = 0.2  # share of the rows grossly off as read that may be so with the right signs
ALIKE = 0.01  # share of the rows by which combinations may differ: the one with fewer turned signs is meant
EVERY = 7  # joints up to which all combinations are tried, else one or two signs at a time

Signs = tuple[int, ...]  # the joints (index from 0) whose signs are turned


class JointSign(Check):
    """Compare robust fits with the signs as read and with any of them turned.

    A turned sign that another base or tool makes up for exactly cannot be seen, and does no harm.
    """

    id: ClassVar[str] = "joint-sign"
    title: ClassVar[str] = "a joint's readings have the wrong sign"
    order: ClassVar[int] = 10

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return one fault a joint whose sign is wrong."""
        turned = {joints: _with(data, joints) for joints in list(likely(data, reference))[:FITTED]}
        fits = {
            joints: again.fit
            for joints, other in turned.items()
            if (again := Reference.of(other, reference.models)) is not None
        }
        if not fits:
            return ()
        limit = min(fit.gross for fit in fits.values())
        before = reference.miss
        after = {joints: fit.miss(turned[joints]) for joints, fit in fits.items()}
        gross = {joints: int((miss > limit).sum()) for joints, miss in after.items()}
        few = min(gross.values()) + ALIKE * len(data)
        meant = min(
            (joints for joints in fits if gross[joints] <= few), key=lambda j: (len(j), gross[j], fits[j].scale)
        )
        off = before > limit
        if data.table["pose"][off].nunique() < FEWEST or gross[meant] > CLEAR * off.sum():
            return ()
        return tuple(_fault(self, data, joint, _typical(before[off]), _typical(after[meant][off])) for joint in meant)


def _typical(miss: np.ndarray) -> float:
    """Return the median of some errors (n_rows,) [mm]."""
    return 1e3 * float(np.median(miss))


def _fault(check: Check, data: Measurements, joint: int, before: float, after: float) -> Fault:
    statement = (
        f"joint {joint + 1}: all readings have the wrong sign (with it turned, rows that a rough fit "
        f"misses by {before:.3g} mm are met to {after:.2g} mm); turn the sign of column q{joint + 1}, or say "
        f"sign = {-data.robot.joints[joint].sign} for this joint in the robot file"
    )
    return fault(check, data, joint + 1, [_turn(joint)], "corrected", statement)


def _turn(joint: int) -> Correction:
    return Correction(0, f"q{joint + 1}", factor=-1.0)


def _with(data: Measurements, turned: Signs) -> Measurements:
    return correct(data, Fault(JointSign.id, 0, (), "", "corrected", tuple(map(_turn, turned))))


def likely(data: Measurements, reference: Reference) -> dict[Signs, float]:
    """Return the turned signs with which the nominal robot, placed where it fits best, misses by less than as read, best first.

    Each stands with that error [m].
    """
    few = data.only(chosen_rows(np.flatnonzero(data.train), ROWS, len(data)))
    n = data.robot.n_joints
    every = [turned for k in range(n + 1 if n <= EVERY else 3) for turned in combinations(range(n), k)]
    conditions = np.repeat(few.conditions[None], len(every), axis=0)
    for k, turned in enumerate(every):
        conditions[k, list(turned)] *= -1
    nominal, model = reference.models.nominal, reference.models.placed
    points = nominal.position(nominal.nominal, np.concatenate(list(conditions), axis=1)).reshape(
        len(every), len(few), 3
    )
    turn, shift, error = motion(points, few.position)
    miss = level(error)
    single = np.array([len(turned) == 1 for turned in every])
    if miss[0] < FAR_OFF * reference.spread:
        worth = np.flatnonzero(single & (miss < CLOSE * miss[0]))
    else:
        worth = np.union1d(np.flatnonzero(single), np.argsort(miss)[:TRIED])
    worth = worth[worth > 0]
    if not len(worth):
        return {}
    placed = {}
    for k in (0, *worth):
        fit = rough(model, conditions[k], few.position, turn[k], shift[k])
        placed[k] = float(level(lengths(few.position - fit.predicted(conditions[k]))))
    best = min(placed.values())
    left = sorted((k for k in placed if k and placed[k] < min(placed[0], NEARLY * best)), key=placed.__getitem__)
    return {every[k]: placed[k] for k in left}
