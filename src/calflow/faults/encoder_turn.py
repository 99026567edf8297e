"""Encoder turn: readings off by a whole turn of the joint, or in a block of rows by one turn of its motor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from calflow.faults.base import Correction, Fault, correct, fault
from calflow.faults.implausible import past
from calflow.faults.reference import Reference
from calflow.faults.rough import NORMAL_LENGTH, lengths
from calflow.faults.segments import state_cost, states
from calflow.faults.setup import SUSPECT_SCALE, FittedSetup
from calflow.measurements.measurements import Measurements

TURN = 2 * np.pi
PAST = np.deg2rad(1.0)  # excess over a limit; less may be rounding, or another kind of limit
MAX_LIMIT_SHARE = 0.2  # share of rows past a limit from which the limit is doubted
MIN_BLOCK_POSES = 3  # least poses in a block: a lost turn persists
COUNTED_STEPS = 3.0  # a row counts if its error is below so many steps
TINY = 1e-9  # m: least displacement by a step
REFINED = 3  # rounds of updating rows and fit in turn
DECISIVE = 9.0  # difference of the deviations from nominal that decides between blocks, before their size
CHANGE = 8.0  # cost of the begin or end of a block: that of an error of 150 robust standard deviations
# Least share of a block's rows that must be far better with the turn corrected, and of the others without.
MIN_IMPROVED_SHARE = 0.8
EXACT = 0.02  # share of a turn by which a step may differ from one; true turns do by 0.004
CERTAIN = 4.0  # standard deviations by which it must, to be none


@dataclass(frozen=True)
class TurnedBlock:
    """A block of rows (n_rows,) in which step [rad] is to be added to the readings of a joint (from 0)."""

    joint: int
    step: float
    rows: np.ndarray

    @property
    def complement(self) -> TurnedBlock:
        """Return the complement with the opposite step, which differs by the joint's zero only."""
        return replace(self, step=-self.step, rows=~self.rows)

    @property
    def corrections(self) -> list[Correction]:
        """Return the corrections of the readings."""
        offset = float(f"{self.step:.10g}")
        return [Correction(int(row) + 1, f"q{self.joint + 1}", offset=offset) for row in np.flatnonzero(self.rows)]

    def undone(self, data: Measurements) -> Measurements:
        """Return the data with the readings corrected."""
        return correct(data, Fault("encoder-turn", 0, (), "", "corrected", tuple(self.corrections)))


def turned_block(data: Measurements, fit: FittedSetup, joint: int, step: float) -> tuple[float, TurnedBlock]:
    """Return the reduction of the cost, and the block of rows offset from all others by a step of a joint's reading.

    The fit itself may have absorbed a fraction of the step: errors in units of the step are then that fraction in some
    rows and one more in the others, so that their phase determines it.
    """
    every, moved = np.arange(len(data)), fit.moved(data.conditions, joint, step)
    error, square = data.position - fit.predicted(data.conditions), (moved**2).sum(axis=1)
    turns = np.exp(2j * np.pi * (moved * error).sum(axis=1) / np.maximum(square, TINY**2))
    near = lengths(error) < COUNTED_STEPS * np.sqrt(square)
    part = float(np.angle((square * turns)[near].sum())) / TURN
    blocks = []
    for low in (part - 1, part):
        left = np.stack([lengths(error - low * moved), lengths(error - (low + 1) * moved)])
        costs = state_cost(left, float(np.median(left.min(axis=0))) / NORMAL_LENGTH)
        path = states(costs, CHANGE)
        cost = costs[path, every].sum() + CHANGE * np.count_nonzero(np.diff(path))
        blocks.append((float(costs.sum(axis=1).min() - cost), TurnedBlock(joint, step, path == 1)))
    return max(blocks, key=itemgetter(0))


