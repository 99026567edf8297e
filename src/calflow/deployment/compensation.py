"""Compensation: commands with which the calibrated robot reaches targets, with the uncertainty of the resulting poses.

Targets are stated in frames. Each command comes with its expected error and orientation error, their standard
deviations, and the clearance to joint limits and singular poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from calflow.deployment.inverse_kinematics import (
    TRIED,
    Landing,
    Targets,
    field_landing,
    landing_from_elsewhere,
    nominal_readings,
    room,
)
from calflow.deployment.prediction import (
    BEYOND_RANGE,
    Missing,
    StatedModel,
    as_stated,
    of_field,
    of_unseen_tool,
    rows_at,
    standing,
)
from calflow.estimation.calibrated_model import MOST_UNTOLD, CalibratedModel
from calflow.estimation.needed_conditions import HOW_TO_GO_ON
from calflow.files.deferred import Rotation, pd
from calflow.files.problems import MOST_TOLD, Problem, nearest, refuse, refuse_any
from calflow.files.tables import column, typed
from calflow.files.toml import Seed, checked_arguments
from calflow.files.words import listed
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import approach_and_travel, numbered
from calflow.model import Model, over_rows
from calflow.observations.pose import Pose
from calflow.robot.formats.frames_file import BASE, MEASURING, TargetFrameTable
from calflow.robot.frames import turning
from calflow.robot.mechanism import READINGS, reading_columns, shown_readings

UNTOLD_ROWS = 100  # rows from which that share is estimated
BY_ORDER = f"--in-order derives approach and travel from the order of the targets; {HOW_TO_GO_ON}"
SAME_TRAVEL = 1e-4  # rad or m
SETTLES = 5  # iterations in which approach directions and commands must agree
NEAR_SINGULAR = np.deg2rad(1.0)
MOST_NAMED = 10  # targets that a note names
WORTH_TELLING = 5e-5  # m: standard deviation of a tool's place beyond its marker's, from which that is said
AXES = ("x", "y", "z")


def targets_in_measuring_frame(
    targets: Targets, names: Sequence[str], frames: Mapping[str, TargetFrameTable], calibrated: CalibratedModel,
    conditions: np.ndarray,
) -> Targets:  # fmt: skip
    """Return targets in the measuring frame, each given in the frame of that name.

    Frame "base": the robot's base as calibrated; "measuring" and "": the measuring frame.

    Raises:
        InputError: a frame is unknown.
    """
    every = {"": TargetFrameTable(), MEASURING: TargetFrameTable(), BASE: TargetFrameTable(within="base"), **frames}
    known_names = ", ".join(filter(None, every))
    refuse_any(
        Problem(f"unknown frame '{name}': expected one of {known_names}{nearest(name, every)}", key="frame")
        for name in sorted(set(names) - set(every))[:MOST_TOLD]
    )
    stated = [every[name] for name in names]
    turn = Rotation.from_euler("XYZ", [frame.rotation for frame in stated]).as_matrix()
    placed = np.tile(np.eye(4), (len(targets), 1, 1))
    placed[:, :3, :3], placed[:, :3, 3] = turn, [frame.origin for frame in stated]
    of_base = np.array([frame.within == BASE for frame in stated])
    if of_base.any():
        placed[of_base] = base_placement(calibrated, conditions[:, of_base]) @ placed[of_base]
    turn, origin = placed[:, :3, :3], placed[:, :3, 3]
    position = np.einsum("nij,nj->ni", turn, targets.position) + origin
    return Targets(position, None if targets.rotation is None else turn @ targets.rotation)


def base_placement(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the calibrated pose of the robot's base in the measuring frame, shape (n_rows, 4, 4)."""
    return calibrated.model.figures("base", lambda p, c, at: [at.stands], calibrated.estimate, conditions)[0]


