"""Further poses: those that make the tool surest over the task, whatever of parameters, lacks and rivals is in doubt.

What is in doubt is turned into directions that are each known with a standard deviation of 1, so that one I-optimal design
weighs parameters, what the model may lack and the rivals of what was found against each other by what they do to the tool.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calflow.design.discrimination import Question
from calflow.design.exchange import greedy, information
from calflow.design.measuring.lacks import Lack, Lacks
from calflow.design.measuring.task_error import Measure, Site, TaskError
from calflow.design.optimality import ToolError
from calflow.design.planned import Planned
from calflow.design.t_optimality import Choices
from calflow.diagnosis.findings.verdict import label
from calflow.estimation.probing import probed
from calflow.estimation.rival_models import Alternative
from calflow.files.units import METRE

MOST_LACKS, DIRECTIONS = 4, 10  # names of what may be lacking that poses are chosen for, and directions of each
PARAMETERS, SURER = "parameters", "surer tool over the task"
MATERIAL = 0.02  # share of the task's mean squared error below which a lack is not asked for
TELLING = 0.5  # share of the poses that tell rivals apart, where there are any
WORST = 0.1  # share of the task's points that count where the worst one does


@dataclass(frozen=True, eq=False)
class Doubt:
    """Something in doubt, by directions of standard deviation 1.

    seen (n_poses, n_units, n) is what each candidate pose shows of them over its noise, tool (n_points, 3, n) [m] what they do.
    """

    name: str
    seen: np.ndarray
    tool: np.ndarray


@dataclass(frozen=True)
class Chosen:
    """A candidate pose to measure, by its number, and what for, in words."""

    number: int
    reason: str


def doubts(
    lacks: Lacks, error: TaskError, alternatives: Sequence[Alternative], site: Site, planned: Planned, choices: Choices
) -> list[Doubt]:
    """Return what is in doubt of the tool over the task, as candidate poses would show it."""
    whole, fitted = lacks.fitted.model, lacks.fitted
    free = np.flatnonzero(~fitted.fit.at_bound)
    asked = _material(lacks, error)
    model = replace(whole, observations=(planned.observation,))
    known = dict(zip((p.identity for p in whole.parameters), fitted.fit.estimate, strict=True))
    estimate = np.array([known.get(p.identity, p.nominal) for p in model.parameters])
    effects = [effect for lack in asked for effect in lack.form.effects]
    problem = planned.problem(model, estimate, choices.rows)
    _, slopes = probed(problem, estimate, effects)
    slopes = slopes.reshape(len(choices.readings), -1, slopes.shape[1])
    place = {p.identity: k for k, p in enumerate(model.parameters)}
    own = [place.get(whole.parameters[k].identity) for k in free]
    jacobian = np.stack(
        [slopes[:, :, k] if k is not None else np.zeros(slopes.shape[:2]) for k in own], axis=2
    )  # where another device stands is nothing that these poses show
    root = np.linalg.cholesky(lacks.covariance)
    found = [Doubt(PARAMETERS, jacobian @ root, site.slopes[:, :, free] @ root)]
    start = len(estimate)
    for lack, tool in zip(asked, site.left(lacks, [one.form for one in asked]), strict=True):
        columns = lack.form.columns
        turn = _directions(lacks, lack, tool) * np.sqrt(lacks.probability(lack.form.kind, lack.form.name))
        seen = slopes[:, :, start : start + len(columns)] + jacobian @ lacks.response(columns)
        found.append(Doubt(lack.form.name, seen @ turn, tool @ turn))
        start += len(columns)
    for k, one in enumerate(alternatives, start=1):
        rival, size = replace(one.model, given=whole.given), np.sqrt(one.probability)
        apart = rival.point(one.estimate, choices.rows) - whole.point(fitted.fit.estimate, choices.rows)
        there = rival.point(one.estimate, site.rows) - whole.point(fitted.fit.estimate, site.rows)
        if planned.observation.units == (METRE,) * 3:
            found.append(Doubt(f"rival {k}", size / planned.sigma * apart[:, :, None], size * there[:, :, None]))
    return found


def further_poses(
    every: Sequence[Doubt], asked: Sequence[Question], choices: Choices, measure: Measure, number: int
) -> list[Chosen]:
    """Choose so many candidates: some that tell rivals apart, where poses can, and with them those that make the tool surest."""
    telling = _telling(asked, choices, int(np.ceil(TELLING * number)))
    seen = np.concatenate([doubt.seen for doubt in every], axis=2)
    tool = np.concatenate([doubt.tool for doubt in every], axis=2)
    known = information(seen[[one.number for one in telling]], np.eye(seen.shape[2]))
    criterion = ToolError(tool, _shares(tool, known, measure))
    others = np.setdiff1d(np.arange(len(seen)), [one.number for one in telling])
    added = others[greedy(seen[others], known, min(number - len(telling), len(others)), criterion)]
    reasons = []
    for pose in added:
        after = information(seen[[pose]], known)
        reasons.append(_reason(every, criterion, known, after))
        known = after
    return [*telling, *(Chosen(int(pose), reason) for pose, reason in zip(added, reasons, strict=True))]


def _material(lacks: Lacks, error: TaskError) -> list[Lack]:
    """The likeliest form and size of what may be lacking and matters most to the tool."""
    left, squared = np.array(error.left), error.lacking**2
    share = {name: float(squared[left == name].sum() / (error.every**2).sum()) for name in set(error.left)}
    likeliest: dict[str, Lack] = {}
    for one in sorted(lacks.every, key=lambda one: one.log_weight):
        if one.form.effects:
            likeliest[one.form.name] = one
    names = sorted(
        (name for name in share if share[name] >= MATERIAL and name in likeliest), key=lambda n: (-share[n], n)
    )
    return [likeliest[name] for name in names[:MOST_LACKS]]


def _directions(lacks: Lacks, lack: Lack, tool: np.ndarray) -> np.ndarray:
    """The directions (n_columns, n) of a lack's amplitudes that move the tool most, each of standard deviation 1."""
    mean, covariance = lacks.amplitude(lack)
    second = np.outer(mean, mean) + covariance
    value, turned = np.linalg.eigh(second)
    root = turned * np.sqrt(np.maximum(value, 0.0))
    moved = tool.reshape(-1, tool.shape[2]) @ root
    return np.asarray(root @ np.linalg.svd(moved, full_matrices=False)[2][:DIRECTIONS].T)


