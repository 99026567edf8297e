"""Figure of the parameters: estimates against what was known before."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from textwrap import fill

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calflow.reporting.style import ACCENT, DARK, LIGHT, figure, turned

AT_BOUND = "at a bound, no sd"
CHARACTER = 0.55  # of a parameter's place that a letter takes


def estimates(
    names: Sequence[str], effects: Sequence[str], scaled: np.ndarray, sd: np.ndarray, from_prior: np.ndarray
) -> Figure:
    """Draw each estimate's distance from nominal ± 2 sd in prior standard deviations, grouped by effect.

    effects names each parameter's group, in words. scaled and sd have shape (n_parameters,), sd is nan at a bound;
    from_prior marks what the data leave to the prior.
    """
    groups = [(effect, len(list(own))) for effect, own in groupby(effects)]
    titles = [_title(effect, number) for effect, number in groups]
    widths = np.array(
        [max(number, CHARACTER * _longest(title)) for (_, number), title in zip(groups, titles, strict=True)]
    )
    edges = np.concatenate([[0.0], np.cumsum(widths + 1)]) - 1  # of the groups, one place between them
    at = np.concatenate([
        middle + np.arange(number) - (number - 1) / 2
        for middle, (_, number) in zip((edges[:-1] + edges[1:]) / 2, groups, strict=True)
    ])  # fmt: skip
    drawn = figure(2.0 + turned(names), max(6.7, 0.1 * edges[-1]))
    axes = drawn.add_subplot()
    axes.axhspan(-1, 1, color=LIGHT, alpha=0.55, linewidth=0)
    axes.axhline(0, color="#444444", linewidth=0.6)
    bound = ~np.isfinite(sd)
    for mask, look, name in (
        (~bound & ~from_prior, {"fmt": "o", "color": DARK}, "told by the data"),
        (~bound & from_prior, {"fmt": "D", "color": ACCENT, "markerfacecolor": "white"}, "left to prior knowledge"),
    ):
        if mask.any():
            axes.errorbar(at[mask], scaled[mask], 2 * sd[mask], elinewidth=1.0, capsize=1.8, label=name, **look)  # type: ignore[arg-type]
    if bound.any():
        axes.plot(at[bound], scaled[bound], "x", color=ACCENT, markersize=5, label=AT_BOUND)
    for title, left, right in zip(titles, edges[:-1], edges[1:], strict=True):
        axes.annotate(title, ((left + right) / 2, 1.0), (0, 2), xycoords=("data", "axes fraction"),
                      textcoords="offset points", ha="center")  # fmt: skip
    for edge in edges[1:-1]:
        axes.axvline(edge, color="#444444", linewidth=0.6)
    axes.set_xticks(at, names, rotation=90, fontsize=6.5)
    axes.set_xlim(edges[0], edges[-1])
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("estimate − nominal, ± 2 sd\n[prior standard deviations]")
    drawn.legend(*_errorbars_first(axes), loc="outside upper center", ncols=3)
    return drawn


def _title(effect: str, number: int) -> str:
    """Break a group's name into lines as long as its parameters give room for, or as its longest word."""
    words = effect.split(" ")
    return fill(effect, max(int(number / CHARACTER), *map(len, words)), break_on_hyphens=False)


def _longest(title: str) -> int:
    return max(map(len, title.split("\n")))


def _errorbars_first(axes: Axes) -> tuple[list[Artist], list[str]]:
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda k: labels[k] == AT_BOUND)
    return [handles[k] for k in order], [labels[k] for k in order]