def not_known(calibrated: CalibratedModel, conditions: np.ndarray) -> list[str]:
    """Return notes on the parts of the orientation in rows (n_conditions, n_rows) that no measurement determined.

    Of images `of_unseen_tool` says it.
    """
    seen = any(isinstance(observation, Pose) for observation in calibrated.model.observations)
    if seen or calibrated.model.tool_unseen:
        return []
    few = conditions[:, np.unique(np.linspace(0, conditions.shape[1] - 1, UNTOLD_ROWS).astype(int))]
    typical = np.sqrt(calibrated.rotation_variances(few)[0].mean(axis=0))
    robot = calibrated.model.robot
    turned = "turned by tool_rotation_deg of the robot file" if robot.tool_rotation else "as it is"
    problems = [
        f"no orientation was measured, positions only: targets turn the frame of link {robot.n_joints}, {turned}; how the tool "
        "sits on it is not checked"
    ]
    untold = calibrated.untold(Model.rotation_jacobian, few)
    if unseen := np.flatnonzero(untold > MOST_UNTOLD).tolist():
        axes, sizes = listed(["xyz"[k] for k in unseen]), listed([f"{1e3 * typical[k]:.2g}" for k in unseen])
        problems.append(
            f"the tool's turn about its own {axes} counts as known to {sizes} mrad, an assumption about robots like this or a "
            "statement of the study: only measured orientations would show it"
        )
    return problems


@dataclass(frozen=True)
class Clearance:
    """Clearance of poses to joint limits and singularities.

    joint (n,): index of the joint nearest to a limit, by share of its travel; limit (n,) [rad, or m]: its distance;
    singular (n,) [rad, 1 m of a prismatic joint as 1 rad]: distance in joint space to the nearest singularity.
    """

    joint: np.ndarray
    limit: np.ndarray
    singular: np.ndarray


def clearance(model: Model, conditions: np.ndarray, oriented: bool) -> Clearance:
    """Return the clearance of packed rows (n_conditions, n) by the nominal robot.

    The distance to a singularity is to first order: the least singular value of the tool's Jacobian over the norm of
    its gradient. It is accurate near a singularity, and large elsewhere. Without orientations only position counts.
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
    slope_of_rows = over_rows(jacobian, none, conditions)[0].T.reshape(conditions.shape[1], *slope.shape)
    left, sizes, right = np.linalg.svd(slope_of_rows, full_matrices=False)
    directions = np.hstack([left[:, :, -1], right[:, -1]])
    slopes = np.linalg.norm(over_rows(change, none, conditions, directions.T)[0], axis=0)
    return np.asarray(np.divide(sizes[:, -1], slopes, out=np.full(len(slopes), np.inf), where=slopes > 0))


@dataclass(frozen=True)
class Compensation:
    """Joint readings (n, n_joints) [rad, or m] that reach targets by the calibrated model.

    remaining (n,) [m], turned (n,) [rad]: remaining errors by the model; reached (n,): whether these vanish, else the
    readings come nearest. sd (n, 3) [m]: standard deviations of the position in the measuring frame; turn_sd (n, 3)
    [rad]: of the rotation about the tool's axes, None for free orientations. nominal (n, n_joints): the nominal robot's
    readings, with errors nominal_miss (n,) [m] and nominal_turned (n,) [rad]. data: rows at the readings; notes:
    targets out of reach, unknown quantities. not_physical (n, 3) [m]: the residual field's part, None without a field.
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
        """Expected root mean square distance from the target (n,) [m]: remaining error and sd combined."""
        return np.sqrt(self.remaining**2 + (self.sd**2).sum(axis=1))


