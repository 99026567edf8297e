"""A uniform style of all figures: sizes, colours distinguishable in greyscale, and reproducible SVG."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any
from unicodedata import east_asian_width

import numpy as np

from calflow.files.words import mm

if TYPE_CHECKING:  # a run without a report starts sooner: only drawing needs Matplotlib
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.colors import ListedColormap, Normalize
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.axes3d import Axes3D

WIDTH = 6.7  # inches: the text width of the page, so that fonts keep their size
DARK, ACCENT, MIDDLE, LIGHT = "#1f3f66", "#c8641b", "#7f8790", "#d4d8dd"
ALONE = (
    (DARK, "-", "o"),
    (ACCENT, "--", "^"),
    (MIDDLE, "-.", "s"),
    ("#000000", ":", "D"),
    ("#5a9bd4", (0, (5, 1)), "v"),
)
LETTER = 0.052  # inches per letter of a vertical label
ARROW = 0.09  # length of a large residual's arrow, as a share of the workspace
# A background that keeps labels legible across lines.
PLATE: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.4}
MOST_VECTOR_POINTS = 1000  # points in a figure above which they are rasterised

SETTINGS: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.titlesize": 8,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#444444",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.5,
    "figure.dpi": 100,
    "savefig.dpi": 250,  # of what is drawn as a picture inside an SVG
    "svg.fonttype": "path",
    "svg.hashsalt": "calflow",
    "figure.constrained_layout.use": True,
    "text.parse_math": False,  # names are shown as they are
}
MOST_NAMED = 60  # points up to which each is labelled
CELLED, CELLS = 150, 12  # points above which a map uses cells instead of dots, and the number of cells across


@contextmanager
def style() -> Iterator[None]:
    """Make and save figures in this context, also as a decorator."""
    import matplotlib

    with matplotlib.rc_context(SETTINGS):  # type: ignore[arg-type]
        yield


def figure(height: float, width: float = WIDTH) -> Figure:
    """Return an empty figure of a size [inches]."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def chart(height: float, width: float = WIDTH) -> tuple[Figure, Axes]:
    """Return a figure of a size [inches] with one pair of axes."""
    drawn = figure(height, width)
    return drawn, drawn.add_subplot()


def turned(names: Sequence[str]) -> float:
    """Return the height [inches] of the longest of these names as a vertical label below an axis."""
    return LETTER * max(sum(2 if east_asian_width(letter) in "WF" else 1 for letter in name) for name in names)


def panels(rows: int, columns: int, height: float, **sharing: Any) -> tuple[Figure, np.ndarray]:
    """Return a figure with a grid of axes, shape (rows, columns)."""
    drawn = figure(height)
    return drawn, drawn.subplots(rows, columns, squeeze=False, **sharing)


def dots(axes: Axes, x: np.ndarray, y: np.ndarray, held: np.ndarray, size: float, n_panels: int) -> None:
    """Scatter training rows as open circles and held-out rows as filled triangles; many points are rasterised."""
    picture = n_panels * len(x) > MOST_VECTOR_POINTS
    axes.scatter(x[~held], y[~held], size, facecolors="none", edgecolors=DARK, linewidths=0.2 * size**0.5, rasterized=picture,
                 label="used for the fit")  # fmt: skip
    if held.any():
        look: dict[str, Any] = {"marker": "^", "color": ACCENT, "linewidths": 0, "rasterized": picture}
        axes.scatter(x[held], y[held], size * 1.3, label="held out", **look)


def name_poses(axes: Axes, points: Sequence[Any], what: str = "pose", after: str = "") -> None:
    """Label points, each with a pose and a marker, along the horizontal axis."""
    several = len({point.marker for point in points}) > 1
    names = [f"{point.pose} {point.marker}" if several else point.pose for point in points]
    if len(points) <= MOST_NAMED:
        axes.set_xticks(range(len(points)), names, rotation=90 if len(names) > 20 else 0)
    axes.set_xlabel(f"{what} and marker{after}" if several else f"{what}{after}")
    axes.grid(axis="x", visible=False)


