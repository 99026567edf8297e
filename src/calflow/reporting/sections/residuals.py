"""Residuals: in the workspace, along each joint, and of outlying rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calflow.files.deferred import pd
from calflow.files.units import METRE
from calflow.files.words import mm, ratio
from calflow.reporting.advice import flags
from calflow.reporting.blocks import Block, Heading, Paragraph, Plot, PosedRobot, Scene, Table
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.sections.validity import from_the_side
from calflow.reporting.style import (
    DARK,
    MOST_VECTOR_POINTS,
    crowded,
    dots,
    figure,
    magnification,
    panels,
    same_scale,
    shades,
    style,
    view,
)
from calflow.robot.mechanism import reading_columns, reading_labels, shown_readings

BINS = 12  # of the running mean
FLAGGED_ROWS_SHOWN = 15  # flagged rows in the table
DRAWN = 700  # arrows in the workspace at most, to be distinguishable
POSED = 200  # poses at which the page can draw the robot
INTRODUCTION = (
    "Residuals of the calibrated model: predicted minus measured. Noise has no preferred direction. Neighbours with alike errors, "
    "or a trend along a joint, mean that the model lacks a cause."
)
PLACE = "Size of the errors against reach, height and row; a trend over the rows may be warm-up or a moved device."
JOINTS = (
    "Errors against each joint reading. Open circles: used for the fit; triangles: held out; line: mean of neighbouring "
    "rows, flat and near zero where nothing is missing."
)
NO_FIT = (
    "Outliers: their errors are too large for the noise and the spread of the others, or far beyond their 95 % limit. Some look "
    "small because the row has high leverage on the fit."
)


def in_workspace(material: Material) -> Figure:
    """Draw each position with its error enlarged, if it has a direction, in space and from three sides.

    The darker, the larger its size.
    """
    shown = material.drawn[_shown(material)]
    shown = shown[np.isfinite(material.distance[shown])]
    place, error, size, held = (
        values[shown] for values in (material.place, material.error, material.distance, material.held)
    )
    drawn = figure(4.4)
    drawn.set_layout_engine("none")
    dark = shades(0.3)
    norm = Normalize(0, size.max() or 1.0)
    colours = dark(norm(size))
    segments = np.stack([place, place + _factor(material) / 1000 * np.nan_to_num(error)], axis=1)
    picture = len(place) > MOST_VECTOR_POINTS / 5

    space = drawn.add_axes((0.0, 0.47, 0.54, 0.50), projection="3d")
    assert isinstance(space, Axes3D)
    space.add_collection3d(Line3DCollection(segments, colors=colours, linewidths=0.9, rasterized=picture))
    for mask, marker in ((~held, "o"), (held, "^")):
        space.scatter(*place[mask].T, c=colours[mask], marker=marker, s=crowded(len(place)), depthshade=False,
                      linewidths=0, rasterized=picture)  # fmt: skip
    same_scale(space, segments)

    for box, (i, j), title in (
        ((0.63, 0.52, 0.36, 0.43), (0, 1), "from above"),
        ((0.07, 0.085, 0.35, 0.30), (0, 2), "from the side"),
        ((0.63, 0.085, 0.36, 0.30), (1, 2), "from the front"),
    ):
        axes = drawn.add_axes(box)
        lines = list(segments[:, :, [i, j]])
        axes.add_collection(LineCollection(lines, colors=colours, linewidths=1.0, rasterized=picture))
        for mask, marker, name in ((~held, "o", "used for the fit"), (held, "^", "held out")):
            if mask.any():
                axes.scatter(place[mask, i], place[mask, j], c=colours[mask], marker=marker, linewidths=0,
                             s=crowded(len(place)), rasterized=picture, label=name)  # fmt: skip
        view(axes, i, j, title)
        if title == "from above":
            legend = drawn.legend(*axes.get_legend_handles_labels(), loc="upper left", ncols=2)
            for handle in legend.legend_handles:
                handle.set(color=DARK, sizes=[12])  # type: ignore[union-attr]
    bar = drawn.add_axes((0.475, 0.10, 0.012, 0.24))
    drawn.colorbar(ScalarMappable(norm, dark), cax=bar)
    bar.set_title(f"error [{material.unit.label}]", fontsize=7)
    return drawn


def against(material: Material, errors: Mapping[str, np.ndarray], along: Mapping[str, np.ndarray]) -> Figure:
    """Draw errors (n_rows,), nan where a row has none, against quantities (n_rows,); keys are axis labels.

    The rows drawn have a dot each; the mean is that of all.
    """
    held, shown = material.held, material.drawn
    several = len(errors) > 1
    drawn, grid = panels(len(errors), len(along), max(2.1, 1.3 * len(errors)), sharey=True, sharex="col")
    most = 1.1 * max(np.nanmax(np.abs(error)) for error in errors.values()) or 1.0
    signed = any((error < 0).any() for error in errors.values())
    for line, (name, error) in zip(grid, errors.items(), strict=True):
        there = np.isfinite(error)
        dotted = shown[there[shown]]
        for axes, values in zip(line, along.values(), strict=True):
            size = crowded(len(shown)) * (0.6 if several else 1.0)
            dots(axes, values[dotted], error[dotted], held[dotted], size, grid.size)
            running_mean(axes, values[there], error[there])
            axes.locator_params(axis="x", nbins=3 if len(along) > 3 else 6)
            axes.ticklabel_format(axis="x", style="plain")
        line[0].set(ylabel=name, ylim=(-most if signed else 0, most))
    for axes, label in zip(grid[-1], along, strict=True):
        axes.set_xlabel(label)
    drawn.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return drawn


def running_mean(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Draw the mean of y in bins of x with about equally many rows; rows with equal x share a bin."""
    shares = np.linspace(0, 1, min(BINS, len(x) // 5) + 1)[1:-1]
    edges = np.unique(np.quantile(x, shares)) if len(x) >= 10 else np.array([])
    bins = np.searchsorted(edges, x, side="left")
    count = np.bincount(bins)
    full = count > 0
    if full.sum() > 1:
        centre, mean = (np.bincount(bins, values)[full] / count[full] for values in (x, y))
        axes.plot(centre, mean, color="black", marker="s", markersize=1.8, linewidth=0.9, label="mean")


@section(50, "What is left: residuals", "identify/residuals.csv")
def residuals_section(material: Material) -> list[Block]:
    """Draw the residuals against place, in space and against joints, and tabulate outlying rows."""
    shown = _shown(material)
    some = f" {len(shown)} of {len(material.data)} rows are shown." if len(shown) < len(material.data) else ""
    drawn, plots = material.drawn_words, Plots(material)
    directed, rows = _directed(material), by_row(material)
    enlarged = (
        f", drawn {_factor(material):,.0f} times enlarged"
        if directed
        else " (as dots: they have no direction in space)"
    )
    return [
        Paragraph(INTRODUCTION, keep=True),
        Plot("residuals_place", plots.residuals_by_place(), PLACE + drawn, rows),
        Plot(
            "residuals_workspace",
            plots.residuals_in_space(),
            f"Errors in the measuring frame{enlarged}; the darker, the larger.{some}",
            rows,
            scene=_scene(material, shown) if material.unit == METRE else None,
        ),
        Plot("residuals_joints", plots.residuals(), JOINTS + drawn, rows),
        *_flagged(material),
    ]


def by_row(material: Material) -> pd.DataFrame:
    """Return the figures' data: name, position, joint readings and errors of each row drawn."""
    robot, table = material.data.robot, material.data.table
    place = {f"{axis}_mm": 1e3 * material.place[:, k] for k, axis in enumerate("xyz")}
    joints = shown_readings(robot, material.data.joints)
    readings = {name: joints[:, k] for k, name in enumerate(reading_columns(robot))}
    error = {f"d{axis}_mm": material.error[:, k] for k, axis in enumerate("xyz")}
    error[f"error_{material.unit.label}"] = material.distance
    named = {name: table[name].astype(str).to_numpy() for name in ("pose", "marker")}
    return pd.DataFrame({**named, "held_out": material.held, **place, **readings, **error}).iloc[material.drawn]


@dataclass(frozen=True)
class Plots:
    """Figures of Matplotlib; `.savefig(path)` writes one."""

    material: Material

    @style()
    def residuals(self) -> Figure:
        """Draw the position errors against each joint's reading."""
        material, robot = self.material, self.material.data.robot
        readings = shown_readings(robot, material.data.joints)
        along = dict(zip(reading_labels(robot), readings.T, strict=True))
        return against(material, _components(material), along)

    @style()
    def residuals_by_place(self) -> Figure:
        """Draw the errors' size against reach, height and row."""
        material = self.material
        along = {
            "horizontal distance from axis 1 [m]": from_the_side(material, material.place)[:, 0],
            "height z [m]": material.place[:, 2],
            "row of the file": np.arange(1, len(material.distance) + 1),
        }
        return against(material, {f"error [{material.unit.label}]": material.distance}, along)

    @style()
    def residuals_in_space(self) -> Figure:
        """Draw the errors in the workspace, enlarged."""
        return in_workspace(self.material)


def _directed(material: Material) -> bool:
    """Whether any error has a direction."""
    return bool(np.isfinite(material.error).all(axis=1).any())


def _factor(material: Material) -> float:
    """Return the magnification of the errors."""
    return magnification(1e3 * material.place, material.error) if _directed(material) else 1.0


def _shown(material: Material) -> np.ndarray:
    """Return the indices, among the rows drawn, of those shown in the workspace."""
    n = len(material.drawn)
    return np.unique(np.linspace(0, n - 1, DRAWN).astype(int))


def _scene(material: Material, shown: np.ndarray) -> Scene:
    """Return the interactive view of the errors, with the robot at their poses."""
    calibrated, rows = material.calibrated, material.drawn[shown]
    robot, pose = calibrated.model.robot, material.data.table["pose"].to_numpy()[rows]
    poses, first = np.unique(pose, return_index=True)
    kept = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), POSED)).astype(int))
    conditions = material.data.conditions[:, rows[first[kept]]]
    links = np.stack(
        [calibrated.model.link(name, calibrated.estimate, conditions)[:, :3, 3] for name in robot.links], axis=1
    )
    edges = [(parent, joint) for joint, parent in enumerate(robot.parents, start=1)]
    number = {name: k for k, name in enumerate(poses[kept])}
    arm = PosedRobot(1e3 * links, edges, [number.get(name, -1) for name in pose])
    return Scene(shown.tolist(), _factor(material), ("pose", "marker"), arm)


