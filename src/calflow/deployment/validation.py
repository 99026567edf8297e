"""Validation: what a calibration is worth on measurements that it has not seen, and whether that meets a tolerance."""

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

CONFIDENCE = 0.95  # that is asked of a verdict, and of intervals
ONE_SIDED = 1.645  # standard deviations of the noise by which a pose must be beyond a tolerance to count as such
OF_THE_SAME = "are these rows of the robot, base, tool, units and signs that were calibrated?"
ELSEWHERE = 20e-3  # m by which nobody's calibrated robot moves: the device stands elsewhere
COORDINATES = 3  # of a pose's position
MOVED_P = 0.01  # chance below which a rigid motion of all points is told


Station = Literal["auto", "known", "fitted"]
Status = Literal["met", "not met", "cannot be told", "no tolerance"]
Judged = Literal["nominal", "calibrated", "figures", "commanded"]
Sent = Literal["corrected commands", "program filter", "controller figures"]


@dataclass(frozen=True, kw_only=True)
class ValidatedModel:
    """How far the robot was from where a model says, over all poses measured; intervals are 95 %, poses being independent."""

    model: Judged = column(
        "the robot as its maker says, as calibrated, as its controller has it, or where commands were to land"
    )
    poses: int = column("number of poses")
    mean_mm: float = column("mean error of a pose", "mm")
    mean_low_mm: float = column("lower end of its interval (Student's t over poses)", "mm")
    mean_high_mm: float = column("upper end of it", "mm")
    rms_mm: float = column("root mean square error of a pose", "mm")
    rms_low_mm: float = column("lower end of its interval", "mm")
    rms_high_mm: float = column("upper end of it", "mm")
    max_mm: float = column("the largest error: pose accuracy AP of the worst pose", "mm")
    further_mm: float = column("what a further pose like these errs by less than, with a probability of 95 %", "mm")
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
    """A point of a pose: how far the barycentre of its rows was from where each model says (ISO 9283's AP), and its RP."""

    pose: str = column("as in the measurements")
    marker: str = column("as in the measurements")
    payload: str = column("as in the measurements")
    session: str = column("as in the measurements; empty: none was named")
    rows: int = column("how many times it was measured")
    nominal_mm: float = column("distance to where the robot as its maker says would be", "mm")
    calibrated_mm: float = column("distance to where the calibrated robot would be", "mm")
    commanded_mm: float = column("distance to the target of the command; empty: none was stated", "mm")
    promised_mm: float = column(
        "standard deviation of the calibrated distance, or of that of the controller's figures, as the calibration promises it",
        "mm",
    )
    dx_mm: float = column("measured minus expected position of what is judged, along the measuring frame's x", "mm")
    dy_mm: float = column("the same along y", "mm")
    dz_mm: float = column("the same along z", "mm")
    rp_mm: float = column("pose repeatability RP; empty: measured once", "mm")
    turn_mrad: float = column("how much the tool is turned beside the calibrated robot's; empty: not measured", "mrad")
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
    """How a validation ended: the verdict with its probabilities, and what was done about the device's frame."""

    status: Status = column("the verdict")
    judged: Judged = column(
        "whose errors the verdict is about: commands where targets were stated, else the calibrated robot, or its controller's "
        "figures where these were typed in"
    )
    sent: Sent | None = column(
        "what the robot had been given when it was measured; null: nothing, the model is judged by what it predicts, as corrected "
        "commands would have it"
    )
    tolerance_mm: float | None = column("what was asked; null: nothing", "mm")
    confidence: float = column("probability that a verdict 'met' needs")
    further_within: float | None = column(
        "probability that a further pose like these is within; null: not asked, or too few poses"
    )
    task_poses: int = column("poses of the task")
    task_within: float | None = column("probability that all of them are within; null: as before")
    decided_by: Literal["further pose", "task"] = column("which of the two decides")
    poses: int = column("poses measured")
    rows: int = column("rows measured")
    beyond: int = column("points that are beyond the tolerance by more than the device's noise explains")
    station: Literal["known", "fitted"] = column(
        "whether the device stood where the calibration's did, or its frame was fitted"
    )
    frames: int = column("frames that were fitted: one a session")
    freedom_lost: int = column("degrees of freedom that this took")
    moved_mm: float | None = column("how far the fitted frame is from the calibration's at these points; of a known one, how far a "
                                    "rigid motion would take them; null: too few poses to tell", "mm")  # fmt: skip
    turned_mrad: float | None = column("by how much it is turned", "mrad")
    moved_p: float | None = column(
        "chance of so large a motion where nothing moved; null: the frame was fitted, or too few poses"
    )
    noise_mm: float | None = column(
        "the device's noise of a row, per axis; null: not known apart from the calibration", "mm"
    )
    promised_mm: float = column(
        "root mean square error that the calibration promised for these poses, noise included", "mm"
    )
    ap_mm: float = column("pose accuracy AP of the worst pose", "mm")
    rp_mm: float | None = column("pose repeatability RP of the worst pose; null: none was measured twice", "mm")
    fewest_cycles: int = column("how many times the pose was attained that was attained least; the standard has 30")
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
    """A calibrated robot held against further measurements: statistics of each model, every point, and the verdict."""

    accuracy: tuple[ValidatedModel, ...]
    poses: tuple[ValidatedPose, ...]
    summary: ValidationSummary

    def of(self, model: str) -> ValidatedModel:
        """Return the statistics of a model."""
        return next(accuracy for accuracy in self.accuracy if accuracy.model == model)

    @property
    def judged(self) -> ValidatedModel:
        """The statistics of what the verdict is about."""
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
    """Hold a calibrated robot against measurements that it has not seen.

    A pose's error is the distance from where it should be to the barycentre of its rows. Poses are the independent unit. The
    tolerance is for errors as measured, the device's noise included, so that noise never makes a robot look better.

    Args:
        calibrated: the calibrated model.
        data: the rows: positions or poses, in the frame of the calibration or any other, or whatever else was observed, which is
            then judged in its own unit.
        tolerance: what a pose may err by [m, or the unit that is judged: rad, px, N].
        task: how many poses must all be within; then that decides instead of a further pose.
        confidence: the probability that a verdict "met" needs.
        station: whether the device stood where it stood in the calibration; "auto" takes it as known but in
            sessions whose points are ELSEWHERE from there on average, which no robot's are.
        sent: what the robot had been given; corrected commands where targets are stated and it is None.
        figures: those that its controller had, where they were sent (see `Levels.figures`).

    Raises:
        InputError: a needed condition is missing, or there are too few poses to fit a frame, or a figure is at fault.
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
    # What the device wanders by is in what it sees, and no part of where the robot is: it is promised where its hour is stated.
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
    """Say of each session whether the device's frame is to be fitted (n_frames,), and return the motions to the calibrated robot's.

    A session of too few points has none, and counts as known unless all are to be fitted.
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
    """Name the sessions whose frames are fitted where others are not."""
    names = [f"'{name}'" for name, is_fitted in zip(attained.sessions, fitted, strict=True) if is_fitted]
    return "" if fitted.all() else f" in session {', '.join(names)}"


