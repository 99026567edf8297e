"""Standstills: the intervals of a recording in which all joints are at rest and have settled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STANDS_STILL = 1e-3  # rad or m: range of a joint's readings at standstill, unless that of the noise is larger
NOISE = 8.0  # range of a standstill's readings in standard deviations of the noise
SHORTEST_STANDSTILL = 0.4  # s: least duration
SETTLING = 0.25  # fraction of a standstill that is discarded at its beginning
DENSE = 0.34  # s: largest median time step of a recording
FEWEST_SAMPLES = 4


@dataclass(frozen=True)
class Standstill:
    """A standstill: its first and last sample, and the interval [s] in which the robot has settled."""

    first: int
    last: int
    begin: float
    end: float

    def counts(self, time: np.ndarray) -> np.ndarray:
        """Return the mask (n_samples,) of the samples recorded in the settled interval."""
        return (time >= self.begin) & (time <= self.end)


def is_recording(time: np.ndarray) -> bool:
    """Whether rows are a recording: at least 20 of them, with a short median time step."""
    if len(time) < 20:
        return False
    step = float(np.median(np.diff(np.sort(time))))
    return 0 < step < DENSE


def find_standstills(time: np.ndarray, readings: np.ndarray) -> list[Standstill]:
    """Return the standstills of joint readings (n_samples, n) [rad or m] at times (n_samples,) [s], in order.

    A standstill lasts while the range of every joint is that of noise; its settling at the beginning is discarded.
    """
    steps = np.diff(readings, axis=0)
    noise = 1.4826 * np.median(np.abs(steps), axis=0) / np.sqrt(2)
    moving = np.median(np.abs(steps).max(axis=1)) > STANDS_STILL  # then the median step is motion, not noise
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
        else:  # the window slides on, without its first samples
            first += 1
            while first < k and k < len(readings) and (np.ptp(readings[first : k + 1], axis=0) > within).any():
                first += 1
        if k < len(readings):
            low, high = readings[first : k + 1].min(axis=0), readings[first : k + 1].max(axis=0)
    return _merged(standstills, readings, within)


def _merged(standstills: list[Standstill], readings: np.ndarray, within: np.ndarray) -> list[Standstill]:
    """The standstills with consecutive ones at the same readings merged."""
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
