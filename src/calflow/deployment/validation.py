"""Validation: accuracy of a calibrated robot on measurements not used in its fit, held against a tolerance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from calflow.deployment.attained import (
    CALIBRATED,
    COMMANDED,
    CYCLES,
    FREEDOM,
    NOMINAL,
    TARGET,
    Alignment,
    Attained,
    can_align,
    cube_edge,
)
from calflow.deployment.figures_alone import FiguresAlone
from calflow.deployment.prediction import beyond_limits, of_field
from calflow.deployment.tolerance import Errors
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.needed_conditions import check_stated
from calflow.files.problems import refuse
from calflow.files.tables import StoredResults, column
from calflow.files.toml import Confidence, Count, checked_arguments
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements

CONFIDENCE = 0.95  # default of a verdict, and level of intervals
ONE_SIDED = 1.645  # standard deviations of the noise by which a pose must exceed a tolerance to count as beyond
OF_THE_SAME = "are these rows of the robot, base, tool, units and signs that were calibrated?"
ELSEWHERE = 20e-3  # m: mean error above which the device stands elsewhere, as no calibrated robot errs so much
COORDINATES = 3  # of a position
MOVED_P = 0.01  # p-value below which a rigid motion of all points is noted


Station = Literal["auto", "known", "fitted"]
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
    dx_mm: float = column("measured minus expected position of what is judged, along the measuring frame's x", "mm")
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
    freedom_lost: int = column("degrees of freedom of the fitted frames")
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
    ap_mm: float = column("pose accuracy AP of the worst pose", "mm")
    rp_mm: float | None = column("pose repeatability RP of the worst pose; null: none was measured twice", "mm")
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
        data: the rows: positions or poses, in the calibration's frame or any other, or other observations, which are
            judged in their own unit.
        tolerance: largest error of a pose [m, or the unit that is judged: rad, px, N].
        task: number of poses that must all be within, which then decides instead of a further pose.
        confidence: the probability that the verdict "met" requires.
        station: whether the device stood where it stood in the calibration; "auto" takes it as known except in
            sessions whose mean error exceeds ELSEWHERE, which no calibrated robot's does.
        sent: what the robot was given; corrected commands where targets are stated and it is None.
        figures: those of its controller, where they were sent (see `Levels.figures`).

    Raises:
        InputError: a needed condition is missing, too few poses to fit a frame, or an invalid argument.
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
    sent = sent or ("corrected commands" if has_targets else None)
    check_stated(calibrated.needed, data.given)
    # The device's wander is in its readings, not in the robot's pose: it is predicted where the time is stated.
    wanders = {*calibrated.errors.inputs} & {*data.given}
    given = data.stating([*wanders, *(need.condition for need in calibrated.needed)]).given
    stated = replace(calibrated, model=replace(calibrated.model, given=given))
    attained = Attained.of(stated, data, figures)
    unit, shown = attained.unit, attained.unit.shown
    if tolerance is not None and not 0 < tolerance < (1 if unit == METRE else np.inf):
        most = " and less than 1000 mm" if unit == METRE else ""
        raise refuse(f"expected more than 0{most}, found {shown(tolerance):g}", key="tolerance")
    field_notes = of_field(stated, data.stating(given).on(stated.model.robot).conditions)
    judged: Judged = "calibrated" if figures is None else "figures"
    judged = "commanded" if COMMANDED in attained.expected else judged
    fitted, frames = stands(attained, station)
    error = {model: attained.errors(model, fitted) for model in attained.expected}
    size = {model: np.linalg.norm(errors, axis=1) for model, errors in error.items()}
    lost = FREEDOM * int(fitted.sum())
    further_ones = {model: _further(attained, model, fitted) for model in attained.expected}
    accuracy = tuple(_statistics(model, attained, sizes, lost, further_ones[model]) for model, sizes in size.items())  # type: ignore[arg-type]
    worst = further_ones[judged]
    asked = task or int(attained.pose.max() + 1)
    within = None if tolerance is None else size[judged] <= tolerance
    beyond = 0 if tolerance is None else int((size[judged] - ONE_SIDED * attained.noise > tolerance).sum())
    further = None if tolerance is None else _or_none(worst.within(tolerance))
    whole = None if tolerance is None else _or_none(worst.within(tolerance, asked))
    p_moved = _moved_p(attained, error[CALIBRATED], frames) if frames and not fitted.any() else None
    moves = _motions(attained, fitted, frames)
    sigma = calibrated.noise(data)
    noise = sigma.typical(unit) if calibrated.noise_known else None
    sd = attained.promised(fitted)
    promised = float(np.sqrt(np.mean(sd**2)))
    summary = ValidationSummary(
        status=_status(within, beyond, whole if task else further, confidence),
        judged=judged,
        sent=sent,
        tolerance_mm=None if tolerance is None else _or_none(attained.in_mm(tolerance)),
        confidence=confidence,
        further_within=further,
        task_poses=asked,
        task_within=whole,
        decided_by="task" if task else "further pose",
        poses=int(attained.pose.max() + 1),
        rows=len(data),
        beyond=beyond,
        station="fitted" if fitted.any() else "known",
        frames=int(fitted.sum()),
        freedom_lost=lost,
        moved_mm=max((1e3 * far for far, _ in moves), default=None),
        turned_mrad=max((1e3 * angle for _, angle in moves), default=None),
        moved_p=p_moved,
        noise_mm=None if noise is None else _or_none(attained.in_mm(noise)),
        promised_mm=attained.in_mm(promised),
        ap_mm=attained.in_mm(float(size[judged].max())),
        rp_mm=_or_none(attained.in_mm(_largest(attained.repeatability))),
        fewest_cycles=int(attained.table["rows"].min()),
        cube_edge_mm=_or_none(attained.in_mm(cube_edge(_places(attained)))),
        unit=unit.label,
        tolerance=None if tolerance is None else shown(tolerance),
        noise=None if noise is None else shown(noise),
        promised=shown(promised),
        notes=(*data.notes, *_notes(attained, size, p_moved, fitted), *field_notes, *beyond_limits(data)),
    )
    return Validation(
        accuracy, _points(attained, error, size, sd, judged, within, attained.alignment(CALIBRATED, fitted)), summary
    )


def stands(attained: Attained, station: Station) -> tuple[np.ndarray, tuple[Alignment, ...]]:
    """Return whether each session's frame is to be fitted (n_frames,), and the motions onto the calibrated robot's.

    A session with too few points has no motion, and counts as known unless all are to be fitted.
    """
    of_frame = [attained.frame == k for k in range(attained.frame.max() + 1)]
    if attained.unit != METRE:  # a frame is fitted to positions alone
        return np.zeros(len(of_frame), dtype=bool), ()
    able = np.array([station == "fitted" or can_align(attained.measured[rows]) for rows in of_frame])
    frames = attained.alignment(CALIBRATED, able)
    if station == "fitted":
        return able, frames
    far = np.array([frame.moved(attained.measured[rows]) for frame, rows in zip(frames, of_frame, strict=True)])
    return (far > ELSEWHERE) & (station == "auto"), frames if able.all() else ()


def of_sessions(attained: Attained, fitted: np.ndarray) -> str:
    """Return words that name the sessions whose frames are fitted where others are not."""
    names = [f"'{name}'" for name, is_fitted in zip(attained.sessions, fitted, strict=True) if is_fitted]
    return "" if fitted.all() else f" in session {', '.join(names)}"


def _motions(attained: Attained, fitted: np.ndarray, frames: tuple[Alignment, ...]) -> list[tuple[float, float]]:
    """Return mean displacement [m] and rotation [rad] of each fitted frame; of all frames where none is fitted."""
    asked = fitted if fitted.any() else np.full(len(fitted), bool(frames))
    alignments = attained.alignment(CALIBRATED, asked)
    return [
        (alignments[k].moved(attained.measured[attained.frame == k]), alignments[k].angle)
        for k in np.flatnonzero(asked)
    ]


def _moved_p(attained: Attained, error: np.ndarray, frames: tuple[Alignment, ...]) -> float:
    """Return the p-value of the reduction of errors by a rigid motion, where nothing moved (F test)."""
    left = np.empty_like(error)
    for k, frame in enumerate(frames):
        rows = attained.frame == k
        left[rows] = frame.of(attained.measured[rows]) - attained.expected[CALIBRATED][rows]
    taken, rest = FREEDOM * len(frames), COORDINATES * len(error) - FREEDOM * len(frames)
    squares, remaining = float((error**2).sum()), float((left**2).sum())
    if rest <= 0 or remaining <= 0:
        return 1.0
    return float(scipy.special.fdtrc(taken, rest, max(squares - remaining, 0.0) / taken / (remaining / rest)))


def _further(attained: Attained, model: str, fitted: np.ndarray) -> Errors:
    """Return the predictive distribution of further poses' largest errors; a fitted frame counts as a pose less."""
    size = np.linalg.norm(attained.errors_of_further(model, fitted), axis=1)
    return Errors.of(attained.by_pose(size, "max"), int(fitted.sum()))


