"""Validation: accuracy of a calibrated robot on measurements not used in its fit, held against a tolerance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from calflow.deployment.attained import (
    CALIBRATED,
    COMMANDED,
    CYCLES,
    ELSEWHERE,
    FREEDOM,
    NOMINAL,
    TARGET,
    Alignment,
    Attained,
    Station,
    cube_edge,
)
from calflow.deployment.figures_alone import FiguresAlone
from calflow.deployment.prediction import beyond_limits, of_field
from calflow.deployment.tolerance import Errors
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.needed_conditions import AT_REST, check_payload_stated, check_stated
from calflow.files.problems import refuse
from calflow.files.tables import StoredResults, column
from calflow.files.toml import Confidence, Count, checked_arguments
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements

CONFIDENCE = 0.95  # default of a verdict, and level of intervals
ONE_SIDED = 1.645  # standard deviations of the noise by which a pose must exceed a tolerance to count as beyond
OF_THE_SAME = "are these rows of the robot, base, tool, units and signs that were calibrated?"
MOVED_P = 0.01  # p-value below which a rigid motion of all points is noted


Status = Literal["met", "not met", "cannot be told", "no tolerance"]
Judged = Literal["nominal", "calibrated", "figures", "commanded"]
Sent = Literal["corrected commands", "program filter", "controller figures"]


@dataclass(frozen=True, kw_only=True)
class ValidatedModel:
    """Errors of a model over all poses measured; intervals are 95 %, with poses independent."""

    model: Judged = column(
        "the nominal robot, the calibrated one, its controller's figures, or the targets of commands"
    )
    poses: int = column("number of poses")
    mean_mm: float = column("mean error of a pose", "mm")
    mean_low_mm: float = column("lower end of its interval (Student's t over poses)", "mm")
    mean_high_mm: float = column("upper end of it", "mm")
    rms_mm: float = column("root mean square error of a pose", "mm")
    rms_low_mm: float = column("lower end of its interval", "mm")
    rms_high_mm: float = column("upper end of it", "mm")
    max_mm: float = column("the largest error: pose accuracy AP of the worst pose", "mm")
    further_mm: float = column("error below which a further pose like these stays with a probability of 95 %", "mm")
    unit: str = column(
        "the unit that the following figures are in: mm, mrad, px, …; those above are empty where it is no length"
    )
    mean: float = column("as mean_mm, in `unit`")
    mean_low: float = column("as mean_low_mm, in `unit`")
    mean_high: float = column("as mean_high_mm, in `unit`")
    rms: float = column("as rms_mm, in `unit`")
    rms_low: float = column("as rms_low_mm, in `unit`")
    rms_high: float = column("as rms_high_mm, in `unit`")
    max: float = column("as max_mm, in `unit`")
    further: float = column("as further_mm, in `unit`")


@dataclass(frozen=True, kw_only=True)
class ValidatedPose:
    """A point of a pose: distance of its rows' barycentre from each model's position (ISO 9283's AP), and its RP."""

    pose: str = column("as in the measurements")
    marker: str = column("as in the measurements")
    payload: str = column("as in the measurements")
    session: str = column("as in the measurements; empty: none was named")
    rows: int = column("number of measurements")
    nominal_mm: float = column("distance from the nominal robot's position", "mm")
    calibrated_mm: float = column("distance from the calibrated robot's position", "mm")
    commanded_mm: float = column("distance from the target of the command; empty: none was stated", "mm")
    promised_mm: float = column(
        "predicted standard deviation of the calibrated distance, or of that by the controller's figures", "mm"
    )
    dx_mm: float = column(
        "measured minus expected position of what is judged, along the measuring frame's x; empty: no position was measured",
        "mm",
    )
    dy_mm: float = column("the same along y", "mm")
    dz_mm: float = column("the same along z", "mm")
    rp_mm: float = column("pose repeatability RP; empty: measured once", "mm")
    turn_mrad: float = column("rotation of the tool relative to the calibrated robot's; empty: not measured", "mrad")
    rp_turn_mrad: float = column("repeatability of the turn about its worst axis, 3 S; empty: not measured", "mrad")
    within: bool | None = column("whether it is within the tolerance; empty: none was given")
    unit: str = column(
        "the unit that the following figures are in: mm, mrad, px, …; those in mm are empty where it is no length"
    )
    nominal: float = column("as nominal_mm, in `unit`")
    calibrated: float = column("as calibrated_mm, in `unit`")
    judged: float = column("the distance that is judged, in `unit`")
    promised: float = column("as promised_mm, in `unit`")


@dataclass(frozen=True, kw_only=True)
class ValidationSummary:
    """The result of a validation: verdict with probabilities, and the treatment of the device's frame."""

    status: Status = column("the verdict")
    judged: Judged = column(
        "whose errors the verdict is about: commands where targets were stated, else the calibrated robot, or its controller's "
        "figures where these were typed in"
    )
    sent: Sent | None = column(
        "what the robot had been given when it was measured; null: nothing, the model is judged by what it predicts, as corrected "
        "commands would have it"
    )
    tolerance_mm: float | None = column("the tolerance; null: none", "mm")
    confidence: float = column("probability that the verdict 'met' requires")
    further_within: float | None = column(
        "probability that a further pose like these is within; null: not asked, or too few poses"
    )
    task_poses: int = column("poses of the task")
    task_within: float | None = column("probability that all of them are within; null: as before")
    decided_by: Literal["further pose", "task"] = column("which of the two probabilities decides")
    poses: int = column("poses measured")
    rows: int = column("rows measured")
    beyond: int = column("points that exceed the tolerance by more than the device's noise explains")
    station: Literal["known", "fitted"] = column(
        "whether the device stood where the calibration's did, or its frame was fitted"
    )
    frames: int = column("frames that were fitted: one a session")
    freedom_lost: int = column("degrees of freedom of the fitted frames, and of new objects that these rows place")
    moved_mm: float | None = column("how far the fitted frame is from the calibration's at these points; of a known one, how far a "
                                    "rigid motion would take them; null: too few poses to tell", "mm")  # fmt: skip
    turned_mrad: float | None = column("rotation of that motion", "mrad")
    moved_p: float | None = column(
        "p-value of that motion where nothing moved; null: the frame was fitted, or too few poses"
    )
    noise_mm: float | None = column(
        "the device's noise of a row, per axis; null: not known apart from the calibration", "mm"
    )
    promised_mm: float = column(
        "root mean square error that the calibration predicts for these poses, noise included", "mm"
    )
    ap_mm: float | None = column("pose accuracy AP of the worst pose; null: no positions were measured", "mm")
    rp_mm: float | None = column(
        "pose repeatability RP of the worst pose; null: none was measured twice, or no positions", "mm"
    )
    fewest_cycles: int = column("smallest number of cycles of a pose; the standard has 30")
    cube_edge_mm: float | None = column(
        "edge of ISO 9283's cube in whose plane the five poses lie; null: they are no such poses", "mm"
    )
    unit: str = column(
        "the unit of what was judged: mm, mrad, px, …; figures in mm are NaN or null where it is no length"
    )
    tolerance: float | None = column("as tolerance_mm, in `unit`")
    noise: float | None = column("as noise_mm, in `unit`")
    promised: float = column("as promised_mm, in `unit`")
    notes: tuple[str, ...] = column("what was assumed, and what to look at", default=())

    @property
    def of_positions(self) -> bool:
        """Whether positions were measured, which ISO 9283 is about, and not lengths, pixels or angles."""
        return self.ap_mm is not None


@dataclass(frozen=True)
class Validation(StoredResults):
    """A calibrated robot compared with further measurements: statistics of each model, every point, and the verdict."""

    accuracy: tuple[ValidatedModel, ...]
    poses: tuple[ValidatedPose, ...]
    summary: ValidationSummary

    def of(self, model: str) -> ValidatedModel:
        """Return the statistics of a model."""
        return next(accuracy for accuracy in self.accuracy if accuracy.model == model)

    @property
    def judged(self) -> ValidatedModel:
        """The statistics of the model that is judged."""
        return self.of(self.summary.judged)


@checked_arguments
def validate(
    calibrated: CalibratedModel,
    data: Measurements,
    *,
    tolerance: float | None = None,
    task: Count | None = None,
    confidence: Confidence = CONFIDENCE,
    station: Station = "auto",
    sent: Sent | None = None,
    figures: FiguresAlone | None = None,
) -> Validation:
    """Compare a calibrated robot with measurements not used in its fit.

    A pose's error is the distance of the barycentre of its rows from the expected position. Poses are the independent
    unit. The tolerance applies to errors as measured, device noise included: noise never flatters a robot.

    Args:
        calibrated: the calibrated model.
        data: the rows: positions or poses, in the calibration's frame or any other, or other observations, whose
            residuals are judged in their own unit.
        tolerance: largest error of a pose [m, or the unit that is judged: rad, px, N].
        task: number of poses that must all be within, which then decides instead of a further pose.
        confidence: the probability that the verdict "met" requires.
        station: whether the device stood where it stood in the calibration; "auto" takes it as known except in
            sessions whose mean error exceeds ELSEWHERE, which no calibrated robot's does, and where the calibration's
            sessions had frames of their own.
        sent: what the robot was given; corrected commands where targets are stated and it is None.
        figures: those of its controller, where they were sent (see `Levels.figures`).

    Raises:
        InputError: a needed condition or payload is missing, too few poses to fit a frame, or an invalid argument.
    """
    sent = _sent(data, sent, figures)
    check_payload_stated(calibrated.model, calibrated.payloads, data.payload_stated)
    check_stated(calibrated.needed, data.given)
    # Wander and delay of the device are in its readings, not in the robot's pose: predicted where time and speeds are stated.
    given = data.stating([*AT_REST, *calibrated.inputs]).given
    stated = calibrated.later(given, data)
    markers = calibrated.model.robot.markers
    flange = np.array([markers[name].point for name in data.table["marker"]]) if sent == "program filter" else None
    attained = Attained.of(stated, data, station, figures, flange)
    _check_tolerance(tolerance, attained.unit)
    field_notes = of_field(stated, stated.conditions_of(data))
    judged: Judged = "commanded" if COMMANDED in attained.expected else "calibrated" if figures is None else "figures"
    compared = _Comparison(attained, judged)
    noise = calibrated.noise(data).typical(attained.unit) if calibrated.noise_known else None
    summary = _summary(compared, noise, rows=len(data), sent=sent, task=task, confidence=confidence)
    if tolerance is not None:
        summary = _with_verdict(summary, compared, tolerance)
    notes = (*data.notes, *compared.notes, *field_notes, *beyond_limits(data))
    statistics = tuple(compared.statistics(model) for model in compared.size)
    return Validation(statistics, compared.points(tolerance), replace(summary, notes=notes))


def _sent(data: Measurements, sent: Sent | None, figures: FiguresAlone | None) -> Sent | None:
    """Return what the robot was given: corrected commands where targets are stated and nothing else is.

    Raises:
        InputError: there are no rows, or none that what was sent is judged by.
    """
    if not len(data):
        raise refuse("expected rows, found none", key="data")
    has_targets = all(name in data.table for name in TARGET)
    if sent in ("corrected commands", "program filter") and not has_targets:
        raise refuse(
            f"expected where commands were to land: columns {', '.join(f'{name}_mm' for name in TARGET)}", key="sent"
        )
    if figures is not None and not data.has_positions:
        raise refuse("controller figures are judged by measured positions", key="sent")
    return sent or ("corrected commands" if has_targets else None)


def _check_tolerance(tolerance: float | None, unit: MeasurementUnit) -> None:
    """Refuse a tolerance that is not positive, or a metre or more."""
    if tolerance is not None and not 0 < tolerance < (1 if unit == METRE else np.inf):
        most = " and less than 1000 mm" if unit == METRE else ""
        raise refuse(f"expected more than 0{most}, found {unit.shown(tolerance):g}", key="tolerance")


@dataclass(frozen=True)
class _Comparison:
    """Attained points beside each model's."""

    attained: Attained
    judged: Judged

    @cached_property
    def error(self) -> dict[str, np.ndarray]:
        """Measured minus expected points (n, 3) of each model, in the unit of measurement."""
        return {model: self.attained.errors(model) for model in self.attained.expected}

    @cached_property
    def size(self) -> dict[str, np.ndarray]:
        """Distances (n,) of each model."""
        return {model: np.linalg.norm(errors, axis=1) for model, errors in self.error.items()}

    @property
    def freedom_lost(self) -> int:
        """Degrees of freedom of the fitted frames, and of new objects."""
        return FREEDOM * int(self.attained.fitted.sum()) + self.attained.taken

    def further(self, model: str) -> Errors:
        """Return the predictive distribution of further poses' largest errors; what is fitted counts as fewer poses."""
        attained = self.attained
        size = np.linalg.norm(attained.errors_of_further(model), axis=1)
        fewer = int(attained.fitted.sum()) + int(np.ceil(attained.taken / attained.values))
        return Errors.of(attained.by_pose(size, "max"), fewer)

    @cached_property
    def motions(self) -> list[tuple[np.ndarray, Alignment]]:
        """The points and the motion of each fitted frame; of all frames where none is fitted and all can be."""
        attained = self.attained
        if attained.fitted.any() or None in attained.motions:
            return attained.refitted
        return replace(attained, fitted=np.full(len(attained.fitted), True)).refitted

    @property
    def moved_p(self) -> float | None:
        """The p-value of the motions (see `Attained.motion_p`); None where a frame moved, or cannot be fitted."""
        return None if self.attained.fitted.any() else self.attained.motion_p

    def statistics(self, model: str) -> ValidatedModel:
        """Return mean, root mean square and largest error over poses, with the bound of a further pose."""
        attained, size = self.attained, self.size[model]
        of_pose = attained.by_pose(size, "mean")
        n = len(of_pose) - self.freedom_lost / attained.values
        mean, low, high = _interval(of_pose, n)
        square, least, most = _interval(attained.by_pose(size**2, "mean"), n)
        further = self.further(model).reached_by(CONFIDENCE)
        figures = (mean, low, high, *np.sqrt((square, least, most)), size.max(), further)
        names = ("mean", "mean_low", "mean_high", "rms", "rms_low", "rms_high", "max", "further")
        return ValidatedModel(
            model=model,  # type: ignore[arg-type]
            poses=len(of_pose),
            unit=attained.unit.label,
            **{name: attained.unit.shown(float(v)) for name, v in zip(names, figures, strict=True)},
            **{f"{name}_mm": attained.in_mm(v) for name, v in zip(names, figures, strict=True)},
        )

    def points(self, tolerance: float | None) -> tuple[ValidatedPose, ...]:
        """Return one row per point."""
        attained, size, turns = self.attained, self.size, self.attained.turns
        shown, sd = attained.unit.shown, attained.promised
        turned = turns.errors(attained.turned) if turns else None
        rows = []
        for k, labels in enumerate(attained.table.to_dict("records")):
            dx, dy, dz = (attained.position_in_mm(value) for value in self.error[self.judged][k][:3])
            rows.append(
                ValidatedPose(
                    pose=str(labels["pose"]), marker=str(labels["marker"]), payload=str(labels["payload"]),
                    session=str(labels.get("session", "")), rows=int(labels["rows"]),
                    nominal_mm=attained.in_mm(size[NOMINAL][k]), calibrated_mm=attained.in_mm(size[CALIBRATED][k]),
                    commanded_mm=attained.in_mm(size[COMMANDED][k]) if COMMANDED in size else float("nan"),
                    promised_mm=attained.in_mm(sd[k]), dx_mm=dx, dy_mm=dy, dz_mm=dz,
                    rp_mm=attained.in_mm(attained.repeatability[k]),
                    turn_mrad=float("nan") if turned is None else 1e3 * float(np.linalg.norm(turned[k])),
                    rp_turn_mrad=1e3 * float(_largest(turns.repeatability[k])) if turns else float("nan"),
                    within=None if tolerance is None else bool(size[self.judged][k] <= tolerance), unit=attained.unit.label,
                    nominal=shown(float(size[NOMINAL][k])), calibrated=shown(float(size[CALIBRATED][k])),
                    judged=shown(float(size[self.judged][k])), promised=shown(float(sd[k])),
                )
            )  # fmt: skip
        return tuple(rows)

    @property
    def notes(self) -> list[str]:
        """Notes on assumptions and anomalies."""
        notes = []
        if self.attained.fitted.any():
            why = (
                "the device is set up anew for each session, as in the calibration"
                if self.attained.by_session
                else f"the device stood elsewhere than in the calibration{self.attained.refitted_words}"
            )
            notes.append(
                f"{why}: its frame was "
                f"fitted to these points, which took {self.freedom_lost} degrees of freedom; where the robot stands is not judged"
            )
        elif self.moved_p is not None and self.moved_p < MOVED_P:
            notes.append(
                "a shift and a turn of all points together would remove much of the error: if the robot's foot or the "
                "device may have moved, --station fitted judges without it"
            )
        nominal, calibrated = self.size[NOMINAL].mean(), self.size[CALIBRATED].mean()
        far = calibrated > ELSEWHERE * self.attained.unit.usual / METRE.usual
        if far or calibrated > nominal:
            than = "any calibrated robot" if far else "the nominal one"
            notes.append(f"the calibrated robot errs by more than {than}: {OF_THE_SAME}")
        if self.attained.taken:
            notes.append(
                f"sockets, surfaces or sessions that the calibration did not have were placed by these rows, which took "
                f"{self.attained.taken} degrees of freedom: they are judged by how well their rows agree"
            )
        repeated = self.attained.table["rows"].min() if self.attained.in_space else 1
        if 1 < repeated < CYCLES:
            notes.append(f"ISO 9283 has each pose attained {CYCLES} times; here the fewest is {repeated}")
        if repeated > 1:
            notes.append(
                "repeats count as the standard's cycles: RP is the robot's only where it came to each pose anew"
            )
        return notes


def _summary(
    compared: _Comparison, noise: float | None, *, rows: int, sent: Sent | None, task: int | None, confidence: float
) -> ValidationSummary:
    """Return the summary without a verdict; noise: the device's, of a row, per axis."""
    attained, fitted = compared.attained, compared.attained.fitted
    shown, in_mm = attained.unit.shown, attained.in_mm
    promised = float(np.sqrt(attained.by_pose(attained.promised**2, "mean").mean()))
    first = np.unique(attained.pose, return_index=True)[1]  # point of each pose
    return ValidationSummary(
        status="no tolerance", judged=compared.judged, sent=sent, tolerance_mm=None, confidence=confidence,
        further_within=None, task_poses=task or len(first), task_within=None,
        decided_by="task" if task else "further pose", poses=len(first), rows=rows, beyond=0,
        station="fitted" if fitted.any() else "known", frames=int(fitted.sum()), freedom_lost=compared.freedom_lost,
        moved_mm=max((1e3 * motion.moved(attained.measured[rows]) for rows, motion in compared.motions), default=None),
        turned_mrad=max((1e3 * motion.angle for _, motion in compared.motions), default=None), moved_p=compared.moved_p,
        noise_mm=None if noise is None else _or_none(in_mm(noise)), promised_mm=in_mm(promised),
        ap_mm=_or_none(attained.position_in_mm(compared.size[compared.judged].max())),
        rp_mm=_or_none(in_mm(_largest(attained.repeatability))), fewest_cycles=int(attained.table["rows"].min()),
        cube_edge_mm=_or_none(attained.position_in_mm(cube_edge(attained.expected[CALIBRATED][first]))),
        unit=attained.unit.label, tolerance=None, noise=None if noise is None else shown(noise), promised=shown(promised),
    )  # fmt: skip


def _with_verdict(summary: ValidationSummary, compared: _Comparison, tolerance: float) -> ValidationSummary:
    """Return the summary with the verdict: not met where a pose is beyond, met where the probability is high enough."""
    attained, size, errors = compared.attained, compared.size[compared.judged], compared.further(compared.judged)
    beyond = int((size - ONE_SIDED * attained.noise > tolerance).sum())
    further, whole = (_or_none(errors.within(tolerance, poses)) for poses in (1, summary.task_poses))
    probability = whole if summary.decided_by == "task" else further
    sure = probability is not None and probability >= summary.confidence
    return replace(
        summary,
        status="not met" if beyond else "met" if sure and (size <= tolerance).all() else "cannot be told",
        tolerance_mm=_or_none(attained.in_mm(tolerance)), further_within=further, task_within=whole, beyond=beyond,
        tolerance=attained.unit.shown(tolerance),
    )  # fmt: skip


def _interval(values: np.ndarray, n: float) -> tuple[float, float, float]:
    """Return the mean of values that count as n, and its Student's t interval, not below 0; nan for small n."""
    mean = float(values.mean())
    if not n > 1:
        return mean, float("nan"), float("nan")
    half = float(scipy.special.stdtrit(n - 1, 0.5 + CONFIDENCE / 2) * values.std(ddof=1) / np.sqrt(n))
    return mean, max(0.0, mean - half), mean + half


def _largest(values: np.ndarray) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
