"""Discrimination: which further poses would separate causes that the data cannot tell apart, and how well.

Any of a finding's rivals may be the truth: poses are to tell all of them from each other, as far as poses can.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pandas as pd

from calflow.design.candidates import candidates
from calflow.design.planned import Planned
from calflow.design.t_optimality import Choices, Explanation, Pair, TCriterion, closest, propose
from calflow.diagnosis.findings.verdict import Rival, Verdict, label
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.files.problems import InputError
from calflow.measurements.columns import condition_columns
from calflow.measurements.measurements import Measurements
from calflow.observations import Observation

POSES = 20
THINNEST = 0.1  # m: a measured region is widened to it, since poses are drawn at random
CANDIDATES = 600  # poses to choose from, for each payload
APART = ["separation_before_sd", "separation_after_sd", "chance_after"]
ANY_MEANS = "another sensor or another load is needed"
ENOUGH = 0.9  # chance of excluding a rival at which poses are worth measuring


@dataclass(frozen=True)
class Separation:
    """How far a cause is apart from one rival [sd]: before, and after further poses, which are either proposed or its own.

    chance is that of excluding the rival then, or the cause if the rival is true; lacking is what a rival that could not be
    tested needs, unasked why no further poses could be looked for.
    """

    rival: Rival
    before: float = 0.0
    after: float = 0.0
    chance: float = 0.0
    proposed: bool = False
    lacking: str = ""
    unasked: str = ""

    def words(self, cause: Cause) -> str:
        """Say what to measure."""
        apart = f"they separate by {self.after:.1f} sd instead of {self.before:.1f}"
        if self.proposed:
            return f"measure the {POSES} poses of next_poses.csv: {apart}"
        rival = catalogue()[self.rival.id]
        if self.unasked:
            means = ", or ".join(dict.fromkeys(filter(None, (cause.effect.told_by, rival.told_by)))) or ANY_MEANS
            where = f"no further poses could be looked for where it was measured ({self.unasked})"
            return f"{where}: measure in a wider region, or {means}"
        if self.rival.cause is None:
            means = f"it takes {self.lacking}" if self.lacking else rival.told_by or ANY_MEANS
            return f"no pose tells {cause.id} from {rival.id} in these data: {means}"
        if self.chance < ENOUGH:
            said = dict.fromkeys(filter(None, (cause.effect.told_by, rival.told_by)))
            return (
                f"no {POSES} poses with any payload known tell {cause.id} from {rival.id} ({self.after:.1f} sd after them): "
                f"{', or '.join(said) or ANY_MEANS}"
            )
        return f"measure {POSES} further poses, once the other rivals are excluded: {apart}"


@dataclass(frozen=True)
class Plan:
    """Poses that tell a finding from some rivals and, as far as they can, those from each other.

    before and after are the least separations [sd] among what they tell apart, chance the least of excluding one of two;
    left_open names the pairs that they do not tell apart.
    """

    poses: Choices
    rivals: tuple[Rival, ...]
    before: float
    after: float
    chance: float
    left_open: tuple[str, ...]


@dataclass(frozen=True)
class Question:
    """A finding's rivals, and the poses to measure if any tell it from some of them."""

    cause: Cause
    separations: tuple[Separation, ...]
    plan: Plan | None = None


def question(verdict: Verdict, fitted: Fitted, share: float, rng: np.random.Generator) -> Question:
    """Return how to tell a finding from each of its rivals; share is how many of the further poses will be fitted."""
    finding = verdict.finding
    data = fitted.data
    untested = tuple(
        Separation(rival, lacking=catalogue()[rival.id].lacking(data.robot, data))
        for rival in verdict.rivals
        if not rival.score
    )
    rivals = [rival for rival in verdict.rivals if rival.score]
    if not rivals:
        return Question(finding.cause, untested)
    explanations = [Explanation(finding.own, 0.0), *(Explanation(r.score, r.bic) for r in rivals if r.score)]
    planned = _planned(fitted, share)
    try:
        choices = _choices(fitted, planned.observation, rng)
    except InputError as error:
        unasked = tuple(Separation(rival, unasked=error.problems[0].message) for rival in rivals)
        return Question(finding.cause, unasked + untested)
    criteria = TCriterion.between(fitted, explanations, choices, planned)
    before = {pair: closest(criteria, pair) for pair in combinations(range(len(explanations)), 2)}
    alone = {pair: propose(criteria, [pair], POSES)[1][pair] for pair in before}
    chosen, together = _together(criteria, alone)
    after = alone | together
    separations = tuple(
        Separation(rival, before[0, k].separation, after[0, k].separation, after[0, k].chance, (0, k) in together)
        for k, rival in enumerate(rivals, start=1)
    )
    if not together:
        return Question(finding.cause, separations + untested)
    names = [label(finding.cause.id, finding.cause.joint), *(label(rival.id, rival.joint) for rival in rivals)]
    open_ = [f"{names[i]} or {names[k]}" for i, k in after if (i, k) not in together]
    open_ += [f"{names[0]} or {label(one.rival.id, one.rival.joint)}" for one in untested]
    plan = Plan(
        choices.only(chosen), tuple(rivals[k - 1] for i, k in together if i == 0),
        min(before[pair].separation for pair in together), min(criterion.separation for criterion in together.values()),
        min(criterion.chance for criterion in together.values()), tuple(open_),
    )  # fmt: skip
    return Question(finding.cause, separations + untested, plan)