@checked_arguments
def compensate(
    calibrated: CalibratedModel, targets: ArrayLike, *, start: ArrayLike | None = None,
    payload: str | Sequence[str] | None = None, marker: str | Sequence[str] | None = None, in_order: bool = False,
    missing: Missing = "refuse", seed: Seed = 1, **conditions: ArrayLike,
) -> Compensation:  # fmt: skip
    """Return joint readings with which the marker lands on the targets (see `compensate_rows`).

    They are those nearest to start, which should be the nominal robot's readings. Without start, nominal solutions
    within the joint limits are used, all in one posture of the arm where one reaches all targets. Where targets are
    positions, the orientation stays as near as possible to that of the start; without a start it is free.

    Args:
        calibrated: the calibrated model.
        targets: positions (n, 3), or (3,), or poses (n, 4, 4), or (4, 4), in the measuring frame [m]. A pose has the
            marker's position and the orientation of the last link's frame, with any tool_rotation of the robot.
        start: readings (n, n_joints), or (n_joints,) for all [rad, or m]; a robot with external axes needs theirs, and
            the arm's may be nan.
        payload: as in `predict`, for all targets or one per target.
        marker: name of the marker, likewise.
        in_order: the robot goes from target to target, so that approach directions follow from the commands.
        missing: as in `predict`.
        seed: of the random poses from which nominal solutions are searched.
        conditions: as in `predict`; approach is the direction from which each joint will arrive.

    Raises:
        InputError: a condition that an effect needs is missing, or an array is invalid.
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
    in_order: bool = False, missing: Missing = "refuse", seed: int = 1, places: np.ndarray | None = None,
) -> Compensation:  # fmt: skip
    """Return the joint readings, nearest to the nominal robot's, with which the calibrated robot reaches the targets.

    Args:
        calibrated: the calibrated model.
        data: one row per target with payload, marker and conditions; its readings are ignored.
        targets: the target poses.
        start: readings of the nominal robot (n, n_joints) [rad, or m]; None: those of `nominal_readings`.
        in_order: commands follow each other, so that approach directions and travel of the joints follow from them.
        missing: as in `predict_rows`.
        seed: of the random poses from which nominal readings are searched.
        places: places (n, 3) [m] on the last link whose standard deviations are asked; None: the markers'.

    Raises:
        InputError: a condition that an effect needs is missing.
    """
    ways = in_order and "approach" not in data.given
    unknown = np.zeros((len(data), 1))
    if ways:
        unknown[0] = as_stated(calibrated, data, "widen").widened  # nothing says where the first is reached from
        data = _on_the_way(data, data.joints if start is None else start)
    stated = as_stated(calibrated, data, missing, BY_ORDER)
    ways = ways and bool({"approach", "travel"} & set(stated.data.given))
    rng, free, common = np.random.default_rng(seed), start is None, np.ones(len(data), dtype=bool)
    if start is None:
        start, common = nominal_readings(stated.calibrated.model, stated.data.conditions, targets, rng)
    stated = _led(stated, start, ways)
    landed = field_landing(stated.calibrated, stated.data.conditions, targets, start)
    elsewhere = np.zeros(len(data), dtype=bool)
    if not landed.reached.all():
        left = np.flatnonzero(~landed.reached)
        other, nominal = landing_from_elsewhere(
            stated.calibrated, stated.data.conditions[:, left], targets.only(left), rng
        )
        got = left[other.reached]
        if free:
            landed, start = landed.with_rows(got, other.only(other.reached)), start.copy()
            start[got] = nominal[other.reached]
        elsewhere[got] = not free
    settled = np.ones(len(data), dtype=bool)
    for _ in range(SETTLES if ways else 0):
        before, stated = stated, _led(stated, landed.readings, ways)
        settled = _same_way(before.data, stated.data)
        if settled.all():
            break
        conditions, aims = stated.data.conditions[:, ~settled], targets.only(~settled)
        again = field_landing(stated.calibrated, conditions, aims, start[~settled], landed.readings[~settled])
        landed = landed.with_rows(~settled, again)
    found = _judged(stated, targets, start, landed, ways, settled, elsewhere, common, places)
    return replace(found, sd=np.sqrt(found.sd**2 + unknown))


def _led(stated: StatedModel, readings: np.ndarray, ways: bool) -> StatedModel:
    """Return the rows at readings, with approach and travel where these follow from the order."""
    names = numbered("q", stated.data.robot.n_joints)
    data = replace(stated.data, table=stated.data.table.assign(**dict(zip(names, readings.T, strict=True))))
    return replace(stated, data=_on_the_way(data, readings).stating(stated.data.given) if ways else data)


def _on_the_way(data: Measurements, readings: np.ndarray) -> Measurements:
    """Return the rows with approach and travel of each joint for readings commanded one after another."""
    n = data.robot.n_joints
    names = numbered("q", n)
    came, far = approach_and_travel(pd.DataFrame(readings, columns=names).assign(order=np.arange(len(readings))), names)
    columns = dict(zip([*numbered("approach", n), *numbered("travel", n)], np.hstack([came, far]).T, strict=True))
    return replace(data, table=data.table.assign(**columns))


def _same_way(first: Measurements, other: Measurements) -> np.ndarray:
    """Return whether each row has the same approach in both, and the same travel where that is given (n,)."""
    n, same = first.robot.n_joints, np.ones(len(first), dtype=bool)
    for names, within in ((numbered("approach", n), 0.0), (numbered("travel", n), SAME_TRAVEL)):
        if names[0] in first.table:
            same &= (np.abs(first.table[names].to_numpy() - other.table[names].to_numpy()) <= within).all(axis=1)
    return same


def _judged(
    stated: StatedModel, targets: Targets, start: np.ndarray, landed: Landing, ways: bool, settled: np.ndarray,
    elsewhere: np.ndarray, common: np.ndarray, places: np.ndarray | None,
) -> Compensation:  # fmt: skip
    """Return the compensation with predicted errors of the readings found and of the nominal ones."""
    calibrated, model = stated.calibrated, stated.calibrated.model
    oriented = targets.rotation is not None

    def misses(conditions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rotation = model.rotation(calibrated.estimate, conditions) if oriented else None
        lacking = targets.lacking(calibrated.expected_point(conditions), rotation)
        return np.linalg.norm(lacking[:, :3], axis=1), np.linalg.norm(lacking[:, 3:], axis=1)

    data = _led(stated, landed.readings, ways).data
    remaining, turned = misses(data.conditions)
    nominal_miss, nominal_turned = misses(_led(stated, start, ways).data.conditions)
    clear = clearance(model, data.conditions, oriented)
    variance = of_marker = calibrated.position_variance(data.conditions)
    if places is not None:
        variance = calibrated.position_variance(data.conditions, places)
    names, lost = data.table["pose"].astype(str).to_numpy(), ~landed.reached
    notes = [
        *_of_rows(f"out of reach within the joint limits ({1 + TRIED} starts tried)", lost & ~elsewhere, names),
        *_of_rows(
            "not reached from the readings given, but from others, with the arm in another posture: give readings near such a "
            "one, or none", lost & elsewhere, names,
        ),
        *_of_rows(
            "reached with the arm in another posture than at the others: it turns over on the way there and back",
            landed.reached & ~common, names,
        ),
        *_of_rows(
            f"nearer than {np.rad2deg(NEAR_SINGULAR):.0f} deg to a singularity, where small corrections turn joints far",
            landed.reached & (clear.singular < NEAR_SINGULAR), names,
        ),
        *_of_rows("a joint moves there by so little that its side of approach depends on the correction itself", ~settled, names),
        *_of_rows(f"a joint is {': '.join(BEYOND_RANGE)}", np.asarray(calibrated.beyond_range(data.joints).any(axis=1)), names),
        # Other tools than the robot's own are where their program says.
        *(standing(calibrated) if places is None else of_unseen_tool(calibrated)),
        *stated.notes,
        *of_field(calibrated, data.conditions),
        *(not_known(calibrated, data.conditions) if oriented else ()),
        *_apart(calibrated, variance - of_marker),
    ]  # fmt: skip
    return Compensation(
        landed.readings, remaining, turned, landed.reached,
        np.sqrt(variance + stated.widened),
        np.sqrt(calibrated.rotation_variances(data.conditions)[0]) if oriented else None,
        start, nominal_miss, nominal_turned, clear, data, tuple(notes),
        calibrated.field_correction(data.conditions) if calibrated.field else None,
    )  # fmt: skip


def _apart(calibrated: CalibratedModel, beyond: np.ndarray) -> list[str]:
    """Return a note where tools are known worse than the marker; beyond (n_rows, 3) [m²]: their variance less the marker's."""
    apart, marker = np.sqrt(max(0.0, beyond.sum(axis=1).mean())), next(iter(calibrated.model.robot.markers))
    if apart < WORTH_TELLING:
        return []
    return [
        f"of the error to expect of the tools some {1e3 * apart:.1g} mm come from how flange and marker lie to each other, which "
        "these measurements do not tell better; at all targets it is the same in the tool's frame. State in the study what is "
        f"known of the marker's place on the flange: [parameters.{marker}.z] with prior_mean_mm = 0, prior_sd_mm, and so on. A "
        "second marker, far from the first, shows how the flange is turned, which matters more the farther a tool is from the "
        "marker"
    ]


