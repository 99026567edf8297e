"""Next poses: whether the measurements suffice, and which further poses best reduce the tool's uncertainty in its task.

All uncertainties (parameters, lacking effects, rivals of findings) are whitened to directions of unit standard
deviation, so that a single I-optimal design weights them by their effect on the tool.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calflow.design.discrimination import Question, planned_like, questions, rows_like
from calflow.design.measuring_order import shortest_tour
from calflow.design.optimality import ToolError, information
from calflow.design.planned import Measure, Planned, SelectionRequest
from calflow.design.search import greedy
from calflow.design.selection import PlannedPose, planned_poses
from calflow.design.task_error import LackingCause, TaskSlopes, independent_sizes, lacking_causes, of_robot, task_error
from calflow.diagnosis.diagnosis import Diagnosis, extended_model
from calflow.diagnosis.findings import Finding, findings
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.verdict import named
from calflow.effects.wording import UNEXPLAINED, NamedCause
from calflow.estimation.accuracy import distances, errors
from calflow.estimation.calibrated_model import Alternative, CalibratedModel, choice_errors, points_at
from calflow.estimation.probing import probed
from calflow.estimation.progress import Draws
from calflow.faults import as_table
from calflow.files.deferred import pd
from calflow.files.tables import Results, column, to_document, typed
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import Model, consecutive

PARAMETERS, PRECISION = "parameters", "less uncertainty of the tool over the task"
DISCRIMINATING_SHARE = 0.5  # largest share of poses that separate rivals
WORST_SHARE = 0.1  # share of the task's points with weight under the worst-point measure
CONFIDENCE = 0.95
LIKELY = 0.02  # probability from which a suspect is reported


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """A source of uncertainty, as directions of unit sd at candidates (n_poses, n_units, n) and tool (n_points, 3, n) [m]."""

    name: str
    seen: np.ndarray
    tool: np.ndarray


def uncertainties(
    fitted: Fitted,
    suspects: Sequence[LackingCause],
    alternatives: Sequence[Alternative],
    at_task: TaskSlopes,
    planned: Planned,
    choices: Measurements,
) -> list[Uncertainty]:
    """Return the sources of uncertainty of the tool over the task, with their effect at the candidate poses."""
    model, estimate, errors = fitted.model, fitted.fit.estimate, of_robot(fitted.errors)
    asked = [*errors.functions, *(suspect.cause for suspect in suspects)]
    _, slopes = probed(planned.problem(model, estimate, choices.conditions), estimate, asked)
    slopes = slopes.reshape(len(choices), -1, slopes.shape[1])
    n, smooth = len(estimate), len(estimate) + len(errors.sd)
    at_poses = slopes[:, :, :smooth] * np.append(np.ones(n), errors.sd)
    at_tool = errors.slopes(model, estimate, at_task.conditions)
    # Their mean is no uncertainty: no further pose reduces it.
    seen, tool = (errors.shared(each, fitted.covariance)[:, :, 1:] for each in (at_poses, at_tool))
    uncertainties = [
        Uncertainty(PARAMETERS, seen[:, :, :n], tool[:, :, :n]),
        Uncertainty("smooth errors", seen[:, :, n:], tool[:, :, n:]),
    ]
    free = slopes[:, :, np.flatnonzero(~fitted.fit.at_bound)]
    columns = consecutive([smooth, *(suspect.response.shape[1] for suspect in suspects)])[1:]
    for suspect, moved, span in zip(suspects, at_task.by(suspects), columns, strict=True):
        root = np.sqrt(suspect.probability) * suspect.root
        uncertainties.append(
            Uncertainty(named(suspect.cause).name, (slopes[:, :, span] + free @ suspect.response) @ root, moved @ root)
        )
    if planned.observation.units == (METRE,) * 3:
        both = (choices.conditions, at_task.conditions)
        seen, tool = (choice_errors(alternatives, model, estimate, points_at(rows)) for rows in both)
        for k, name in enumerate(map(_rival, alternatives)):
            uncertainties.append(Uncertainty(name.name, seen[:, :, [k]] / planned.sigma, tool[:, :, [k]]))
    return uncertainties


def further_poses(
    every: Sequence[Uncertainty], asked: Sequence[Question], measure: Measure, number: int
) -> Mapping[int, str]:
    """Choose candidates, by their numbers, with reasons in words: some separate rivals, others reduce the tool's variance."""
    reasons = _discriminating(asked, int(np.ceil(DISCRIMINATING_SHARE * number)))
    seen = np.concatenate([doubt.seen for doubt in every], axis=2)
    tool = np.concatenate([doubt.tool for doubt in every], axis=2)
    information_matrix = information(seen[list(reasons)], np.eye(seen.shape[2]))
    criterion = ToolError(tool, _shares(tool, information_matrix, measure))
    others = np.setdiff1d(np.arange(len(seen)), list(reasons))
    for pose in others[greedy(seen[others], information_matrix, min(number - len(reasons), len(others)), criterion)]:
        after = information(seen[[pose]], information_matrix)
        reasons[int(pose)] = _reason(every, criterion, information_matrix, after)
        information_matrix = after
    return reasons


