"""Drift check: what has moved since a calibration, by how much and since when, from a few check poses.

Where a single pose carries the error, or all errors exceed what any robot moves by, no movement is reported. A few
further poses are proposed that separate what has moved from its rivals, or estimate it better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from calflow.deployment.attained import ELSEWHERE, Attained, Station, beside_motion, can_align, placed_anew, rigid_slope
from calflow.deployment.movements import (
    ANYWHERE,
    FALSE_ALARM,
    WITHIN,
    CheckProblem,
    Explained,
    Kind,
    Movement,
    SearchRound,
    by_sessions,
    movements,
)
from calflow.deployment.validation import OF_THE_SAME
from calflow.design.candidates import candidates
from calflow.design.optimality import ParameterCriterion
from calflow.design.search import greedy
from calflow.design.t_optimality import Discrimination
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.needed_conditions import AT_REST, check_payload_stated
from calflow.files.problems import InputError, refuse
from calflow.files.tables import StoredResults, column
from calflow.files.toml import FalseAlarm, Seed, checked_arguments
from calflow.files.words import first_up, rounded
from calflow.measurements.measurements import Measurements
from calflow.model import consecutive
from calflow.robot.mechanism import READINGS, reading_columns, shown_readings
from calflow.robot.robot import Robot

CANDIDATES = 300  # candidate poses
POSES_PROPOSED = 4
MOST_RIVALS = 3  # nearest rivals that the poses separate
ALL_ALIKE = 1e-2  # share of a movement below which, beside a fitted frame, nothing is left of it
MOST_LEFT = 0.5  # share of the mean error above which, beyond noise, what movements leave speaks against them
MOVEMENTS_SHARE = 0.8  # share of the false-alarm rate for movements; the rest is for error that no movement explains


def mistaken_poses(check: CheckProblem, rounds: Sequence[SearchRound], station: Station, alarm: float) -> str | None:
    """Return what to check before a movement is reported; None where movements may explain the error.

    A pose is suspect where the other poses, without any movement, leave a smaller whitened square than movements leave
    of all, by the margin that separates two movements, and the others agree with the calibration or are near it.
    Movements that leave most of the error would be a correction that does not make the calibration right again.
    """
    far = check.size().mean() > ELSEWHERE
    if not rounds and not far and check.remaining_error_p(()) >= alarm:
        return None
    moved = check.beside(rounds)
    for k in np.argsort(-check.size()):
        rest = _rest(check, k, station)
        if rest is None or not rest.square + 2 * WITHIN < moved.square:
            continue
        if rest.remaining_error_p(()) >= alarm or rest.size().mean() <= ELSEWHERE < check.size()[k]:
            return _alone(check, int(k))
    if not far:
        error, left = (1e3 * float(each.mean()) for each in (check.size(), _left(check, check.joint_sizes(rounds))))
        if not rounds or left < MOST_LEFT * error or check.remaining_error_p(rounds) >= alarm:
            return None
        named = " and of ".join(step.best.movement.meaning for step in rounds)
        return (
            f"a change of {named} would explain the check poses best, but leaves {rounded(left)} of {rounded(error)} mm, "
            f"more than chance allows: it is no correction. {first_up(OF_THE_SAME)} "
            "Did they carry what they state?"
        )
    return (
        f"the check poses are off by more than any calibrated robot, {rounded(1e3 * check.size().mean())} mm on average: "
        f"{OF_THE_SAME} What moved is stated to first order, which holds only for small movements"
    )


def _alone(check: CheckProblem, k: int) -> str:
    labels = check.attained.table.iloc[k]
    session = labels.get("session", "")
    named = f"pose {labels['pose']}, marker {labels['marker']}{f', session {session}' if session else ''}"
    return (
        f"{named} alone carries the error, off by {rounded(1e3 * check.size()[k])} mm: was it another pose, another marker, or "
        f"was the beam broken? Measure it again, or leave it out"
    )


def _rest(check: CheckProblem, k: int, station: Station) -> CheckProblem | None:
    """Return the check without a point; None where too few are left."""
    same = check.attained.frame == check.attained.frame[k]
    same[k] = False
    anew = placed_anew(station, check.calibrated.model.by_session)
    if not same.any() or (anew and not can_align(check.points[same])):
        return None
    return CheckProblem.of(check.calibrated, check.data.only(check.attained.group != k), station)


def settling(
    check: CheckProblem, best: Explained, rivals: list[Explained], fitted: bool, rng: np.random.Generator
) -> tuple[tuple[SettlingPose, ...], float | None]:
    """Choose a few poses that separate the best explanation from its rivals (T-optimality), or estimate it better.

    Return them with the probability that they exclude the rivals, None without rivals; or no poses.
    """
    calibrated, nothing = check.calibrated, ((), None)
    payload, marker = (str(check.data.table[name].iloc[0]) for name in ("payload", "marker"))
    bare = replace(calibrated, model=replace(calibrated.model, given=()), alternatives=())
    try:
        readings, conditions = candidates(bare.model, CANDIDATES, payload, marker, None, rng)
    except InputError:
        return nothing
    model = bare.model
    new = Measurements.from_arrays(model.robot, readings, None, payload=payload, marker=marker)
    there = {movement.name: movement for movement in movements(bare, new, not fitted)}
    sigma = float(np.sqrt(check.own.mean()))
    if not rivals or best.movement.name not in there:
        moved = there.get(best.movement.name)
        if moved is None:
            return nothing
        slope = moved.slope * moved.sd / sigma
        chosen = greedy(slope, np.diag((moved.sd / best.sd) ** 2), POSES_PROPOSED, ParameterCriterion(len(moved.sd)))
        return _to_measure(model.robot, readings[chosen], payload, marker), None
    possible = [rival for rival in rivals[:MOST_RIVALS] if rival.movement.name in there]
    if not possible:
        return nothing
    nuisance = _left_open(check, bare, conditions, sigma, fitted)
    explanations = _discrimination(check, nuisance, [best, *possible], there, sigma)
    chosen, after = explanations.propose([(0, k) for k in range(1, len(possible) + 1)], POSES_PROPOSED)
    chance = min(separation.chance for separation in after.values())
    return _to_measure(model.robot, readings[chosen], payload, marker), chance if np.isfinite(chance) else None


def _left_open(
    check: CheckProblem, bare: CalibratedModel, conditions: np.ndarray, sigma: float, fitted: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return whitened Jacobians of the check's coordinates (n, k) and of candidates (m, 3, k) by nuisance parameters.

    These are the calibration's uncertain errors, each of standard deviation 1, and a fitted device frame.
    """
    calibrated = replace(check.calibrated, alternatives=())
    together = check.means(calibrated.shared_errors(calibrated.conditions_of(check.data)))
    seen = together.reshape(len(check.error), -1) / np.sqrt(np.repeat(check.own, 3))[:, None]
    new = bare.shared_errors(conditions) / sigma
    if fitted:  # the further poses are measured in a frame of their own
        frame = rigid_slope(bare.model.point(calibrated.estimate, conditions)) * ANYWHERE / sigma
        seen = np.hstack([seen, np.zeros((len(seen), 6))])
        new = np.concatenate([new, frame], axis=2)
    return seen, new


