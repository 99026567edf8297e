"""Commands: joint readings that land on targets, each with what is promised of it.

Clearance: how far commands stay from the joints' limits, and from poses at which the tool cannot be moved in some direction.
Landing beside a target by what a residual field will add: the field has no part in the model's graph.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pandas as pd

from calflow.deployment.compensation import Landing, landing
from calflow.deployment.nominal_inverse import best_of, near, nominal_readings, room
from calflow.deployment.orientation import not_known, turn_sd
from calflow.deployment.prediction import Missing, Told, as_told, of_field
from calflow.deployment.targets import Targets
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.certainty import expected_point, field_correction, position_variance
from calflow.estimation.needed_conditions import NeededCondition
from calflow.measurements.columns import numbered
from calflow.measurements.measurements import Measurements
from calflow.measurements.sequence import approach_and_travel
from calflow.model import Model, over_rows
from calflow.robot.transforms import turning


@dataclass(frozen=True)
class Clearance:
    """How far poses are from what a robot cannot do.

    joint (n,) is the joint (from 0) nearest to a limit, by share of its travel, and limit (n,) [rad, or m] how far it is from it;
    singular (n,) [rad, a slide's metre counted as a radian] is how far all joints together are from the nearest singularity.
    """

    joint: np.ndarray
    limit: np.ndarray
    singular: np.ndarray


def clearance(model: Model, rows: np.ndarray, oriented: bool) -> Clearance:
    """Return the clearance of packed rows (n_conditions, n) by the nominal robot.

    The distance to a singularity is that to first order: the least singular value of the tool's Jacobian over its steepest
    slope. It is right near a singularity, and elsewhere says that there is none near. Where no orientation is asked for,
    only the Jacobian of the tool's point counts.
    """
    robot = model.robot
    q = rows[: robot.n_joints].T @ robot.reading_matrix.T
    share = room(robot, q)
    joint = share.argmin(axis=1)
    low, high = robot.stops.T
    limit = np.take_along_axis(np.minimum(q - low, high - q), joint[:, None], axis=1)[:, 0]
    return Clearance(joint, limit, _to_singularity(Model(robot, (), model.given), rows, oriented))


def _to_singularity(rigid: Model, rows: np.ndarray, oriented: bool) -> np.ndarray:
    p, c, predicted = rigid.symbols
    readings = c[: rigid.robot.n_joints]
    moved = np.where(np.isin(np.arange(rigid.robot.n_joints), rigid.robot.external), 0.0, 1.0)
    mixed = ca.sparsify(ca.DM(rigid.robot.angle_matrix * moved))
    slope = ca.jacobian(predicted.point, readings) @ mixed
    if oriented:
        slope = ca.vertcat(slope, turning(predicted.rotation, readings) @ mixed)
    u, v = ca.SX.sym("u", slope.shape[0]), ca.SX.sym("v", slope.shape[1])
    steepest = ca.gradient(ca.dot(u, slope @ v), readings).T @ mixed
    jacobian = ca.Function("jacobian", [p, c], [ca.densify(slope.T)])
    change = ca.Function("change", [p, c, ca.vertcat(u, v)], [ca.densify(steepest.T)])
    none = np.zeros(0)
    found = over_rows(jacobian, none, rows)[0].T.reshape(rows.shape[1], *slope.shape)
    left, sizes, right = np.linalg.svd(found, full_matrices=False)
    directions = np.hstack([left[:, :, -1], right[:, -1]])
    slopes = np.linalg.norm(over_rows(change, none, rows, directions.T)[0], axis=0)
    return np.asarray(np.divide(sizes[:, -1], slopes, out=np.full(len(slopes), np.inf), where=slopes > 0))


ELSEWHERE_TRIED = 12  # starts of a target that is not reached from its own
ROUNDS = 4  # each leaves of the field what it changes by over its own correction: a thousandth or so


def field_landing(
    known: CalibratedModel, rows: np.ndarray, targets: Targets, start: np.ndarray, begun: np.ndarray | None = None
) -> Landing:
    """Return the readings nearest to a start that land on targets, by the model and its residual field (see `landing`)."""
    found = landing(known.model, known.estimate, rows, targets, start, begun)
    if known.field is None:
        return found
    for _ in range(ROUNDS):
        aims = replace(targets, position=targets.position - known.field.correction(found.readings))
        found = landing(known.model, known.estimate, rows, aims, start, found.readings)
    return found


def landing_from_elsewhere(
    known: CalibratedModel, rows: np.ndarray, targets: Targets, rng: np.random.Generator
) -> tuple[Landing, np.ndarray]:
    """Return the best landing of each target from starts anywhere within the limits, and the nominal robot's readings beside it."""
    rigid = Model(known.model.robot, (), known.model.given)
    starts = near(rigid, rows, targets, rng)[:, :ELSEWHERE_TRIED]
    every = np.repeat(np.arange(len(targets)), starts.shape[1])
    landed = field_landing(known, rows[:, every], targets.only(every), starts.reshape(len(every), -1))
    found = landed.only(best_of(known.model.robot, landed, starts.shape[1]))
    return found, landing(rigid, np.zeros(0), rows, targets, found.readings).readings


SAME_TRAVEL = 1e-4  # rad or m
SETTLES = 5  # rounds in which the ways between commands and the commands must agree
NEAR_SINGULAR = np.deg2rad(1.0)
MOST_NAMED = 10  # targets that a note names


@dataclass(frozen=True)
class Compensation:
    """Joint readings (n, n_joints) [rad, or m] that land on targets, as the calibrated model has it.

    remaining (n,) [m] and turned (n,) [rad] is how far from its target each lands by the model, reached (n,) whether that is
    on it. sd (n, 3) [m] is how surely it is known where, in the measuring frame, and turn_sd (n, 3) [rad] how it is turned,
    about the tool's own axes; None where no orientation was asked for. nominal (n, n_joints) are the readings that the nominal
    robot would be sent to, which miss by nominal_miss (n,) [m] and nominal_turned (n,) [rad]. A target that is not reached has
    the readings that come nearest. data are the rows at the readings; notes say what is out of reach, and what is not known.
    not_physical (n, 3) [m] is what of the positions is a residual field's, which no cause explains; None without such a field.
    """

    readings: np.ndarray
    remaining: np.ndarray
    turned: np.ndarray
    reached: np.ndarray
    sd: np.ndarray
    turn_sd: np.ndarray | None
    nominal: np.ndarray
    nominal_miss: np.ndarray
    nominal_turned: np.ndarray
    clearance: Clearance
    data: Measurements
    notes: tuple[str, ...] = ()
    not_physical: np.ndarray | None = None

    @property
    def expected(self) -> np.ndarray:
        """The root mean square distance from the target that is to be expected (n,) [m]: what remains, and what is not known."""
        return np.sqrt(self.remaining**2 + (self.sd**2).sum(axis=1))


def compensated(
    known: CalibratedModel, needed: Sequence[NeededCondition], data: Measurements, targets: Targets, *,
    start: np.ndarray | None = None, in_order: bool = False, missing: Missing = "refuse", seed: int = 1,
) -> Compensation:  # fmt: skip
    """Return joint readings with which the robot lands on targets, nearest to those that the nominal robot would be sent to.

    Args:
        known: the calibrated model.
        needed: the conditions that it needs.
        data: a row a target: payload, marker and conditions; its readings do not count.
        targets: where to land.
        start: readings of the nominal robot (n, n_joints) [rad, or m]; any that are within the limits where it is None.
        in_order: the commands follow each other, so that the side from which each joint comes, and how far, follow from them.
        missing: as in `predict_positions`.
        seed: of the poses from which nominal readings are looked for.

    Raises:
        InputError: a condition is missing that an effect needs.
    """
    ways = in_order and "approach" not in data.given
    if ways:
        data = _on_the_way(data, data.joints if start is None else start)
    told = as_told(known, needed, data, missing)
    ways = ways and bool({"approach", "travel"} & set(told.data.given))
    rng, free = np.random.default_rng(seed), start is None
    if start is None:
        start = nominal_readings(told.known.model, told.data.rows, targets, rng)
    told = _led(told, start, ways)
    found = field_landing(told.known, told.data.rows, targets, start)
    elsewhere = np.zeros(len(data), dtype=bool)
    if not found.reached.all():
        left = np.flatnonzero(~found.reached)
        other, nominal = landing_from_elsewhere(told.known, told.data.rows[:, left], targets.only(left), rng)
        got = left[other.reached]
        if free:
            found, start = found.with_rows(got, other.only(other.reached)), start.copy()
            start[got] = nominal[other.reached]
        elsewhere[got] = not free
    settled = np.ones(len(data), dtype=bool)
    for _ in range(SETTLES if ways else 0):
        before, told = told, _led(told, found.readings, ways)
        settled = _same_way(before.data, told.data)
        if settled.all():
            break
        rows, aims = told.data.rows[:, ~settled], targets.only(~settled)
        again = field_landing(told.known, rows, aims, start[~settled], found.readings[~settled])
        found = found.with_rows(~settled, again)
    return _judged(told, targets, start, found, ways, settled, elsewhere)


def with_readings(data: Measurements, readings: np.ndarray) -> Measurements:
    """Return rows at other joint readings (n, n_joints) [rad, or m]."""
    names = numbered("q", data.robot.n_joints)
    return replace(data, table=data.table.assign(**dict(zip(names, readings.T, strict=True))))


def _led(told: Told, readings: np.ndarray, ways: bool) -> Told:
    """The rows at readings, with the ways that lead there if these follow from the order."""
    data = with_readings(told.data, readings)
    return replace(told, data=_on_the_way(data, readings).stating(told.data.given) if ways else data)


def _on_the_way(data: Measurements, readings: np.ndarray) -> Measurements:
    """The rows with the sides from which the joints come, and how far, where they follow each other at these readings."""
    n = data.robot.n_joints
    names = numbered("q", n)
    came, far = approach_and_travel(pd.DataFrame(readings, columns=names).assign(order=np.arange(len(readings))), names)
    columns = dict(zip([*numbered("approach", n), *numbered("travel", n)], np.hstack([came, far]).T, strict=True))
    return replace(data, table=data.table.assign(**columns))


def _same_way(one: Measurements, other: Measurements) -> np.ndarray:
    """Whether each row's joints come from the same side in both, and as far where that counts (n,)."""
    n, same = one.robot.n_joints, np.ones(len(one), dtype=bool)
    for names, within in ((numbered("approach", n), 0.0), (numbered("travel", n), SAME_TRAVEL)):
        if names[0] in one.table:
            same &= (np.abs(one.table[names].to_numpy() - other.table[names].to_numpy()) <= within).all(axis=1)
    return same


def _judged(
    told: Told,
    targets: Targets,
    start: np.ndarray,
    found: Landing,
    ways: bool,
    settled: np.ndarray,
    elsewhere: np.ndarray,
) -> Compensation:
    """What is promised of the readings found, and what those begun with would have done."""
    known, model = told.known, told.known.model
    oriented = targets.rotation is not None

    def misses(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rotation = model.rotation(known.estimate, rows) if oriented else None
        lacking = targets.lacking(expected_point(known, rows), rotation)
        return np.linalg.norm(lacking[:, :3], axis=1), np.linalg.norm(lacking[:, 3:], axis=1)

    data = _led(told, found.readings, ways).data
    remaining, turned = misses(data.rows)
    nominal_miss, nominal_turned = misses(_led(told, start, ways).data.rows)
    clear = clearance(model, data.rows, oriented)
    names, lost = data.table["pose"].astype(str).to_numpy(), ~found.reached
    notes = [
        *_of_rows(f"not reached within the joint limits, from {ELSEWHERE_TRIED} other starts neither", lost & ~elsewhere, names),
        *_of_rows(
            "not reached from the readings given, but from others, with the arm in another posture: give readings near such a "
            "one, or none", lost & elsewhere, names,
        ),
        *_of_rows(
            f"nearer than {np.rad2deg(NEAR_SINGULAR):.0f} deg to a singularity, where small corrections turn joints far",
            found.reached & (clear.singular < NEAR_SINGULAR), names,
        ),
        *_of_rows("a joint moves there by so little that its side of approach hangs on the correction itself", ~settled, names),
        *told.notes,
        *of_field(known, data.rows),
        *(not_known(known, data.rows) if oriented else ()),
    ]  # fmt: skip
    return Compensation(
        found.readings, remaining, turned, found.reached,
        np.sqrt(position_variance(known, data.rows) + told.widened),
        turn_sd(known, data.rows) if oriented else None,
        start, nominal_miss, nominal_turned, clear, data, tuple(notes),
        field_correction(known, data.rows) if known.field else None,
    )  # fmt: skip


def _of_rows(what: str, which: np.ndarray, names: np.ndarray) -> list[str]:
    """Say what is so of some targets, by name; nothing where it is so of none."""
    if not which.any():
        return []
    more = f" and {which.sum() - MOST_NAMED} more" if which.sum() > MOST_NAMED else ""
    return [f"{which.sum()} of {len(which)} targets: {what}: pose {', '.join(names[which][:MOST_NAMED])}{more}"]
