"""Discrimination: poses that separate all causes between which the data cannot decide from each other (T-optimality)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calflow.design.candidates import candidates
from calflow.design.planned import Planned
from calflow.design.t_optimality import Discrimination, Pair, TCriterion
from calflow.diagnosis.diagnosis import Diagnosis
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Score
from calflow.diagnosis.trial import Detection
from calflow.diagnosis.verdict import Rival, Verdict, named
from calflow.effects import effect_class
from calflow.effects.base import NEEDS
from calflow.effects.cause import Cause
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.probing import probed
from calflow.estimation.progress import Draws
from calflow.files.deferred import pd
from calflow.files.problems import InputError
from calflow.files.tables import column, to_frame, typed
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import condition_columns
from calflow.observations import Observation
from calflow.robot.mechanism import READINGS, reading_columns, shown_readings

MOST_NEXT_POSES = 20
LEAST_EXTENT = 0.1  # m: least extent of the region in which poses are drawn
CANDIDATES = 600  # poses to choose from, for each payload
MOST_CANDIDATES = 2400  # for all payloads together
MOST_RIVALS = 6  # nearest rivals for which poses are sought, separating every pair
ANY_MEANS = "another sensor or another load is needed"
ENOUGH = 0.9  # probability of excluding a rival from which poses are worth measuring
# Errors after which no poses are proposed: only advice is lost.
SOUGHT_IN_VAIN = (InputError, ArithmeticError, np.linalg.LinAlgError, MemoryError)


@dataclass(frozen=True, kw_only=True)
class NextPose:
    """A pose that separates a finding from some of its rivals."""

    pose: int = column("its number")
    readings: Mapping[str, float] = column("reading of each joint", "as named", name=READINGS)
    approach: Mapping[str, int] = column("side each joint comes from: -1, +1", name="approach{joint}")
    payload: str = column("the load it is measured under; empty: none")
    tells: str = column("the finding: id and joint")
    rivals: tuple[str, ...] = column("the rivals it is separated from: id and joint", name="from", separator="; ")
    leaves_open: str = column("pairs that the poses do not separate, in words")
    separation_before_sd: float = column("least separation of these pairs before the poses", "standard deviations")
    separation_after_sd: float = column("the same after the poses", "standard deviations")
    chance_after: float = column("least probability that the wrong one of a pair is then excluded")
    cause: str = column("id of the finding")
    joint: int | None = column("its joint or link; empty: none")
    rival_causes: tuple[str, ...] = column("ids of the rivals it is separated from")
    rival_joints: tuple[int, ...] = column("their joints; 0: none")
    open_causes: tuple[str, ...] = column("ids of the first of each pair left open")
    open_joints: tuple[int, ...] = column("their joints; 0: none")
    open_other_causes: tuple[str, ...] = column("ids of the second of each pair")
    open_other_joints: tuple[int, ...] = column("their joints; 0: none")


@dataclass(frozen=True, kw_only=True)
class SeparationRow:
    """The separation of a finding from a rival, and what to measure or do to increase it."""

    cause: str = column("id of the finding")
    joint: int | None = column("its joint or link; empty: none")
    rival: str = column("id of the rival")
    rival_joint: int | None = column("its joint or link; empty: none")
    separation_before_sd: float = column("their separation", "standard deviations")
    separation_after_sd: float = column("the same after further poses", "standard deviations")
    chance_after: float = column(
        "probability that the wrong one is then excluded (each pose weighted by the share of poses that is fitted)"
    )
    words: str = column("what to measure, or what else to do at the robot, in words")
    proposed: bool = column("whether the poses of next_poses.csv separate them", default=False)
    tested: bool = column("whether the data could test the rival", default=True)
    unasked: str = column("why no further poses could be sought; empty: they were", default="")
    means: str = column("what to do at the robot where no pose separates them", default="")


@dataclass(frozen=True)
class Plan:
    """Poses that separate a finding from some rivals and, as far as possible, these from each other.

    before, after: least separation [sd] of the pairs that they separate; chance: least probability of excluding the
    wrong one of a pair; left_open: pairs that they do not separate.
    """

    poses: Measurements
    rivals: tuple[Rival, ...]
    before: float
    after: float
    chance: float
    left_open: tuple[tuple[Cause | Rival, Rival], ...]


@dataclass(frozen=True)
class Question:
    """A finding's separations from its rivals, and the poses that would separate it from some of them, if any."""

    cause: Cause
    separations: tuple[SeparationRow, ...]
    plan: Plan | None = None


