"""The promise: by how much the calibrated robot is expected to miss poses, where it works and within its joints' limits."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calflow.deployment.usability import no_gain_words
from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel, distance_moved, expected_point, promised_distance
from calflow.estimation.leverage import beyond
from calflow.files.problems import InputError
from calflow.files.toml import FileModel, Lengths3
from calflow.files.words import mm, percent
from calflow.measurements.measurements import Measurements

POSES = 600  # drawn within the joints' limits, or in a region
LATER = {"an hour": 3600.0, "a day": 86400.0}  # s, after the measurement
MEASURED, STATED = "that were measured", "in the study's region"


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
    def of(calibrated: CalibratedModel, data: Measurements) -> Promised:
        """Draw poses within the joints' limits, under the first payload and for the first marker that were measured."""
        return _drawn(calibrated, data, None, "within the joints' limits")

    @staticmethod
    def at_work(calibrated: CalibratedModel, data: Measurements, planned: Mapping[str, Any]) -> Promised:
        """Return the promise in the box where the study plans poses, else at the poses that were measured.

        planned are the settings of the stage select.
        """
        box = {
            key: value for key, value in {**planned, **planned.get("task", {})}.items() if key.startswith("region_m")
        }
        if box:
            region = _Region.model_validate(box)
            with suppress(InputError):  # hardly any pose reaches it
                return _drawn(calibrated, data, np.array([region.region_min, region.region_max]), STATED)
        return _promised_at(calibrated, data.conditions, np.zeros(len(data), dtype=bool), MEASURED)

    @property
    def words(self) -> str:
        """The figures in words."""
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
        no_gain = no_gain_words(float((self.error >= self.nominal).mean()), self.where)
        return f"{sentence} {no_gain}{measure}" if no_gain else sentence


def rms_mm(error: np.ndarray) -> str:
    """Return the root mean square of errors [m] in words [mm]."""
    return mm(1e3 * float(np.sqrt((error**2).mean())))


def _drawn(calibrated: CalibratedModel, data: Measurements, region: np.ndarray | None, where: str) -> Promised:
    first, draws = data.table.iloc[0], np.random.default_rng(0)
    readings, conditions = candidates(calibrated.model, POSES, first["payload"], first["marker"], region, draws)
    measured = data.only(data.train).joints
    return _promised_at(calibrated, conditions, np.asarray(beyond(readings, measured).any(axis=1)), where)


def _promised_at(calibrated: CalibratedModel, conditions: np.ndarray, outside: np.ndarray, where: str) -> Promised:
    error, moved = (of(calibrated, conditions) for of in (promised_distance, distance_moved))
    return Promised(expected_point(calibrated, conditions), error, moved, outside, where)


def later_words(calibrated: CalibratedModel, data: Measurements) -> str:
    """Say what becomes of the promise at poses that were measured, later; empty where no time is known."""
    rows = data.only(data.train)
    if "time" not in calibrated.model.given:
        return ""
    rows = rows.stating(calibrated.model.given)
    end = float(rows.table["time"].max())
    moments = [replace(rows, table=rows.table.assign(time=end + seconds)) for seconds in LATER.values()]
    later = [
        1e3 * float(np.sqrt((promised_distance(calibrated, moment.conditions) ** 2).mean()))
        for moment in (rows, *moments)
    ]
    words = ", ".join(f"{mm(value)} mm {name} later" for name, value in zip(LATER, later[1:], strict=True))
    return f"At the measured poses: {mm(later[0])} mm then, {words}, as seen from where the instrument stands."
