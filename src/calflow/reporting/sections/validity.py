"""Validity: the calibrated robot's expected error where it works, over the joint limits, and later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from calflow.files.words import mm, plural
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.material import Material
from calflow.reporting.promised import Promised, rms_mm
from calflow.reporting.section import section
from calflow.reporting.style import crowded, panels, shade, shades

CAPTION = (
    "Expected error at {poses} drawn at random within the joints' limits (root mean square): the darker, the larger; from the "
    "side and from above. Crosses: measured poses."
)
SIDE = {"xlabel": "horizontal distance from axis 1 [m]", "ylabel": "height z [m]"}
ABOVE = {"xlabel": "x [m]", "ylabel": "y [m]"}
IN_REGION = (
    "Errors at poses {where}, before and now, seen from the side; each has its own scale: the darker, the larger. Left: distance "
    "between nominal and calibrated robot; right: expected error of the calibrated one."
)


def from_the_side(material: Material, place: np.ndarray) -> np.ndarray:
    """Return the distance from the first axis and the height of places (n, 3) [m], shape (n, 2)."""
    base = np.array(material.calibrated.model.robot.base.origin)
    return np.column_stack([np.hypot(*(place - base)[:, :2].T), place[:, 2]])


Map = tuple[str, Mapping[str, str], np.ndarray, Sequence[np.ndarray]]  # title, axes' labels, sizes, places and crosses


def maps(label: str, *every: Map) -> Figure:
    """Draw sizes (n,) [m] at places (n, 2) [m] side by side, each on a scale of its own, with crosses (k, 2) at others."""
    drawn, (grid,) = panels(1, len(every), 2.7)
    for axes, (title, labels, errors, (seen, *crosses)) in zip(grid, every, strict=True):
        size = 1e3 * errors
        low, high = (float(np.quantile(size, share)) for share in (0.02, 0.98))
        norm, dark = Normalize(low, max(high, 1.01 * low)), shades(0.05)
        shade(axes, seen, size, dark, norm)
        for marked in crosses:
            for colour, width in (("white", 1.5), ("black", 0.6)):  # visible on any shade
                axes.scatter(*marked.T, 1.5 * crowded(len(marked)), marker="x", color=colour, linewidths=width)
        axes.set(title=title, **labels)
        axes.set_aspect("equal", adjustable="datalim")
        drawn.colorbar(ScalarMappable(norm, dark), ax=axes, fraction=0.06, pad=0.02, extend="max", label=label)
    return drawn


@section(4, "Where the robot works", "identify/residuals.csv", lambda material: material.is_of_lengths)
def region_section(material: Material) -> list[Block]:
    """State and draw the errors before and after calibration where the robot works."""
    shown = Promised.at_work(material.calibrated, material.data, material.settings.get("select", {}))
    off = f"The nominal robot is off by {rms_mm(shown.nominal)} mm there."
    side = [from_the_side(material, shown.place)]
    before = ("before: nominal robot", SIDE, shown.nominal, side)
    drawn = maps("error [mm]", before, ("now: expected of the calibrated robot", SIDE, shown.error, side))
    return [
        Paragraph(f"{shown.words} {off}", keep=True),
        Plot("region", drawn, IN_REGION.format(where=shown.where), shown.rows),
    ]


@section(58, "Where the calibration holds", "identify/residuals.csv", lambda material: material.is_of_lengths)
def validity_section(material: Material) -> list[Block]:
    """State and draw the expected errors within the joints' limits, and state those later on."""
    shown = material.promised
    when = zip(material.certainty.expected_mm, ("then", "an hour later", "a day later"), strict=False)
    moments = ", ".join(f"{mm(error)} mm {moment}" for error, moment in when)
    caption = CAPTION.format(poses=plural(len(shown.place), "pose"))
    sides = [from_the_side(material, place) for place in (shown.place, material.place)]
    above = [place[:, :2] for place in (shown.place, material.place)]
    drawn = maps(
        "expected error [mm]", ("from the side", SIDE, shown.error, sides), ("from above", ABOVE, shown.error, above)
    )
    return [
        Paragraph(shown.words, keep=True),
        *([Paragraph(f"At the measured poses: {moments}, in the instrument's frame.")] if moments else []),
        Plot("validity", drawn, caption, shown.rows),
    ]
