"""The verdict of the measuring loop after a batch of measurements, as a document."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from calflow.design.measuring.task_error import Measure
from calflow.design.selection import PlannedPose
from calflow.files.tables import column

Status = Literal["stop", "measure", "no tolerance", "too few", "nothing measured"]
CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class NextMeasurement(PlannedPose):
    """A pose to measure next, in measuring order, and what for."""

    reason: str = column("what it is chosen for")


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """What the model may lack, or have by another name, though nothing proves it."""

    name: str = column("a cause's id and joint; or the inputs of a smooth background; `pose`: every pose for itself")
    kind: Literal["cause", "background", "pose", "rival"] = column(
        "what it is; a rival is instead of a cause that was found"
    )
    probability: float = column("that it is so, as far as the data tell")


@dataclass(frozen=True, kw_only=True)
class MeasuringVerdict:
    """What the measurements so far say of the tool over its task, and whether to go on."""

    status: Status = column(
        "`stop`: the tolerance is met with the probability asked for; `measure`: not yet; `no tolerance`: none was stated; `too "
        "few` to identify anything, or `nothing measured`: poses to begin with"
    )
    poses: int = column("poses measured so far")
    fitted_poses: int = column("of these, poses that were fitted")
    measure: Measure = column(
        "what is compared with the tolerance: the tool's true error over the task, `rms` or `worst` point"
    )
    tolerance_mm: float | None = column("what it is to be within; null: not stated", "mm", default=None)
    confidence: float = column("probability that `stop` needs")
    probability: float | None = column(
        "probability that the error is within; null: no tolerance, or too few poses", default=None
    )
    probability_at_best: float | None = column(
        "the same where all parameters were known, and no more of what may be lacking: what more poses of this kind come to",
        default=None,
    )
    error_mm: float | None = column("the error: as likely larger as smaller; null: too few poses", "mm", default=None)
    error_most_mm: float | None = column(
        "the error that it is below with the probability `confidence`", "mm", default=None
    )
    heldout_rms_mm: float | None = column(
        "root mean square error at held-out poses, the device's noise in it; null: none was held out",
        "mm",
        default=None,
    )
    leftout_rms_mm: float | None = column(
        "the same of fitted poses, each left out in turn (by one Jacobian, without a refit)", "mm", default=None
    )
    elsewhere_mm: float | None = column(
        "what the model errs by at poses left out, beyond noise and parameters, per axis", "mm", default=None
    )
    noise_mm: float | None = column("noise of a row, per axis; null: too few poses", "mm", default=None)
    noise_known: bool = column(
        "whether it is known apart from the fit; else all that is left counts as the robot's", default=False
    )
    found: tuple[str, ...] = column("causes that were found, and what nobody can name, in words", default=())
    suspected: tuple[Suspect, ...] = column("what is suspected and not proven, the likeliest first", default=())
    untested: tuple[str, ...] = column(
        "effects that these data cannot show: the probability knows nothing of them", default=()
    )
    notes: tuple[str, ...] = column("what was assumed, and what to look at", default=())