def questions(
    diagnosis: Diagnosis, data: Measurements, rng: Draws, among: Measurements | None = None
) -> list[Question]:
    """Return how to separate each finding from its rivals by poses, among these or drawn in the measured region."""
    final, planned = diagnosis.extended, planned_like(diagnosis.extended, data)
    return [question(verdict, final, planned, rng(f"poses{k}"), among) for k, verdict in enumerate(diagnosis.verdicts)]


def question(
    verdict: Verdict, fitted: Fitted, planned: Planned, rng: np.random.Generator, among: Measurements | None = None
) -> Question:
    """Return how to separate a finding from each rival by poses, measured as planned, among these or drawn in the region.

    If none can be sought, the separations state why: that is no reason to abort a diagnosis.
    """
    cause = verdict.cause
    untested, tested = ([rival for rival in verdict.others if bool(rival.score) is known] for known in (False, True))
    asked, rest = tested[:MOST_RIVALS], tested[MOST_RIVALS:]
    few = f"poses are sought for the {MOST_RIVALS} nearest rivals only"
    rows = [_separation(cause, rival, means=_means_untested(rival, fitted.data)) for rival in untested]
    rows += [_separation(cause, rival, means=_means(cause, rival), unasked=few) for rival in rest]
    if not asked:
        return Question(cause, tuple(rows))
    try:
        choices = among or _choices(fitted, planned.observation, rng)
        apart, plan = _asked(verdict, asked, [*untested, *rest], fitted, planned, choices)
    except SOUGHT_IN_VAIN as error:
        wider, reason = "", f"{type(error).__name__}: {error}"
        if isinstance(error, InputError):
            wider, reason = "measure in a wider region, or ", error.problems[0].message
        apart = [_separation(cause, rival, means=wider + _means(cause, rival), unasked=reason) for rival in asked]
        plan = None
    return Question(cause, (*apart, *rows), plan)


def _means(cause: Cause, rival: Rival) -> str:
    """Return what to do at the robot where no pose separates a cause and a rival."""
    other = effect_class(rival.id)  # None for an unnamed structure
    every = (cause.effect.told_by, other.told_by if other else "")
    return ". Or ".join(dict.fromkeys(filter(None, every))) or ANY_MEANS


def _means_untested(rival: Rival, data: Measurements) -> str:
    """Return what to do at the robot about a rival that the data cannot test, by what they lack, in plain words."""
    kind = effect_class(rival.id)
    if kind is None:
        return ANY_MEANS
    asks = " and ".join(NEEDS[need].plain for need in kind.asks(data.robot, data))
    lacking = asks or kind.lacking(data.robot, data)
    return f"to tell them apart, note {lacking}" if lacking else kind.told_by or ANY_MEANS


def _separation(
    cause: Cause, rival: Rival, before: float = 0.0, after: float = 0.0, chance: float = 0.0, *,
    proposed: bool = False, means: str = "", unasked: str = "",
) -> SeparationRow:  # fmt: skip
    """Return the row of a cause and a rival, separated by so many standard deviations before and after further poses."""
    apart = f"they separate by {after:.1f} sd instead of {before:.1f}"
    either = f"{named(cause).name} from {named(rival).name}"
    if proposed:
        words = f"measure the {MOST_NEXT_POSES} poses of next_poses.csv: {apart}"
    elif not means:
        words = f"measure {MOST_NEXT_POSES} further poses, once the other rivals are excluded: {apart}"
    elif unasked:
        words = f"no further poses could be sought in the measured region ({unasked}): {means}"
    elif rival.cause is None:
        words = f"no pose distinguishes {either} in these data: {means}"
    else:
        words = f"even {MOST_NEXT_POSES} further poses, with any known payload, separate {either} by {after:.1f} sd only: {means}"
    return SeparationRow(
        cause=cause.id, joint=cause.joint or None, rival=rival.id, rival_joint=rival.joint or None,
        separation_before_sd=before, separation_after_sd=after, chance_after=chance, words=words,
        proposed=proposed, tested=rival.cause is not None, unasked=unasked, means=means,
    )  # fmt: skip


