"""Figure of the parameters: estimates against what was known before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calflow.report.style import ACCENT, DARK, LIGHT, figure


def estimates(
    names: Sequence[str], effects: Sequence[str], scaled: np.ndarray, sd: np.ndarray, from_prior: np.ndarray
) -> Figure:
    """Draw each estimate's distance from nominal ± 2 sd in prior standard deviations, grouped by effect.

    scaled and sd have shape (n_parameters,), sd is nan at a bound; from_prior marks what the data leave to the prior.
    """
    drawn = figure(2.6, max(6.7, 0.1 * len(names)))
    axes = drawn.add_subplot()
    starts = [k for k, effect in enumerate(effects) if k == 0 or effects[k - 1] != effect]
    gap = np.searchsorted(starts, np.arange(len(names)), side="right") - 1
    at = np.arange(len(names)) + gap
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
        axes.plot(at[bound], scaled[bound], "x", color=ACCENT, markersize=5, label="at a bound, no sd")
    for k, start in enumerate(starts):
        end = starts[k + 1] if k + 1 < len(starts) else len(names)
        axes.annotate(effects[start].replace("-", " "), ((at[start] + at[end - 1]) / 2, 1.0), (0, 2),
                      xycoords=("data", "axes fraction"), textcoords="offset points", ha="center")  # fmt: skip
        if k:
            axes.axvline(at[start] - 1, color="#444444", linewidth=0.6)
    axes.set_xticks(at, names, rotation=90, fontsize=6.5)
    axes.set_xlim(-1, at[-1] + 1)
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("estimate − nominal, ± 2 sd\n[prior standard deviations]")
    drawn.legend(*_errorbars_first(axes), loc="outside upper center", ncols=3)
    return drawn


def _errorbars_first(axes: Axes) -> tuple[list[Artist], list[str]]:
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda k: labels[k].startswith("at a bound"))
    return [handles[k] for k in order], [labels[k] for k in order]
