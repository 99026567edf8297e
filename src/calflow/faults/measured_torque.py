"""Measured torque: torque columns with a sign or scale that contradicts the robot file's masses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calflow.faults.base import MEASUREMENT_FILE, ROBOT_FILE, Correction, Fault, fault
from calflow.files.words import listed, plural_word
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import numbered
from calflow.robot.mechanism import Row, gravity_torque, moment_torques, reachable

MIN_FREEDOM = 12  # least residual degrees of freedom per joint
LOADED = 0.02  # least gravity load, as a share of the most loaded joint's
OPEN = 0.05  # least share of the payload's load not confounded with links of unknown mass
AGAINST = -0.9  # correlation below which a sign is wrong
ALONG = 0.95  # correlation above which a scale is determined
SCALE = 1.15  # ratio beyond the error of masses from a drawing
MIN_DEVIATIONS = 5.0  # significance of a wrong scale, in standard deviations


@dataclass(frozen=True)
class TorqueComparison:
    """A joint's measured torques (index from 0) compared with computed gravity torques, without offset and friction."""

    joint: int
    correlation: float
    slope: float
    sd: float
    against: str

    @property
    def off(self) -> bool:
        """Whether the scale of the torques is significantly wrong."""
        times = abs(self.slope)
        return abs(self.correlation) >= ALONG and max(times - SCALE, 1 / SCALE - times) > MIN_DEVIATIONS * self.sd


def measured_torque(data: Measurements) -> tuple[Fault, ...]:
    """Return the faults of joints whose measured torques have the wrong sign or scale against computed gravity torques.

    Signs are corrected, as one fault, if all joints, or all with reversed readings, agree; a scale is only reported, since
    torques or masses may be wrong.
    """
    compared = {comparison.joint: comparison for comparison in comparisons(data)}
    turned = {joint for joint, comparison in compared.items() if comparison.correlation < AGAINST}
    clear = {joint for joint, comparison in compared.items() if abs(comparison.correlation) > -AGAINST}
    backwards = {j for j, joint in enumerate(data.robot.joints) if joint.sign == -1}
    # The controller's sign convention of motor torques: all joints alike, unloaded ones too.
    for alike in (set(range(data.robot.n_joints)), backwards):
        if turned and turned == alike & {*compared} == alike & clear:
            signs = [_turned(data, sorted(alike), compared, True)]
            break
    else:
        signs = [_turned(data, [joint], compared, False) for joint in sorted(turned)]
    return (*signs, *(_scaled(data, comparison) for comparison in compared.values() if comparison.off))


def _turned(data: Measurements, joints: Sequence[int], compared: Mapping[int, TorqueComparison], clear: bool) -> Fault:
    """Return the fault of joints' torques with the wrong sign, which is corrected if that is unambiguous."""
    numbers = [joint + 1 for joint in joints]
    weakest = max((compared[joint] for joint in joints if joint in compared), key=lambda one: one.correlation)
    columns = f"{plural_word(numbers, 'column')} {listed([f'tau{number}' for number in numbers], len(numbers))}"
    action = f"corrected for this run only; correct {columns}, too"
    if not clear:
        action = f"not changed, since other joints' are right: check the sign convention of {columns}"
    statement = (
        f"{plural_word(numbers, 'joint')} {listed(numbers, len(numbers))}: measured torques have the wrong sign (correlation "
        f"{weakest.correlation:.3f}{' or less' if len(numbers) > 1 else ''} with {weakest.against}); {action}"
    )
    turned = [Correction(0, f"tau{number}", factor=-1.0) for number in numbers] if clear else [Correction(0)]
    number = numbers[0] if len(numbers) == 1 else 0
    return fault("torque-sign", data, number, turned, "corrected" if clear else "told", statement)


def _scaled(data: Measurements, compared: TorqueComparison) -> Fault:
    number = compared.joint + 1
    statement = (
        f"joint {number}: measured torques are {abs(compared.slope):.2g} times {compared.against} (correlation "
        f"{abs(compared.correlation):.3f}); not changed: check the unit of tau{number}, "
        "whether it is the torque before the gear, the masses, and whether a spring or cylinder carries a part"
    )
    where = f"{MEASUREMENT_FILE} or {ROBOT_FILE}"
    return fault("torque-scale", data, number, [Correction(0)], "told", statement, where)


def comparisons(data: Measurements) -> tuple[TorqueComparison, ...]:
    """Return the comparison of measured with computed torques for each joint that gravity loads enough.

    If masses are unknown, known payloads determine the scale: the links' part, linear in unknown first moments, is
    fitted with it.
    """
    robot = data.robot
    if "torque" not in data.given:
        return ()
    angles = data.joint_angles
    there = reachable(robot, angles)
    angles, payload = angles[there], data.conditions[Row.spans(robot)["payload"]].T[there]
    if not len(angles):
        return ()
    measured = data.table[numbered("tau", robot.n_joints)].to_numpy()[there]
    came = data.table[numbered("approach", robot.n_joints)].to_numpy()[there] if "approach" in data.given else None
    held = _mapped(gravity_torque(robot), angles, payload)
    moments = None
    if robot.has_masses:
        against = "the gravity torque of the robot file's masses"
    elif any(load.mass for load in robot.payloads.values()):
        held = held - _mapped(gravity_torque(robot), angles, 0 * payload)
        moments = np.array(moment_torques(robot).map(len(angles))(angles.T)).T.reshape(len(angles), -1, robot.n_joints)
        against = "the gravity torque of the known payloads"
    else:
        return ()
    spread = held.std(axis=0)
    compared = []
    for j in np.flatnonzero(spread > LOADED * spread.max(initial=0.0)):
        other = [np.ones(len(angles)), *([] if came is None else [came[:, j]])]
        beside = np.column_stack([*other, *(() if moments is None else moments[:, :, j].T)])
        comparison = _compared(int(j), measured[:, j], held[:, j], beside, against)
        compared += [] if comparison is None else [comparison]
    return tuple(compared)


def _compared(
    joint: int, measured: np.ndarray, held: np.ndarray, beside: np.ndarray, against: str
) -> TorqueComparison | None:
    """Compare torques (n,) with loads (n,), other terms (n, k) projected out of both; None if loads are too small."""
    u, s, _ = np.linalg.svd(beside / np.maximum(np.linalg.norm(beside, axis=0), 1e-12), full_matrices=False)
    u = u[:, s > 1e-9 * s[0]]
    y, x = (values - u @ (u.T @ values) for values in (measured, held))
    free = len(y) - u.shape[1] - 1
    xx, yy = float(x @ x), float(y @ y)
    if free < MIN_FREEDOM or xx < OPEN**2 * float(held @ held) or not yy > 0:
        return None
    slope = float(x @ y) / xx
    left = y - slope * x
    return TorqueComparison(
        joint, float(x @ y) / np.sqrt(xx * yy), slope, float(np.sqrt(left @ left / free / xx)), against
    )


def _mapped(function: object, angles: np.ndarray, payload: np.ndarray) -> np.ndarray:
    """Return the holding torques, shape (n_rows, n_joints) [Nm]."""
    return np.array(function.map(len(angles))(angles.T, payload.T)).T  # type: ignore[attr-defined]
