"""Figures of the diagnosis: what each cause explains, what it gained, and how strong the evidence is."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from calflow.files.units import METRE
from calflow.files.words import mm, number
from calflow.reporting.style import (
    ACCENT,
    DARK,
    LIGHT,
    MANY,
    MIDDLE,
    PLATE,
    crowded,
    dots,
    error_axis,
    figure,
    mark_floor,
    panels,
    shades,
)

FEW_VALUES = 6  # of a variable, up to which its rows are drawn in groups
SMOOTH = 0.05  # share of a curve's variance between neighbours up to which it is drawn as a line
GAP = 0.08  # share of a variable's range without rows across which no line is drawn
LEAST_P = 1e-12  # smallest probability that is drawn
LARGE_MOMENT = 2000.0  # Nm from which kNm are drawn
ROW = 0.19  # inches a bar takes
CHARACTERS = 36  # below one of three panels


def explained_figure(
    x: np.ndarray, before: np.ndarray, after: np.ndarray, fitted: np.ndarray, held: np.ndarray, label: str, unit: str,
    error_unit: str = METRE.label,
) -> Figure:  # fmt: skip
    """Draw errors [error_unit] against a variable without and with a cause in the model, and against what the cause explains.

    All arrays have shape (n_rows,); fitted is the cause's part of before.
    """
    if unit == "Nm" and np.abs(x).max() >= LARGE_MOMENT:
        x, unit = x / 1000, "kNm"
    drawn = figure(2.15)
    first, second, third = drawn.subplots(1, 3, sharey=True, width_ratios=(1.0, 1.0, 0.72))
    size = crowded(len(x))
    values, group = np.unique(np.round(x, 9), return_inverse=True)
    few = len(values) <= FEW_VALUES
    for axes, error in ((first, before), (second, after)):
        axes.set_xlabel(fill(f"{label} [{unit}]" if unit else label, CHARACTERS))
        if few:
            _grouped(axes, values, group, error, held, size)
        else:
            dots(axes, x, error, held, size, 3)
    if few:
        look = {"fmt": "D", "color": ACCENT, "markerfacecolor": "white"}
        _spread(first, group, fitted, 0.4, look, "explained: mean ± sd")
    else:
        _curve(first, x, fitted)
    dots(third, fitted, before, held, size, 3)
    ends = np.array([min(fitted.min(), 0.0), max(fitted.max(), 0.0)])
    third.plot(ends, ends, color="black", linestyle="--", linewidth=1.0, label="equal")
    third.set_xlabel(f"explained by the cause [{error_unit}]")
    third.locator_params(axis="x", nbins=4)
    first.set_ylabel(f"error where the\ncause acts [{error_unit}]")
    for axes, title in ((first, "without the cause"), (second, "with it"), (third, "agreement")):
        axes.axhline(0, color="#444444", linewidth=0.6, zorder=0.5)
        axes.set_title(title)
    low, high = min(before.min(), after.min(), 0.0), max(before.max(), after.max(), 0.0)
    margin = 0.07 * (high - low) or 1.0
    first.set_ylim(low - margin, high + margin)
    _legend(drawn, (first, third))
    return drawn


def gains(
    start: float, labels: Sequence[str], after: Sequence[float], intervals: np.ndarray, floor: float | None,
    unit: str = METRE.label,
) -> Figure:  # fmt: skip
    """Draw what each cause takes off the held-out mean error [unit], from the study's own model on.

    after has the error that is left with each cause, intervals (n_causes, 2) what it takes off at least and at most.
    """
    drawn = figure(0.8 + ROW * (len(labels) + 2))
    axes = drawn.add_subplot()
    axes.barh(0, start, 0.66, color=MIDDLE)
    _beside(axes, 0, start, f"{mm(start)} {unit}")
    levels = [start, *after]
    ends = [start]
    for k, (before, now) in enumerate(pairwise(levels), start=1):
        low, high = before - intervals[k - 1, 1], before - intervals[k - 1, 0]
        _taken(axes, k, before, now, unit, said_at=max(before, high))
        look: dict[str, Any] = {"fmt": "none", "ecolor": "black", "elinewidth": 1.0, "capsize": 2.5}
        look["path_effects"] = [withStroke(linewidth=2.6, foreground="white")]  # to be seen on the bar
        axes.errorbar(now, k, xerr=[[max(now - low, 0.0)], [max(high - now, 0.0)]], **look,
                      label="95 % interval" if k == 1 else None)  # fmt: skip
        ends.append(max(before, high))
    _left(axes, len(levels), 0.0, levels[-1], floor, unit)
    axes.set_xlim(0, 1.16 * max([*ends, floor or 0.0]))
    _rows(axes, ["the study's model", *labels, "left"])
    axes.set_xlabel(f"mean {error_axis(unit)} at held-out poses")
    _legend(drawn, (axes,))
    return drawn


def evidence(
    labels: Sequence[str], evidence: np.ndarray, p: np.ndarray, named: np.ndarray, within: float, threshold: float
) -> Figure:
    """Draw how strongly each place speaks: its evidence, and the chance of a false alarm with the threshold it must pass.

    All arrays have shape (n_places,), best first; named marks what is in the extended model; where there is any, places whose
    evidence is no more than within short of the best cannot be told from it by the first look.
    """
    drawn = figure(0.85 + ROW * len(labels))
    left, right = drawn.subplots(1, 2, sharey=True, width_ratios=(1.0, 0.75))
    at, near = np.arange(len(labels)), named.any() & (evidence > evidence.max() - within)
    looks: list[tuple[np.ndarray, dict[str, Any], str]] = [
        (named, {"color": DARK}, "added to the model"),
        (~named & near, {"facecolor": LIGHT, "edgecolor": DARK, "hatch": "////"}, "within reach of the best"),
        (~named & ~near, {"facecolor": "white", "edgecolor": MIDDLE}, "other"),
    ]
    for mask, look, name in looks:
        if mask.any():
            left.barh(at[mask], evidence[mask], 0.66, linewidth=0.6, label=name, **look)
    left.axvline(0, color="#444444", linewidth=0.6)
    left.set_xlabel("evidence (twice its logarithm)")
    shown = np.clip(p, LEAST_P, 1.0)
    for mask, look, _ in looks:
        marker = {"markerfacecolor": look.get("color", look.get("facecolor")), "markeredgecolor": DARK}
        right.plot(shown[mask], at[mask], "o", markersize=4, linestyle="none", **marker)
    right.axvline(threshold, color="black", linestyle="--", linewidth=0.9, label=f"threshold: {100 * threshold:.2g} %")
    right.set_xscale("log")
    right.set_xlim(4.0, LEAST_P / 4)
    right.set_xticks(ticks := [1.0, 1e-4, 1e-8, LEAST_P], [_power(tick) for tick in ticks])
    right.xaxis.set_minor_locator(matplotlib.ticker.NullLocator())
    right.set_xlabel("chance of a false alarm")
    _rows(left, labels)
    _legend(drawn, (left, right))
    return drawn


def errors_in_space(
    position: np.ndarray, before: np.ndarray, after: np.ndarray, held: np.ndarray, factor: float
) -> Figure:
    """Draw positions with their errors [mm] (n_rows, 3) times factor, before and after, from above and from the side."""
    drawn, grid = panels(2, 2, 4.4)
    sizes = [np.linalg.norm(error, axis=1) for error in (before, after)]
    dark = shades(0.3)
    norm = Normalize(0, max(size.max() for size in sizes) or 1.0)
    picture = 4 * len(position) > MANY / 2
    for line, (j, view) in zip(grid, ((1, "from above"), (2, "from the side")), strict=True):
        for axes, error, size, when in zip(line, (before, after), sizes, ("before", "after"), strict=True):
            colours = dark(norm(size))
            segments = np.stack([position, position + factor * error], axis=1)[:, :, [0, j]] / 1000
            axes.add_collection(LineCollection(list(segments), colors=colours, linewidths=1.2, rasterized=picture))
            for mask, marker in ((~held, "o"), (held, "^")):
                axes.scatter(position[mask, 0] / 1000, position[mask, j] / 1000, c=colours[mask], marker=marker, linewidths=0,
                             s=crowded(len(position)), rasterized=picture)  # fmt: skip
            axes.autoscale()
            axes.set_aspect("equal", adjustable="datalim")
            axes.set(title=f"{view}, {when}", xlabel="x [m]", ylabel=f"{'xyz'[j]} [m]")
    drawn.colorbar(ScalarMappable(norm, dark), ax=grid, label="error [mm]", fraction=0.03, pad=0.01)
    return drawn


def _grouped(
    axes: Axes, values: np.ndarray, group: np.ndarray, error: np.ndarray, held: np.ndarray, size: float
) -> None:
    """Draw rows in groups side by side, with the mean and the spread of each."""
    place = group.astype(float)
    for k in range(len(values)):
        members = np.flatnonzero(group == k)
        order = np.argsort(np.argsort(members * 7919 % 1009))  # spread out, the same each time
        place[members] += np.linspace(-0.2, 0.1, len(members))[order]
    dots(axes, place, error, held, size, 3)
    _spread(axes, group, error, 0.25, {"fmt": "s", "color": "black"}, "mean ± sd")
    axes.set_xticks(range(len(values)), [number(value, "+.4g" if values.min() < 0 else ".4g") for value in values])
    axes.set_xlim(-0.5, len(values) - 0.35)
    axes.grid(axis="x", visible=False)


def _spread(axes: Axes, group: np.ndarray, values: np.ndarray, shift: float, look: dict[str, Any], name: str) -> None:
    """Draw each group's mean with its standard deviation."""
    number_ = np.bincount(group)
    mean = np.bincount(group, values) / number_
    sd = np.sqrt(np.maximum(np.bincount(group, values**2) / number_ - mean**2, 0.0))
    axes.errorbar(np.arange(len(mean)) + shift, mean, sd, elinewidth=1.0, capsize=2.5, label=name, zorder=4, **look)