def _discrimination(
    check: CheckProblem, nuisance: tuple[np.ndarray, np.ndarray], every: Sequence[Explained], there: Mapping[str, Movement],
    sigma: float,
) -> Discrimination:  # fmt: skip
    """Return the discrimination of movements, which the nuisance parameters of `_left_open` may imitate too."""
    whitening = np.sqrt(np.repeat(check.own, 3))[:, None]
    seen, new = [nuisance[0]], [nuisance[1]]
    for explained in every:
        sd = explained.movement.sd
        seen.append(check.columns(explained.movement, explained.since) * sd / whitening)
        new.append(there[explained.movement.name].slope * sd / sigma)
    common, *own = (np.r_[span] for span in consecutive(part.shape[1] for part in seen))
    effects = [explained.size / explained.movement.sd for explained in every]
    return Discrimination.between(
        np.hstack(seen), np.concatenate(new, axis=2), common, own, effects, [0.0] * len(every)
    )


Status = Literal["in place", "moved", "conditions", "cannot be told", "cannot be seen"]


@dataclass(frozen=True, kw_only=True)
class MovementRow:
    """A movement, found or possible."""

    movement: str = column("what moved, or may have")
    kind: Kind = column(
        "zero of a joint, station or foot, tool, a dimension, a cause of the model, or a condition, which is no drift"
    )
    meaning: str = column("what it is, in words")
    joint: int | None = column("its joint; empty: none")

    @staticmethod
    def named(movement: Movement) -> dict[str, Any]:
        """Return the columns that describe a movement."""
        return {name: getattr(movement, name) for name in ("kind", "meaning")} | {
            "movement": movement.name,
            "joint": movement.joint or None,
        }


