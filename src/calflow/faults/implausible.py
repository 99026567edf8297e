"""Implausible data: wrong units, an open loop, positions that no calibration of the robot file explains, and joint limits.

Units and loop are checked as rows are read; the others after corrections.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from calflow.estimation.accuracy import distances, leading_errors
from calflow.estimation.registration import registered_model
from calflow.faults.base import lines_in_words
from calflow.faults.mistake import LENGTH_UNITS
from calflow.faults.setup import Setup
from calflow.files.problems import Problem, refuse_any
from calflow.files.units import METRE
from calflow.files.words import rounded
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import at_rows
from calflow.model import build

# In m, and as a share of the reach: largest deviation of a robot from its maker's dimensions.
IMPLAUSIBLE_ERROR, IMPLAUSIBLE_SHARE = 0.1, 0.1
MIN_POSES = 8  # least number of poses: base and tool fit fewer
TOLERANCE = {"rad": np.deg2rad(0.5), "m": 1e-3}  # excess over a limit; less may be rounding, or a compliant stop
SHAPE_ROWS = 200  # rows whose mutual distances reveal a wrong unit
SHAPE_WRONG = 0.3  # least disagreement with the nominal robot's distances in the named unit
SHAPE_RIGHT = 0.1  # largest disagreement in the unit that is meant
FEW_POSES = 3  # too few to compare shapes


def plausible(measured: Measurements, path: Path) -> Measurements:
    """Return measurements, or rows to be predicted, after checking that they are plausible for their robot.

    Raises:
        InputError: they are in other units than their columns say, or at joint readings that the robot cannot reach.
    """
    refuse_any(check_units(measured, path) or check_loop(measured, path))
    return measured


def check_units(measured: Measurements, path: Path) -> list[Problem]:
    """Find wrong units, as degrees named radians or millimetres named metres.

    Distances between measured points are compared with those between the nominal robot's: a unit is wrong if they agree far
    better when angles or lengths are read in another.
    """
    revolute = [i for i, joint in enumerate(measured.robot.joints) if joint.kind == "revolute"]
    largest = np.abs(measured.joints[:, revolute]).max() if revolute else 0.0
    angles = f"q1 … q{measured.robot.n_joints}"
    degrees = f"{angles}: does a column named _rad hold degrees? "
    if largest > 6 * np.pi:
        return [Problem(f"{degrees}The largest reading is {largest:.4g} rad, over three turns", path)]
    if "x" not in measured.table or measured.table["pose"].nunique() <= FEW_POSES:
        return []
    named, turns, stretches = measured.units, {1.0: ""}, {1.0: ""}
    if "rad" in named:
        turns[np.pi / 180] = degrees
    if "deg" in named:
        turns[180 / np.pi] = f"{angles}: does a column named _deg hold radians? "
    if "m" in named:
        stretches[1e-3] = "x, y, z: does a column named _m hold millimetres? "
    if "mm" in named:
        stretches[1e3] = "x, y, z: does a column named _mm hold metres? "
    if _disagreement(measured, 1.0, 1.0) < SHAPE_WRONG:
        return []
    disagreements = {(turn, stretch): _disagreement(measured, turn, stretch) for turn in turns for stretch in stretches}
    best = min(disagreements, key=lambda units: disagreements[units])
    if disagreements[best] > SHAPE_RIGHT:
        return []
    return [
        Problem(
            f"{turns[best[0]]}{stretches[best[1]]}The measured points would fit the nominal robot far better then", path
        )
    ]


def _disagreement(measured: Measurements, turn: float, stretch: float) -> float:
    """Return the relative difference of distances between points from the nominal robot's: 0 where all agree, at most 1.

    Readings of revolute joints are multiplied by turn, measured positions by stretch.
    """
    nominal = build(measured.robot, (), measured.given)
    chosen = np.unique(np.linspace(0, len(measured) - 1, SHAPE_ROWS).astype(int))
    conditions = measured.conditions[:, chosen]
    conditions[: measured.robot.n_joints] *= [
        [turn if joint.kind == "revolute" else 1.0] for joint in measured.robot.joints
    ]
    both = (stretch * measured.position[chosen], nominal.position(nominal.nominal, conditions))
    points, expected = (np.linalg.norm(places[:, None] - places[None], axis=2) for places in both)
    share = np.median(np.abs(points - expected)) / (np.median(points) + np.median(expected))
    return float(share) if np.isfinite(share) else 1.0


def check_loop(measured: Measurements, path: Path) -> list[Problem]:
    """Return the problems of rows whose joint readings do not close the four-bar loop."""
    if measured.robot.loop is None:
        return []
    nominal = build(measured.robot, (), measured.given)
    open_ = np.abs(nominal.closure_cosine(nominal.nominal, measured.conditions)) >= 1
    return at_rows(open_, measured.table, path, "the four-bar loop cannot be closed at these joint readings")


def one_position(position: np.ndarray) -> str:
    """Return in words that all positions (n_rows, 3) [m] are one and the same; empty otherwise."""
    if len(position) < MIN_POSES or np.ptp(position, axis=0).any():
        return ""
    x, y, z = 1e3 * position[0]
    return (
        f"all {len(position)} positions are the same, ({x:.7g}, {y:.7g}, {z:.7g}) mm: expected what was measured at each pose; was "
        "one row copied into all others?"
    )


def nominal_misfit(setup: Setup) -> str:
    """Return in words the misfit of the nominal robot to positions, with base and tool fitted; empty if it is plausible.

    Half of all rows must deviate more than any robot can, so that single rows do not decide.
    """
    if len(setup.seen) < MIN_POSES:
        return ""
    far = float(np.median(setup.rigid.fitted.error))
    reach = float(np.nanmax(np.linalg.norm(setup.points(), axis=1)))
    limit = min(IMPLAUSIBLE_ERROR, IMPLAUSIBLE_SHARE * reach)
    if far <= limit:
        return ""
    return (
        f"the nominal robot, with base and tool fitted, misses half of all positions by {1e3 * far:,.0f} mm or more, which no "
        f"calibration can correct (at most {rounded(1e3 * limit)} mm): check the units of readings and positions, the links' "
        "lengths, the order and signs of the joints, their zeros (theta), the convention (dh or modified-dh), the "
        "order of the rows, and that x, y, z are a right-handed frame"
    )


def lengths_in_other_units(data: Measurements) -> Iterator[tuple[np.ndarray, str]]:
    """Yield the rows (n_rows,) of lengths that the nominal robot misses by far in half of them, but not in another unit, and why.

    What is touched is placed by its rows.
    """
    far = _median_errors(data)
    for k in map(int, np.flatnonzero(far > IMPLAUSIBLE_ERROR)):
        if unit := _other_unit(data, k, SHAPE_RIGHT * far[k]):
            name = data.series[k].name or data.series[k].kind
            yield (
                data.of_series(k),
                f"the lengths of '{name}' are in {unit}: the nominal robot fits them far better then",
            )


def _other_unit(data: Measurements, k: int, limit: float) -> str:
    """Return in words the unit in which the lengths of a series are, if its median error is below a limit [m] then."""
    lengths, here = data.table["length"], data.of_series(k)
    for factor, words in LENGTH_UNITS.items():
        table = data.table.assign(length=lengths.where(~here, factor * lengths))
        if _median_errors(replace(data, table=table))[k] < limit:
            return words
    return ""


def _median_errors(data: Measurements) -> np.ndarray:
    """Return the nominal robot's median error of each series [m], (n_series,); nan where it reports no lengths, or few."""
    nominal, train = registered_model(data.only(data.train))
    error = distances(leading_errors(nominal, nominal.nominal, train))
    series = enumerate(nominal.observations)
    each = [error[train.of_series(k)] if one.units[0] == METRE else error[:0] for k, one in series]
    return np.array([np.median(errors) if len(errors) >= MIN_POSES else np.nan for errors in each])


