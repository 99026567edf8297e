"""Standstills: the instants of a recording at which a robot has settled, and what was recorded meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STANDS_STILL = 1e-3  # rad or m within which a joint that stands still stays, or what noise has if that is more
NOISE = 8.0  # standard deviations of noise that the extremes of a standstill are apart
SHORTEST_STANDSTILL = 0.4  # s that a standstill lasts
SETTLING = 0.25  # of a standstill that passes before it counts
DENSE = 0.34  # s between rows up to which they are a recording's
FEWEST_SAMPLES = 4


@dataclass(frozen=True)
class Standstill:
    """A standstill: its first and last sample, and the times [s] between which it counts."""

    first: int
    last: int
    begin: float
    end: float

    def counts(self, time: np.ndarray) -> np.ndarray:
        """Return which samples were recorded while it counts, (n_samples,)."""
        return (time >= self.begin) & (time <= self.end)


def is_recording(time: np.ndarray) -> bool:
    """Return whether rows are a recording's: many in a second, most of them next to the row before."""
    if len(time) < 20:
        return False
    step = float(np.median(np.diff(np.sort(time))))
    return 0 < step < DENSE


def find_standstills(time: np.ndarray, readings: np.ndarray) -> list[Standstill]:
    """Return the standstills of readings (n_samples, n) [rad, or m] in order of time (n_samples,) [s].

    A standstill is as long as all joints stay within what noise is; its beginning, in which it settles, does not count.
    """
    steps = np.diff(readings, axis=0)
    noise = 1.4826 * np.median(np.abs(steps), axis=0) / np.sqrt(2)
    moving = np.median(np.abs(steps).max(axis=1)) > STANDS_STILL  # then the median step is no noise
    within = np.full(readings.shape[1], STANDS_STILL) if moving else np.maximum(STANDS_STILL, NOISE * noise)
    standstills, first = [], 0
    low = high = readings[0]
    for k in range(1, len(readings) + 1):
        if k < len(readings):
            lower, upper = np.minimum(low, readings[k]), np.maximum(high, readings[k])
            if (upper - lower <= within).all():
                low, high = lower, upper
                continue
        if k - first >= FEWEST_SAMPLES and time[k - 1] - time[first] >= SHORTEST_STANDSTILL:
            begin = time[first] + SETTLING * (time[k - 1] - time[first])
            standstills.append(Standstill(first, k - 1, float(begin), float(time[k - 1])))
            first = k
        else:  # the window slides on: what it began with is left behind
            first += 1
            while first < k and k < len(readings) and (np.ptp(readings[first : k + 1], axis=0) > within).any():
                first += 1
        if k < len(readings):
            low, high = readings[first : k + 1].min(axis=0), readings[first : k + 1].max(axis=0)
    return _merged(standstills, readings, within)


def _merged(standstills: list[Standstill], readings: np.ndarray, within: np.ndarray) -> list[Standstill]:
    """Standstills that follow each other at the same readings are one."""
    merged: list[Standstill] = []
    for standstill in standstills:
        if merged:
            before = merged[-1]
            apart = np.abs(
                np.median(readings[standstill.first : standstill.last + 1], axis=0)
                - np.median(readings[before.first : before.last + 1], axis=0)
            )
            if standstill.first - before.last <= FEWEST_SAMPLES and (apart <= within).all():
                merged[-1] = Standstill(before.first, standstill.last, before.begin, standstill.end)
                continue
        merged.append(standstill)
    return merged