def _of_rows(what: str, which: np.ndarray, names: np.ndarray) -> list[str]:
    """Return a note that names the targets concerned; nothing where there are none."""
    named = listed([*dict.fromkeys(names[which])], MOST_NAMED)
    return [f"{which.sum()} of {len(which)} targets: {what}: pose {named}"] if which.any() else []


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command that reaches a target, with its predicted errors; the targets' own columns precede these."""

    reached: bool = column("whether the robot lands on the target, by the model; else no command is given")
    q: Mapping[str, float] = column("joint readings to command; empty where the target is out of reach", name=READINGS)
    expected_mm: float = column(
        "root mean square distance from the target to expect: remaining_mm and the standard deviations together", "mm"
    )
    remaining_mm: float = column(
        "distance from the target, by the model; out of reach: of the nearest pose within the limits", "mm"
    )
    remaining_mrad: float = column("the same of the orientation; empty: none was asked for", "mrad")
    sd_x_mm: float = column("standard deviation of the tool's position along the measuring frame's x", "mm")
    sd_y_mm: float = column("the same along y", "mm")
    sd_z_mm: float = column("the same along z", "mm")
    sd_rx_mrad: float = column(
        "standard deviation of the tool's rotation about its own x; empty: not asked for", "mrad"
    )
    sd_ry_mrad: float = column("the same about its own y", "mrad")
    sd_rz_mrad: float = column("the same about its own z", "mrad")
    nominal_q: Mapping[str, float] = column("readings of the nominal robot for the target", name=f"nominal_{READINGS}")
    nominal_miss_mm: float = column("distance from the target with these, by the calibrated model", "mm")
    nominal_miss_mrad: float = column("the same of the orientation; empty: none was asked for", "mrad")
    not_physical: Mapping[str, float] = column(
        "the residual field's part of the position, which is not physical; only where the run has such a field",
        "mm",
        name="not_physical_{x|y|z}_mm",
    )
    limit_joint: int = column("the joint nearest to a limit, by share of its travel")
    to_limit: Mapping[str, float] = column(
        "its distance to the limit; empty: the joint is of the other kind, or no joint has limits",
        name="to_limit_{deg|mm}",
    )
    to_singularity_deg: float = column(
        "distance in joint space, to first order, to a singularity, where the tool cannot move in some direction", "deg"
    )
    approach: Mapping[str, int] = column(
        "with --in-order: direction from which each joint arrives, by the order of the commands", name="approach{joint}"
    )