def _discriminating(asked: Sequence[Question], most: int) -> dict[int, str]:
    """Return the poses of all questions' plans, taken in turn, by their numbers among the choices, with what they are for."""
    plans = [(question, question.plan) for question in asked if question.plan]
    reasons: dict[int, str] = {}
    for k in range(most):
        for question, plan in plans:
            if k < len(plan.poses) and len(reasons) < most:
                rivals = ", ".join(named(rival).name for rival in plan.rivals)
                what = f"distinguishes {named(question.cause).name} from {rivals}"
                reasons.setdefault(int(plan.poses.table.index[k]), what)
    return reasons


def _shares(tool: np.ndarray, information_matrix: np.ndarray, measure: Measure) -> np.ndarray:
    """Return the weights of the task's points: equal, or of the worst ones only."""
    variance = ToolError(tool, np.full(len(tool), 1 / len(tool))).variances(np.linalg.inv(information_matrix))
    counts = variance >= np.quantile(variance, 1 - WORST_SHARE) if measure == "worst" else variance >= 0
    return np.asarray(counts / counts.sum())


def _reason(every: Sequence[Uncertainty], criterion: ToolError, before: np.ndarray, after: np.ndarray) -> str:
    gone = np.linalg.inv(before) - np.linalg.inv(after)
    moved = (criterion.root @ criterion.root.T) * gone
    gains = [float(moved[span, span].sum()) for span in consecutive(doubt.seen.shape[2] for doubt in every)]
    best = every[int(np.argmax(gains))].name
    return PRECISION if best == PARAMETERS else f"suspected: {best}"


Kind = Literal["cause", "background", "pose", "rival"]
Status = Literal["stop", "measure", "no tolerance", "too few", "nothing measured"]


@dataclass(frozen=True, kw_only=True)
class NextMeasurement(PlannedPose):
    """A pose to measure next, in measuring order, with its reason."""

    reason: str = column("the reason for its choice")


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """An effect that the model may lack, or have under another name, without proof."""

    name: str = column(
        "a cause in words, with its joint; or the inputs of a smooth background; `pose`: every pose for itself"
    )
    kind: Kind = column("its kind; a rival: in place of a cause found")
    cause: str = column("id of the cause; empty: it is none", default="")
    joint: int | None = column("number of its joint or link; null: none", default=None)
    probability: float = column("its posterior probability")


