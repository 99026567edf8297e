"""The figure of joint errors found on two series of measurements."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from calflow.reporting.style import ACCENT, DARK, panels

COLUMNS = 3


def two_series(curves: pd.DataFrame) -> Figure:
    """Draw every joint's error [µrad] against its angle [deg], a slide's in µm and mm, as found here and on the other series."""
    groups = list(curves.groupby(["cause", "joint"], sort=False))
    rows = -(-len(groups) // COLUMNS)
    drawn, grid = panels(rows, COLUMNS, 1.9 * rows + 0.3)
    for axes, ((_, joint), curve) in zip(grid.flat, groups, strict=False):
        slides = "position_mm" in curve and curve["position_mm"].notna().all()
        along, unit = ("position_mm", "um") if slides else ("angle_deg", "urad")
        axes.plot(curve[along], curve[f"here_{unit}"], color=DARK, label="here")
        axes.plot(curve[along], curve[f"there_{unit}"], color=ACCENT, linestyle="--", label="the other series")
        axes.set(title=f"joint {joint}", xlabel="position [mm]" if slides else "angle [deg]")
        if slides or axes in grid[:, 0]:
            axes.set_ylabel("error [µm]" if slides else "error [µrad]")
    for axes in list(grid.flat)[len(groups) :]:
        axes.set_visible(False)
    drawn.legend(*grid.flat[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return drawn
