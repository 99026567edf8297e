"""Encoder turn: readings that are off by a whole turn of the joint, or in a block of rows by one turn of its motor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from calflow.faults.base import Check, Correction, Fault, correct, fault
from calflow.faults.reference import Reference
from calflow.faults.rough import NORMAL_LENGTH, Rough, lengths, rows_with_reading
from calflow.faults.segments import state_cost, states
from calflow.measurements.measurements import Measurements

TURN = 2 * np.pi
PAST = np.deg2rad(1.0)  # past a limit: less may be rounding, or a limit of another kind
FEW = 0.2  # share of the rows: where more lie past a limit, the limit is doubted
FEWEST = 3  # poses in a block: a motor that has lost a turn stays so for a while
FAR, TINY = 3.0, 1e-9  # times a step up to which a row's error counts, and m by which a step moves a row at least
REFINED = 3  # rounds in which rows and fit follow each other
DECISIVE = 9.0  # by which one robot must be nearer to the nominal to choose a block by that, and not by its size
CHANGE = 8.0  # what the begin or end of a block costs: as much as a row that is off by 150 robust standard deviations
BELIEVED = 0.8  # share of a block's rows that must be far better with the turn back, and of the others without


@dataclass(frozen=True)
class TurnedBlock:
    """Rows (n_rows,) that step [rad] is to be added to in the readings of a joint (from 0), and how much less all cost then."""

    joint: int
    step: float
    rows: np.ndarray
    gain: float

    @property
    def others(self) -> TurnedBlock:
        """The same with all other rows, to the other side: only the joint's zero tells them apart."""
        return replace(self, step=-self.step, rows=~self.rows)

    @staticmethod
    def of(data: Measurements, fit: Rough, joint: int, step: float) -> TurnedBlock:
        """Return the block that lies a step of the reading apart from all other rows.

        The fit itself may have gone with a part of the step: errors, along the step and in steps, are that part in some rows and
        one more in the others, so that their phase tells it.
        """
        every, here = np.arange(len(data)), fit.predicted(data.conditions)
        moved = fit.predicted(rows_with_reading(data, joint, data.joints[:, joint] + step, every)) - here
        error, square = data.position - here, (moved**2).sum(axis=1)
        turns = np.exp(2j * np.pi * (moved * error).sum(axis=1) / np.maximum(square, TINY**2))
        near = lengths(error) < FAR * np.sqrt(square)
        part = float(np.angle((square * turns)[near].sum())) / TURN
        return max(
            (_split(TurnedBlock(joint, step, near, 0.0), error, moved, low) for low in (part - 1, part)), key=_gain
        )


def _split(block: TurnedBlock, error: np.ndarray, moved: np.ndarray, low: float) -> TurnedBlock:
    """Return the block with the rows whose errors (n_rows, 3) [m] are low + 1 of the steps moved (n_rows, 3) [m], not low."""
    left = np.stack([lengths(error - part * moved) for part in (low, low + 1)])
    costs = state_cost(left, float(np.median(left.min(axis=0))) / NORMAL_LENGTH)
    path = states(costs, CHANGE)
    cost = costs[path, np.arange(len(path))].sum() + CHANGE * np.count_nonzero(np.diff(path))
    return replace(block, rows=path == 1, gain=float(costs.sum(axis=1).min() - cost))


def _gain(block: TurnedBlock) -> float:
    return block.gain


@dataclass(frozen=True)
class Turned:
    """Rows that step is to be added to [rad], how far the robot is from its nominal then, and whether a reading past its limits."""

    rows: np.ndarray
    step: float
    deviation: float
    outside: bool


