"""Validity: where, and until when, the calibrated model keeps what page one promises."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel, IdentifySummary, expected_point, position_variance
from calflow.estimation.leverage import beyond
from calflow.files.words import plural
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.style import DARK, crowded, panels, shades

POSES = 600  # drawn within the joints' limits
LATER = {"an hour": 3600.0, "a day": 86400.0}  # s, after the measurement
CAPTION = (
    "What the calibrated robot is promised to err by at {poses} drawn at random within its joints' limits, root mean square "
    "distance: the darker, the more; from the side, and from above. Crosses: poses that were measured."
)


@dataclass(frozen=True, eq=False)
class Promised:
    """What is promised at poses drawn within the joints' limits, place (n, 3) [m]: error (n,) [m], and the nominal robot's.

    outside (n,) are poses of which a joint was not measured there.
    """

    place: np.ndarray
    error: np.ndarray
    nominal: np.ndarray
    outside: np.ndarray

    @staticmethod
    def of(material: Material) -> Promised:
        """Draw poses under the first payload and for the first marker that were measured."""
        known, first = material.calibrated, material.data.table.iloc[0]
        draws = np.random.default_rng(0)
        readings, conditions = candidates(known.model, POSES, first["payload"], first["marker"], None, draws)
        place = expected_point(known, conditions)
        off = known.model.point(known.model.nominal, conditions) - place
        measured = material.data.only(material.data.train).joints
        outside = np.asarray(beyond(readings, measured).any(axis=1))
        return Promised(place, promised(known, conditions), np.linalg.norm(off, axis=1), outside)

    @property
    def words(self) -> str:
        """The figures in words."""
        middle, most = (1e3 * float(np.quantile(self.error, share)) for share in (0.5, 0.95))
        said = (
            f"Within the joints' limits positions are promised to {middle:.3f} mm at half of the poses, and to {most:.3f} mm at "
            "95 in 100 (root mean square distance, the device's noise not in it)."
        )
        if self.outside.any():
            inside = ~self.outside
            there = 1e3 * float(np.sqrt((self.error[self.outside] ** 2).mean()))
            here = (
                f", {1e3 * float(np.sqrt((self.error[inside] ** 2).mean())):.3f} mm at the others"
                if inside.any()
                else ""
            )
            said += f" At {self.outside.mean():.0%} of them a joint stands beyond what was measured: {there:.3f} mm there{here}."
        if (worse := self.error >= self.nominal).any():
            said += (
                f" At {worse.mean():.0%} the calibrated robot is not promised to be any nearer than the nominal one: measure "
                "there before it is used there."
            )
        return said


def promised(known: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the distances that positions are promised to, root mean square, shape (n_rows,) [m]."""
    return np.asarray(np.sqrt(position_variance(known, conditions).sum(axis=1)))


def later_words(material: Material) -> str:
    """Say what becomes of the promise at poses that were measured, later; empty where no time is known."""
    known, rows = material.calibrated, material.data.only(material.data.train)
    if "time" not in known.model.given:
        return ""
    rows = rows.stating(known.model.given)
    end = float(rows.table["time"].max())
    moments = [replace(rows, table=rows.table.assign(time=end + seconds)) for seconds in LATER.values()]
    later = [1e3 * float(np.sqrt((promised(known, one.conditions) ** 2).mean())) for one in (rows, *moments)]
    words = ", ".join(f"{value:.3f} mm {name} later" for name, value in zip(LATER, later[1:], strict=True))
    return (
        f"At the poses that were measured it was {later[0]:.3f} mm then, {words}, as seen from where the device stands."
    )


def over_the_workspace(material: Material, shown: Promised) -> Figure:
    """Draw what is promised over the workspace, from the side and from above."""
    drawn, grid = panels(1, 2, 2.9)
    dark = shades(0.2)
    size = 1e3 * shown.error
    norm = Normalize(0, float(np.quantile(size, 0.98)))
    base = np.array(material.calibrated.model.robot.base.origin)
    ways = {
        ("horizontal distance from axis 1 [m]", "height z [m]"): lambda p: (np.hypot(*(p - base)[:, :2].T), p[:, 2]),
        ("x [m]", "y [m]"): lambda p: (p[:, 0], p[:, 1]),
    }
    for axes, ((label, height), of) in zip(grid[0], ways.items(), strict=True):
        axes.scatter(*of(shown.place), c=dark(norm(size)), s=9, linewidths=0)
        axes.scatter(*of(material.place), marker="x", color=DARK, s=1.5 * crowded(len(material.data)), linewidths=0.5)
        axes.set(xlabel=label, ylabel=height)
        axes.set_aspect("equal", adjustable="datalim")
    bar = drawn.colorbar(ScalarMappable(norm, dark), ax=list(grid[0]), extend="max", fraction=0.04, pad=0.02)
    bar.set_label("promised error [mm]")
    return drawn


def _validity(material: Material) -> list[Block]:
    """Say where and until when the promise holds, and show where it is how good."""
    shown = Promised.of(material)
    rows = pd.DataFrame(shown.place, columns=["x_m", "y_m", "z_m"]).assign(
        promised_mm=1e3 * shown.error, nominal_mm=1e3 * shown.nominal, beyond_measured=shown.outside
    )
    caption = CAPTION.format(poses=plural(len(rows), "pose"))
    later = later_words(material)
    return [
        Paragraph(shown.words, keep=True),
        *([Paragraph(later)] if later else []),
        Plot("validity", over_the_workspace(material, shown), caption, rows),
    ]


VALIDITY_SECTION = Section(
    58,
    "Where the calibration holds",
    ("identify/residuals.csv", "identify/summary.json"),
    _validity,
    worth_telling=lambda results: results.document("identify/summary.json", IdentifySummary).new_poses_mm is not None,
)
