"""Mistaken check poses: where one alone carries the error, or all are off by more than any robot moves, no movement is told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calflow.deployment.alignment import can_align
from calflow.deployment.attained import Attained
from calflow.deployment.check import Check
from calflow.deployment.drift import WITHIN, Step, unexplained
from calflow.deployment.needed_conditions import NeededCondition
from calflow.deployment.validation import ELSEWHERE, Station, stands
from calflow.estimation.calibrated import Identified
from calflow.measurements.measurements import Measurements


def mistaken(
    known: Identified, needed: list[NeededCondition], data: Measurements, check: Check, told: Sequence[Step], station: Station,
    alarm: float,
) -> str | None:  # fmt: skip
    """Return what to look at before anything is told to have moved; None where movements may explain the error.

    One pose is to be looked at where nothing having moved leaves less of the others' whitened squares than movements leave of all,
    by as much as tells two movements apart, and the others are in place, or not far from it while that one is.
    """
    far = check.size().mean() > ELSEWHERE
    if not told and not far and unexplained(check, ()) >= alarm:
        return None
    moved = check
    for step in told:
        moved = moved.without(step.best.movement, step.best.since)
    for k in np.argsort(-check.size()):
        rest = _rest(known, needed, data, check, k, station)
        if rest is None or not rest.square + 2 * WITHIN < moved.square:
            continue
        if unexplained(rest, ()) >= alarm or rest.size().mean() <= ELSEWHERE < check.size()[k]:
            return _alone(check, int(k))
    if not far:
        return None
    return (
        f"the check poses are off by more than any calibrated robot, {1e3 * check.size().mean():.3g} mm on average: are these rows "
        "of the robot, base, tool, units and signs that were calibrated? What moved is told to first order, which holds for small "
        "movements alone"
    )


def _alone(check: Check, k: int) -> str:
    labels, session = check.table.iloc[k], check.names[check.session[3 * k]]
    named = f"pose {labels['pose']}, marker {labels['marker']}{f', session {session}' if session else ''}"
    return (
        f"{named} alone carries the error, off by {1e3 * check.size()[k]:.3g} mm: was it another pose, another marker, or a beam "
        "that was broken? Measure it again, or leave it out"
    )


def _rest(
    known: Identified, needed: list[NeededCondition], data: Measurements, check: Check, k: int, station: Station
) -> Check | None:
    """The check without a point, as if it had not been measured; None where too few are left."""
    left = data.only(check.share[k] == 0)
    same = check.session[::3] == check.session[3 * k]
    same[k] = False
    if not same.any() or (station == "fitted" and not can_align(check.points[same])):
        return None
    attained = Attained.of(known, left)
    return Check.of(known, needed, left, attained.of_rows(left, stands(attained, station)[0]))
