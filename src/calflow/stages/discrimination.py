"""Discrimination: which further poses would separate causes that the data cannot tell apart, and how well.

T-optimality (Atkinson and Fedorov 1975): a rival is fitted as well as it can be to what the first cause does; what it
cannot imitate, in standard deviations of the noise, is the separation. Poses are added where it grows most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.measurements import Measurements, condition_columns
from calflow.model import Model
from calflow.stages.candidates import candidates
from calflow.stages.causes import Cause
from calflow.stages.fitted import Fitted
from calflow.stages.verdict import Rival, Verdict

POSES = 20
CANDIDATES = 600  # poses to choose from, for each payload
TELLS = ["tells", "from", "separation_before_sd", "separation_after_sd"]
ELSE = {  # what tells a cause from one that the data could not test
    "joint-hysteresis": "log each joint's travel since its last reversal (columns travel1_deg …)",
    "joint-backlash": "vary the travel since the last reversal, from tenths of a degree to many degrees",
}
ENOUGH = 4.0  # standard deviations of separation at which a rival is as good as excluded


@dataclass(frozen=True)
class Proposal:
    """Poses to measure: readings (n, n_joints), approach (n, n_joints), payload names; separation before and after them [sd]."""

    readings: np.ndarray
    approach: np.ndarray
    payloads: tuple[str, ...]
    before: float
    after: float


@dataclass(frozen=True)
class Separation:
    """How to tell a cause from one rival: poses that do, or in words what would."""

    cause: Cause
    rival: Rival
    proposal: Proposal | None

    @property
    def words(self) -> str:
        """Say what to measure."""
        if self.rival.cause is None:
            return (
                f"no pose tells {self.cause.id} from {self.rival.id} in these data: "
                f"{ELSE.get(self.rival.id, 'another sensor or another direction of load is needed')}"
            )
        assert self.proposal
        now, then = self.proposal.before, self.proposal.after
        if then < ENOUGH:
            return (
                f"no pose under these loads tells {self.cause.id} from {self.rival.id} ({then:.1f} sd after {POSES} poses): "
                "another payload, a load from another direction, or a sensor at the joint is needed"
            )
        number = len(self.proposal.readings)
        return f"measure the {number} poses of next_poses.csv: they separate by {then:.1f} sd instead of {now:.1f}"


def separation(verdict: Verdict, fitted: Fitted, rng: np.random.Generator) -> list[Separation]:
    """Return how to tell a finding from each of its rivals."""
    cause, sigma = verdict.finding.cause, float(np.sqrt(np.mean(fitted.noise.total[0] ** 2)))
    return [
        Separation(cause, rival, propose(fitted, cause, rival.cause, sigma, rng) if rival.cause else None)
        for rival in verdict.rivals
    ]


def poses_table(separations: Sequence[Sequence[Separation]], fitted: Fitted) -> pd.DataFrame:
    """Return diagnose/next_poses.csv: the poses that separate each finding from its nearest rival that poses can exclude."""
    robot = fitted.model.robot
    readings = [f"q{i + 1}_{'deg' if joint.kind == 'revolute' else 'mm'}" for i, joint in enumerate(robot.joints)]
    units = np.array([np.rad2deg(1.0) if joint.kind == "revolute" else 1e3 for joint in robot.joints])
    blocks = []
    for several in separations:
        useful = [one for one in several if one.proposal and one.proposal.after >= ENOUGH]
        if not useful:
            continue
        one = min(useful, key=lambda one: one.rival.bic)
        assert one.proposal
        block = pd.DataFrame(np.round(one.proposal.readings * units, 4), columns=readings)
        if "approach" in fitted.model.given:
            block[[f"approach{i + 1}" for i in range(robot.n_joints)]] = one.proposal.approach.astype(int)
        block["payload"] = one.proposal.payloads
        block["tells"], block["from"] = one.cause.id, one.rival.id
        block["separation_before_sd"], block["separation_after_sd"] = one.proposal.before, one.proposal.after
        blocks.append(block)
    if not blocks:
        return pd.DataFrame(columns=["pose", *readings, "payload", *TELLS])
    table = pd.concat(blocks, ignore_index=True)
    table.insert(0, "pose", np.arange(1, len(table) + 1))
    return table


def separations_table(separations: Sequence[Sequence[Separation]]) -> pd.DataFrame:
    """Return diagnose/separations.csv: for each finding and rival how far apart they are, and what to do."""
    rows = [
        (one.cause.id, one.cause.joint or None, one.rival.id, one.rival.joint or None,
         one.proposal.before if one.proposal else 0.0, one.proposal.after if one.proposal else 0.0, one.words)
        for several in separations for one in several
    ]  # fmt: skip
    columns = ["cause", "joint", "rival", "rival_joint", "separation_before_sd", "separation_after_sd", "words"]
    return pd.DataFrame(rows, columns=columns).astype({"joint": "Int64", "rival_joint": "Int64"})


def propose(fitted: Fitted, cause: Cause, rival: Cause, sigma: float, rng: np.random.Generator) -> Proposal:
    """Choose poses and payloads that separate a cause in the fitted model from a rival that is not in it."""
    model, robot = fitted.model, fitted.model.robot
    both = Model(robot, (*model.effects, rival), model.given)
    point = np.concatenate([fitted.fit.estimate, np.zeros(len(rival.declared))])
    own = fitted.columns(cause)
    others = np.setdiff1d(np.arange(len(point)), own)
    sd = both.prior_sd[others]
    free = np.concatenate([~fitted.fit.at_bound, np.full(len(rival.declared), True)])[others]

    def split(rows: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        jacobian = both.position_jacobian(point, rows) / noise[:, None, None]
        return jacobian[:, :, own] @ fitted.fit.estimate[own], (jacobian[:, :, others] * sd * free)

    effect, imitate = split(fitted.data.rows, fitted.noise.total[0])
    readings, approach, payloads, rows = _choices(fitted, rng)
    new_effect, new_imitate = split(rows, np.full(rows.shape[1], sigma))
    information = np.eye(len(others)) + np.einsum("rai,raj->ij", imitate, imitate)
    moment = np.einsum("rai,ra->i", imitate, effect)
    energy = float((effect**2).sum())
    before = energy - moment @ np.linalg.solve(information, moment)
    chosen: list[int] = []
    for _ in range(min(POSES, len(readings))):
        covariance = np.linalg.inv(information)
        unexplained = new_effect - new_imitate @ (covariance @ moment)
        spread = np.eye(3) + np.einsum("rai,ij,rbj->rab", new_imitate, covariance, new_imitate, optimize=True)
        grown = np.einsum("ra,ra->r", unexplained, np.linalg.solve(spread, unexplained[..., None])[..., 0])
        grown[chosen] = -1.0
        best = int(np.argmax(grown))
        chosen.append(best)
        information += new_imitate[best].T @ new_imitate[best]
        moment = moment + new_imitate[best].T @ new_effect[best]
        energy += float((new_effect[best] ** 2).sum())
    after = energy - moment @ np.linalg.solve(information, moment)
    return Proposal(readings[chosen], approach[chosen], tuple(payloads[k] for k in chosen),
                    float(np.sqrt(max(before, 0.0))), float(np.sqrt(max(after, 0.0))))  # fmt: skip


def _choices(fitted: Fitted, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, list[str], np.ndarray]:
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
    return np.vstack(readings), np.vstack(approach), payloads, np.hstack(packed)


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
