"""The figure of a cause: errors without it, with it, and against its prediction."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from calflow.files.units import METRE
from calflow.files.words import number
from calflow.reporting.style import ACCENT, crowded, dots, panels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FEW_VALUES = 6  # distinct values of a variable up to which rows are drawn in groups
SMOOTH = 0.05  # share of a curve's variance between neighbours up to which it is drawn as a line
GAP = 0.08  # share of a variable's range without rows across which no line is drawn
LARGE_MOMENT = 2000.0  # Nm above which the unit is kNm
CHARACTERS = 36  # length of a label below one of three panels


def explained_figure(
    x: np.ndarray, before: np.ndarray, after: np.ndarray, fitted: np.ndarray, held: np.ndarray, label: str, unit: str,
    error_unit: str = METRE.label,
) -> Figure:  # fmt: skip
    """Draw errors [error_unit] against a variable without and with a cause, and against the cause's prediction.

    All arrays have shape (n_rows,); fitted is the cause's part of before.
    """
    if unit == "Nm" and np.abs(x).max() >= LARGE_MOMENT:
        x, unit = x / 1000, "kNm"
    drawn, (panels_of,) = panels(1, 3, 2.15, sharey=True, width_ratios=(1.0, 1.0, 0.72))
    first, second, third = panels_of
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


def _grouped(
    axes: Axes, values: np.ndarray, group: np.ndarray, error: np.ndarray, held: np.ndarray, size: float
) -> None:
    """Draw rows in groups side by side, with mean and standard deviation of each."""
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
    """Draw a cause's prediction: as a line where it is a function of x, else as a cross per row."""
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


def _legend(drawn: Figure, several: Sequence[Axes]) -> None:
    """Draw a common legend of axes above them, each label once."""
    handles: dict[str, Any] = {}
    for axes in several:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        drawn.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=min(5, len(handles)),
                     columnspacing=1.2, handletextpad=0.5)  # fmt: skip