def past_limits(data: Measurements) -> Iterator[tuple[np.ndarray, str]]:
    """Yield for each joint the used rows (n_rows,) beyond its limits, and the problem in words.

    Limits are of the joint variable, after sign and couplings; the words say if they seem to be meant for the
    reading.
    """
    used = data.train | data.held_out
    angles = data.joint_angles
    for i, joint in enumerate(data.robot.joints):
        if joint.limits is None:
            continue
        unit, factor = joint.shown
        low, high = (factor * limit for limit in joint.limits)
        by = past(angles[:, i], joint.limits)
        rows = used & (by > TOLERANCE[joint.unit])
        if rows.any():
            lines = lines_in_words([int(line) for line in data.table["line"][rows]])
            yield (
                rows,
                (
                    f"joint {i + 1}: in {lines} its {joint.noun} is past the limits {low:.6g} to {high:.6g} {unit}, "
                    f"by up to {rounded(factor * by[rows].max())} {unit}; {_hint(data, i, angles[used, i], data.joints[used, i])}"
                ),
            )


def _hint(data: Measurements, i: int, angle: np.ndarray, reading: np.ndarray) -> str:
    """Return a hint on the meaning of limits that a joint (from 0) exceeds at these angles and readings (n,)."""
    joint, slack = data.robot.joints[i], TOLERANCE[data.robot.joints[i].unit]
    limits, (unit, factor) = joint.range, joint.shown
    coupled = any(coupling.joint == i + 1 for coupling in data.robot.couplings)
    if (past(reading, limits) < slack).all() and (joint.sign == -1 or coupled):
        low, high = -factor * limits[1], -factor * limits[0]
        before, here = ("its coupling", "") if coupled else ("`sign`", f", here {low:.6g} to {high:.6g} {unit}")
        return (
            f"the readings themselves are within, so the limits seem to be given before {before}: expected those of the joint "
            f"variable, after `sign` and couplings{here}"
        )
    if (past(-angle, limits) < slack).all():
        return f"with the opposite sign all would be within: expected sign = {-joint.sign}, or limits of the angle after `sign`"
    return "correct these readings, or the limits in the robot file"


def past(values: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """Return the excess of values (n,) over limits; negative inside."""
    return np.asarray(np.maximum(limits[0] - values, values - limits[1]))
