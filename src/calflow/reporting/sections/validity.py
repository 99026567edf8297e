"""Validity: where, and until when, the calibrated model keeps what page one promises."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel, IdentifySummary, expected_point, position_variance
from calflow.estimation.leverage import beyond
from calflow.files.deferred import pd
from calflow.files.problems import InputError
from calflow.files.tables import Results
from calflow.files.toml import FileModel, Lengths3
from calflow.files.words import mm, percent, plural
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.style import DARK, crowded, panels, shades

POSES = 600  # drawn within the joints' limits, or in a region
CELLED, CELLS = 150, 12  # poses from which a map has cells in the place of dots, and how many of them across
LATER = {"an hour": 3600.0, "a day": 86400.0}  # s, after the measurement
CAPTION = (
    "Expected error at {poses} drawn at random within the joints' limits (root mean square): the darker, the larger; from the "
    "side and from above. Crosses: measured poses."
)
MEASURED, STATED = "where it was measured", "in the study's region"


class _Region(FileModel):
    """The box in which a study says that the robot works."""

    region_min: Lengths3
    region_max: Lengths3


@dataclass(frozen=True, eq=False)
class Promised:
    """What is promised at poses, place (n, 3) [m]: error (n,) [m], and the nominal robot's.

    outside (n,) are poses of which a joint was not measured there; where says which poses they are.
    """

    place: np.ndarray
    error: np.ndarray
    nominal: np.ndarray
    outside: np.ndarray
    where: str

    @staticmethod
    def of(material: Material) -> Promised:
        """Draw poses within the joints' limits, under the first payload and for the first marker that were measured."""
        return _drawn(material, None, "within the joints' limits")

    @staticmethod
    def at_work(material: Material) -> Promised:
        """Return the promise in the box where the study plans poses, else at the poses that were measured."""
        asked = dict(material.settings.get("select", {}))
        box = {key: value for key, value in (asked | asked.get("task", {})).items() if key.startswith("region_m")}
        if box:
            region = _Region.model_validate(box)
            with suppress(InputError):  # hardly any pose reaches it
                return _drawn(material, np.array([region.region_min, region.region_max]), STATED)
        return _promised_at(material, material.data.conditions, np.zeros(len(material.data), dtype=bool), MEASURED)

    @property
    def quantiles(self) -> tuple[float, float]:
        """The error at half of the poses, and at 95 in 100 [mm]."""
        middle, most = 1e3 * np.quantile(self.error, (0.5, 0.95))
        return float(middle), float(most)

    @property
    def words(self) -> str:
        """The figures in words."""
        middle, most = self.quantiles
        sentence = (
            f"Expected error {self.where}: at most {mm(middle)} mm at half of the poses, {mm(most)} mm at 95 in 100 (root mean "
            "square, without the instrument's noise)."
        )
        if self.outside.any():
            inside = ~self.outside
            there = _rms(self.error[self.outside])
            here = f", {_rms(self.error[inside])} mm at the others" if inside.any() else ""
            share = percent(self.outside.mean())
            sentence += f" At {share} of them a joint is beyond its measured range: {there} mm there{here}."
        if (worse := self.error >= self.nominal).any():
            sentence += (
                f" At {percent(worse.mean())} of the poses the calibrated robot is not expected to be any closer than the nominal "
                "one: measure there before you use it there."
            )
        return sentence


def _rms(error: np.ndarray) -> str:
    return mm(1e3 * float(np.sqrt((error**2).mean())))


def _drawn(material: Material, region: np.ndarray | None, where: str) -> Promised:
    calibrated, first = material.calibrated, material.data.table.iloc[0]
    draws = np.random.default_rng(0)
    readings, conditions = candidates(calibrated.model, POSES, first["payload"], first["marker"], region, draws)
    measured = material.data.only(material.data.train).joints
    return _promised_at(material, conditions, np.asarray(beyond(readings, measured).any(axis=1)), where)


def _promised_at(material: Material, conditions: np.ndarray, outside: np.ndarray, where: str) -> Promised:
    calibrated = material.calibrated
    place = expected_point(calibrated, conditions)
    off = calibrated.model.point(calibrated.model.nominal, conditions) - place
    return Promised(place, promised(calibrated, conditions), np.linalg.norm(off, axis=1), outside, where)


