"""Discrimination: which further poses would separate causes that the data cannot tell apart, and how well.

T-optimality (Atkinson and Fedorov 1975): a rival is fitted as well as it can be to what the first cause does; what it
cannot imitate, in standard deviations of the noise, is the separation. Poses are added where it grows most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calflow.measurements import Measurements, condition_columns
from calflow.model import Model
from calflow.stages.candidates import candidates
from calflow.stages.causes import Cause
from calflow.stages.fitted import Fitted
from calflow.stages.verdict import Rival, Verdict, label

POSES = 20
CANDIDATES = 600  # poses to choose from, for each payload
TELLS = ["tells", "from", "separation_before_sd", "separation_after_sd"]
ELSE = {  # what tells a cause from one that the data could not test
    "joint-hysteresis": "log each joint's travel since its last reversal (columns travel1_deg …)",
    "joint-backlash": "vary the travel since the last reversal, from tenths of a degree to many degrees",
}
ENOUGH = 4.7  # standard deviations of separation at which a rival is excluded (its BIC 10 worse) nine times in ten


@dataclass(frozen=True)
class Choices:
    """Poses to choose from: readings and approach (n, n_joints), payload names, and the packed rows (n_conditions, n)."""

    readings: np.ndarray
    approach: np.ndarray
    payloads: tuple[str, ...]
    rows: np.ndarray

    def only(self, which: Sequence[int]) -> Choices:
        """Return some of the poses."""
        chosen = list(which)
        payloads = tuple(self.payloads[k] for k in chosen)
        return Choices(self.readings[chosen], self.approach[chosen], payloads, self.rows[:, chosen])


@dataclass(frozen=True)
class Contest:
    """A cause's effect, and how well a rival and all other parameters can imitate it: in the data, and at each further pose.

    information (n, n), moment (n,) and energy are of the least squares problem in standard deviations of noise and priors;
    new_effect (n_poses, 3) and new_imitate (n_poses, 3, n) what a further pose would add to it.
    """

    information: np.ndarray
    moment: np.ndarray
    energy: float
    new_effect: np.ndarray
    new_imitate: np.ndarray

    @staticmethod
    def of(fitted: Fitted, cause: Cause, rival: Cause, choices: Choices, sigma: float) -> Contest:
        """Set a cause in the fitted model against a rival that is not in it; sigma [m] is a further measurement's."""
        model = fitted.model
        both = Model(model.robot, (*model.effects, rival), model.given)
        point = np.concatenate([fitted.fit.estimate, np.zeros(len(rival.declared))])
        own = fitted.columns(cause)
        others = np.setdiff1d(np.arange(len(point)), own)
        sd = both.prior_sd[others]
        free = np.concatenate([~fitted.fit.at_bound, np.full(len(rival.declared), True)])[others]

        def split(rows: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            jacobian = both.position_jacobian(point, rows) / noise[:, None, None]
            return jacobian[:, :, own] @ fitted.fit.estimate[own], (jacobian[:, :, others] * sd * free)

        effect, imitate = split(fitted.data.rows, fitted.noise.total[0])
        new_effect, new_imitate = split(choices.rows, np.full(choices.rows.shape[1], sigma))
        information = np.eye(len(others)) + np.einsum("rai,raj->ij", imitate, imitate)
        moment = np.einsum("rai,ra->i", imitate, effect)
        return Contest(information, moment, float((effect**2).sum()), new_effect, new_imitate)

    @property
    def separation(self) -> float:
        """What the rival cannot imitate [sd]."""
        left = self.energy - float(self.moment @ np.linalg.solve(self.information, self.moment))
        return float(np.sqrt(max(left, 0.0)))

    @property
    def growth(self) -> np.ndarray:
        """By how much each further pose would raise the separation's square, shape (n_poses,)."""
        covariance = np.linalg.inv(self.information)
        unexplained = self.new_effect - self.new_imitate @ (covariance @ self.moment)
        spread = np.eye(3) + np.einsum("rai,ij,rbj->rab", self.new_imitate, covariance, self.new_imitate, optimize=True)
        return np.einsum("ra,ra->r", unexplained, np.linalg.solve(spread, unexplained[..., None])[..., 0])

    def measured(self, pose: int) -> Contest:
        """Return the contest after one more pose."""
        effect, imitate = self.new_effect[pose], self.new_imitate[pose]
        return replace(self, information=self.information + imitate.T @ imitate, moment=self.moment + imitate.T @ effect,
                       energy=self.energy + float((effect**2).sum()))  # fmt: skip


def propose(contests: Sequence[Contest], number: int) -> tuple[list[int], list[Contest]]:
    """Choose poses, each for the rival that is then the nearest, and return the contests after them."""
    now, chosen = list(contests), list[int]()
    for _ in range(min(number, len(now[0].new_effect))):
        growth = min(now, key=lambda contest: contest.separation).growth
        growth[chosen] = -1.0
        chosen.append(int(np.argmax(growth)))
        now = [contest.measured(chosen[-1]) for contest in now]
    return chosen, now


@dataclass(frozen=True)
class Separation:
    """How far a cause is apart from one rival [sd]: before, and after further poses, which are either proposed or its own."""

    rival: Rival
    before: float
    after: float
    proposed: bool

    def words(self, cause: Cause) -> str:
        """Say what to measure."""
        apart = f"they separate by {self.after:.1f} sd instead of {self.before:.1f}"
        if self.proposed:
            return f"measure the {POSES} poses of next_poses.csv: {apart}"
        if self.rival.cause is None:
            return (
                f"no pose tells {cause.id} from {self.rival.id} in these data: "
                f"{ELSE.get(self.rival.id, 'another sensor or another direction of load is needed')}"
            )
        if self.after < ENOUGH:
            return (
                f"no pose under these loads tells {cause.id} from {self.rival.id} ({self.after:.1f} sd after {POSES} poses): "
                "another payload, a load from another direction, or a sensor at the joint is needed"
            )
        return f"measure {POSES} further poses, once the other rivals are excluded: {apart}"


@dataclass(frozen=True)
class Question:
    """A finding's rivals, and the poses that would tell it from those of them that poses can exclude together."""

    cause: Cause
    separations: tuple[Separation, ...]
    poses: Choices | None


def question(verdict: Verdict, fitted: Fitted, rng: np.random.Generator) -> Question:
    """Return how to tell a finding from each of its rivals."""
    cause, sigma = verdict.finding.cause, float(np.sqrt(np.mean(fitted.noise.total[0] ** 2)))
    if not any(rival.cause for rival in verdict.rivals):
        return Question(cause, tuple(Separation(rival, 0.0, 0.0, False) for rival in verdict.rivals), None)
    choices = _choices(fitted, rng)
    contests = {
        k: Contest.of(fitted, cause, rival.cause, choices, sigma)
        for k, rival in enumerate(verdict.rivals) if rival.cause
    }  # fmt: skip
    after = {k: propose([contest], POSES)[1][0].separation for k, contest in contests.items()}
    open_ = [k for k in contests if after[k] >= ENOUGH]
    chosen = list[int]()
    while open_:
        chosen, ends = propose([contests[k] for k in open_], POSES)
        together = dict(zip(open_, (contest.separation for contest in ends), strict=True))
        if min(together.values()) >= ENOUGH:
            after |= together
            break
        open_.remove(min(together, key=lambda k: together[k]))
    separations = tuple(
        Separation(rival, contests[k].separation, after[k], k in open_)
        if k in contests
        else Separation(rival, 0.0, 0.0, False)
        for k, rival in enumerate(verdict.rivals)
    )
    return Question(cause, separations, choices.only(chosen) if open_ else None)


def poses_table(questions: Sequence[Question], fitted: Fitted) -> pd.DataFrame:
    """Return diagnose/next_poses.csv: the poses that tell each finding from its rivals, as far as poses can."""
    robot = fitted.model.robot
    readings = [f"q{i + 1}_{'deg' if joint.kind == 'revolute' else 'mm'}" for i, joint in enumerate(robot.joints)]
    units = np.array([np.rad2deg(1.0) if joint.kind == "revolute" else 1e3 for joint in robot.joints])
    blocks = []
    for one in questions:
        if one.poses is None:
            continue
        asked = [separation for separation in one.separations if separation.proposed]
        block = pd.DataFrame(np.round(one.poses.readings * units, 4), columns=readings)
        if "approach" in fitted.model.given:
            block[[f"approach{i + 1}" for i in range(robot.n_joints)]] = one.poses.approach.astype(int)
        block["payload"] = one.poses.payloads
        block["tells"] = label(one.cause.id, one.cause.joint)
        block["from"] = "; ".join(label(other.rival.id, other.rival.joint) for other in asked)
        block["separation_before_sd"] = min(other.before for other in asked)
        block["separation_after_sd"] = min(other.after for other in asked)
        blocks.append(block)
    if not blocks:
        return pd.DataFrame(columns=["pose", *readings, "payload", *TELLS])
    table = pd.concat(blocks, ignore_index=True)
    table.insert(0, "pose", np.arange(1, len(table) + 1))
    return table


def separations_table(questions: Sequence[Question]) -> pd.DataFrame:
    """Return diagnose/separations.csv: for each finding and rival how far apart they are, and what to do."""
    rows = [
        (asked.cause.id, asked.cause.joint or None, one.rival.id, one.rival.joint or None, one.before, one.after,
         one.words(asked.cause))
        for asked in questions for one in asked.separations
    ]  # fmt: skip
    columns = ["cause", "joint", "rival", "rival_joint", "separation_before_sd", "separation_after_sd", "words"]
    return pd.DataFrame(rows, columns=columns).astype({"joint": "Int64", "rival_joint": "Int64"})


def _choices(fitted: Fitted, rng: np.random.Generator) -> Choices:
    """Draw poses in the measured region, under every payload there was, each joint coming from either side."""
    data, model = fitted.data, fitted.model
    region = np.array([data.position.min(axis=0), data.position.max(axis=0)])
    readings, approach, payloads, packed = [], [], [], []
    for payload in dict.fromkeys(data.table["payload"]):
        drawn, _ = candidates(model, CANDIDATES, payload, str(data.table["marker"].iloc[0]), region, rng)
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
    return Measurements(robot, drawn)
