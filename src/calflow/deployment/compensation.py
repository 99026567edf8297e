"""Compensation: joint readings with which the calibrated robot lands on targets, each with what is promised of it.

What is promised: where the tool will be and how it will be turned, how surely, and how far the readings stay from the joints'
limits and from singular poses. What a residual field adds is landed beside, as it has no part in the model's graph.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from calflow.deployment.inverse_kinematics import Landing, Targets, best_of, landing, near, nominal_readings, room
from calflow.deployment.prediction import Missing, StatedModel, as_stated, of_field, rows_at
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.certainty import (
    expected_point,
    field_correction,
    position_variance,
    rotation_variance,
    untold_turns,
)
from calflow.files.problems import refuse
from calflow.files.tables import column, typed
from calflow.measurements.columns import numbered
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import approach_and_travel
from calflow.model import Model, over_rows
from calflow.observations.pose import Pose
from calflow.robot.conditions import READINGS, reading_columns, shown_readings
from calflow.robot.transforms import turning

MOST = 0.5  # share of the variance of a turn that no measurement told of, from which it is said
ROWS = 100  # of which that is worked out


def turn_sd(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the standard deviations of the tool's turn about its own axes (n_rows, 3) [rad]."""
    return np.sqrt(rotation_variance(calibrated, conditions))


def not_known(calibrated: CalibratedModel, conditions: np.ndarray) -> list[str]:
    """Say what nobody measured of the orientation in rows (n_conditions, n_rows)."""
    if any(isinstance(observation, Pose) for observation in calibrated.model.observations):
        return []
    few = conditions[:, np.unique(np.linspace(0, conditions.shape[1] - 1, ROWS).astype(int))]
    typical = np.sqrt((turn_sd(calibrated, few) ** 2).mean(axis=0))
    robot = calibrated.model.robot
    turned = "turned by tool_rotation_deg of the robot file" if robot.tool_rotation else "as it is"
    said = [
        f"no orientation was measured, positions only: what meets the targets' orientation is the frame of link {robot.n_joints}, "
        f"{turned}; how the tool sits on it is not checked"
    ]
    untold = untold_turns(calibrated, few)
    said += [
        f"the tool's turn about its own {axis} is known to {1e3 * typical[k]:.2g} mrad only, which is an assumption about "
        "robots like this: no measurement told of it (orientations would)"
        for k, axis in enumerate("xyz") if untold[k] > MOST
    ]  # fmt: skip
    return said


@dataclass(frozen=True)
class Clearance:
    """How far poses are from what a robot cannot do.

    joint (n,) is the joint (from 0) nearest to a limit, by share of its travel, and limit (n,) [rad, or m] how far it is from it;
    singular (n,) [rad, a slide's metre counted as a radian] is how far all joints together are from the nearest singularity.
    """

    joint: np.ndarray
    limit: np.ndarray
    singular: np.ndarray


def clearance(model: Model, conditions: np.ndarray, oriented: bool) -> Clearance:
    """Return the clearance of packed rows (n_conditions, n) by the nominal robot.

    The distance to a singularity is that to first order: the least singular value of the tool's Jacobian over its steepest
    slope. It is right near a singularity, and elsewhere says that there is none near. Where no orientation is asked for,
    only the Jacobian of the tool's point counts.
    """
    robot = model.robot
    q = conditions[: robot.n_joints].T @ robot.reading_matrix.T
    share = room(robot, q)
    joint = share.argmin(axis=1)
    low, high = robot.stops.T
    limit = np.take_along_axis(np.minimum(q - low, high - q), joint[:, None], axis=1)[:, 0]
    return Clearance(joint, limit, _to_singularity(Model(robot, (), model.given), conditions, oriented))


def _to_singularity(rigid: Model, conditions: np.ndarray, oriented: bool) -> np.ndarray:
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
    found = over_rows(jacobian, none, conditions)[0].T.reshape(conditions.shape[1], *slope.shape)
    left, sizes, right = np.linalg.svd(found, full_matrices=False)
    directions = np.hstack([left[:, :, -1], right[:, -1]])
    slopes = np.linalg.norm(over_rows(change, none, conditions, directions.T)[0], axis=0)
    return np.asarray(np.divide(sizes[:, -1], slopes, out=np.full(len(slopes), np.inf), where=slopes > 0))


ELSEWHERE_TRIED = 12  # starts of a target that is not reached from its own
ROUNDS = 4  # each leaves of the field what it changes by over its own correction: a thousandth or so