def _curve(axes: Axes, x: np.ndarray, fitted: np.ndarray) -> None:
    """Draw what a cause explains: a line where it is a function of x, else a cross a row."""
    order = np.argsort(x, kind="stable")
    curve = fitted[order]
    between = curve[1:-1] - (curve[:-2] + curve[2:]) / 2
    if (between**2).mean() <= SMOOTH * curve.var():
        gaps = np.flatnonzero(np.diff(x[order]) > GAP * np.ptp(x)) + 1
        along, curve = (np.insert(values, gaps, np.nan) for values in (x[order], curve))
        axes.plot(along, curve, color="black", linewidth=1.2, label="explained by the cause", zorder=4)
    else:
        look: dict[str, Any] = {"markersize": 2.8, "markeredgewidth": 0.6, "zorder": 0.9}
        axes.plot(x, fitted, "x", color="black", label="explained by the cause", **look)


def _taken(axes: Axes, k: int, before: float, after: float, unit: str, said_at: float | None = None) -> None:
    """Draw what a step takes off, or adds, from the level that the one before has left."""
    low, high = sorted((before, after))
    better = after <= before
    axes.barh(k, high - low, 0.66, left=low, color=DARK if better else ACCENT, hatch="" if better else "xx")
    axes.plot([before, before], [k - 0.67, k + 0.33], color="#444444", linewidth=0.6)
    _beside(axes, k, said_at or high, f"{'−' if better else '+'}{mm(high - low)} {unit}")


