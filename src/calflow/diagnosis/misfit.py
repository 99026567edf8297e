"""Misfit: the region in which a lack of fit is largest, of ranges between eighths of the poses along an input, or of a label."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calflow.diagnosis.fitted import Fitted
from calflow.estimation.accuracy import distances, errors, judged_unit
from calflow.files.deferred import pd
from calflow.files.tables import column
from calflow.files.words import rounded
from calflow.observations import leading_units

PARTS = 8  # quantiles of an input's poses, at which regions begin and end
MAX_REGION_SHARE = 0.5  # largest share of the poses in a range
MIN_REGION_POSES = 4  # poses inside a region, and outside
DRAWS = 499  # permutations of the poses
BY_CHANCE = 0.05  # p-value, over all inputs, above which no region is reported: the misfit is then about uniform
OF_MEASURING = ("device", "session")  # labels of rows that are alike to the robot
LABELS = ("payload", "marker", "session")  # columns with few values
IN_WORDS = {"order": "the row's place in measuring order"}


@dataclass(frozen=True, kw_only=True)
class MisfitRegion:
    """The region with the largest residuals: a range of one input, or one of its few values."""

    input: str = column("q1 … (joints), x, y, z, time, order, payload, marker, device, session")
    low: float | None = column("start of the range", "as `unit` says", default=None)
    high: float | None = column("end of the range", "as `unit` says", default=None)
    unit: str = column("of the range", default="")
    value: str = column("the payload, marker, device or session", default="")
    error_unit: str = column("the unit of the errors: mm, mrad, px, …")
    there: float = column("mean error of the training rows there", "as `error_unit` says")
    elsewhere: float = column("mean error of the others", "as `error_unit` says")

    @property
    def is_of_measuring(self) -> bool:
        return self.input in OF_MEASURING

    @property
    def where(self) -> str:
        if self.value:
            return f"{'the ' * self.is_of_measuring}{self.input} is {self.value}"
        is_joint = self.input[0] == "q" and self.input[1:].isdigit()
        name = f"joint {self.input[1:]}" if is_joint else IN_WORDS.get(self.input, self.input)
        return f"{name} is between {_said(self.low)} and {_said(self.high)}{f' {self.unit}' if self.unit else ''}"

    @property
    def words(self) -> str:
        there, elsewhere = (f"{rounded(error)} {self.error_unit}" for error in (self.there, self.elsewhere))
        return f"largest where {self.where}: {there} against {elsewhere} elsewhere"


@dataclass(frozen=True)
class _Input:
    """An input along which regions are searched for: its values in display units, or its labels, one per row."""

    name: str
    values: np.ndarray
    unit: str = ""

    @property
    def is_label(self) -> bool:
        return self.values.dtype == object

    def regions(self) -> Iterator[np.ndarray]:
        if self.is_label:
            yield from (self.values == value for value in dict.fromkeys(self.values))
            return
        ends = np.unique(np.quantile(self.values, np.linspace(0, 1, PARTS + 1)))
        for low, high in combinations(ends, 2):
            yield (self.values >= low) & (self.values <= high)


def largest_misfit(fitted: Fitted, rng: np.random.Generator, along: Collection[str] = ()) -> MisfitRegion | None:
    """Return the region with the largest residuals, along what unexplained structure depends on, else all; None if not significant.

    Mean squared whitened residuals inside and outside a region are compared as variances, by their likelihood ratio; its p-value is
    by permutation of the poses (Fisher 1935), times the number of inputs.
    """
    studentised, wanted = fitted.studentised, (*along, *OF_MEASURING)
    inputs = [candidate for candidate in _inputs(fitted) if not along or candidate.name in wanted]
    squared, number = np.nansum(studentised**2, axis=1), np.isfinite(studentised).sum(axis=1)
    tried = [(*_worst(candidate, squared, number, fitted.poses, rng), candidate) for candidate in inputs]
    p, _, inside, worst = min(tried, key=lambda one: one[:2], default=(np.inf, 0.0, np.zeros(0), None))
    return _region(worst, inside, fitted) if worst and p * len(inputs) <= BY_CHANCE else None


def _worst(
    candidate: _Input, squared: np.ndarray, number: np.ndarray, poses: np.ndarray, rng: np.random.Generator
) -> tuple[float, float, np.ndarray]:
    """Return an input's worst region: p-value, by permuting poses, minus its likelihood ratio, and rows (n_rows,); or infinity."""
    constant = (pd.Series(candidate.values).groupby(poses).nunique() == 1).all()
    groups = poses if constant else np.arange(len(squared))
    _, first, group = np.unique(groups, return_index=True, return_inverse=True)
    inside = np.array([region[first] for region in candidate.regions()], dtype=bool).reshape(-1, len(first))
    size = inside.sum(axis=1)
    most = len(first) - MIN_REGION_POSES if candidate.is_label else MAX_REGION_SHARE * len(first)
    inside = inside[(size >= MIN_REGION_POSES) & (size <= most)]
    if not len(inside):
        return np.inf, 0.0, np.zeros(len(squared), dtype=bool)
    total, count = np.bincount(group, squared), np.bincount(group, number)
    orders = np.array([np.arange(len(first)), *(rng.permutation(len(first)) for _ in range(DRAWS))]).T
    ratio = _likelihood_ratio(inside, total[orders], count[orders])  # (n_regions, 1 + DRAWS)
    best = ratio.max(axis=0)
    return float((best >= best[0]).mean()), -float(best[0]), inside[int(ratio[:, 0].argmax())][group]