@dataclass(frozen=True, kw_only=True)
class Moved(MovementRow):
    """A movement found since the calibration, given those found before it."""

    probability: float = column("posterior probability, among all movements tested")
    cannot_tell_from: tuple[str, ...] = column("movements that explain the check poses about as well")
    p: float = column("family-wise p-value over all movements, where nothing moved")
    since: str = column("session from which on it is there; empty: in all of them")
    before: str = column("the last session without it; empty: none, or the calibration")


@dataclass(frozen=True, kw_only=True)
class Recalibrated:
    """A parameter that the smallest recalibration changes: all others keep their calibrated values."""

    movement: str = column("what moved")
    symbol: str = column("which of its components")
    unit: str = column("of the figures in this row (SI)")
    shift: float = column("its estimated change: to be added to the calibrated value", "as `unit` says")
    sd: float = column("its standard deviation", "as `unit` says")
    parameter: str = column("the model's parameter that it changes; empty: none of its own")


@dataclass(frozen=True, kw_only=True)
class TestedMovement(MovementRow):
    """A candidate movement, tested alone against the hypothesis that nothing moved."""

    units: tuple[str, ...] = column("of its components (SI)")
    shifts: tuple[float, ...] = column("estimated change, if it alone moved", "as `units` says")
    sds: tuple[float, ...] = column("their standard deviations", "as `units` says")
    p: float = column("p-value where nothing moved, not corrected for the number of tests")
    probability: float = column("posterior probability, if anything moved")
    limits: tuple[float, ...] = column(
        "shift that these check poses would detect in 95 of 100 cases", "as `units` says"
    )


@dataclass(frozen=True, kw_only=True)
class CheckedPose:
    """A check pose: its distance from the calibrated robot's prediction, and what the movements found leave of it."""

    pose: str = column("as in the measurements")
    marker: str = column("as in the measurements")
    session: str = column("its session; empty: there is one")
    error_mm: float = column("distance from the calibrated robot's prediction", "mm")
    expected_mm: float = column("its standard deviation where nothing moved", "mm")
    left_mm: float = column("the distance that remains with the smallest recalibration", "mm")


@dataclass(frozen=True, kw_only=True)
class SettlingPose:
    """A pose to measure next, to separate what moved from its rivals."""

    readings: Mapping[str, float] = column("reading of each joint", "as named", name=READINGS)
    payload: str = column("the load; empty: none")
    marker: str = column("its name")


@dataclass(frozen=True, kw_only=True)
class DriftSummary:
    """The result of a drift check."""

    status: Status = column("the verdict")
    false_alarm: float = column("probability that a movement is reported where nothing moved")
    family_p: float = column("family-wise p-value over all movements, where nothing moved")
    unexplained_p: float = column("p-value of the error that the movements found leave")
    poses: int = column("check poses, markers and sessions counted apart")
    sessions: int = column("sessions in which they were measured")
    station: Literal["known", "fitted"] = column(
        "whether the device stood where the calibration's did, or its frame was fitted"
    )
    error_mm: float = column("mean error of the check poses", "mm")
    left_mm: float = column("the same with the smallest recalibration", "mm")
    expected_mm: float = column("root mean square error that was expected where nothing moved", "mm")
    unseen_mm: float = column(
        "root mean square displacement of the check poses by the joint zero that is detected worst, at its limit, "
        "found in 95 of 100 checks",
        "mm",
    )
    usual_mm: float = column("root mean square error of a robot of the kind that was never calibrated", "mm")
    chance: float | None = column("probability that the poses proposed exclude the rivals; null: there are none")
    notes: tuple[str, ...] = column("what was assumed", default=())


@dataclass(frozen=True)
class Drift(StoredResults):
    """The result of a drift check: movements found, best first, and all that were tested."""

    moved: tuple[Moved, ...]
    recalibration: tuple[Recalibrated, ...]
    candidates: tuple[TestedMovement, ...]
    poses: tuple[CheckedPose, ...]
    next_poses: tuple[SettlingPose, ...]
    summary: DriftSummary


def check_positions(data: Measurements) -> None:
    """Check that every row has a measured position, by which alone it is told what moved.

    Raises:
        InputError: some have none.
    """
    if not data.has_positions:
        raise refuse(
            "expected a measured position in every row: what moved is told by positions alone; calflow validate takes other rows",
            key="data",
        )