def encoder_turn(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Return faults of a block with an additional motor turn, and of rows with an additional whole turn, by joint.

    A whole turn does not move the robot and shows by the joint's limits; a motor turn shows by the positions. Of two
    complementary blocks, the faulty one is that whose correction brings the robot nearer to its nominal, or the smaller
    one if base or tool can absorb the difference.
    """
    faults = _motor(data, reference)
    for turned in faults:  # a motor turn may have moved readings past a limit
        data = correct(data, turned)
    joints = range(data.robot.n_joints)
    return (*faults, *(turned for joint in joints for turned in _whole(data, joint)))


def _whole(data: Measurements, joint: int) -> list[Fault]:
    of = data.robot.joints[joint]
    if of.kind != "revolute" or of.limits is None:
        return []
    turns = _turns_outside(data, joint)
    inside = past(data.joint_angles[:, joint] + turns * TURN, of.range) < 0
    if (turns != 0).mean() > MAX_LIMIT_SHARE:
        return []
    faults = []
    for turn in (-1, 1):
        block = TurnedBlock(joint, turn * of.sign * TURN, (turns == turn) & inside)
        if block.rows.any():
            faults.append(_fault(data, block, "whole turn", "lies outside its limits"))
    return faults


def _motor(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    steps = {
        j: TURN / joint.gear_ratio
        for j, joint in enumerate(data.robot.joints)
        if joint.kind == "revolute" and joint.gear_ratio
    }
    if not steps:
        return ()
    gain, block = max((turned_block(data, reference.fit, j, step) for j, step in steps.items()), key=itemgetter(0))
    sides = [_refined(data, reference, side) for side in (block, block.complement)] if gain > 0 else []
    explaining = [side for side in sides if side]
    if not explaining:
        return ()
    nearest = min(deviation for deviation, _ in explaining)
    alike = [side for deviation, side in explaining if deviation < nearest + DECISIVE]
    chosen = min(alike, key=lambda side: (_turns_outside(side.undone(data), side.joint).any(), side.rows.sum()))
    ratio = data.robot.joints[block.joint].gear_ratio
    why = f"turn of its motor ({abs(np.rad2deg(chosen.step)):.4g} deg at gear ratio {ratio:g})"
    return (_fault(data, chosen, why, "does not agree with the position"),)


def _refined(data: Measurements, reference: Reference, block: TurnedBlock) -> tuple[float, TurnedBlock] | None:
    """Return the deviation from nominal of a robot fitted with the block corrected, and the block refined by it.

    None if the turn does not explain the rows: a zero changed by nearly a turn leaves errors too large for a robot, or a step.
    """
    pose = data.table["pose"].to_numpy()
    for _ in range(REFINED):
        again = Reference.of(undone := block.undone(data), reference.fit.setup.on(undone))
        if again is None:
            return None
        fit = again.fit
        error = data.position - fit.predicted(data.conditions)
        before, after = lengths(error), lengths(error - fit.moved(data.conditions, block.joint, block.step))
        needed = states(np.stack([state_cost(before, fit.scale), state_cost(after, fit.scale)]), CHANGE) == 1
        # If the fit has absorbed the turn, nearly all rows seem to need it: the others must agree without.
        if not all(
            len(set(pose[part])) >= MIN_BLOCK_POSES
            and fit.better(wrong[part], right[part]).mean() >= MIN_IMPROVED_SHARE
            for part, wrong, right in ((needed, before, after), (~needed, after, before))
        ):
            return None
        settled, block = np.array_equal(needed, block.rows), replace(block, rows=needed)
        if settled:
            break
    if fit.scale >= SUSPECT_SCALE or _leaves_a_step(data, fit, block):
        return None
    return float((fit.deviations**2).sum()), block


def _leaves_a_step(data: Measurements, fit: FittedSetup, block: TurnedBlock) -> bool:
    """Whether the joint still differs between the block, with the turn corrected, and the other rows: no turn is a part of one."""
    moved = fit.moved(data.conditions, block.joint, block.step)
    error = data.position - fit.predicted(data.conditions) - moved * block.rows[:, None]
    size = np.maximum(lengths(moved), TINY)
    of_turn = np.nan_to_num((error * moved).sum(axis=1) / size**2)
    # Regression of least absolute deviations: rows may have errors of their own.
    sides = (block.rows, ~block.rows)
    inside, outside = (np.quantile(of_turn[side], 0.5, weights=size[side], method="inverted_cdf") for side in sides)
    sd = fit.scale * np.sqrt(sum(1 / (size[side] ** 2).sum() for side in sides))
    return bool(abs(inside - outside) > max(EXACT, CERTAIN * sd))


def _fault(data: Measurements, block: TurnedBlock, what: str, why: str) -> Fault:
    statement = (
        f"joint {block.joint + 1}: in LINES the reading {why}, and is right with one {what} "
        f"{'more' if block.step > 0 else 'less'}; corrected for this run only; correct the file, too, and check the joint's zero"
    )
    return fault("encoder-turn", data, block.joint + 1, block.corrections, "corrected", statement)


def _turns_outside(data: Measurements, joint: int) -> np.ndarray:
    """Return the sign (n_rows,) of the turn that returns a joint within its limits; zero inside or without limits."""
    limits = data.robot.joints[joint].limits
    if limits is None:
        return np.zeros(len(data), dtype=int)
    angle = data.joint_angles[:, joint]
    return np.where(past(angle, limits) > PAST, -np.sign(angle - np.mean(limits)), 0).astype(int)