def field_landing(
    calibrated: CalibratedModel,
    conditions: np.ndarray,
    targets: Targets,
    start: np.ndarray,
    begun: np.ndarray | None = None,
) -> Landing:
    """Return the readings nearest to a start that land on targets, by the model and its residual field (see `landing`)."""
    found = landing(calibrated.model, calibrated.estimate, conditions, targets, start, begun)
    if calibrated.field is None:
        return found
    for _ in range(ROUNDS):
        aims = replace(targets, position=targets.position - calibrated.field.correction(found.readings))
        found = landing(calibrated.model, calibrated.estimate, conditions, aims, start, found.readings)
    return found


def landing_from_elsewhere(
    calibrated: CalibratedModel, conditions: np.ndarray, targets: Targets, rng: np.random.Generator
) -> tuple[Landing, np.ndarray]:
    """Return the best landing of each target from starts anywhere within the limits, and the nominal robot's readings beside it."""
    rigid = Model(calibrated.model.robot, (), calibrated.model.given)
    starts = near(rigid, conditions, targets, rng)[:, :ELSEWHERE_TRIED]
    every = np.repeat(np.arange(len(targets)), starts.shape[1])
    landed = field_landing(calibrated, conditions[:, every], targets.only(every), starts.reshape(len(every), -1))
    found = landed.only(best_of(calibrated.model.robot, landed, starts.shape[1]))
    return found, landing(rigid, np.zeros(0), conditions, targets, found.readings).readings


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


def compensate(
    calibrated: CalibratedModel, targets: ArrayLike, *, start: ArrayLike | None = None,
    payload: str | Sequence[str] | None = None, marker: str | Sequence[str] | None = None, in_order: bool = False,
    missing: Missing = "refuse", seed: int = 1, **conditions: ArrayLike,
) -> Compensation:  # fmt: skip
    """Return joint readings with which the marker lands on the targets (see `compensate_rows`).

    They are those nearest to start: give the readings that the nominal robot would be sent to. Without start any nominal
    solution within the joint limits is taken as such. Where the targets are positions, the tool keeps its orientation as
    nearly as the start has it; without a start it is left open.

    Args:
        calibrated: the calibrated model.
        targets: positions (n, 3), or (3,), or poses (n, 4, 4), or (4, 4), in the measuring frame [m]. A pose is where the
            marker is, and how the frame of the last link is turned, with the robot's tool_rotation where it has one.
        start: readings (n, n_joints), or (n_joints,) for all [rad, or m]; of a robot with external axes theirs must be there,
            and the arm's may be nan.
        payload: what is carried, for all or one a target.
        marker: which marker, likewise.
        in_order: the robot goes from target to target, so that the side from which each joint comes follows from the commands.
        missing: as in `predict`.
        seed: of the poses from which nominal solutions are looked for.
        conditions: as in `predict`; approach is the side that each joint will come from.

    Raises:
        InputError: a condition is missing that an effect needs, or an array is at fault.
    """
    asked, robot = Targets.of(targets), calibrated.model.robot
    n = robot.n_joints
    given = np.full(n, np.nan) if start is None else np.asarray(start, dtype=float)
    if given.shape not in ((n,), (len(asked), n)):
        raise refuse(f"expected shape ({n},) or ({len(asked)}, {n}), found {given.shape}", key="start")
    begun = np.broadcast_to(given, (len(asked), n))
    if np.isnan(begun[:, robot.external]).any():
        named = ", ".join(str(i + 1) for i in robot.external)
        raise refuse(f"expected readings of the external axes (joints {named}): they stay where they are", key="start")
    data = rows_at(calibrated, np.nan_to_num(begun), payload, marker, conditions)
    whole = None if np.isnan(begun).any() else begun
    return compensate_rows(calibrated, data, asked, start=whole, in_order=in_order, missing=missing, seed=seed)