def _motions(attained: Attained, fitted: np.ndarray, frames: tuple[Alignment, ...]) -> list[tuple[float, float]]:
    """How far from the calibration's each fitted frame is, at its points on average [m], and turned [rad]; without such, of all."""
    asked = fitted if fitted.any() else np.full(len(fitted), bool(frames))
    alignments = attained.alignment(CALIBRATED, asked)
    return [
        (alignments[k].moved(attained.measured[attained.frame == k]), alignments[k].angle)
        for k in np.flatnonzero(asked)
    ]


def _moved_p(attained: Attained, error: np.ndarray, frames: tuple[Alignment, ...]) -> float:
    """Chance that a rigid motion takes so much off the errors where they are independent and nothing moved (F test)."""
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
    """What the poses tell of further ones, each judged by its worst point; those that share a fitted frame count as one less."""
    size = np.linalg.norm(attained.errors_of_further(model, fitted), axis=1)
    return Errors.of(attained.by_pose(size, "max"), int(fitted.sum()))


def _statistics(model: Judged, attained: Attained, size: np.ndarray, lost: int, worst: Errors) -> ValidatedModel:
    """Mean, root mean square and largest error over poses, with what a further pose stays below."""
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
    """Mean of values that count as n, and its interval by Student's t, not below nothing; without ends where they are too few."""
    mean = float(values.mean())
    if not n > 1:
        return mean, float("nan"), float("nan")
    half = float(scipy.special.stdtrit(n - 1, 0.5 + CONFIDENCE / 2) * values.std(ddof=1) / np.sqrt(n))
    return mean, max(0.0, mean - half), mean + half


def _status(within: np.ndarray | None, beyond: int, probability: float | None, confidence: float) -> Status:
    """The verdict: not met where a pose is beyond, met where none is and further ones are within as surely as asked."""
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
    """A row a point."""
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
    """Where the poses are, one point of each (n_poses, 3) [m]."""
    return np.asarray(attained.expected[CALIBRATED][np.unique(attained.pose, return_index=True)[1]])


def _notes(attained: Attained, size: Mapping[str, np.ndarray], p_moved: float | None, fitted: np.ndarray) -> list[str]:
    """Say what was assumed, and what looks wrong."""
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
