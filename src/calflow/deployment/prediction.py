"""Prediction: positions of a calibrated robot's markers with their standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.needed_conditions import HOW_TO_GO_ON, check_payload_stated, check_stated
from calflow.estimation.residual_field import NOT_PHYSICAL
from calflow.files.deferred import pd
from calflow.files.toml import checked_arguments
from calflow.files.words import rounded
from calflow.measurements.measurements import Measurements

Missing = Literal["refuse", "widen"]
BEYOND_RANGE = "beyond its measured range", "how errors go on there is a guess; measure there before you rely on it"


@dataclass(frozen=True)
class Prediction:
    """Predicted positions (n_rows, 3) [m], standard deviations per axis sd (n_rows, 3) [m], notes on assumptions.

    not_physical (n_rows, 3) [m]: the residual field's part, which no cause explains; None without a field.
    """

    position: np.ndarray
    sd: np.ndarray
    notes: tuple[str, ...] = ()
    not_physical: np.ndarray | None = None

    @property
    def table(self) -> pd.DataFrame:
        """The same in mm: x_mm …, sd_x_mm …, and with a residual field not_physical_x_mm …."""
        parts = {"": self.position, "sd_": self.sd, "not_physical_": self.not_physical}
        return pd.DataFrame(
            {
                f"{stem}{axis}_mm": 1e3 * values[:, k]
                for stem, values in parts.items()
                if values is not None
                for k, axis in enumerate("xyz")
            }
        )


@checked_arguments
def predict(
    calibrated: CalibratedModel, q: ArrayLike, *, payload: str | Sequence[str] | None = None,
    marker: str | Sequence[str] | None = None, missing: Missing = "refuse", **conditions: ArrayLike,
) -> Prediction:  # fmt: skip
    """Return the marker's position in the measuring frame with its standard deviation (see `predict_rows`).

    Args:
        calibrated: the calibrated model.
        q: joint readings, shape (n_rows, n_joints), or (n_joints,) of one row [rad, or m].
        payload: name of the payload, "" for none; None only where the model depends on no payload.
        marker: name of the marker; None: the first.
        missing: "widen" to predict without needed conditions, with a larger standard deviation.
        conditions: approach, travel, wrench, torque, time, temperature, as in `Measurements.from_arrays`.

    Raises:
        InputError: a condition that an effect needs is missing, or an array is invalid.
    """
    return predict_rows(calibrated, rows_at(calibrated, q, payload, marker, conditions), missing)


def rows_at(
    calibrated: CalibratedModel, q: ArrayLike, payload: str | Sequence[str] | None, marker: str | Sequence[str] | None,
    conditions: Mapping[str, ArrayLike],
) -> Measurements:  # fmt: skip
    """Return rows at joint readings, for the arguments of `predict`."""
    q = np.atleast_2d(np.asarray(q, dtype=float))
    labels = {name: given for name, given in (("payload", payload), ("marker", marker)) if given is not None}
    origin = {"time_origin": calibrated.time_origin} if "time" in conditions else {}
    return Measurements.from_arrays(
        calibrated.model.robot, q, None, pose=np.arange(len(q)), **labels, **origin, **conditions  # type: ignore[arg-type]
    )  # fmt: skip


def predict_rows(calibrated: CalibratedModel, data: Measurements, missing: Missing = "refuse") -> Prediction:
    """Return the predicted positions of the rows' markers.

    The standard deviations include parameter uncertainty and the model's discrepancy, without the measuring device's
    noise; where that noise was estimated from the fit, the two are not separable and both are included.

    Args:
        calibrated: the calibrated model; conditions that it does not need are ignored.
        data: the rows.
        missing: whether rows without a needed condition are refused, or predicted without its effects, with a standard
            deviation increased by the spread of these effects over the fitted rows.

    Raises:
        InputError: a needed condition is missing.
    """
    stated = as_stated(calibrated, data, missing)
    conditions = stated.data.conditions
    position = stated.calibrated.expected_point(conditions)
    variance = stated.calibrated.position_variance(conditions) + stated.widened
    notes = (*standing(calibrated), *stated.notes, *of_field(stated.calibrated, conditions), *beyond_limits(data),
             *_of_joints(data, calibrated.beyond_range(data.joints), *BEYOND_RANGE))  # fmt: skip
    field = calibrated.field_correction(conditions) if calibrated.field else None
    return Prediction(position, np.sqrt(variance), notes, field)


def of_field(calibrated: CalibratedModel, conditions: np.ndarray) -> list[str]:
    """Return notes on the residual field at packed rows (n_conditions, n_rows); empty where the model has none."""
    if calibrated.field is None:
        return []
    size = 1e3 * np.linalg.norm(calibrated.field_correction(conditions), axis=1)
    faded = int((calibrated.field.share(conditions[: calibrated.model.robot.n_joints].T) < 1).sum())
    beyond = (
        f"; {faded} of {len(size)} rows are beyond the measured joint ranges, where it fades to nothing"
        if faded
        else ""
    )
    return [
        f"a residual field is added, which is {NOT_PHYSICAL}: {size.mean():.3f} mm on average, {size.max():.3f} mm at most{beyond}"
    ]


def standing(calibrated: CalibratedModel) -> list[str]:
    """Return a note on the measuring frame where no external device saw the robot, and on the tool where nothing placed it."""
    robot = calibrated.model.robot
    if not robot.base.fixed:
        return []
    notes = ["no device saw the robot from outside: the robot's own base stands in for the measuring frame"]
    notes += of_unseen_tool(calibrated)
    if calibrated.model.tool_unseen:
        notes += [
            f"nothing tells where marker '{name}' is on its link: state its place in the robot file, with known = true"
            for name, marker in robot.markers.items()
            if not marker.known
        ]
    return notes


def of_unseen_tool(calibrated: CalibratedModel) -> list[str]:
    """Return a note where images alone were measured, which do not show the tool; empty elsewhere."""
    if not calibrated.model.tool_unseen:
        return []
    return [
        "images tell neither where the robot stands nor how flange and tool sit on its last link: that is in the standard "
        "deviations, but the same at all poses in the tool's frame; once base and tool are taught, with corrected commands, "
        "expect the error over the joints' ranges that the run states (in_space.csv)"
    ]


@dataclass(frozen=True)
class StatedModel:
    """A calibrated model restricted to the needed conditions that rows state, and the rows with these alone.

    widened [m²]: further variance of a position along any axis due to missing conditions; notes: which are missing.
    """

    calibrated: CalibratedModel
    data: Measurements
    widened: float
    notes: tuple[str, ...]


def as_stated(
    calibrated: CalibratedModel, data: Measurements, missing: Missing, instead: str = HOW_TO_GO_ON
) -> StatedModel:
    """Return the model for the conditions rows state (see `predict_rows`); instead: the advice in a refusal.

    Raises:
        InputError: a needed condition is missing, or a payload on which the model depends.
    """
    check_payload_stated(calibrated.model, calibrated.payloads, data.payload_stated)
    if missing == "refuse":
        check_stated(calibrated.needed, data.given, instead)
    lacking = [need for need in calibrated.needed if need.condition not in data.given]
    inputs = calibrated.inputs
    given = tuple(name for name in data.given if name in inputs)
    notes = tuple(
        f"without {need.columns} nothing is predicted of {', '.join(need.effects)}: the standard deviations are wider by "
        f"{rounded(need.spread_mm)} mm, what that did to the rows that were fitted"
        for need in lacking
    )
    widened = float(sum((need.spread_mm / 1e3) ** 2 for need in lacking))
    return StatedModel(calibrated.later(given), data.stating(given), widened, notes)


def beyond_limits(data: Measurements, so: str = "the prediction there is extrapolated") -> list[str]:
    """Return notes that name the rows with a joint past its limits, and the consequence so."""
    past = data.robot.past_limits(data.joint_angles, 1e-9)
    return _of_joints(data, past, "past its limits", so)


def _of_joints(data: Measurements, which: np.ndarray, what: str, so: str) -> list[str]:
    """Return notes on the joints that are what is said in some rows, by the mask (n_rows, n_joints) which."""
    lines = data.table["line"].to_numpy()
    return [
        f"joint {i + 1} is {what} in line {', '.join(map(str, lines[which[:, i]][:5]))}"
        f"{' and more' if which[:, i].sum() > 5 else ''}: {so}"
        for i in np.flatnonzero(which.any(axis=0))
    ]