def _asked(
    finding: Detection[Cause],
    rivals: Sequence[Rival],
    others: Sequence[Rival],
    fitted: Fitted,
    planned: Planned,
    choices: Measurements,
) -> tuple[list[SeparationRow], Plan | None]:
    """Return how far poses separate a finding from rivals, and those that do; others: rivals for which none are sought."""
    scores = [replace(finding.own, cost=0.0), *(replace(r.score, cost=r.cost) for r in rivals if r.score)]
    explanations = discrimination(fitted, scores, choices, planned)
    before = {pair: explanations.closest(pair) for pair in combinations(range(len(scores)), 2)}
    alone = _each_alone(explanations, [pair for pair in before if pair[0] == 0])
    possible = {k for (_, k), criterion in alone.items() if criterion.chance >= ENOUGH}
    # Poses tell two rivals apart only after both are told from the finding.
    alone |= _each_alone(explanations, [pair for pair in before if possible.issuperset(pair)])
    chosen, together = _together(explanations, alone)
    after = alone | together
    rows = []
    for k, rival in enumerate(rivals, start=1):
        then = after[0, k]
        rows.append(
            _separation(finding.cause, rival, before[0, k].separation, then.separation, then.chance,
                        proposed=(0, k) in together, means="" if then.chance >= ENOUGH else _means(finding.cause, rival))
        )  # fmt: skip
    if not together:
        return rows, None
    causes: list[Cause | Rival] = [finding.cause, *rivals]
    open_ = [(causes[i], rivals[k - 1]) for i, k in before if (i, k) not in together]
    open_ += [(finding.cause, rival) for rival in others]
    return rows, Plan(
        replace(choices, table=choices.table.iloc[chosen]), tuple(rivals[k - 1] for i, k in together if i == 0),
        min(before[pair].separation for pair in together), min(criterion.separation for criterion in together.values()),
        min(criterion.chance for criterion in together.values()), tuple(open_),
    )  # fmt: skip


def discrimination(fitted: Fitted, scores: Sequence[Score], choices: Measurements, planned: Planned) -> Discrimination:
    """Return the discrimination of the explanations of a finding by further poses, measured as planned.

    scores are of causes in its place, with costs relative to the finding's, whose own cause, in the model, comes first.
    """
    model, fit = fitted.model, fitted.fit
    # The cost of parameters and variants, up to a constant of the finding.
    costs = [float(score.cost - fit.residual.size * np.log1p(-score.share)) for score in scores]
    both = replace(model, effects=(*model.effects, *(score.cause for score in scores[1:])))
    own = [both.columns(score.cause) for score in scores]
    common = np.setdiff1d(np.arange(len(both.parameters)), np.concatenate([*own, np.flatnonzero(fit.at_bound)]))
    point = np.concatenate([fit.estimate, both.nominal[len(fit.estimate) :]])
    sd = both.prior_sd
    seen = probed(LeastSquares.of(both, fitted.data, fitted.noise), point, ())[1] * sd
    new = planned.whitened(both, point, choices.conditions) * sd
    effects = [score.estimate / sd[columns] for score, columns in zip(scores, own, strict=True)]
    return Discrimination.between(seen, new, common, own, effects, costs)


def _each_alone(explanations: Discrimination, pairs: Sequence[Pair]) -> dict[Pair, TCriterion]:
    """Return each pair's criterion after poses that are chosen for it alone."""
    return {pair: explanations.propose([pair], MOST_NEXT_POSES)[1][pair] for pair in pairs}


def _together(
    explanations: Discrimination, alone: Mapping[Pair, TCriterion]
) -> tuple[list[int], dict[Pair, TCriterion]]:
    """Choose poses that serve as many pairs as possible, the finding's (0) first, given criteria by poses for one alone."""
    left = [pair for pair, criterion in alone.items() if criterion.chance >= ENOUGH]
    while any(i == 0 for i, _ in left):
        chosen, after = explanations.propose(left, MOST_NEXT_POSES)
        hard = [pair for pair in left if after[pair].chance < ENOUGH]
        if not hard:
            return chosen, after
        left.remove(min(hard, key=lambda pair: (pair[0] == 0, after[pair].lead)))
    return [], {}


