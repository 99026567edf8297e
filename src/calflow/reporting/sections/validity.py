"""Validity: where, and until when, the calibrated model keeps what page one promises."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from calflow.deployment.run_outcome import RunOutcome
from calflow.files.deferred import pd
from calflow.files.words import plural
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.material import Material
from calflow.reporting.promise import Promised, later_words, rms_mm
from calflow.reporting.section import Section
from calflow.reporting.style import DARK, crowded, panels, shade, shades

CAPTION = (
    "Expected error at {poses} drawn at random within the joints' limits (root mean square): the darker, the larger; from the "
    "side and from above. Crosses: measured poses."
)


def from_the_side(material: Material, place: np.ndarray) -> np.ndarray:
    """Return the distance from the first axis and the height of places (n, 3) [m], shape (n, 2)."""
    base = np.array(material.calibrated.model.robot.base.origin)
    return np.column_stack([np.hypot(*(place - base)[:, :2].T), place[:, 2]])


@dataclass(frozen=True, eq=False)
class Map:
    """Sizes (n,) [mm] at places as they are seen (n, 2) [m], along two axes; crosses mark others (n, 2)."""

    title: str
    labels: tuple[str, str]
    seen: np.ndarray
    size: np.ndarray
    crosses: np.ndarray | None = None


def maps(several: Sequence[Map], label: str) -> Figure:
    """Draw maps beside each other, each with its own scale; label says what sizes are."""
    drawn, (grid,) = panels(1, len(several), 2.7)
    dark = shades(0.05)
    for axes, shown in zip(grid, several, strict=True):
        low, high = (float(np.quantile(shown.size, share)) for share in (0.02, 0.98))
        norm = Normalize(low, max(high, 1.01 * low))
        shade(axes, shown.seen, shown.size, dark, norm)
        if shown.crosses is not None:
            size = 1.5 * crowded(len(shown.crosses))
            axes.scatter(*shown.crosses.T, marker="x", color=DARK, s=size, linewidths=0.5)
        axes.set(title=shown.title, xlabel=shown.labels[0], ylabel=shown.labels[1])
        axes.set_aspect("equal", adjustable="datalim")
        drawn.colorbar(ScalarMappable(norm, dark), ax=axes, fraction=0.06, pad=0.02, extend="max", label=label)
    return drawn


SIDE = ("horizontal distance from axis 1 [m]", "height z [m]")


def before_and_now(material: Material, shown: Promised) -> Figure:
    """Draw how far the nominal robot is off, and what is promised of the calibrated one, from the side."""
    seen = from_the_side(material, shown.place)
    sides = {"before: nominal robot": shown.nominal, "now: expected of the calibrated robot": shown.error}
    return maps([Map(title, SIDE, seen, 1e3 * size) for title, size in sides.items()], "error [mm]")


def over_the_workspace(material: Material, shown: Promised) -> Figure:
    """Draw what is promised over the workspace, from the side and from above, and where it was measured."""
    size = 1e3 * shown.error
    side, measured = (from_the_side(material, place) for place in (shown.place, material.place))
    views = [
        Map("from the side", SIDE, side, size, measured),
        Map("from above", ("x [m]", "y [m]"), shown.place[:, :2], size, material.place[:, :2]),
    ]
    return maps(views, "expected error [mm]")


def as_rows(shown: Promised) -> pd.DataFrame:
    """Return a promise as a table for whoever wants a figure's numbers."""
    return pd.DataFrame(shown.place, columns=["x_m", "y_m", "z_m"]).assign(
        promised_mm=1e3 * shown.error, nominal_mm=1e3 * shown.nominal, beyond_measured=shown.outside
    )


def promises(outcome: RunOutcome) -> bool:
    """Whether anything is promised in millimetres: some lengths were measured."""
    return outcome.summary.new_poses_mm is not None


IN_REGION = (
    "Errors at poses {where}, before and now, seen from the side; each has its own scale: the darker, the larger. Left: distance "
    "between nominal and calibrated robot; right: expected error of the calibrated one."
)


def _region(material: Material) -> list[Block]:
    """Show what the calibration gains where the robot works."""
    shown = Promised.at_work(material.calibrated, material.data, material.settings.get("select", {}))
    off = f"The nominal robot is off by {rms_mm(shown.nominal)} mm there."
    caption = IN_REGION.format(where=shown.where)
    return [
        Paragraph(f"{shown.words} {off}", keep=True),
        Plot("region", before_and_now(material, shown), caption, as_rows(shown)),
    ]


def _validity(material: Material) -> list[Block]:
    """Say where and until when the promise holds, and show where it is how good."""
    shown = Promised.of(material.calibrated, material.data)
    later = later_words(material.calibrated, material.data)
    caption = CAPTION.format(poses=plural(len(shown.place), "pose"))
    return [
        Paragraph(shown.words, keep=True),
        *([Paragraph(later)] if later else []),
        Plot("validity", over_the_workspace(material, shown), caption, as_rows(shown)),
    ]


VALIDITY_SECTION = Section(58, "Where the calibration holds", "identify/residuals.csv", _validity, promises)
REGION_SECTION = Section(4, "Where the robot works", "identify/residuals.csv", _region, promises)