class EncoderTurn(Check):
    """A whole turn leaves the robot in its place and shows by the joint's limits; a motor's turn shows by the positions.

    Of two blocks that differ by a turn either could be wrong: it is the one without which the robot is nearer to its nominal, or
    where base or tool make up for it the smaller one.
    """

    id: ClassVar[str] = "encoder-turn"
    title: ClassVar[str] = "an encoder lost or gained a turn"
    order: ClassVar[int] = 30

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return the block with a motor's turn too much, and the rows with a whole turn too much, joint by joint."""
        faults = self._motor(data, reference)
        for turned in faults:  # a motor's turn may have taken readings past a limit
            data = correct(data, turned)
        joints = range(data.robot.n_joints)
        return (*faults, *(turned for joint in joints for turned in self._whole(data, joint)))

    def _whole(self, data: Measurements, joint: int) -> list[Fault]:
        of = data.robot.joints[joint]
        if of.kind != "revolute" or of.limits is None:
            return []
        angle, (low, high) = _angle(data, joint), of.range
        turns = _turns_outside(data, joint)
        inside = (angle + turns * TURN > low) & (angle + turns * TURN < high)
        if (turns != 0).mean() > FEW:
            return []
        faults = []
        for turn in (-1, 1):
            rows = np.flatnonzero((turns == turn) & inside)
            if len(rows):
                faults.append(
                    self._fault(data, joint, rows, turn * of.sign * TURN, "whole turn", "lies outside its limits")
                )
        return faults

    def _motor(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        steps = {
            j: TURN / joint.gear_ratio
            for j, joint in enumerate(data.robot.joints)
            if joint.kind == "revolute" and joint.gear_ratio
        }
        if not steps:
            return ()
        block = max((TurnedBlock.of(data, reference.fit, j, step) for j, step in steps.items()), key=_gain)
        if block.gain <= 0:
            return ()
        sides = [
            side
            for candidate in (block, block.others)
            if (side := self._refined(data, reference, candidate)) is not None
        ]
        if not sides:
            return ()
        nearest = min(side.deviation for side in sides)
        alike = [side for side in sides if side.deviation < nearest + DECISIVE]
        chosen = min(alike, key=lambda side: (side.outside, len(side.rows)))
        ratio = data.robot.joints[block.joint].gear_ratio
        why = f"turn of its motor ({abs(np.rad2deg(chosen.step)):.4g} deg at gear ratio {ratio:g})"
        return (self._fault(data, block.joint, chosen.rows, chosen.step, why, "does not agree with the position"),)

    def _refined(self, data: Measurements, reference: Reference, block: TurnedBlock) -> Turned | None:
        """Return the rows that need the turn by a robot that is fitted with it; None where it does not explain them."""
        pose = data.table["pose"].to_numpy()
        rows = np.flatnonzero(block.rows)
        read = rows_with_reading(data, block.joint, data.joints[:, block.joint] + block.step, np.arange(len(data)))
        for _ in range(REFINED):
            turned = self._turned(data, block, rows)
            again = Reference.of(turned, reference.explained.setup)
            if again is None:
                return None
            fit = again.fit
            before, after = (
                lengths(data.position - fit.predicted(conditions)) for conditions in (data.conditions, read)
            )
            needed = states(np.stack([state_cost(before, fit.scale), state_cost(after, fit.scale)]), CHANGE) == 1
            # Nearly all rows may need a turn that the fit has followed: the others must be right without it.
            if not all(
                len(set(pose[part])) >= FEWEST and fit.better(wrong[part], right[part]).mean() >= BELIEVED
                for part, wrong, right in ((needed, before, after), (~needed, after, before))
            ):
                return None
            settled, rows = np.array_equal(np.flatnonzero(needed), rows), np.flatnonzero(needed)
            if settled:
                break
        outside = _turns_outside(self._turned(data, block, rows), block.joint).any()
        return Turned(rows, block.step, fit.deviation, bool(outside))

    def _turned(self, data: Measurements, block: TurnedBlock, rows: np.ndarray) -> Measurements:
        turns = tuple(Correction(int(row) + 1, f"q{block.joint + 1}", offset=block.step) for row in rows)
        return correct(data, Fault(self.id, 0, (), "", "corrected", turns))

    def _fault(self, data: Measurements, joint: int, rows: np.ndarray, step: float, what: str, why: str) -> Fault:
        statement = (
            f"joint {joint + 1}: in LINES the reading {why}, and is right with one {what} "
            f"{'more' if step > 0 else 'less'}; corrected so, correct the file and check the joint's zero"
        )
        offset = float(f"{step:.10g}")  # as the table will say it
        corrections = [Correction(int(row) + 1, f"q{joint + 1}", offset=offset) for row in rows]
        return fault(self, data, joint + 1, corrections, "corrected", statement)


def _angle(data: Measurements, joint: int) -> np.ndarray:
    return np.asarray((data.joints @ data.robot.reading_matrix.T)[:, joint])


def _turns_outside(data: Measurements, joint: int) -> np.ndarray:
    """Return the sense (n_rows,) in which a joint past its limits would come back; zero inside, or where no limits are stated."""
    limits = data.robot.joints[joint].limits
    if limits is None:
        return np.zeros(len(data), dtype=int)
    angle = _angle(data, joint)
    return np.where(angle > limits[1] + PAST, -1, np.where(angle < limits[0] - PAST, 1, 0))