def _statistics(model: Judged, attained: Attained, size: np.ndarray, lost: int, worst: Errors) -> ValidatedModel:
    """Return mean, root mean square and largest error over poses, with the bound of a further pose."""
    of_pose = attained.by_pose(size, "mean")
    n = len(of_pose) - lost / COORDINATES
    mean, low, high = _interval(of_pose, n)
    square, least, most = _interval(of_pose**2, n)
    figures = (mean, low, high, *np.sqrt((square, least, most)), size.max(), worst.reached_by(CONFIDENCE))
    names = ("mean", "mean_low", "mean_high", "rms", "rms_low", "rms_high", "max", "further")
    return ValidatedModel(
        model=model,
        poses=len(of_pose),
        unit=attained.unit.label,
        **{name: attained.unit.shown(float(v)) for name, v in zip(names, figures, strict=True)},
        **{f"{name}_mm": attained.in_mm(v) for name, v in zip(names, figures, strict=True)},
    )


def _interval(values: np.ndarray, n: float) -> tuple[float, float, float]:
    """Return the mean of values that count as n, and its Student's t interval, not below 0; nan for small n."""
    mean = float(values.mean())
    if not n > 1:
        return mean, float("nan"), float("nan")
    half = float(scipy.special.stdtrit(n - 1, 0.5 + CONFIDENCE / 2) * values.std(ddof=1) / np.sqrt(n))
    return mean, max(0.0, mean - half), mean + half