def promised(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the distances that positions are promised to, root mean square, shape (n_rows,) [m]."""
    return np.asarray(np.sqrt(position_variance(calibrated, conditions).sum(axis=1)))


def later_words(material: Material) -> str:
    """Say what becomes of the promise at poses that were measured, later; empty where no time is known."""
    calibrated, rows = material.calibrated, material.data.only(material.data.train)
    if "time" not in calibrated.model.given:
        return ""
    rows = rows.stating(calibrated.model.given)
    end = float(rows.table["time"].max())
    moments = [replace(rows, table=rows.table.assign(time=end + seconds)) for seconds in LATER.values()]
    later = [1e3 * float(np.sqrt((promised(calibrated, moment.conditions) ** 2).mean())) for moment in (rows, *moments)]
    words = ", ".join(f"{mm(value)} mm {name} later" for name, value in zip(LATER, later[1:], strict=True))
    return f"At the measured poses: {mm(later[0])} mm then, {words}, as seen from where the instrument stands."


def from_the_side(material: Material, place: np.ndarray) -> np.ndarray:
    """Return the distance from the first axis and the height of places (n, 3) [m], shape (n, 2)."""
    base = np.array(material.calibrated.model.robot.base.origin)
    return np.column_stack([np.hypot(*(place - base)[:, :2].T), place[:, 2]])


def before_and_now(material: Material, shown: Promised) -> Figure:
    """Draw how far the nominal robot is off, and what is promised of the calibrated one, from the side, each on its own scale."""
    drawn, (grid,) = panels(1, 2, 2.6)
    sides = {"before: nominal robot": 1e3 * shown.nominal, "now: expected of the calibrated robot": 1e3 * shown.error}
    seen = from_the_side(material, shown.place)
    for axes, (title, size) in zip(grid, sides.items(), strict=True):
        low, high = (float(np.quantile(size, share)) for share in (0.02, 0.98))
        norm, dark = Normalize(low, max(high, 1.01 * low)), shades(0.05)
        _shaded(axes, seen, size, dark, norm)
        axes.set(title=title, xlabel="horizontal distance from axis 1 [m]")
        axes.set_aspect("equal", adjustable="datalim")
        bar = drawn.colorbar(ScalarMappable(norm, dark), ax=axes, fraction=0.06, pad=0.02)
        bar.ax.set_title("[mm]")
    grid[0].set_ylabel("height z [m]")
    return drawn


def _shaded(axes: Axes, seen: np.ndarray, size: np.ndarray, dark: ListedColormap, norm: Normalize) -> None:
    """Shade places (n, 2) by their errors (n,); where they are many, cells by the root mean square in each."""
    along, height = seen.T
    if len(seen) < CELLED:
        axes.scatter(along, height, c=dark(norm(size)), s=3 * crowded(len(seen)), linewidths=0)
        return
    look: dict[str, Any] = {"cmap": dark, "norm": norm, "linewidths": 0.2}
    axes.hexbin(
        along, height, size, reduce_C_function=lambda cell: np.sqrt(np.mean(np.square(cell))), gridsize=CELLS, **look
    )


def over_the_workspace(material: Material, shown: Promised) -> Figure:
    """Draw what is promised over the workspace, from the side and from above."""
    drawn, grid = panels(1, 2, 2.9)
    dark = shades(0.2)
    size = 1e3 * shown.error
    norm = Normalize(0, float(np.quantile(size, 0.98)))
    ways: dict[tuple[str, str], Callable[[np.ndarray], np.ndarray]] = {
        ("horizontal distance from axis 1 [m]", "height z [m]"): lambda p: from_the_side(material, p).T,
        ("x [m]", "y [m]"): lambda p: p[:, :2].T,
    }
    for axes, ((label, height), of) in zip(grid[0], ways.items(), strict=True):
        (x, y), (x_measured, y_measured) = of(shown.place), of(material.place)
        axes.scatter(x, y, c=dark(norm(size)), s=9, linewidths=0)
        axes.scatter(
            x_measured, y_measured, marker="x", color=DARK, s=1.5 * crowded(len(material.data)), linewidths=0.5
        )
        axes.set(xlabel=label, ylabel=height)
        axes.set_aspect("equal", adjustable="datalim")
    bar = drawn.colorbar(ScalarMappable(norm, dark), ax=list(grid[0]), extend="max", fraction=0.04, pad=0.02)
    bar.set_label("expected error [mm]")
    return drawn


def as_rows(shown: Promised) -> pd.DataFrame:
    """Return a promise as a table for whoever wants a figure's numbers."""
    return pd.DataFrame(shown.place, columns=["x_m", "y_m", "z_m"]).assign(
        promised_mm=1e3 * shown.error, nominal_mm=1e3 * shown.nominal, beyond_measured=shown.outside
    )


def promises(results: Results) -> bool:
    """Whether anything is promised in millimetres: some lengths were measured."""
    return results.document("identify/summary.json", IdentifySummary).new_poses_mm is not None


IN_REGION = (
    "Errors {where}, before and now, seen from the side; each has its own scale: the darker, the larger. Left: distance between "
    "nominal and calibrated robot; right: expected error of the calibrated one."
)


def _region(material: Material) -> list[Block]:
    """Show what the calibration gains where the robot works."""
    shown = Promised.at_work(material)
    off = f"The nominal robot is off by {_rms(shown.nominal)} mm there."
    caption = IN_REGION.format(where=shown.where)
    return [
        Paragraph(f"{shown.words} {off}", keep=True),
        Plot("region", before_and_now(material, shown), caption, as_rows(shown)),
    ]


def _validity(material: Material) -> list[Block]:
    """Say where and until when the promise holds, and show where it is how good."""
    shown = Promised.of(material)
    later = later_words(material)
    caption = CAPTION.format(poses=plural(len(shown.place), "pose"))
    return [
        Paragraph(shown.words, keep=True),
        *([Paragraph(later)] if later else []),
        Plot("validity", over_the_workspace(material, shown), caption, as_rows(shown)),
    ]


VALIDITY_SECTION = Section(
    58,
    "Where the calibration holds",
    ("identify/residuals.csv", "identify/summary.json"),
    _validity,
    worth_telling=promises,
)
REGION_SECTION = Section(
    4, "Where the robot works", ("identify/residuals.csv", "identify/summary.json"), _region, worth_telling=promises
)