def compensate_rows(
    calibrated: CalibratedModel, data: Measurements, targets: Targets, *, start: np.ndarray | None = None,
    in_order: bool = False, missing: Missing = "refuse", seed: int = 1,
) -> Compensation:  # fmt: skip
    """Return joint readings with which the robot lands on targets, nearest to those that the nominal robot would be sent to.

    Args:
        calibrated: the calibrated model.
        data: a row a target: payload, marker and conditions; its readings do not count.
        targets: where to land.
        start: readings of the nominal robot (n, n_joints) [rad, or m]; any that are within the limits where it is None.
        in_order: the commands follow each other, so that the side from which each joint comes, and how far, follow from them.
        missing: as in `predict_rows`.
        seed: of the poses from which nominal readings are looked for.

    Raises:
        InputError: a condition is missing that an effect needs.
    """
    ways = in_order and "approach" not in data.given
    if ways:
        data = _on_the_way(data, data.joints if start is None else start)
    stated = as_stated(calibrated, data, missing)
    ways = ways and bool({"approach", "travel"} & set(stated.data.given))
    rng, free = np.random.default_rng(seed), start is None
    if start is None:
        start = nominal_readings(stated.calibrated.model, stated.data.conditions, targets, rng)
    stated = _led(stated, start, ways)
    found = field_landing(stated.calibrated, stated.data.conditions, targets, start)
    elsewhere = np.zeros(len(data), dtype=bool)
    if not found.reached.all():
        left = np.flatnonzero(~found.reached)
        other, nominal = landing_from_elsewhere(
            stated.calibrated, stated.data.conditions[:, left], targets.only(left), rng
        )
        got = left[other.reached]
        if free:
            found, start = found.with_rows(got, other.only(other.reached)), start.copy()
            start[got] = nominal[other.reached]
        elsewhere[got] = not free
    settled = np.ones(len(data), dtype=bool)
    for _ in range(SETTLES if ways else 0):
        before, stated = stated, _led(stated, found.readings, ways)
        settled = _same_way(before.data, stated.data)
        if settled.all():
            break
        conditions, aims = stated.data.conditions[:, ~settled], targets.only(~settled)
        again = field_landing(stated.calibrated, conditions, aims, start[~settled], found.readings[~settled])
        found = found.with_rows(~settled, again)
    return _judged(stated, targets, start, found, ways, settled, elsewhere)


def with_readings(data: Measurements, readings: np.ndarray) -> Measurements:
    """Return rows at other joint readings (n, n_joints) [rad, or m]."""
    names = numbered("q", data.robot.n_joints)
    return replace(data, table=data.table.assign(**dict(zip(names, readings.T, strict=True))))


def _led(stated: StatedModel, readings: np.ndarray, ways: bool) -> StatedModel:
    """The rows at readings, with the ways that lead there if these follow from the order."""
    data = with_readings(stated.data, readings)
    return replace(stated, data=_on_the_way(data, readings).stating(stated.data.given) if ways else data)


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
    stated: StatedModel,
    targets: Targets,
    start: np.ndarray,
    found: Landing,
    ways: bool,
    settled: np.ndarray,
    elsewhere: np.ndarray,
) -> Compensation:
    """What is promised of the readings found, and what those begun with would have done."""
    calibrated, model = stated.calibrated, stated.calibrated.model
    oriented = targets.rotation is not None

    def misses(conditions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rotation = model.rotation(calibrated.estimate, conditions) if oriented else None
        lacking = targets.lacking(expected_point(calibrated, conditions), rotation)
        return np.linalg.norm(lacking[:, :3], axis=1), np.linalg.norm(lacking[:, 3:], axis=1)

    data = _led(stated, found.readings, ways).data
    remaining, turned = misses(data.conditions)
    nominal_miss, nominal_turned = misses(_led(stated, start, ways).data.conditions)
    clear = clearance(model, data.conditions, oriented)
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
        *stated.notes,
        *of_field(calibrated, data.conditions),
        *(not_known(calibrated, data.conditions) if oriented else ()),
    ]  # fmt: skip
    return Compensation(
        found.readings, remaining, turned, found.reached,
        np.sqrt(position_variance(calibrated, data.conditions) + stated.widened),
        turn_sd(calibrated, data.conditions) if oriented else None,
        start, nominal_miss, nominal_turned, clear, data, tuple(notes),
        field_correction(calibrated, data.conditions) if calibrated.field else None,
    )  # fmt: skip


def _of_rows(what: str, which: np.ndarray, names: np.ndarray) -> list[str]:
    """Say what is so of some targets, by name; nothing where it is so of none."""
    if not which.any():
        return []
    more = f" and {which.sum() - MOST_NAMED} more" if which.sum() > MOST_NAMED else ""
    return [f"{which.sum()} of {len(which)} targets: {what}: pose {', '.join(names[which][:MOST_NAMED])}{more}"]


AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class Command:
    """What is commanded to land on a target, and what is promised of it; the targets' own columns stand before."""

    reached: bool = column("whether the robot lands on the target, by the model; else no command is given")
    q: Mapping[str, float] = column("joint readings to command; empty where the target is out of reach", name=READINGS)
    expected_mm: float = column(
        "root mean square distance from the target to expect: remaining_mm and the standard deviations together", "mm"
    )
    remaining_mm: float = column(
        "distance from the target, by the model; out of reach: of the nearest pose within the limits", "mm"
    )
    remaining_mrad: float = column("the same of the orientation; empty: none was asked for", "mrad")
    sd_x_mm: float = column("how surely it is known where the tool will be, along the measuring frame's x", "mm")
    sd_y_mm: float = column("the same along y", "mm")
    sd_z_mm: float = column("the same along z", "mm")
    sd_rx_mrad: float = column(
        "how surely it is known how the tool will be turned about its own x; empty: not asked for", "mrad"
    )
    sd_ry_mrad: float = column("the same about its own y", "mrad")
    sd_rz_mrad: float = column("the same about its own z", "mrad")
    nominal_q: Mapping[str, float] = column(
        "readings that the nominal robot would be sent to", name=f"nominal_{READINGS}"
    )
    nominal_miss_mm: float = column("what these would miss the target by, by the model", "mm")
    nominal_miss_mrad: float = column("the same of the orientation; empty: none was asked for", "mrad")
    not_physical: Mapping[str, float] = column(
        "what of the position a residual field adds, which is not physical; only where the run has such a field", "mm",
        name="not_physical_{x|y|z}_mm",
    )  # fmt: skip
    limit_joint: int = column("the joint that is nearest to a limit, by share of its travel")
    to_limit: Mapping[str, float] = column(
        "how far it is from there; empty: it is of the other kind, or no joint has limits", name="to_limit_{deg|mm}"
    )
    to_singularity_deg: float = column(
        "how far all joints together are from a pose at which the tool cannot be moved in some direction, to first order",
        "deg",
    )
    approach: Mapping[str, int] = column(
        "with --in-order: the side from which each joint comes, by the order of the commands", name="approach{joint}"
    )


def command_table(found: Compensation, in_order: bool) -> pd.DataFrame:
    """Return the table of `Command`s, a row a target."""
    robot = found.data.robot
    names = reading_columns(robot)
    columns: dict[str, object] = {"reached": found.reached}
    given = shown_readings(robot, np.where(found.reached[:, None], found.readings, np.nan))
    columns |= dict(zip(names, given.T, strict=True))
    oriented, none = found.turn_sd is not None, np.full((len(given), 3), np.nan)
    columns |= {
        "expected_mm": 1e3 * found.expected,
        "remaining_mm": 1e3 * found.remaining,
        "remaining_mrad": 1e3 * found.turned if oriented else none[:, 0],
    }
    columns |= {f"sd_{axis}_mm": 1e3 * found.sd[:, k] for k, axis in enumerate(AXES)}
    turns = none if found.turn_sd is None else 1e3 * found.turn_sd
    columns |= {f"sd_r{axis}_mrad": turns[:, k] for k, axis in enumerate(AXES)}
    columns |= {
        f"nominal_{name}": values for name, values in zip(names, shown_readings(robot, found.nominal).T, strict=True)
    }
    columns |= {
        "nominal_miss_mm": 1e3 * found.nominal_miss,
        "nominal_miss_mrad": 1e3 * found.nominal_turned if oriented else none[:, 0],
        "limit_joint": found.clearance.joint + 1,
    }
    if found.not_physical is not None:
        columns |= {f"not_physical_{axis}_mm": 1e3 * found.not_physical[:, k] for k, axis in enumerate(AXES)}
    units = np.array([joint.shown[0] for joint in robot.joints])
    factors = np.array([joint.shown[1] for joint in robot.joints])
    for unit in dict.fromkeys(units):
        own = units[found.clearance.joint] == unit
        own &= np.isfinite(found.clearance.limit)
        columns[f"to_limit_{unit}"] = np.where(own, found.clearance.limit * factors[found.clearance.joint], np.nan)
    columns["to_singularity_deg"] = np.rad2deg(found.clearance.singular)
    sides = [f"approach{i + 1}" for i in robot.driven]
    if in_order and sides[0] in found.data.table:
        columns |= {name: found.data.table[name].astype(int).to_numpy() for name in sides}
    return typed(pd.DataFrame(columns), Command)