def _components(material: Material) -> dict[str, np.ndarray]:
    """Return the components of the errors (n_rows,) by axis label, nan where a row does not have one."""
    values, unit = material.values, material.unit
    if unit == METRE:
        alone = np.where(np.isnan(values[:, 1]), values[:, 0], np.nan)
        parts = {f"d{axis} [mm]": error for axis, error in zip("xyz", material.error.T, strict=True)}
        parts["length [mm]"] = alone
    else:
        kind = next(of for of in material.calibrated.model.observations if of.units[0] == unit)
        names = [*(f"d{name}" for name in kind.columns.needed), *(f"value {k + 1}" for k in range(values.shape[1]))]
        parts = {f"{name} [{unit.label}]": value for name, value in zip(names, values.T, strict=False)}
    return {name: part for name, part in parts.items() if np.isfinite(part).any()}


def _flagged(material: Material) -> list[Block]:
    rows = flags(material)
    flagged = rows[rows["flagged"].astype(bool)].sort_values("error", ascending=False)
    if flagged.empty:
        return [
            Paragraph("No single row is an outlier. Several rows with alike errors are left to the search for causes.")
        ]
    cells = [
        (*(str(row[name]) for name in ("line", "pose", "repeat", "marker")),
         "held out" if row["split"] == "holdout" else "used", f"{mm(row['error'])} {row['unit']}", ratio(row["whitened"]))
        for row in flagged.head(FLAGGED_ROWS_SHOWN).to_dict("records")
    ]  # fmt: skip
    left = (
        f" The {FLAGGED_ROWS_SHOWN} largest of {len(flagged)} are shown." if len(flagged) > FLAGGED_ROWS_SHOWN else ""
    )
    header = ("line of the file", "pose", "repeat", "marker", "row", "error", "times the noise")
    return [Heading("Rows that do not fit"), Paragraph(f"{NO_FIT}{left}", keep=True), Table(header, cells, "rrrllrr")]
