"""Figures of what a number of poses is worth."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from calflow.design.selection import Certificate
from calflow.design.worth import HowMany
from calflow.reporting.style import ALONE, DARK, MIDDLE, figure, panels

INDICES = ("O1", "O2", "O3", "O4", "O5")
CURVES = {"expected_sd_mm": "root mean square", "worst_sd_mm": "worst pose"}


def observability(table: pd.DataFrame, certificate: Certificate) -> Figure:
    """Draw the indices, each relative to its value with all poses, and the tool's expected sd [mm] with its bound."""
    drawn, ((left, right),) = panels(1, 2, 2.3)
    poses = table["n_poses"].to_numpy()
    for name, (colour, line, marker) in zip(INDICES, ALONE, strict=True):
        values = table[name].to_numpy(dtype=float)
        if np.isfinite(values[-1]) and values[-1] != 0:
            left.plot(poses, values / values[-1], color=colour, linestyle=line, marker=marker, markevery=max(1, len(poses) // 8),
                      markersize=3, label=name)  # fmt: skip
    left.set(xlabel="number of poses", ylabel="observability index\n[relative to all poses]", ylim=(0, None))
    if left.lines:  # with fewer poses than it takes there is no index
        left.legend(ncols=2)
    for (name, label), (colour, line, marker) in zip(CURVES.items(), ALONE, strict=False):
        right.plot(poses, table[name], color=colour, linestyle=line, marker=marker, markersize=2.5, label=label)
    if certificate.criterion != "parameters":
        right.axhline(certificate.least_loss, color=DARK, linewidth=0.8, label="least possible")
    right.set(xlabel="number of poses", ylabel="expected sd of the\npredicted position [mm]", ylim=(0, None))
    right.legend()
    return drawn


def expected_error(table: pd.DataFrame, how_many: HowMany) -> Figure:
    """Draw the tool's expected sd [mm] against the number of poses, with the knee and the tolerance that was asked for."""
    drawn = figure(2.3, 3.4)
    axes = drawn.add_subplot()
    for (name, label), (colour, line, marker) in zip(CURVES.items(), ALONE, strict=False):
        axes.plot(
            table["n_poses"], table[name], color=colour, linestyle=line, marker=marker, markersize=2.5, label=label
        )
    axes.axvline(how_many.knee_poses, color=MIDDLE, linestyle=":", linewidth=0.9, label="knee")
    if how_many.tolerance_mm is not None:
        axes.axhline(how_many.tolerance_mm, color=DARK, linewidth=0.8, label="asked for")
    axes.set(xlabel="number of poses", ylabel="expected sd of the tool [mm]", ylim=(0, None))
    axes.legend()
    return drawn
