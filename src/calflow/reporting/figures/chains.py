"""Figures of the posterior: against Laplace's approximation, traces, corner, and held-out predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from calflow.reporting.style import ACCENT, ALONE, DARK, LIGHT, MIDDLE, figure, panels, turned

BINS = 32
SMOOTH = 0.7  # bins, of the density in a pair
SHARES = (0.95, 0.68)  # of the posterior inside a contour


def against_laplace(names: Sequence[str], ratio: np.ndarray) -> Figure:
    """Draw the sampled standard deviation over Laplace's for each parameter, shape (n_parameters,)."""
    drawn = figure(1.3 + turned(names))
    axes = drawn.add_subplot()
    axes.axhline(1, color="black", linewidth=0.8)
    axes.vlines(np.arange(len(names)), 1, ratio, color=MIDDLE, linewidth=0.8)
    axes.plot(np.arange(len(names)), ratio, "o", color=DARK)
    reach = max(0.1, 1.15 * float(np.nanmax(np.abs(ratio - 1))))
    axes.set_ylim(1 - min(reach, 1.0), 1 + reach)
    axes.set_xlim(-0.8, len(names) - 0.2)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=6.5)
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("sampled sd /\napproximate sd")
    return drawn


def traces(steps: np.ndarray, chain: np.ndarray, labels: Sequence[str], discard: int) -> Figure:
    """Draw each ensemble's median and 95 % band over its walkers at each step.

    chain has shape (n_ensembles, n_steps, n_walkers, n_parameters); steps before discard were not used.
    """
    drawn, grid = panels(len(labels), 1, 0.5 + 0.95 * len(labels), sharex=True)
    for k, label in enumerate(labels):
        axes = grid[k, 0]
        low, middle, high = np.quantile(chain[..., k], [0.025, 0.5, 0.975], axis=2)
        axes.axvspan(0, discard, color=LIGHT, alpha=0.6, linewidth=0)
        for e, (colour, line, _) in zip(range(len(chain)), ALONE * (len(chain) // len(ALONE) + 1), strict=False):
            axes.plot(
                steps,
                middle[e],
                color=colour,
                linestyle=line,
                linewidth=0.9,
                label=f"ensemble {e + 1}" if k == 0 else None,
            )
            axes.plot(steps, low[e], color=colour, linestyle=line, linewidth=0.5)
            axes.plot(steps, high[e], color=colour, linestyle=line, linewidth=0.5)
        axes.set_ylabel(label)
        axes.margins(x=0)
        axes.locator_params(axis="y", nbins=4)
    grid[-1, 0].set_xlabel("step (grey: left out as burn-in)")
    drawn.align_ylabels()
    drawn.legend(loc="outside upper center", ncols=5)
    return drawn


def corner(draws: np.ndarray, labels: Sequence[str]) -> Figure:
    """Draw the posterior of every pair of parameters; draws has shape (n_draws, n_parameters).

    Grey is density; the lines hold 68 % and 95 %.
    """
    n = len(labels)
    drawn = figure(0.4 + 0.8 * n, 0.5 + 0.85 * n)
    drawn.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.02)
    grid = drawn.add_gridspec(n, n)
    first: dict[int, Axes] = {}
    for i in range(n):
        for j in range(i + 1):
            axes = drawn.add_subplot(grid[i, j], sharex=first.get(j))
            first.setdefault(j, axes)
            axes.grid(visible=False)
            if i == j:
                axes.hist(draws[:, i], BINS, histtype="stepfilled", color=LIGHT, edgecolor=DARK, linewidth=0.8)
            else:
                _density(axes, draws[:, j], draws[:, i])
            axes.locator_params(nbins=3)
            axes.tick_params(labelsize=6, labelleft=j == 0 and i > 0, left=j == 0 and i > 0, labelbottom=i == n - 1)
            for tick in axes.get_xticklabels():
                tick.set_rotation(30)
            if i == n - 1:
                axes.set_xlabel(labels[j])
            if j == 0 and i > 0:
                axes.set_ylabel(labels[i])
    drawn.align_labels()
    return drawn


def predictions(error: np.ndarray, low: np.ndarray, high: np.ndarray, covered: np.ndarray) -> Figure:
    """Draw errors [mm] against the interval in which each was expected, rows ordered by the interval's end."""
    drawn = figure(2.2)
    axes = drawn.add_subplot()
    order = np.argsort(high, kind="stable")
    error, low, high, covered = error[order], low[order], high[order], covered[order]
    at = np.arange(1, len(error) + 1)
    axes.fill_between(at, low, high, step="mid", color=LIGHT, linewidth=0, label="95 % interval")
    size = float(np.clip(500 / len(error), 2, 14))
    picture = len(error) > 5000
    axes.scatter(at[covered], error[covered], size, color=DARK, linewidths=0, rasterized=picture, label="inside")
    if (~covered).any():
        axes.scatter(
            at[~covered], error[~covered], 2.2 * size, color=ACCENT, marker="x", linewidths=1.0, label="outside"
        )
    axes.set(
        xlabel="rows, ordered by expected error", ylabel="error [mm]", xlim=(0.3, len(error) + 0.7), ylim=(0, None)
    )
    axes.legend(loc="upper left", ncols=3)
    return drawn


def _density(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    counts, x_edges, y_edges = np.histogram2d(x, y, BINS)
    counts = gaussian_filter(counts, SMOOTH)
    axes.pcolormesh(x_edges, y_edges, counts.T, cmap="Greys", rasterized=True)
    ordered = np.sort(counts.ravel())[::-1]
    inside = np.cumsum(ordered) / ordered.sum()
    levels = sorted({float(ordered[np.searchsorted(inside, share)]) for share in SHARES} - {0.0, float(ordered[0])})
    if levels:
        middle = [(edges[1:] + edges[:-1]) / 2 for edges in (x_edges, y_edges)]
        axes.contour(*middle, counts.T, levels=levels, colors=[ACCENT], linewidths=0.8)
