"""Promised errors of the calibrated robot: where it works, and over its joints' limits."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from calflow.deployment.usability import no_gain_words
from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.files.deferred import pd
from calflow.files.problems import InputError
from calflow.files.toml import FileModel, Lengths3
from calflow.files.words import listed, mm, percent, plural_word
from calflow.measurements.measurements import Measurements
from calflow.reporting.style import root_mean_square

DRAWN_POSES = 600  # drawn within the joints' limits, or in a region
MUCH_MORE = 2.0  # times what is promised at measured poses, from which page one says what is promised beyond them
MEASURED, STATED, WITHIN = "that were measured", "in the study's region", "within the joints' limits"


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
    def rows(self) -> pd.DataFrame:
        """The data of a figure."""
        return pd.DataFrame(self.place, columns=["x_m", "y_m", "z_m"]).assign(
            promised_mm=1e3 * self.error, nominal_mm=1e3 * self.nominal, beyond_measured=self.outside
        )

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
            "mean square, without measurement noise)."
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