def poses_table(questions: Sequence[Question], fitted: Fitted) -> pd.DataFrame:
    """Return diagnose/next_poses.csv: the poses that separate each finding from its rivals, as far as possible."""
    robot = fitted.model.robot
    names = reading_columns(robot)
    sides = [f"approach{i + 1}" for i in robot.driven] if "approach" in fitted.model.given else []
    rows: list[NextPose] = []
    for plan, cause in ((question.plan, question.cause) for question in questions if question.plan):
        first, second = [one for one, _ in plan.left_open], [other for _, other in plan.left_open]
        readings, table = np.round(shown_readings(robot, plan.poses.joints), 4), plan.poses.table
        for k, payload in enumerate(table["payload"]):
            rows.append(
                NextPose(
                    pose=len(rows) + 1, readings=dict(zip(names, readings[k], strict=True)),
                    approach={side: int(table[side].iloc[k]) for side in sides}, payload=payload,
                    tells=named(cause).label, rivals=tuple(named(rival).label for rival in plan.rivals),
                    leaves_open="; ".join(f"{named(one).label} or {named(other).label}" for one, other in plan.left_open),
                    separation_before_sd=plan.before, separation_after_sd=plan.after, chance_after=plan.chance,
                    cause=cause.id, joint=cause.joint or None, rival_causes=tuple(rival.id for rival in plan.rivals),
                    rival_joints=tuple(rival.joint for rival in plan.rivals),
                    open_causes=tuple(one.id for one in first), open_joints=tuple(one.joint for one in first),
                    open_other_causes=tuple(other.id for other in second),
                    open_other_joints=tuple(other.joint for other in second),
                )
            )  # fmt: skip
    table = to_frame(rows, NextPose)
    return table if rows else typed(table.assign(**dict.fromkeys(names, ())), NextPose)


def separations_table(questions: Sequence[Question]) -> pd.DataFrame:
    """Return diagnose/separations.csv: the separation of each finding from each rival, and what to do."""
    return to_frame([row for asked in questions for row in asked.separations], SeparationRow)


def planned_like(fitted: Fitted, data: Measurements) -> Planned:
    """Return how further poses are measured: like those of data, by an external device if any series is; as many are held out."""
    observed, share = fitted.model.observations, float(data.train.sum() / (data.train | data.held_out).sum())
    k = next((k for k, observation in enumerate(observed) if observation.from_outside), 0)
    return Planned.like(observed[k], fitted.noise, k, share)


def _choices(fitted: Fitted, observation: Observation, rng: np.random.Generator) -> Measurements:
    """Draw poses in the measured region, under every payload, with each joint's approach from either side; or raise InputError."""
    data, model = fitted.data, fitted.model
    points = model.point(fitted.fit.estimate, data.conditions)
    region = np.array([points.min(axis=0), points.max(axis=0)])
    thin = np.maximum(0.0, LEAST_EXTENT - np.ptp(region, axis=0)) / 2
    region += np.array([-thin, thin])
    tables = []
    possible = list(dict.fromkeys([*data.table["payload"], *data.robot.payloads]))
    number = min(CANDIDATES, max(1, MOST_CANDIDATES // len(possible)))
    for payload in possible:
        drawn, _ = candidates(model, number, payload, str(data.table["marker"].iloc[0]), region, rng, observation)
        tables.append(rows_like(data, drawn, (str(payload),) * len(drawn), rng).table)
    return replace(data, table=pd.concat(tables, ignore_index=True))


def rows_like(
    data: Measurements, readings: np.ndarray, payloads: Sequence[str], rng: np.random.Generator
) -> Measurements:
    """Return rows of readings (n, n_joints), under payloads, approached from either side, with other conditions of the data."""
    robot, came = data.robot, rng.choice([-1.0, 1.0], readings.shape)
    drawn = data.table.iloc[rng.integers(len(data), size=len(readings))].reset_index(drop=True)
    drawn[condition_columns("reading", robot)] = readings
    drawn["payload"] = list(payloads)
    drawn["marker"] = data.table["marker"].iloc[0]
    if "approach" in data.given:
        drawn[condition_columns("approach", robot)] = came
    for name in ("order", "time"):
        if name in data.given:
            drawn[name] = data.table[name].max()
    return replace(data, table=drawn)