@dataclass(frozen=True, kw_only=True)
class MeasuringVerdict:
    """The verdict on the measurements so far: the tool's error over its task, and whether to continue."""

    status: Status = column(
        "`stop`: the tolerance is met with the probability asked for; `measure`: not yet; `no tolerance`: none was stated; `too "
        "few` to identify anything, or `nothing measured`: poses to begin with"
    )
    poses: int = column("poses measured so far")
    fitted_poses: int = column("of these, poses that were fitted")
    measure: Measure = column(
        "the quantity compared with the tolerance: the tool's true error over the task, `rms` or at the `worst` point"
    )
    tolerance_mm: float | None = column("the tolerance; null: not stated", "mm", default=None)
    confidence: float = column("probability that `stop` needs")
    probability: float | None = column(
        "probability that the error is within; null: no tolerance, or too few poses", default=None
    )
    probability_at_best: float | None = column(
        "the same with all parameters known, and lacking effects unchanged: the limit for more poses of this kind",
        default=None,
    )
    error_mm: float | None = column("posterior median of the error; null: too few poses", "mm", default=None)
    error_most_mm: float | None = column(
        "posterior quantile of the error at the probability `confidence`", "mm", default=None
    )
    heldout_rms_mm: float | None = column(
        "root mean square error at held-out poses, including the device's noise; null: none was held out",
        "mm",
        default=None,
    )
    leftout_rms_mm: float | None = column(
        "the same for fitted poses, each left out in turn (linearised, without a refit)", "mm", default=None
    )
    elsewhere_mm: float | None = column(
        "model error at poses left out, beyond noise and parameter uncertainty, per axis", "mm", default=None
    )
    noise_mm: float | None = column(
        "noise of a row, per axis; null: too few poses, or no lengths were measured", "mm", default=None
    )
    noise_known: bool = column(
        "whether it is known independently of the fit; else all residuals are attributed to the robot", default=False
    )
    found: tuple[str, ...] = column("causes that were found, and unexplained errors, in words", default=())
    left_out: tuple[str, ...] = column("causes that are suspected and left out of the model, in words", default=())
    suspected: tuple[Suspect, ...] = column("suspected but unproven effects, the likeliest first", default=())
    untested: tuple[str, ...] = column(
        "effects that these data cannot test: the probability does not include them", default=()
    )
    notes: tuple[str, ...] = column("assumptions and warnings", default=())


@dataclass(frozen=True, eq=False)
class NextStep:
    """The verdict after some measurements, and the poses to measure next, in measuring order: none if it is to stop.

    calibrated: the model judged; None if there are too few poses to identify one.
    """

    verdict: MeasuringVerdict
    poses: pd.DataFrame
    calibrated: CalibratedModel | None = None

    @property
    def results(self) -> Results:
        """poses.csv and verdict.json."""
        return Results({"poses.csv": self.poses}, {"verdict.json": to_document(self.verdict)})


def next_step(
    diagnosis: Diagnosis, identified: CalibratedModel, data: Measurements, asked: SelectionRequest, confidence: float,
    rng: Draws,
) -> NextStep:  # fmt: skip
    """Return the verdict on a diagnosed model and its tolerance, and the poses to measure next.

    Args:
        diagnosis: the diagnosis of the measurements.
        identified: the model before diagnosis.
        data: the measurements, gross mistakes corrected.
        asked: the selection of poses, which names a task and a marker.
        confidence: probability of meeting the tolerance at which measuring may stop.
        rng: random numbers for all draws.

    Raises:
        InputError: no stated pose, or hardly any drawn one, is admissible.
    """
    # The deployed model, without unproven effects.
    fitted = diagnosis.final or diagnosis.extended.with_causes(())
    assert asked.task is not None
    catalogue = Catalogue.of(fitted.data, [effect.id for effect in fitted.plain])
    causes = lacking_causes(fitted, catalogue)
    bare = replace(fitted.model, given=())
    at_task = TaskSlopes.of(fitted, asked.task, rng("conditions"))
    rivals = [alternative for alternative in diagnosis.alternatives if alternative.gone]  # others are lacking causes
    by_cause = [
        [rival for rival in rivals if rival.gone == cause] for cause in diagnosis.causes[: diagnosis.n_deployed]
    ]
    drawn = task_error(fitted, causes, by_cause, at_task, asked.measure, rng("task error"))
    lacking = findings(diagnosis, identified, data, as_table((), data), rng("resamples"))
    verdict = _verdict(
        data, fitted, *drawn, asked, confidence, lacking,
        _suspects(rivals, fitted, causes), tuple(sorted(catalogue.lacking)),
    )  # fmt: skip
    calibrated = extended_model(diagnosis, identified, data)
    if verdict.status == "stop":
        nothing = planned_poses(bare, asked, np.zeros((0, bare.robot.n_joints))).assign(reason="")
        return NextStep(verdict, numbered_on(nothing, data), calibrated)
    planned = planned_like(fitted, data)
    drawing = rng("candidates")
    readings = asked.choice(bare, planned.observation, drawing, 1)
    choices = rows_like(fitted.data, readings, (asked.payload,) * len(readings), drawing)
    every = uncertainties(fitted, causes, rivals, at_task, planned, choices)
    chosen = further_poses(every, questions(diagnosis, data, rng, choices), asked.measure, asked.number)
    return NextStep(verdict, numbered_on(_table(bare, choices, chosen, asked), data), calibrated)