def _together(
    criteria: Mapping[Pair, TCriterion], alone: Mapping[Pair, TCriterion]
) -> tuple[list[int], dict[Pair, TCriterion]]:
    """Choose poses for as many pairs as they can serve together, those of the finding (number 0) above all.

    alone are the criteria after poses for one pair.
    """
    possible = [pair for pair, criterion in alone.items() if criterion.chance >= ENOUGH]
    left = [(i, k) for i, k in possible if i == 0 or {(0, i), (0, k)} <= set(possible)]
    while any(i == 0 for i, _ in left):
        chosen, after = propose(criteria, left, POSES)
        hard = [pair for pair in left if after[pair].chance < ENOUGH]
        if not hard:
            return chosen, after
        left.remove(min(hard, key=lambda pair: (pair[0] == 0, after[pair].lead)))
    return [], {}


def poses_table(questions: Sequence[Question], fitted: Fitted) -> pd.DataFrame:
    """Return diagnose/next_poses.csv: the poses that tell each finding from its rivals, as far as poses can."""
    robot = fitted.model.robot
    readings = [f"q{i + 1}_{joint.shown[0]}" for i, joint in enumerate(robot.joints)]
    units = np.array([joint.shown[1] for joint in robot.joints])
    blocks = []
    for one in questions:
        if one.plan is None:
            continue
        plan = one.plan
        block = pd.DataFrame(np.round(plan.poses.readings * units, 4), columns=readings)
        if "approach" in fitted.model.given:
            block[[f"approach{i + 1}" for i in range(robot.n_joints)]] = plan.poses.approach.astype(int)
        block["payload"] = plan.poses.payloads
        block["tells"] = label(one.cause.id, one.cause.joint)
        block["from"] = "; ".join(label(rival.id, rival.joint) for rival in plan.rivals)
        block["leaves_open"] = "; ".join(plan.left_open)
        block[APART] = plan.before, plan.after, plan.chance
        blocks.append(block)
    if not blocks:
        return pd.DataFrame(columns=["pose", *readings, "payload", "tells", "from", "leaves_open", *APART])
    table = pd.concat(blocks, ignore_index=True)
    table.insert(0, "pose", np.arange(1, len(table) + 1))
    return table


def separations_table(questions: Sequence[Question]) -> pd.DataFrame:
    """Return diagnose/separations.csv: for each finding and rival how far apart they are, and what to do."""
    rows = [
        (asked.cause.id, asked.cause.joint or None, one.rival.id, one.rival.joint or None, one.before, one.after,
         one.chance, one.words(asked.cause))
        for asked in questions for one in asked.separations
    ]  # fmt: skip
    columns = ["cause", "joint", "rival", "rival_joint", *APART, "words"]
    return pd.DataFrame(rows, columns=columns).astype({"joint": "Int64", "rival_joint": "Int64"})


def _planned(fitted: Fitted, share: float) -> Planned:
    """Further poses are measured as those there are: from outside, if any series is."""
    observed = fitted.model.observations
    k = next((k for k, one in enumerate(observed) if one.from_outside), 0)
    return Planned.like(observed[k], fitted.noise, k, share)


def _choices(fitted: Fitted, observation: Observation, rng: np.random.Generator) -> Choices:
    """Draw poses in the measured region, under every payload there was or may be, each joint coming from either side.

    Raises:
        InputError: hardly any pose is there.
    """
    data, model = fitted.data, fitted.model
    points = model.point(fitted.fit.estimate, data.rows)
    region = np.array([points.min(axis=0), points.max(axis=0)])
    thin = np.maximum(0.0, THINNEST - np.ptp(region, axis=0)) / 2
    region += np.array([-thin, thin])
    readings, approach, payloads, packed = [], [], [], []
    for payload in dict.fromkeys([*data.table["payload"], *data.robot.payloads]):
        drawn, _ = candidates(model, CANDIDATES, payload, str(data.table["marker"].iloc[0]), region, rng, observation)
        came = rng.choice([-1.0, 1.0], drawn.shape)
        table = _rows_like(data, drawn, came, str(payload), rng)
        readings.append(drawn)
        approach.append(came)
        payloads += [str(payload)] * len(drawn)
        packed.append(table.rows)
    return Choices(np.vstack(readings), np.vstack(approach), tuple(payloads), np.hstack(packed))


def _rows_like(
    data: Measurements, readings: np.ndarray, came: np.ndarray, payload: str, rng: np.random.Generator
) -> Measurements:
    """Rows of these readings whose other conditions are drawn from those of the data, after the last of them in time."""
    robot = data.robot
    drawn = data.table.iloc[rng.integers(len(data), size=len(readings))].reset_index(drop=True)
    drawn[condition_columns("reading", robot)] = readings
    drawn["payload"] = payload
    drawn["marker"] = data.table["marker"].iloc[0]
    if "approach" in data.given:
        drawn[condition_columns("approach", robot)] = came
    for name in ("order", "time"):
        if name in data.given:
            drawn[name] = data.table[name].max()
    return replace(data, table=drawn)
