"""Changes over time: which of many parameters moved between independent calibrations, and between which ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calflow.estimation.alone import Alone

DRAWS = 20_000  # of calibrations in which nothing moves


@dataclass(frozen=True)
class Change:
    """A parameter (its index) that is not the same in calibrations first to last, and changed most likely after one of them.

    All three count calibrations from 0. p is the chance that any parameter looks so anywhere where none moved; shift is the mean
    after less the mean before, in these calibrations, and sd its standard deviation.
    """

    parameter: int
    first: int
    after: int
    last: int
    p: float
    shift: float
    sd: float


def changes(runs: Sequence[Alone], false_alarm: float, rng: np.random.Generator) -> list[Change]:
    """Return the parameters that moved and when, by how the mean of some calibrations in a row differs from that of the next ones.

    A parameter is tested by what each calibration says of it whatever all others are, so that those which moved do not make
    another one look so, and along a direction that the measurements do not determine nothing is told. Of every pair of
    neighbouring groups of calibrations and every parameter that all of them tell of the largest |z| is compared with the
    largest among draws in which nothing moved, with the covariances in full (Westfall & Young 1993): the chance that anything
    is told wrongly is at most false_alarm. The narrowest group that shows a change says when (Baranowski, Chen & Fryzlewicz 2019);
    before and after it there may be others.
    """
    told = np.all([run.told for run in runs], axis=0)
    if not told.any():
        return []
    weight = np.array([1 / np.diag(run.covariance)[told] for run in runs])
    value = np.array([run.value[told] for run in runs])
    drawn = np.stack([_drawn(run, rng)[:, told] for run in runs])
    largest = np.zeros(DRAWS)
    shown: dict[tuple[int, int, int], np.ndarray] = {}
    for span in _spans(len(runs)):
        shift, sd = _shift(value, weight, span)
        shown[span] = np.abs(shift / sd)
        shift, sd = _shift(drawn, weight[:, None], span)
        largest = np.maximum(largest, np.abs(shift / sd).max(axis=1))
    largest.sort()
    chance = {span: (1 + DRAWS - np.searchsorted(largest, z, side="left")) / (1 + DRAWS) for span, z in shown.items()}
    names = np.flatnonzero(told)
    return [
        Change(int(names[j]), *span, float(chance[span][j]), *_shift(value[:, j], weight[:, j], span))
        for j in range(len(names))
        for span in _narrowest({s: z[j] for s, z in shown.items() if chance[s][j] <= false_alarm}, 0, len(runs) - 1)
    ]


@dataclass(frozen=True)
class Level:
    """What a parameter was in calibrations first to last (from 0), in which it did not move that anybody could tell."""

    parameter: int
    first: int
    last: int
    value: float
    sd: float


def levels(runs: Sequence[Alone], found: Sequence[Change]) -> list[Level]:
    """Return each parameter's mean between its changes, in order; weighted by what each calibration knows of it."""
    made = []
    for j in range(len(runs[0].value)):
        ends = [*(one.after for one in found if one.parameter == j), len(runs) - 1]
        for begin, end in zip([0, *(1 + one for one in ends[:-1])], ends, strict=True):
            own = runs[begin : end + 1]
            weight = np.array([1 / run.sd[j] ** 2 for run in own])
            value = float(weight @ [run.value[j] for run in own] / weight.sum())
            made.append(Level(j, begin, end, value, float(weight.sum() ** -0.5)))
    return made


def _spans(n: int) -> Iterator[tuple[int, int, int]]:
    """Every group of calibrations in a row with every place to part it: first, last before the change, last."""
    return ((a, k, b) for a in range(n) for b in range(a + 1, n) for k in range(a, b))


def _shift(value: np.ndarray, weight: np.ndarray, span: tuple[int, int, int]) -> tuple[Any, Any]:
    """Mean after less mean before, and its standard deviation, of values (runs, …) with weights that spread over them."""
    a, k, b = span
    before, after = slice(a, k + 1), slice(k + 1, b + 1)
    means = [(value[own] * weight[own]).sum(axis=0) / weight[own].sum(axis=0) for own in (before, after)]
    return means[1] - means[0], np.sqrt(sum(1 / weight[own].sum(axis=0) for own in (before, after)))


def _drawn(run: Alone, rng: np.random.Generator) -> np.ndarray:
    """What a calibration would say by chance (DRAWS, n) where all parameters are zero."""
    scale = np.sqrt(np.diag(run.covariance))
    variance, vectors = np.linalg.eigh(run.covariance / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(variance, 0))
    return np.asarray(scale * (rng.standard_normal((DRAWS, len(scale))) @ root.T))


def _narrowest(shown: dict[tuple[int, int, int], float], first: int, last: int) -> list[tuple[int, int, int]]:
    """The narrowest groups that show a change, the clearest of equally narrow ones, in order; none overlaps another's change."""
    own = {span: z for span, z in shown.items() if first <= span[0] and span[2] <= last}
    if not own:
        return []
    best = min(own, key=lambda span: (span[2] - span[0], -own[span]))
    return [*_narrowest(shown, first, best[1]), best, *_narrowest(shown, best[1] + 1, last)]
