"""Selection of the most informative poses, with observability indices and expected accuracy by the number of poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calflow.design.measuring_order import DriftPull, drift_pulls, orders, reached, vias
from calflow.design.optimality import Criterion, ParameterCriterion, ToolError, indices, information
from calflow.design.planned import Aim, SelectionRequest, Task
from calflow.design.refinement import refined_poses
from calflow.design.search import greedy, search_poses, search_worst
from calflow.design.worth import HowMany, PlanInformation, Worth, knee, next_best, poses_for_tolerance
from calflow.estimation.identifiability import NULL
from calflow.estimation.progress import SAME, Advance, Draws, Say, nobody
from calflow.files.deferred import pd
from calflow.files.problems import Problem, refuse, refuse_any, unknown_name
from calflow.files.tables import column, to_frame, typed
from calflow.model import Model
from calflow.robot.mechanism import READINGS, VIAS, reading_columns, shown_readings

CURVE = 30  # numbers of poses at which the curve is evaluated
TASK_POSES = 400  # default number of poses of the task


@dataclass(frozen=True, kw_only=True)
class Observability:
    """The observability and the expected accuracy of a number of poses, the most informative first."""

    n_poses: int = column("number of poses, besides existing measurements that are included")
    indices: Mapping[str, float] = column(
        "observability indices O1 to O5 of these poses, parameters scaled by their priors", name="O{1|2|3|4|5}"
    )
    expected_sd_mm: float = column(
        "root mean square over the task (the workspace, where the study names none) of the predicted position's standard "
        "deviation",
        "mm",
    )
    worst_sd_mm: float = column("the largest of these standard deviations", "mm")


def observability(whitened: np.ndarray, prior: np.ndarray, tool: ToolError, added: bool) -> pd.DataFrame:
    """Return indices and the tool's expected standard deviation against the number of poses, whitened (n, n_axes, n_parameters).

    Parameters are scaled by their priors, so an index compares the data with prior knowledge. The standard deviation is the root
    mean square over the task's poses, all three axes. For poses added to others the table starts at the first.
    """
    n_parameters = whitened.shape[2]
    singular = np.linalg.svd(whitened.reshape(-1, n_parameters), compute_uv=False)
    rank = int((singular > NULL * singular[0]).sum())
    first = 0 if added else min(len(whitened), -(-rank // whitened.shape[1]))
    rows = []
    for n in sorted({*range(first, len(whitened) + 1, max(1, (len(whitened) - first) // CURVE)), len(whitened)}):
        part = whitened[:n]
        variances = tool.variances(np.linalg.inv(information(part, prior)))
        part_indices = indices(part.reshape(-1, n_parameters), rank)
        rows.append(
            Observability(
                n_poses=n,
                indices={f"O{k}": value for k, value in enumerate(part_indices, start=1)},
                expected_sd_mm=1e3 * float(np.sqrt(tool.shares @ variances)),
                worst_sd_mm=1e3 * float(np.sqrt(variances.max())),
            )
        )
    return to_frame(rows, Observability)


@dataclass(frozen=True, kw_only=True)
class PlannedPose:
    """A chosen pose, in measuring order: joints, the side each comes from, and where the tool will be.

    via and travel are given if a suspected cause depends on the side from which joints approach.
    """

    pose: int = column("its number in measuring order")
    readings: Mapping[str, float] = column("reading of each joint", "as named", name=READINGS)
    approach: Mapping[str, int] = column(
        "side each joint comes from: -1, +1; 0 at the first pose, which is reached from anywhere",
        name="approach{joint}",
    )
    via: Mapping[str, float] = column(
        "reading of each joint to go to before: from there all come straight to the pose", "as named", name=VIAS
    )
    travel: Mapping[str, float] = column(
        "way of each joint since it last turned back", "as named", name="travel{joint}_{deg|mm}"
    )
    nominal: Mapping[str, float] = column(
        "the nominal marker's position in the measuring frame", "mm", name="nominal_{x|y|z}_mm"
    )
    marker: str = column("its name")
    payload: str = column("the load; empty: none")


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """The criterion of the selection, and a bound on the gain of any other choice of as many of these candidates."""

    criterion: Aim = column(
        "what was minimised: the standard deviations of all `parameters`, those of the `tool` over the task, or their `worst`"
    )
    n_poses: int = column("number of poses")
    n_candidates: int = column("number of candidates from which they were chosen")
    n_parameters: int = column("number of the model's parameters")
    loss: float = column(
        "of `parameters` the geometric mean of their standard deviations, each relative to its prior; else the root "
        "mean square [mm] of the tool's standard deviation over the task, or its largest"
    )
    least_loss: float = column("lower bound on the loss of any choice, by the equivalence theorem")
    could_gain_percent: float = column("largest possible reduction of the loss by any other choice", "%")
    refined_percent: float | None = column(
        "further reduction of the loss by moving the chosen poses between the candidates; null: not refined",
        "%",
        default=None,
    )


@dataclass(frozen=True)
class Selection:
    """The chosen poses in measuring order, their observability by number, and the certificate of the choice.

    readings (n, n_joints): of the poses, including joints that follow others; vias (n, n_joints): readings before each,
    or None; worth: the plan's accuracy with single additions; drift: the bias by drift in each order.
    """

    poses: pd.DataFrame
    observability: pd.DataFrame
    certificate: Certificate
    how_many: HowMany
    readings: np.ndarray
    vias: np.ndarray | None
    worth: tuple[Worth, ...]
    drift: tuple[DriftPull, ...]


def select(
    model: Model, request: SelectionRequest, *, rng: Draws = SAME, say: Say = nobody, advance: Advance = nobody
) -> Selection:
    """Choose poses by relaxation, rounding and exchange, with their observability and a bound on any other choice.

    Args:
        model: the model whose parameters are to be estimated, with the planned observation.
        request: the settings.
        rng: random numbers for the candidates.
        say: receives messages on the quality of the choice.
        advance: receives the share of work done.

    Raises:
        InputError: unknown marker or payload, hardly any pose reaches the region, or too few stated poses are
            admissible.
    """
    named = ("marker", request.marker, model.robot.markers), ("payload", request.payload, model.robot.payloads)
    refuse_any(Problem(message, key=asked[0]) for asked in named if (message := unknown_name(*asked)))
    request = replace(request, marker=request.marker or next(iter(model.robot.markers)))
    if not model.observations:
        model = replace(model, observations=(request.planned.observation,))
    readings = request.choice(model, request.planned.observation, rng("candidates"), request.number, say)
    advance(0.3)
    whitened, prior = request.whitened(model, readings), np.eye(len(model.parameters))
    if request.there is not None:
        if len(request.there) != model.n_conditions:
            shape = f"({model.n_conditions}, n)"
            raise refuse(f"expected packed conditions of shape {shape}, found {request.there.shape}", key="there")
        already = request.planned.whitened(model, model.nominal, request.there) * model.prior_sd
        prior = information(already, prior)
    tool = (request.task or Task.of(readings[:TASK_POSES], [request.payload], request.marker)).criterion(model)
    criterion: Criterion = ParameterCriterion(len(prior)) if request.aim == "parameters" else tool
    say(f"{len(readings)} candidates, {len(prior)} parameters")
    advance(0.5)
    if request.aim == "worst":
        result = search_worst(whitened, prior, request.number, tool, rng("search"))
    else:
        result = search_poses(whitened, prior, request.number, criterion, rng("search"))
    unit = 1.0 if request.aim == "parameters" else 1e3
    certificate = Certificate(
        criterion=request.aim, n_poses=request.number, n_candidates=len(whitened), n_parameters=len(prior),
        loss=unit * result.loss, least_loss=unit * result.bound, could_gain_percent=100 * result.could_gain,
    )  # fmt: skip
    say(
        f"no other {request.number} of these candidates are better by more than {certificate.could_gain_percent:.2g} % "
        f"({'standard deviations' if request.aim == 'parameters' else 'tool error'})"
    )
    advance(0.9)
    poses, chosen = readings[result.chosen], whitened[result.chosen]
    if request.refine:
        poses = refined_poses(model, request, poses, prior, criterion)
        chosen = request.whitened(model, poses)
        gained = 100 * (1 - criterion.loss(np.linalg.inv(information(chosen, prior))) / result.loss)
        certificate = replace(certificate, refined_percent=gained)
        say(f"moved between the candidates they are better by {gained:.2g} %")
    further = whitened[next_best(whitened, information(chosen, prior), result.chosen, tool)]
    curve = observability(
        chosen[greedy(chosen, prior, request.number, criterion)], prior, tool, request.there is not None
    )
    plan = PlanInformation(model, request, poses, chosen, prior, tool, further)
    how_many = _how_many(plan, whitened, curve, rng)
    every = orders(plan, rng("order"))
    ordered, reached_from = poses[every[request.order]], None
    if request.both_sides:
        reached_from = vias(model, request, ordered, rng("vias"))
    return Selection(
        planned_poses(model, request, ordered, reached_from), curve, certificate, how_many, ordered,
        reached_from, plan.worth, tuple(drift_pulls(plan, every)),
    )  # fmt: skip


def _how_many(plan: PlanInformation, whitened: np.ndarray, curve: pd.DataFrame, rng: Draws) -> HowMany:
    """Return the gain by ten more poses, the bend of the curve, and the number of poses that meets a tolerance."""
    request, met, needed = plan.request, None, None
    if request.tolerance is not None:
        met, needed = poses_for_tolerance(whitened, plan.prior, plan.tool, request.tolerance, rng("number"))
    return HowMany(
        n_poses=request.number,
        expected_sd_mm=plan.worth[0].expected_sd_mm,
        next_ten_mm=next((row.gain_mm for row in plan.worth if row.n_poses > request.number), 0.0),
        knee_poses=knee(curve["n_poses"].to_numpy(), curve["expected_sd_mm"].to_numpy()),
        tolerance_mm=None if request.tolerance is None else 1e3 * request.tolerance,
        enough_poses=met,
        needed_poses=needed,
    )


def planned_poses(
    model: Model, request: SelectionRequest, readings: np.ndarray, reached_from: np.ndarray | None = None
) -> pd.DataFrame:
    """Return the table of poses in measuring order, with vias (n, n_joints), without which the first approach is unknown, 0."""
    robot = model.robot
    came, travel = reached(readings, reached_from)
    joints = {"q": readings} if reached_from is None else {"q": readings, "via": reached_from, "travel": travel}
    position = 1e3 * model.position(model.nominal, request.rows(model, readings))
    table: dict[str, object] = {"pose": np.arange(1, len(readings) + 1)}
    for stem, values in joints.items():
        names = (stem + name.removeprefix("q") for name in reading_columns(robot))
        table |= dict(zip(names, np.round(shown_readings(robot, values), 4).T, strict=True))
    table |= {f"approach{i + 1}": came[:, i].astype(int) for i in robot.driven}
    table |= {f"nominal_{axis}_mm": np.round(position[:, i], 1) for i, axis in enumerate("xyz")}
    return typed(pd.DataFrame({**table, "marker": request.marker, "payload": request.payload}), PlannedPose)