def crowded(n_rows: int) -> float:
    """Return the marker size for this many rows."""
    return float(np.clip(9 - 1.8 * np.log10(max(n_rows, 10) / 10), 1.5, 9))


def plain_decades(axis: Axis, low: float, high: float) -> None:
    """Label a logarithmic axis from low to high with plain numbers, more densely where the range is short."""
    from matplotlib.ticker import LogLocator

    axis.set_major_locator(LogLocator(subs=(1.0,) if high / low > 50 else (1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def mark_floor(line: Callable[..., Any], floor: float | None, unit: str) -> None:
    """Draw a line at the mean error [unit] that noise alone would give, where it is known."""
    if floor:
        line(floor, color="black", linestyle="--", linewidth=0.9, label=f"mean of noise alone: {mm(floor)} {unit}")


def shades(lightest: float) -> ListedColormap:
    """Return a colour map for errors, darker for larger ones, whose lightest colour is visible on white."""
    import matplotlib
    from matplotlib.colors import ListedColormap

    return ListedColormap(matplotlib.colormaps["cividis_r"](np.linspace(lightest, 1, 256)))


def view(axes: Axes, i: int, j: int, title: str) -> None:
    """Set up axes for the coordinates i and j of positions [m], with equal scales."""
    axes.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", title=title)
    axes.set_aspect("equal", adjustable="datalim")


def root_mean_square(values: np.ndarray | list[float]) -> float:
    """Return the root mean square, as the value of a map's cell."""
    return float(np.sqrt(np.mean(np.square(values))))


def shade(
    axes: Axes, seen: np.ndarray, size: np.ndarray, colours: ListedColormap, norm: Normalize,
    reduce: Callable[[np.ndarray | list[float]], float] = root_mean_square,
) -> None:  # fmt: skip
    """Shade places (n, 2) by sizes (n,), darker for larger ones; many points are reduced to cells by `reduce`."""
    x, y = seen.T
    look: dict[str, Any] = {"cmap": colours, "norm": norm}
    if len(seen) < CELLED:
        axes.scatter(x, y, 3 * crowded(len(seen)), size, linewidths=0, **look)
    else:
        axes.hexbin(x, y, size, reduce_C_function=reduce, gridsize=CELLS, linewidths=0.2, **look)


def magnification(position: np.ndarray, error: np.ndarray) -> float:
    """Return a round factor (1, 2 or 5 times a power of ten) that makes large errors visible among the positions."""
    length = np.linalg.norm(error, axis=1)
    large = np.quantile(length[np.isfinite(length)], 0.9)
    if large == 0:
        return 1.0
    wanted = ARROW * np.ptp(position, axis=0).max() / large
    power = 10 ** np.floor(np.log10(wanted))
    return float(max(step * power for step in (1, 2, 5) if step * power <= wanted))


def same_scale(space: Axes3D, segments: np.ndarray) -> None:
    """Give all three axes the same scale; segments has shape (n, n_ends, 3) [m]."""
    low, high = segments.min(axis=(0, 1)), segments.max(axis=(0, 1))
    size = np.maximum(high - low, 0.02 * (high - low).max() or 1e-3)
    ends = np.outer((-0.52, 0.52), size) + (high + low) / 2
    parts = zip("xyz", (space.xaxis, space.yaxis, space.zaxis), ends.T, (-3, -3, -6), strict=True)
    for name, axis, limits, pad in parts:
        space.set(**{f"{name}lim": limits, f"{name}label": f"{name} [m]"})
        space.locator_params(axis=name, nbins=5)
        space.tick_params(axis=name, pad=-2, labelsize=6.5)
        axis.labelpad = pad
        axis.pane.set_facecolor("white")
    space.set_box_aspect(size, zoom=0.88)