def _verdict(
    data: Measurements, fitted: Fitted, error: np.ndarray, at_best: np.ndarray, asked: SelectionRequest, confidence: float,
    lacking: Sequence[Finding], suspected: tuple[Suspect, ...], untested: tuple[str, ...],
) -> MeasuringVerdict:  # fmt: skip
    """Return the verdict by draws (n_draws,) of the tool's error, and of that with all parameters known."""
    tolerance = asked.tolerance
    probability, best = (
        None if tolerance is None else float(np.mean(drawn <= tolerance)) for drawn in (error, at_best)
    )
    status: Status = "no tolerance" if probability is None else "stop" if probability >= confidence else "measure"
    heldout = data.only(data.held_out)
    outside = distances(errors(fitted.model, fitted.fit.estimate, heldout, METRE))
    outside = outside[np.isfinite(outside)]
    return MeasuringVerdict(
        status=status, poses=data.table["pose"].nunique(), fitted_poses=fitted.data.table["pose"].nunique(),
        measure=asked.measure, tolerance_mm=in_mm(tolerance), confidence=confidence, probability=probability,
        probability_at_best=best, error_mm=in_mm(float(np.median(error))),
        error_most_mm=in_mm(float(np.quantile(error, confidence))),
        heldout_rms_mm=in_mm(float(np.sqrt((outside**2).mean()))) if len(outside) else None,
        leftout_rms_mm=in_mm(fitted.left_out.rms), elsewhere_mm=in_mm(float(fitted.left_out.excess())),
        noise_mm=in_mm(fitted.noise.typical(METRE)) or None, noise_known=fitted.noise.known,
        found=tuple(finding.in_short for finding in lacking if not finding.is_suspicion),
        left_out=tuple(finding.in_short for finding in lacking if finding.is_suspicion),
        suspected=suspected, untested=untested, notes=data.notes,
    )  # fmt: skip


def _table(model: Model, choices: Measurements, reasons: Mapping[int, str], asked: SelectionRequest) -> pd.DataFrame:
    """Return the poses in short measuring order, each with its reason, and its sides of approach if recorded."""
    chosen = np.array(list(reasons))
    numbers = chosen[shortest_tour(choices.joints[chosen])]
    table = planned_poses(model, asked, choices.joints[numbers])
    if "approach" in choices.given:
        sides = choices.table[[f"approach{i + 1}" for i in model.robot.driven]]
        table = table.assign(**sides.iloc[numbers].astype(int).reset_index(drop=True))
    return table.assign(reason=[reasons[number] for number in numbers])


def _rival(alternative: Alternative) -> NamedCause:
    return named(alternative.rival) if alternative.rival else NamedCause(UNEXPLAINED, 0)


def _suspects(rivals: Sequence[Alternative], fitted: Fitted, causes: Sequence[LackingCause]) -> tuple[Suspect, ...]:
    of_poses = float(independent_sizes(fitted)[1][1:].sum())
    every = [
        *(_named_suspect(named(lacking.cause), "cause", lacking.probability) for lacking in causes),
        *(
            Suspect(name=" and ".join(inputs), kind="background", probability=share)
            for inputs, share in fitted.smooth.probabilities.items()
        ),
        Suspect(name="pose", kind="pose", probability=of_poses),
        *(_named_suspect(_rival(rival), "rival", rival.probability) for rival in rivals),
    ]
    likeliest = sorted(every, key=lambda suspect: -suspect.probability)
    return tuple(suspect for suspect in likeliest if suspect.probability >= LIKELY)


def _named_suspect(cause: NamedCause, kind: Kind, probability: float) -> Suspect:
    return Suspect(name=cause.name, kind=kind, cause=cause.cause, joint=cause.joint or None, probability=probability)


def numbered_on(table: pd.DataFrame, data: Measurements | None) -> pd.DataFrame:
    """Return the table with poses numbered on from those measured, so that it can be appended to their file."""
    names = [] if data is None else [str(name) for name in data.table["pose"]]
    last = max((int(name) for name in names if name.isdecimal()), default=0)
    return typed(table.assign(pose=last + np.arange(1, len(table) + 1)), NextMeasurement)


def in_mm(length: float | None) -> float | None:
    """Return a length [m] in mm; None for None."""
    return None if length is None or not np.isfinite(length) else 1e3 * length


TABLES = {"poses.csv": NextMeasurement, "verdict.json": MeasuringVerdict}