@checked_arguments
def drift(
    calibrated: CalibratedModel,
    data: Measurements,
    *,
    false_alarm: FalseAlarm = FALSE_ALARM,
    station: Station = "auto",
    seed: Seed = 1,
) -> Drift:
    """Test whether anything has moved since a robot was calibrated.

    Args:
        calibrated: the calibrated model; needed conditions that the rows lack widen the errors by their usual effect, and what
            device and robot usually wander by until the rows were measured is no movement.
        data: check poses, some five to ten, in one session or several.
        false_alarm: probability that a movement is reported where nothing moved.
        station: as in `validate`; where it is fitted, movements of the robot's base cannot be detected.
        seed: of the simulation of false alarms.

    Raises:
        InputError: a frame cannot be fitted, or rows lack a position or a payload on which the model depends.
    """
    if not len(data):
        raise refuse("expected rows, found none", key="data")
    check_positions(data)
    check_payload_stated(calibrated.model, calibrated.payloads, data.payload_stated)
    given = data.stating([*AT_REST, *calibrated.inputs]).given
    calibrated, data = replace(calibrated.later(given, data), field=None), by_sessions(data)
    check = CheckProblem.of(calibrated, data, station)
    attained = check.attained
    fitted = bool(attained.fitted.all())  # where some frames are known, they tell of the robot's foot
    every = movements(calibrated, data, not fitted)
    rng = np.random.default_rng(seed)
    steps = check.searched(every, MOVEMENTS_SHARE * false_alarm, rng)
    significant = [step for step in steps if step.family_p < MOVEMENTS_SHARE * false_alarm]
    doubt = mistaken_poses(check, significant, station, (1 - MOVEMENTS_SHARE) * false_alarm)
    significant = significant if doubt is None else []
    rest = check.remaining_error_p(significant)
    unseen, usual = _unseen(check, steps[0], fitted), _usual_error(check, fitted)
    status: Status = "cannot be told" if doubt else _status(significant, rest, (1 - MOVEMENTS_SHARE) * false_alarm)
    if status == "in place" and unseen > usual:
        status = "cannot be seen"
    best = check.joint_sizes(significant)
    left = _left(check, best)
    poses, chance = (
        settling(check, significant[0].best, rivals(significant[0]), fitted, rng) if significant else ((), None)
    )
    summary = DriftSummary(
        status=status, false_alarm=false_alarm, family_p=steps[0].family_p, unexplained_p=rest, poses=len(check.points),
        sessions=len(attained.sessions), station="fitted" if attained.fitted.any() else "known",
        error_mm=1e3 * float(check.size().mean()), left_mm=1e3 * float(left.mean()),
        expected_mm=1e3 * float(np.sqrt(np.trace(_still(check)) / len(check.points))),
        unseen_mm=1e3 * unseen, usual_mm=1e3 * usual, chance=chance,
        notes=(*data.notes, *_notes(calibrated, data, attained), *([doubt] if doubt else [])),
    )  # fmt: skip
    return Drift(
        tuple(_moved(step, check) for step in significant), tuple(row for movement in best for row in _recalibrated(movement)),
        _tested(steps[0]), _poses(check, left), poses, summary,
    )  # fmt: skip


def rivals(step: SearchRound) -> list[Explained]:
    """Return the movements not distinguished from a round's best, each once, the nearest first."""
    nearest: dict[str, Explained] = {}
    for explained in step.explained:
        if explained.movement.name != step.best.movement.name and step.best.evidence - explained.evidence < WITHIN:
            nearest.setdefault(explained.movement.name, explained)
    return list(nearest.values())


def _status(rounds: list[SearchRound], rest: float, alarm: float) -> Status:
    """Return the verdict: what conditions explain, or may explain, is not certain to be drift."""
    if not rounds:
        return "cannot be told" if rest < alarm else "in place"
    first = [rounds[0].best, *rivals(rounds[0])]
    are_known = [explained.movement.is_known for explained in first]
    if all(are_known) and all(step.best.movement.is_known for step in rounds):
        return "conditions"
    return "cannot be told" if any(are_known) and len(rounds) == 1 else "moved"


def _unseen(check: CheckProblem, step: SearchRound, fitted: bool) -> float:
    """Return the root mean square displacement of points [m] at the detection limit of the joint zero detected worst.

    Beside a fitted frame, the rigid part of the displacement is removed.
    """
    far = [0.0]
    for explained in step.explained:
        if explained.movement.kind == "zero" and explained.since == 0:
            whole = check.columns(explained.movement, 0)[:, 0].reshape(-1, 3)
            moves = beside_motion(whole, check.points) if fitted else whole
            if np.linalg.norm(moves) > ALL_ALIKE * np.linalg.norm(whole):
                far.append(float(explained.limit[0] * np.linalg.norm(moves) / np.sqrt(len(check.points))))
    return max(far)