def command_table(compensation: Compensation, in_order: bool) -> pd.DataFrame:
    """Return the table of `Command`s, one row per target."""
    found, robot, clear = compensation, compensation.data.robot, compensation.clearance
    names, nominal = reading_columns(robot), shown_readings(robot, found.nominal)
    given = shown_readings(robot, np.where(found.reached[:, None], found.readings, np.nan))
    oriented, none = found.turn_sd is not None, np.full((len(given), 3), np.nan)
    turns = none if found.turn_sd is None else 1e3 * found.turn_sd
    columns: dict[str, object] = {
        "reached": found.reached,
        **dict(zip(names, given.T, strict=True)),
        "expected_mm": 1e3 * found.expected,
        "remaining_mm": 1e3 * found.remaining,
        "remaining_mrad": 1e3 * found.turned if oriented else none[:, 0],
        **{f"sd_{axis}_mm": 1e3 * found.sd[:, k] for k, axis in enumerate(AXES)},
        **{f"sd_r{axis}_mrad": turns[:, k] for k, axis in enumerate(AXES)},
        **{f"nominal_{name}": values for name, values in zip(names, nominal.T, strict=True)},
        "nominal_miss_mm": 1e3 * found.nominal_miss,
        "nominal_miss_mrad": 1e3 * found.nominal_turned if oriented else none[:, 0],
        "limit_joint": clear.joint + 1,
    }
    if found.not_physical is not None:
        columns |= {f"not_physical_{axis}_mm": 1e3 * found.not_physical[:, k] for k, axis in enumerate(AXES)}
    units, factors = (np.array(figures) for figures in zip(*(joint.shown for joint in robot.joints), strict=True))
    for unit in dict.fromkeys(units):
        rows = (units[clear.joint] == unit) & np.isfinite(clear.limit)
        columns[f"to_limit_{unit}"] = np.where(rows, clear.limit * factors[clear.joint], np.nan)
    columns["to_singularity_deg"] = np.rad2deg(clear.singular)
    sides = [f"approach{i + 1}" for i in robot.driven]
    if in_order and sides[0] in found.data.table:
        columns |= {name: found.data.table[name].astype(int).to_numpy() for name in sides}
    return typed(pd.DataFrame(columns), Command)
