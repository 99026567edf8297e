"""Validity: the calibrated robot's expected error where it works, over the joint limits, and later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from calflow.deployment.run_outcome import RunOutcome
from calflow.deployment.usability import no_gain_words
from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.files.deferred import pd
from calflow.files.problems import InputError
from calflow.files.toml import FileModel, Lengths3
from calflow.files.words import listed, mm, percent, plural, plural_word
from calflow.measurements.measurements import Measurements
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.style import crowded, panels, root_mean_square, shade, shades

DRAWN_POSES = 600  # drawn within the joints' limits, or in a region
MUCH_MORE = 2.0  # times what is promised at measured poses, from which page one says what is promised beyond them
MEASURED, STATED, WITHIN = "that were measured", "in the study's region", "within the joints' limits"
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


class _Region(FileModel):
    """The region in which the robot works, by the study."""

    region_min: Lengths3
    region_max: Lengths3


@dataclass(frozen=True, eq=False)
class Promised:
    """Expected errors (n,) [m] at poses, place (n, 3) [m], and nominal, the distance to the nominal robot (n,) [m].

    gained (n,): mask of poses with a certain gain; beyond (n, n_joints): mask of joints beyond their measured range; where: which
    poses, in words.
    """

    place: np.ndarray
    error: np.ndarray
    nominal: np.ndarray
    gained: np.ndarray
    beyond: np.ndarray
    where: str

    @staticmethod
    def of(
        calibrated: CalibratedModel, data: Measurements, region: np.ndarray | None = None, where: str = WITHIN
    ) -> Promised:
        """Return the expected errors at random poses in a region (2, 3) [m], with the first payload and marker measured."""
        first, draws = data.table.iloc[0], np.random.default_rng(0)
        readings, conditions = candidates(
            calibrated.model, DRAWN_POSES, first["payload"], first["marker"], region, draws
        )
        return _promised_at(calibrated, conditions, calibrated.beyond_range(readings), where)

    @staticmethod
    def at_work(calibrated: CalibratedModel, data: Measurements, planned: Mapping[str, Any]) -> Promised:
        """Return the expected errors in the region where the study plans poses, else at the poses that were measured.

        planned: the settings of the stage select.
        """
        box = {
            key: value for key, value in {**planned, **planned.get("task", {})}.items() if key.startswith("region_m")
        }
        if box:
            region = _Region.model_validate(box)
            with suppress(InputError):  # hardly any pose reaches it
                return Promised.of(calibrated, data, np.array([region.region_min, region.region_max]), STATED)
        return _promised_at(calibrated, data.conditions, np.zeros(data.joints.shape, dtype=bool), MEASURED)

    @property
    def outside(self) -> np.ndarray:
        """Mask of poses (n,) with a joint beyond its measured range."""
        return np.asarray(self.beyond.any(axis=1))

    def beyond_words(self, within: float) -> str:
        """Return a sentence on joints measured over a part of their travel; empty unless far more than within [mm] is promised."""
        if not self.outside.any() or 1e3 * root_mean_square(self.error[self.outside]) < MUCH_MORE * within:
            return ""
        joints = (np.flatnonzero(self.beyond.any(axis=0)) + 1).tolist()
        part = "was measured over a part of its" if len(joints) == 1 else "were measured over a part of their"
        expected = f"expect an RMS error of {rms_mm(self.error[self.outside])} mm ({mm(within)} mm within)"
        return f" {plural_word(joints, 'Joint')} {listed(joints, 8)} {part} travel: beyond that {expected}."

    @property
    def words(self) -> str:
        """The expected errors in words."""
        middle, most = (1e3 * float(np.quantile(self.error, share)) for share in (0.5, 0.95))
        sentence = (
            f"Expected error at poses {self.where}: at most {mm(middle)} mm at half of the poses, {mm(most)} mm at 95 in 100 (root "
            "mean square, without the instrument's noise)."
        )
        if self.outside.any():
            inside = ~self.outside
            there = rms_mm(self.error[self.outside])
            here = f", {rms_mm(self.error[inside])} mm at the others" if inside.any() else ""
            share = percent(self.outside.mean())
            sentence += f" At {share} of them a joint is beyond its measured range: {there} mm there{here}."
        measure = "" if self.where == MEASURED else " Measure there before you use it there."
        no_gain = no_gain_words(float(1.0 - self.gained.mean()), self.where)
        return f"{sentence} {no_gain}{measure}" if no_gain else sentence


def rms_mm(error: np.ndarray) -> str:
    """Return the root mean square of errors [m] in words [mm]."""
    return mm(1e3 * root_mean_square(error))


def _promised_at(calibrated: CalibratedModel, conditions: np.ndarray, beyond: np.ndarray, where: str) -> Promised:
    place, error = calibrated.expected_point(conditions), calibrated.promised_distance(conditions)
    nominal, gained = calibrated.distance_moved(conditions), calibrated.gain_is_certain(conditions)
    return Promised(place, error, nominal, gained, beyond, where)


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


def as_rows(shown: Promised) -> pd.DataFrame:
    """Return the data of a figure."""
    return pd.DataFrame(shown.place, columns=["x_m", "y_m", "z_m"]).assign(
        promised_mm=1e3 * shown.error, nominal_mm=1e3 * shown.nominal, beyond_measured=shown.outside
    )


def promises(outcome: RunOutcome) -> bool:
    """Whether errors are expected in millimetres: some lengths were measured."""
    return outcome.summary.new_poses_mm is not None


@section(4, "Where the robot works", "identify/residuals.csv", promises)
def region_section(material: Material) -> list[Block]:
    """State and draw the errors before and after calibration where the robot works."""
    shown = Promised.at_work(material.calibrated, material.data, material.settings.get("select", {}))
    off = f"The nominal robot is off by {rms_mm(shown.nominal)} mm there."
    side = [from_the_side(material, shown.place)]
    before = ("before: nominal robot", SIDE, shown.nominal, side)
    drawn = maps("error [mm]", before, ("now: expected of the calibrated robot", SIDE, shown.error, side))
    return [
        Paragraph(f"{shown.words} {off}", keep=True),
        Plot("region", drawn, IN_REGION.format(where=shown.where), as_rows(shown)),
    ]


@section(58, "Where the calibration holds", "identify/residuals.csv", promises)
def validity_section(material: Material) -> list[Block]:
    """State and draw the expected errors within the joints' limits, and state those later on."""
    shown = Promised.of(material.calibrated, material.data)
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
        Plot("validity", drawn, caption, as_rows(shown)),
    ]
