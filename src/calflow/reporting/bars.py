"""Horizontal bar charts with labelled values: the error budget, and the evidence of causes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from calflow.files.deferred import pd
from calflow.files.words import chance_figure, mm
from calflow.reporting.style import ACCENT, DARK, LIGHT, MIDDLE, PLATE, chart, mark_floor, plain_decades

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW = 0.19  # inches per bar
DECADES = 20  # ratio to the least level above which the axis is logarithmic
ROOM = 0.16  # share of the axis beside the longest bar, for its label


def error_budget(names: Sequence[str], levels: Sequence[float], floor: float | None, unit: str, where: str) -> Figure:
    """Draw the reduction of the mean error [unit] from each model to the next, and the remaining error.

    names and levels: those of the models, from the nominal robot on; floor: error due to noise, where it is known.
    """
    drawn, axes = _rows([*names, "left"])
    least, most = min([*levels, floor or levels[-1]]), max(levels)
    begin = least / 2 if (decades := most > DECADES * least) else 0.0
    axes.barh(0, levels[0] - begin, 0.66, begin, color=MIDDLE)
    _beside(axes, 0, levels[0], f"{mm(levels[0])} {unit}")
    for k, (before, now) in enumerate(pairwise(levels), start=1):
        sign, look = ("−", {"color": DARK}) if now <= before else ("+", {"color": ACCENT, "hatch": "xx"})
        axes.barh(k, abs(before - now), 0.66, min(before, now), **look)  # type: ignore[arg-type]
        _beside(axes, k, max(before, now), f"{sign}{mm(abs(before - now))} {unit}")
    left: dict[str, Any] = {"facecolor": LIGHT, "edgecolor": MIDDLE, "hatch": "////", "linewidth": 0.6}
    axes.barh(len(levels), levels[-1] - begin, 0.66, begin, **left)
    _beside(axes, len(levels), max(levels[-1], floor or 0.0), f"{mm(levels[-1])} {unit}")
    mark_floor(axes.axvline, floor, unit)
    if decades:
        axes.set_xscale("log")
        axes.set_xlim(begin, most * (most / begin) ** ROOM)
        plain_decades(axes.xaxis, begin, most)
    else:
        axes.set_xlim(0, (1 + ROOM) * max(most, floor or 0.0))
    axes.set_xlabel(f"mean error at poses {where} [{unit}]")
    if floor:
        drawn.legend(loc="outside upper right")
    return drawn


def evidence(causes: pd.DataFrame) -> Figure:
    """Draw the evidence of causes, best first, with false-alarm probabilities; dark: added to the model.

    causes has columns cause, evidence, chance_of_a_false_alarm and in_the_model.
    """
    drawn, axes = _rows(causes["cause"].tolist())
    lengths, colours = causes["evidence"], np.where(causes["in_the_model"], DARK, LIGHT)
    axes.barh(range(len(causes)), lengths, 0.66, color=colours, edgecolor=DARK, linewidth=0.6)
    axes.axvline(0, color="#444444", linewidth=0.6)
    for k, (length, chance) in enumerate(zip(lengths, causes["chance_of_a_false_alarm"], strict=True)):
        _beside(axes, k, max(length, 0.0), chance_figure(chance))
    low, high = min(lengths.min(), 0.0), max(lengths.max(), 0.0)
    axes.set_xlim(low - 0.02 * (high - low), high + ROOM * (high - low or 1.0))
    axes.set_xlabel("evidence (twice its logarithm), and the chance of a false alarm")
    return drawn


def _rows(names: Sequence[str]) -> tuple[Figure, Axes]:
    drawn, axes = chart(0.8 + ROW * len(names))
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.45, -0.55)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    return drawn, axes


def _beside(axes: Axes, y: float, x: float, text: str) -> None:
    axes.annotate(text, (x, y), (4, 0), textcoords="offset points", va="center", bbox=PLATE)