def _likelihood_ratio(inside: np.ndarray, total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return twice the log likelihood ratio of two variances against one, (n_regions, n_orders); zero if smaller inside.

    inside (n_regions, n_groups) marks groups, total and count (n_groups, n_orders) are their sums of squares and numbers.
    """
    within, n = inside @ total, inside @ count
    beside, m = total.sum(axis=0) - within, count.sum(axis=0) - n
    even = (within + beside) / (n + m)
    ratio = (n + m) * np.log(even) - n * np.log(within / n) - m * np.log(beside / m)
    return np.where(within / n > beside / m, ratio, 0.0)


def _inputs(fitted: Fitted) -> list[_Input]:
    data = fitted.data
    shown = zip(data.joint_angles.T, (joint.shown for joint in data.robot.joints), strict=True)
    inputs = [_Input(f"q{i}", factor * angles, unit) for i, (angles, (unit, factor)) in enumerate(shown, start=1)]
    place = 1e3 * fitted.model.point(fitted.fit.estimate, data.conditions)
    inputs += [_Input(axis, place[:, i], "mm") for i, axis in enumerate("xyz")]
    for name, unit in (("time", "s"), ("order", "")):
        if name in data.given:
            inputs.append(_Input(name, data.table[name].to_numpy(float), unit))
            break
    labels = [_Input(name, data.table[name].astype(str).to_numpy(object)) for name in LABELS if name in data.table]
    labels.append(_Input("device", data.device))
    return inputs + [label for label in labels if len(set(label.values)) > 1]


def _region(candidate: _Input, inside: np.ndarray, fitted: Fitted) -> MisfitRegion:
    unit = judged_unit(leading_units(fitted.data))
    size = unit.shown(distances(errors(fitted.model, fitted.fit.estimate, fitted.data)))
    there, elsewhere = float(np.nanmean(size[inside])), float(np.nanmean(size[~inside]))
    region = MisfitRegion(input=candidate.name, error_unit=unit.label, there=there, elsewhere=elsewhere)
    values = candidate.values[inside]
    if candidate.is_label:
        return replace(region, value=str(values[0]))
    return replace(region, low=float(values.min()), high=float(values.max()), unit=candidate.unit)


def _said(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"
