"""Joint sign: a joint whose readings count the other way, in every row."""

from __future__ import annotations

from itertools import combinations
from typing import ClassVar

import numpy as np

from calflow.faults.base import Check, Fault, Mend, fault, mend
from calflow.faults.reference import LEAST_GROSS, Reference, Rough, at_origin, chosen, motion, placement, rough
from calflow.measurements import Measurements
from calflow.model import build

ROWS = 60  # that tell joint signs apart
FAR_OFF = 0.02  # share of the measured space from which a nominal robot's error makes several wrong signs thinkable
CLOSE = 2.0  # times the error as read up to which another sign is worth a fit, where that error is small
TRIED = 8  # combinations of signs that are placed at most, besides single ones
FITTED, NEARLY = 3, 4.0  # that are fitted at most, and times by which the best of them may be better placed
CLEAR = 10.0  # times by which the right signs must lessen the error of a robust fit
ALIKE = 2.0  # times by which the errors of two combinations may differ: the one with fewer turned signs is meant
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
        likely = _likely(data, reference.spread)
        if not likely or reference.fit is None:
            return ()
        fits = {turned: fit for turned in likely if (fit := Reference(_with(self, data, turned)).fit) is not None}
        best, before = min(fit.scale for fit in fits.values()), reference.fit
        if before.scale < max(CLEAR * best, LEAST_GROSS):
            return ()
        meant = min((t for t in fits if fits[t].scale < ALIKE * best), key=lambda t: (len(t), fits[t].scale))
        return tuple(_fault(self, data, joint, before, fits[meant]) for joint in meant)


def _fault(check: Check, data: Measurements, joint: int, before: Rough, after: Rough) -> Fault:
    statement = (
        f"joint {joint + 1}: all readings have the wrong sign (with it turned, a rough fit misses by "
        f"{1e3 * after.scale:.2g} mm instead of {1e3 * before.scale:.3g} mm); turn the sign of column q{joint + 1}, or say "
        f"sign = {-data.robot.joints[joint].sign} for this joint in the robot file"
    )
    return fault(check, data, joint + 1, [_turn(joint)], "corrected", statement)


def _turn(joint: int) -> Mend:
    return Mend(0, f"q{joint + 1}", factor=-1.0)


def _with(check: Check, data: Measurements, turned: Signs) -> Measurements:
    return mend(data, Fault(check.id, 0, (), "", "corrected", tuple(map(_turn, turned))))


def _likely(data: Measurements, spread: float) -> list[Signs]:
    """Return the turned signs with which the nominal robot, placed where it fits best, misses by less than as read."""
    few = data.only(chosen(np.flatnonzero(data.train), ROWS, len(data)))
    n = data.robot.n_joints
    every = [turned for k in range(n + 1 if n <= EVERY else 3) for turned in combinations(range(n), k)]
    rows = np.repeat(few.rows[None], len(every), axis=0)
    for k, turned in enumerate(every):
        rows[k, list(turned)] *= -1
    robot = at_origin(data.robot)
    nominal = build(robot, (), data.given)
    points = nominal.position(nominal.nominal, np.concatenate(list(rows), axis=1)).reshape(len(every), len(few), 3)
    turn, shift, error = motion(points, few.position)
    miss = np.median(error, axis=1)
    single = np.array([len(turned) == 1 for turned in every])
    if miss[0] < FAR_OFF * spread:
        worth = np.flatnonzero(single & (miss < CLOSE * miss[0]))
    else:
        worth = np.union1d(np.flatnonzero(single), np.argsort(miss)[:TRIED])
    worth = worth[(worth > 0) & np.isfinite(miss[worth])]
    if not len(worth):
        return []
    model = placement(robot, data.given)
    placed = {
        k: rough(model, rows[k], (few.position - shift[k]) @ turn[k]).scale for k in (0, *worth) if np.isfinite(miss[k])
    }
    best = min(placed.values())
    left = sorted(
        (k for k in placed if k and placed[k] < min(placed.get(0, np.inf), NEARLY * best)), key=placed.__getitem__
    )
    return [every[k] for k in left[:FITTED]]
