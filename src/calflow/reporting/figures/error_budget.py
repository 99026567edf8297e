"""Figures of accuracy: before and after, the error budget, and the distribution of errors."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calflow.files.words import mm
from calflow.reporting.material import ModelAccuracy
from calflow.reporting.style import ACCENT, DARK, LIGHT, MIDDLE, figure, panels, plain_decades

NOISE_DRAWS = 200_000
MOST_STEPS = 5000  # of a cumulative curve: more are finer than a line
LONGEST = 14  # letters of a line below a bar


def before_after(steps: Sequence[ModelAccuracy], floor: float | None) -> Figure:
    """Draw mean and largest error [mm] of each model on a logarithmic scale, with what noise alone would leave.

    floor is None where that is not known.
    """
    drawn = figure(2.9, 3.5)
    axes = drawn.add_subplot()
    at = np.arange(len(steps))
    base = _base(steps, floor)
    looks: list[tuple[float, str, list[float], dict[str, Any]]] = [
        (-0.2, "mean", [step.mean for step in steps], {"color": DARK}),
        (0.2, "largest", [step.max for step in steps], {"facecolor": LIGHT, "edgecolor": MIDDLE, "hatch": "////"}),
    ]
    for shift, name, values, look in looks:
        axes.bar(at + shift, np.array(values) - base, 0.38, bottom=base, label=name, linewidth=0.6, **look)
        for x, value in zip(at + shift, values, strict=True):
            _said(axes, x, value, mm(value), fontsize=6.5)
    _floor(axes, floor)
    _log_mm(axes, base, max(step.max for step in steps))
    axes.set_xticks(at, [_wrapped(step) for step in steps])
    axes.set_xlim(-0.55, len(steps) - 0.45)
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("tool-position error [mm]")
    drawn.legend(loc="outside upper center", ncols=3, columnspacing=1.0, handlelength=1.6)
    return drawn


def budget(steps: Sequence[ModelAccuracy], floor: float | None) -> Figure:
    """Draw what each step of the model takes off the mean error [mm], as a waterfall on a logarithmic scale."""
    drawn = figure(1.9)
    axes = drawn.add_subplot()
    base = _base(steps, floor)
    first, final, last = steps[0], steps[-1], len(steps)
    labels = [first.label]
    axes.bar(0, first.mean - base, 0.6, bottom=base, color=MIDDLE)
    _said(axes, 0, first.mean, f"{mm(first.mean)} mm")
    for k, (before, after) in enumerate(pairwise(steps), start=1):
        low, high = sorted((before.mean, after.mean))
        better = after.mean <= before.mean
        axes.bar(k, high - low, 0.6, bottom=low, color=DARK if better else ACCENT, hatch="" if better else "xx")
        _level(axes, k, before.mean)
        _said(axes, k, high, f"{'−' if better else '+'}{mm(high - low)} mm")
        labels.append(f"{'explained' if better else 'added'} by\n{after.name}")
    look: dict[str, Any] = {"facecolor": LIGHT, "edgecolor": MIDDLE, "hatch": "////", "linewidth": 0.6}
    axes.bar(last, final.mean - base, 0.6, bottom=base, **look)
    _level(axes, last, final.mean)
    _said(axes, last, max(floor or 0.0, final.mean), f"{mm(final.mean)} mm")
    _floor(axes, floor)
    _log_mm(axes, base, max(step.mean for step in steps))
    axes.set_xticks(range(last + 1), [*labels, "left"])
    axes.grid(axis="x", visible=False)
    axes.set_xlim(-0.5, last + 0.5)
    axes.set_ylabel("mean tool-position\nerror [mm]")
    if floor:
        axes.legend(loc="upper right")
    return drawn


def distribution(distance: np.ndarray, held: np.ndarray, sigma: np.ndarray, noise_name: str) -> Figure:
    """Draw histogram and cumulative share of the errors' lengths [mm], used and held out, with those of normal noise.

    sigma is the noise of each row per axis [mm].
    """
    drawn, ((left, right),) = panels(1, 2, 1.95)
    rng = np.random.default_rng(0)
    noise = np.sort(np.linalg.norm(rng.standard_normal((NOISE_DRAWS, 3)), axis=1) * rng.choice(sigma, NOISE_DRAWS))
    end = 1.03 * max(distance.max(), np.quantile(noise, 0.999))
    bins = np.linspace(0, end, 25)
    groups: list[tuple[str, np.ndarray, dict[str, Any], str]] = [
        ("used for the fit", ~held, {"color": DARK, "linestyle": "-"}, ""),
        ("held out", held, {"color": ACCENT, "linestyle": "--"}, "////"),
    ]
    for name, mask, look, hatch in groups:
        if not mask.any():
            continue
        ordered = np.sort(distance[mask])
        left.hist(
            ordered, bins, weights=np.full(len(ordered), 100 / len(ordered)), histtype="step", hatch=hatch, **look
        )
        share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
        kept = np.unique(np.linspace(0, len(ordered) - 1, MOST_STEPS).astype(int))
        right.step([0, *ordered[kept], end], [0, *share[kept], 100], where="post", label=name, **look)
    look = {"color": "black", "linestyle": ":", "linewidth": 1.2}
    left.stairs(100 * np.histogram(noise, bins)[0] / len(noise), bins, **look)
    grid = np.linspace(0, end, 300)
    right.plot(grid, 100 * np.searchsorted(noise, grid) / len(noise), label=noise_name, **look)
    left.set(xlabel="error [mm]", ylabel="share of rows in a bin [%]", xlim=(0, end))
    right.set(xlabel="error [mm]", ylabel="rows with a\nsmaller error [%]", xlim=(0, end), ylim=(0, 103))
    right.legend(loc="lower right")
    return drawn


def _base(steps: Sequence[ModelAccuracy], floor: float | None) -> float:
    """Return where the bars of a logarithmic scale begin [mm]."""
    return 0.4 * min([*(step.mean for step in steps), *([floor] if floor else [])])


def _floor(axes: Axes, floor: float | None) -> None:
    if floor:
        axes.axhline(floor, color="black", linestyle="--", linewidth=0.9, label=f"mean of noise alone: {mm(floor)} mm")


def _level(axes: Axes, k: int, value: float) -> None:
    """Carry a level over from the bar before."""
    axes.plot([k - 0.7, k + 0.3], [value, value], color="#444444", linewidth=0.6)


def _said(axes: Axes, x: float, y: float, text: str, **look: Any) -> None:
    """Write a bar's value above it, readable where a line crosses."""
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.4}
    axes.annotate(text, (x, y), (0, 2.5), textcoords="offset points", ha="center", bbox=box, **look)


def _wrapped(step: ModelAccuracy) -> str:
    """Break a long label after its first word, and where it is too long for its bar."""
    first, *rest = step.name.split()
    plus = "+ " if step.added else ""
    return "\n".join([f"{plus}{first}", *wrap(" ".join(rest), LONGEST)])


def _log_mm(axes: Axes, low: float, high: float) -> None:
    axes.set_yscale("log")
    axes.set_ylim(low, high * (high / low) ** 0.16)
    plain_decades(axes.yaxis, low, high)