def _left(axes: Axes, k: int, base: float, value: float, floor: float | None, unit: str) -> None:
    """Draw what is left, and what noise alone would leave."""
    look: dict[str, Any] = {"facecolor": LIGHT, "edgecolor": MIDDLE, "hatch": "////", "linewidth": 0.6}
    axes.barh(k, value - base, 0.66, left=base, **look)
    axes.plot([value, value], [k - 0.67, k + 0.33], color="#444444", linewidth=0.6)
    _beside(axes, k, max(value, floor or 0.0), f"{mm(value)} {unit}")
    mark_floor(axes.axvline, floor, unit)


def _beside(axes: Axes, y: float, x: float, text: str) -> None:
    axes.annotate(text, (x, y), (4, 0), textcoords="offset points", va="center", bbox=PLATE)


def _rows(axes: Axes, labels: Sequence[str]) -> None:
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.45, -0.55)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)


def _legend(drawn: Figure, several: Sequence[Axes]) -> None:
    """Put what the axes name above them, each name once."""
    handles: dict[str, Any] = {}
    for axes in several:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        drawn.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=min(5, len(handles)),
                     columnspacing=1.2, handletextpad=0.5)  # fmt: skip


def _power(value: float) -> str:
    """Return a power of ten as it is written."""
    exponent = round(np.log10(value))
    digits = str(abs(exponent)).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return "1" if exponent == 0 else f"{'≤ ' if value == LEAST_P else ''}10⁻{digits}"
