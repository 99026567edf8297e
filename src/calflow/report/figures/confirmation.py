"""The figure of joint errors found on two series of measurements."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from calflow.report.style import ACCENT, DARK, panels

COLUMNS = 3


def two_series(curves: pd.DataFrame) -> Figure:
    """Draw every joint's error [µrad] against its angle [deg], as found here and on the other series."""
    groups = list(curves.groupby(["cause", "joint"], sort=False))
    rows = -(-len(groups) // COLUMNS)
    drawn, grid = panels(rows, COLUMNS, 1.9 * rows + 0.3)
    for axes, ((_, joint), curve) in zip(grid.flat, groups, strict=False):
        axes.plot(curve["angle_deg"], curve["here_urad"], color=DARK, label="here")
        axes.plot(curve["angle_deg"], curve["there_urad"], color=ACCENT, linestyle="--", label="the other series")
        axes.set(title=f"joint {joint}", xlabel="angle [deg]")
    for axes in grid[:, 0]:
        axes.set_ylabel("error [µrad]")
    for axes in list(grid.flat)[len(groups) :]:
        axes.set_visible(False)
    drawn.legend(*grid.flat[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return drawn