def _status(within: np.ndarray | None, beyond: int, probability: float | None, confidence: float) -> Status:
    """Return the verdict: not met where a pose is beyond, met where the probability reaches the confidence."""
    if within is None:
        return "no tolerance"
    if beyond:
        return "not met"
    sure = probability is not None and probability >= confidence
    return "met" if within.all() and sure else "cannot be told"


def _points(
    attained: Attained, error: Mapping[str, np.ndarray], size: Mapping[str, np.ndarray], sd: np.ndarray, judged: Judged,
    within: np.ndarray | None, frames: tuple[Alignment, ...],
) -> tuple[ValidatedPose, ...]:  # fmt: skip
    """Return one row per point."""
    shown = attained.unit.shown
    turns = attained.turns
    turned = turns.errors(CALIBRATED, frames, attained.frame) if turns else None
    rows = []
    for k, labels in enumerate(attained.table.to_dict("records")):
        dx, dy, dz = (attained.in_mm(value) for value in error[judged][k][:3])
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
                within=None if within is None else bool(within[k]), unit=attained.unit.label,
                nominal=shown(float(size[NOMINAL][k])), calibrated=shown(float(size[CALIBRATED][k])),
                judged=shown(float(size[judged][k])), promised=shown(float(sd[k])),
            )
        )  # fmt: skip
    return tuple(rows)


def _places(attained: Attained) -> np.ndarray:
    """Return one expected position per pose (n_poses, 3) [m]."""
    return np.asarray(attained.expected[CALIBRATED][np.unique(attained.pose, return_index=True)[1]])


def _notes(attained: Attained, size: Mapping[str, np.ndarray], p_moved: float | None, fitted: np.ndarray) -> list[str]:
    """Return notes on assumptions and anomalies."""
    notes = []
    if fitted.any():
        notes.append(
            f"the device stood elsewhere than in the calibration{of_sessions(attained, fitted)}: its frame was fitted to these "
            f"points, which took {FREEDOM * int(fitted.sum())} degrees of freedom; where the robot stands is not judged"
        )
    elif p_moved is not None and p_moved < MOVED_P:
        notes.append(
            "a shift and a turn of all points together would remove much of the error: if the robot's foot or the "
            "device may have moved, --station fitted judges without it"
        )
    far = attained.unit == METRE and size[CALIBRATED].mean() > ELSEWHERE
    if far or size[CALIBRATED].mean() > size[NOMINAL].mean():
        than = "any calibrated robot" if far else "the nominal one"
        notes.append(f"the calibrated robot errs by more than {than}: {OF_THE_SAME}")
    repeated = attained.table["rows"].min()
    if 1 < repeated < CYCLES:
        notes.append(f"ISO 9283 has each pose attained {CYCLES} times; here the fewest is {repeated}")
    if repeated > 1:
        notes.append("repeats count as the standard's cycles: RP is the robot's only where it came to each pose anew")
    return notes


def _largest(values: np.ndarray) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