def _telling(asked: Sequence[Question], choices: Choices, most: int) -> list[Chosen]:
    """The first poses of each question's plan in turn."""
    plans = [(one, one.plan) for one in asked if one.plan]
    found: dict[int, str] = {}
    for k in range(most):
        for one, plan in plans:
            if k < len(plan.poses.readings) and len(found) < most:
                same = (choices.readings == plan.poses.readings[k]).all(axis=1)
                rivals = ", ".join(label(rival.id, rival.joint) for rival in plan.rivals)
                found.setdefault(int(same.argmax()), f"tells {label(one.cause.id, one.cause.joint)} from {rivals}")
    return [Chosen(number, reason) for number, reason in found.items()]


def _shares(tool: np.ndarray, known: np.ndarray, measure: Measure) -> np.ndarray:
    """How much each point of the task counts: all alike, or the worst ones alone."""
    variance = ToolError(tool, np.full(len(tool), 1 / len(tool))).variances(np.linalg.inv(known))
    counts = variance >= np.quantile(variance, 1 - WORST) if measure == "worst" else variance >= 0
    return np.asarray(counts / counts.sum())


def _reason(every: Sequence[Doubt], criterion: ToolError, before: np.ndarray, after: np.ndarray) -> str:
    """Say what of the doubts a pose takes away most."""
    gone = np.linalg.inv(before) - np.linalg.inv(after)
    moved = (criterion.root @ criterion.root.T) * gone
    ends = np.cumsum([0, *(doubt.seen.shape[2] for doubt in every)])
    gains = [float(moved[i:j, i:j].sum()) for i, j in pairwise(ends)]
    best = every[int(np.argmax(gains))].name
    return SURER if best == PARAMETERS else f"suspected: {best}"