def _usual_error(check: CheckProblem, fitted: bool) -> float:
    """Return the root mean square error of the points [m] of an uncalibrated robot of the kind, by the priors."""
    model, rows = check.calibrated.model, check.calibrated.conditions_of(check.data)
    joint = np.array([bool(parameter.joint) for parameter in model.parameters])
    moves = check.means(model.point_jacobian(check.calibrated.estimate, rows)) * (model.prior_sd * joint)
    return float(np.linalg.norm(beside_motion(moves, check.points) if fitted else moves) / np.sqrt(len(check.points)))


def _left(check: CheckProblem, best: tuple[Explained, ...]) -> np.ndarray:
    """Return the length of each point's error beside the movements found (n / 3,) [m], frames that are fitted being fitted anew."""
    moved = (check.columns(explained.movement, explained.since) @ explained.size for explained in best)
    error = (check.error - sum(moved)).reshape(-1, 3)
    for there, _ in check.attained.refitted:
        error[there] = beside_motion(error[there], check.points[there])
    return np.linalg.norm(error, axis=1)


def _still(check: CheckProblem) -> np.ndarray:
    """Return the covariance of the error where nothing moved; in fitted frames only the points' independent part."""
    apart = np.repeat(check.attained.fitted[check.attained.frame], 3)
    return np.where(apart | apart[:, None], np.diag(np.repeat(check.own, 3)), check.covariance)


def _moved(step: SearchRound, check: CheckProblem) -> Moved:
    best, since, names = step.best, step.best.since, check.attained.sessions
    return Moved(
        **MovementRow.named(best.movement), probability=step.names[best.movement.name], p=step.family_p,
        cannot_tell_from=tuple(rival.movement.name for rival in rivals(step)),
        since=names[since] if since else "", before=names[since - 1] if since else "",
    )  # fmt: skip


def _recalibrated(best: Explained) -> list[Recalibrated]:
    """Return one row per component of a movement of the robot or the station; none for conditions."""
    of = best.movement
    return [
        Recalibrated(movement=of.name, symbol=symbol, unit=unit, shift=float(shift), sd=float(sd), parameter=of.parameter)
        for symbol, unit, shift, sd in zip(of.symbols, of.units, best.size, best.sd, strict=True) if not of.is_known
    ]  # fmt: skip


def _tested(step: SearchRound) -> tuple[TestedMovement, ...]:
    """Return one row per movement, since the session that explains most."""
    tested: dict[str, TestedMovement] = {}
    for explained in step.explained:
        of = explained.movement
        shifts, sds, limits = (tuple(map(float, each)) for each in (explained.size, explained.sd, explained.limit))
        row = TestedMovement(
            **MovementRow.named(of), units=of.units, shifts=shifts, sds=sds, p=explained.p,
            probability=step.names[of.name], limits=limits,
        )  # fmt: skip
        tested.setdefault(of.name, row)
    return tuple(tested.values())


def _poses(check: CheckProblem, left: np.ndarray) -> tuple[CheckedPose, ...]:
    expected = np.sqrt(np.diag(_still(check)).reshape(-1, 3).sum(axis=1))
    rows = zip(check.attained.table.to_dict("records"), check.size(), expected, left, strict=True)
    return tuple(
        CheckedPose(pose=str(labels["pose"]), marker=str(labels["marker"]), session=str(labels.get("session", "")),
                    error_mm=1e3 * float(error), expected_mm=1e3 * float(sd), left_mm=1e3 * float(rest))
        for labels, error, sd, rest in rows
    )  # fmt: skip


def _to_measure(robot: Robot, readings: np.ndarray, payload: str, marker: str) -> tuple[SettlingPose, ...]:
    shown = np.round(shown_readings(robot, readings), 4)
    rows = [dict(zip(reading_columns(robot), map(float, row), strict=True)) for row in shown]
    return tuple(SettlingPose(readings=row, payload=payload, marker=marker) for row in rows)


def _notes(calibrated: CalibratedModel, data: Measurements, attained: Attained) -> list[str]:
    notes = [
        f"without {need.columns} nothing is known of {', '.join(need.effects)} here: "
        f"the test is less sharp by {rounded(need.spread_mm)} mm"
        for need in calibrated.needed
        if need.condition not in data.given
    ]
    if attained.fitted.any() and not attained.fitted.all():
        notes.append(
            f"the device's frame was fitted{attained.refitted_words}, where it stood elsewhere, and in no other"
        )
    elif attained.fitted.any():
        notes.append(
            "the device's frame was fitted to the check poses: nothing can be said of the robot's foot or the zero of an axis "
            "that turns all of it"
        )
    return notes
