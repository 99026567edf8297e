"""Figures of residuals: where in the workspace, and against what the robot did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calflow.reporting.style import ACCENT, DARK, MANY, crowded, dots, figure, panels

ARROW = 0.09  # length of a large residual's arrow, as a share of the workspace
BINS = 12  # of the running mean


def magnification(position: np.ndarray, error: np.ndarray) -> float:
    """Return a round factor (1, 2 or 5 times a power of ten) that makes large errors visible among the positions."""
    length = np.linalg.norm(error, axis=1)
    large = np.quantile(length[np.isfinite(length)], 0.9)
    if large == 0:
        return 1.0
    wanted = ARROW * np.ptp(position, axis=0).max() / large
    power = 10 ** np.floor(np.log10(wanted))
    return float(max(step * power for step in (1, 2, 5) if step * power <= wanted))


def in_workspace(
    position: np.ndarray, error: np.ndarray, length: np.ndarray, held: np.ndarray, factor: float
) -> Figure:
    """Draw each position with its error times factor, in space and from three sides.

    position and error have shape (n_rows, 3) [mm], error nan where it has no direction; the darker, the larger its length
    (n_rows,) [mm].
    """
    drawn = figure(4.8)
    drawn.set_layout_engine("none")
    dark = ListedColormap(matplotlib.colormaps["cividis_r"](np.linspace(0.3, 1, 256)))
    norm = Normalize(0, length.max() or 1.0)
    colours = dark(norm(length))
    segments = np.stack([position, position + factor * np.nan_to_num(error)], axis=1) / 1000
    picture = len(position) > MANY / 5

    space = drawn.add_axes((0.0, 0.44, 0.54, 0.53), projection="3d")
    assert isinstance(space, Axes3D)
    space.add_collection3d(Line3DCollection(segments, colors=colours, linewidths=0.9, rasterized=picture))
    for mask, marker in ((~held, "o"), (held, "^")):
        space.scatter(*position[mask].T / 1000, c=colours[mask], marker=marker, s=crowded(len(position)), depthshade=False,
                      linewidths=0, rasterized=picture)  # fmt: skip
    _same_scale(space, segments)

    for box, (i, j), title in (
        ((0.63, 0.52, 0.36, 0.43), (0, 1), "from above"),
        ((0.07, 0.085, 0.35, 0.30), (0, 2), "from the side"),
        ((0.63, 0.085, 0.36, 0.30), (1, 2), "from the front"),
    ):
        axes = drawn.add_axes(box)
        axes.add_collection(
            LineCollection(list(segments[:, :, [i, j]]), colors=colours, linewidths=1.0, rasterized=picture)
        )
        for mask, marker, name in ((~held, "o", "used for the fit"), (held, "^", "held out")):
            if mask.any():
                axes.scatter(position[mask, i] / 1000, position[mask, j] / 1000, c=colours[mask], marker=marker, linewidths=0,
                             s=crowded(len(position)), rasterized=picture, label=name)  # fmt: skip
        axes.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", title=title)
        axes.set_aspect("equal", adjustable="datalim")
        if title == "from above":
            legend = drawn.legend(*axes.get_legend_handles_labels(), loc="upper left", ncols=2)
            for handle in legend.legend_handles:
                handle.set(color=DARK, sizes=[12])  # type: ignore[union-attr]
    bar = drawn.add_axes((0.475, 0.10, 0.012, 0.24))
    drawn.colorbar(ScalarMappable(norm, dark), cax=bar)
    bar.set_title("error [mm]", fontsize=7)
    return drawn


def against_joints(
    reading: np.ndarray, parts: Mapping[str, np.ndarray], held: np.ndarray, shown: np.ndarray, labels: Sequence[str]
) -> Figure:
    """Draw the parts of the errors (n_rows,) [mm], nan where a row has none, against every joint's reading (n_rows, n_joints).

    shown are the rows that get a dot; the mean is that of all.
    """
    n_joints = reading.shape[1]
    drawn, grid = panels(len(parts), n_joints, 1.3 * max(len(parts), 1.5), sharey=True, sharex="col")
    limit = 1.1 * max(np.nanmax(np.abs(error)) for error in parts.values()) or 1.0
    for k, (name, error) in enumerate(parts.items()):
        there = np.isfinite(error)
        dotted = shown[there[shown]]
        for i in range(n_joints):
            axes = grid[k, i]
            dots(
                axes, reading[dotted, i], error[dotted], held[dotted], 0.6 * crowded(len(shown)), len(parts) * n_joints
            )
            running_mean(axes, reading[there, i], error[there])
            axes.set_ylim(-limit, limit)
            axes.locator_params(axis="x", nbins=3)
        grid[k, 0].set_ylabel(f"{name} [mm]")
    for i, label in enumerate(labels):
        grid[-1, i].set_xlabel(label)
        grid[0, i].set_title(f"joint {i + 1}")
    return drawn


def against_place(
    reach: np.ndarray, height: np.ndarray, distance: np.ndarray, held: np.ndarray, shown: np.ndarray
) -> Figure:
    """Draw the errors' lengths [mm] against reach and height [m] and against the order of the rows.

    shown are the rows that get a dot; the mean is that of all.
    """
    drawn, grid = panels(1, 3, 2.1, sharey=True)
    order = np.arange(1, len(distance) + 1)
    for axes, values, label in zip(
        grid[0],
        (reach, height, order),
        ("horizontal distance from axis 1 [m]", "height z [m]", "row of the file"),
        strict=True,
    ):
        dots(axes, values[shown], distance[shown], held[shown], crowded(len(shown)), 3)
        running_mean(axes, values, distance)
        axes.set_xlabel(label)
        axes.ticklabel_format(axis="x", style="plain")  # of a million rows too
    grid[0, 0].set_ylabel("error [mm]")
    grid[0, 0].set_ylim(0, 1.22 * distance.max() or 1.0)
    grid[0, 0].legend(loc="upper left", ncols=3, columnspacing=0.8, handletextpad=0.2, handlelength=1.2)
    return drawn


def running_mean(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Draw the mean of y in bins of x that hold about equally many rows; rows with the same x stay together."""
    edges = (
        np.unique(np.quantile(x, np.linspace(0, 1, min(BINS, len(x) // 5) + 1)[1:-1])) if len(x) >= 10 else np.array([])
    )
    bins = np.searchsorted(edges, x, side="left")
    count = np.bincount(bins)
    full = count > 0
    if full.sum() > 1:
        centre, mean = (np.bincount(bins, values)[full] / count[full] for values in (x, y))
        axes.plot(centre, mean, color="black", marker="s", markersize=1.8, linewidth=0.9, label="mean")


def map_of_poses(position: np.ndarray) -> Figure:
    """Draw planned tool positions (n_poses, 3) [mm] in space and from above, the path in measuring order."""
    drawn = figure(2.9)
    drawn.set_layout_engine("none")
    points = position / 1000
    space = drawn.add_axes((0.0, 0.02, 0.5, 0.98), projection="3d")
    assert isinstance(space, Axes3D)
    above = drawn.add_axes((0.6, 0.17, 0.38, 0.75))
    for axes, columns in ((space, points.T), (above, points[:, :2].T)):
        axes.plot(*columns, color="#b4bbc3", linewidth=0.4)
        axes.plot(*columns, "o", color=DARK, markersize=2.5, rasterized=len(points) > MANY)
        axes.plot(*columns[:, :1], "s", color=ACCENT, markersize=5)
    _same_scale(space, points[:, None])
    above.set(xlabel="x [m]", ylabel="y [m]", title="from above")
    above.set_aspect("equal", adjustable="datalim")
    return drawn


def _same_scale(space: Axes3D, segments: np.ndarray) -> None:
    """Give all three axes the same scale; segments has shape (n, n_ends, 3) [m]."""
    low, high = segments.min(axis=(0, 1)), segments.max(axis=(0, 1))
    size = np.maximum(high - low, 0.02 * (high - low).max() or 1e-3)
    middle = (high + low) / 2
    for i, (axis, limits) in enumerate(zip("xyz", (space.set_xlim, space.set_ylim, space.set_zlim), strict=True)):
        limits(middle[i] - 0.52 * size[i], middle[i] + 0.52 * size[i])
        space.locator_params(axis=axis, nbins=5)
        space.tick_params(axis=axis, pad=-2, labelsize=6.5)
    space.set_box_aspect(size, zoom=0.88)
    space.set_xlabel("x [m]", labelpad=-3)
    space.set_ylabel("y [m]", labelpad=-3)
    space.set_zlabel("z [m]", labelpad=-6)
    space.xaxis.pane.set_facecolor("white")
    space.yaxis.pane.set_facecolor("white")
    space.zaxis.pane.set_facecolor("white")
