"""Encoder turn: readings that are off by a whole turn of the joint, or in a block of rows by one turn of its motor."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calflow.faults.base import Check, Correction, Fault, correct, fault
from calflow.faults.reference import Reference, changed, lengths
from calflow.faults.segments import cost, states
from calflow.measurements.measurements import Measurements

TURN = 2 * np.pi
PAST = np.deg2rad(1.0)  # past a limit: less may be rounding, or a limit of another kind
FEW = 0.2  # share of the rows: where more lie past a limit, the limit is doubted
FEWEST = 3  # poses in a block: a motor that has lost a turn stays so for a while
CHANGE = 8.0  # what the begin or end of a block costs: as much as a row that is off by 150 robust standard deviations
BELIEVED = 0.8  # share of a block's rows that must be far better with the turn back


class EncoderTurn(Check):
    """A whole turn leaves the robot in its place and shows by the joint's limits; a motor's turn shows by the positions."""

    id: ClassVar[str] = "encoder-turn"
    title: ClassVar[str] = "an encoder lost or gained a turn"
    order: ClassVar[int] = 30

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return the block with a motor's turn too much, and the rows with a whole turn too much, joint by joint."""
        faults = self._motor(data, reference)
        for found in faults:  # a motor's turn may have taken readings past a limit
            data = correct(data, found)
        return (*faults, *(found for joint in range(data.robot.n_joints) for found in self._whole(data, joint)))

    def _whole(self, data: Measurements, joint: int) -> list[Fault]:
        of = data.robot.joints[joint]
        if of.kind != "revolute" or of.limits is None:
            return []
        angle = (data.joints @ data.robot.reading_matrix.T)[:, joint]
        low, high = of.range
        turns = np.where(angle > high + PAST, -1, np.where(angle < low - PAST, 1, 0))
        inside = (angle + turns * TURN > low) & (angle + turns * TURN < high)
        if (turns != 0).mean() > FEW:
            return []
        found = []
        for turn in (-1, 1):
            rows = np.flatnonzero((turns == turn) & inside)
            if len(rows):
                found.append(
                    self._fault(data, joint, rows, turn * of.sign * TURN, "whole turn", "lies outside its limits")
                )
        return found

    def _motor(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        fit = reference.fit
        geared = [j for j, joint in enumerate(data.robot.joints) if joint.kind == "revolute" and joint.gear_ratio]
        before, pose = reference.miss, data.table["pose"].to_numpy()
        if not geared or len(set(pose[reference.gross])) < FEWEST:
            return ()
        best: tuple[int, int, float, np.ndarray] | None = None
        for joint in geared:
            for turn in (1, -1):
                step = turn * TURN / float(data.robot.joints[joint].gear_ratio or 1)
                rows = changed(data, joint, data.joints[:, joint] + step, np.arange(len(data)))
                after = lengths(data.position - fit.predicted(rows))
                block = states(np.stack([cost(before, fit.scale), cost(after, fit.scale)]), CHANGE) == 1
                better = fit.better(before[block], after[block])
                if len(set(pose[block])) < FEWEST or better.mean() < BELIEVED:
                    continue
                if best is None or better.sum() > best[0]:
                    best = (int(better.sum()), joint, step, np.flatnonzero(block))
        if best is None:
            return ()
        _, joint, step, found = best
        ratio = data.robot.joints[joint].gear_ratio
        why = f"turn of its motor ({abs(np.rad2deg(step)):.4g} deg at gear ratio {ratio:g})"
        return (self._fault(data, joint, found, step, why, "does not agree with the position"),)

    def _fault(self, data: Measurements, joint: int, rows: np.ndarray, step: float, what: str, why: str) -> Fault:
        statement = (
            f"joint {joint + 1}: in LINES the reading {why}, and is right with one {what} "
            f"{'more' if step > 0 else 'less'}; corrected so, correct the file and check the joint's zero"
        )
        offset = float(f"{step:.10g}")  # as the table will say it
        corrections = [Correction(int(row) + 1, f"q{joint + 1}", offset=offset) for row in rows]
        return fault(self, data, joint + 1, corrections, "corrected", statement)
