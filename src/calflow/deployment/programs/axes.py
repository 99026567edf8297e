"""Axes: which of a robot's joints a program's joint values and its values of external axes are of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calflow.deployment.programs.target import Program, Target
from calflow.robot.robot import Robot

SCALES = {"mm": 1e-3, "deg": np.pi / 180}
TURNING = (0, 3, 5)  # joints of an arm, from 0, that can turn more than once around


@dataclass(frozen=True)
class Axes:
    """The joints (from 0) of an arm, in the order in which programs give them, of all number of joints of a robot.

    external has the joint of each of the controller's external axes by its number from 1, and units what programs give its value
    in: deg or mm. endless are joints that turn without an end: a whole turn more leads to the same pose.
    """

    number: int
    arm: tuple[int, ...]
    external: Mapping[int, int]
    units: Mapping[int, str]
    endless: tuple[int, ...] = ()

    @staticmethod
    def of(robot: Robot) -> Axes:
        """Return a robot's axes."""
        external = {robot.joints[i].external or 0: i for i in robot.external}
        external = dict(sorted(external.items()))
        endless = tuple(i for i in robot.arm if np.isinf(robot.stops[i]).all())
        units = {k: robot.joints[i].shown[0] for k, i in external.items()}
        return Axes(robot.n_joints, tuple(robot.arm), external, units, endless)

    def turned(self, ways: np.ndarray) -> np.ndarray:
        """Return ways (n, n_joints) with a turn more or less of the endless ones of the joints of which programs count turns."""
        for joint in (self.arm[k] for k in TURNING if k < len(self.arm) and self.arm[k] in self.endless):
            ways = np.concatenate([ways + 2 * np.pi * turn * np.eye(self.number)[joint] for turn in (0, -1, 1)])
        return ways

    def turned_to(self, ways: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return ways (n, n_joints) with the whole turns of endless joints that bring them nearest to readings (n_joints,)."""
        endless = np.isin(np.arange(self.number), self.endless)
        return np.asarray(ways + 2 * np.pi * np.round((near - ways) / (2 * np.pi)) * endless)

    def lacking(self, target: Target) -> str:
        """Say what a target lacks to tell where the external axes are; empty where nothing."""
        for number, unit in self.units.items():
            if number not in target.external:
                return f"gives no value of external axis {number}, which the robot file has"
            said = target.external[number].unit
            if said not in ("", unit):
                return f"gives external axis {number} in {said}, which by the robot file is in {unit}"
        return ""

    def at(self, target: Target) -> np.ndarray:
        """Return readings (n_joints,) [rad, or m] with those of the external axes at a target, the arm's at 0."""
        found = np.zeros(self.number)
        for number, joint in self.external.items():
            found[joint] = target.external[number].value * SCALES[self.units[number]]
        return found

    def readings(self, target: Target, arm: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return readings (n_joints,) of an arm (n,) where the external axes are as at a target."""
        found = self.at(target)
        found[list(self.arm)] = arm
        return found

    def moved_to(self, readings: np.ndarray, target: Target) -> np.ndarray:
        """Return readings (n_joints,) with the external axes as at a target."""
        return self.readings(target, readings[list(self.arm)])

    def unknown_words(self, program: Program) -> tuple[str, ...]:
        """Say that a program gives values of external axes that the robot has not; nothing where it gives none but 0."""
        others = [
            {number for number, said in target.external.items() if said.value and number not in self.external}
            for target in program.targets
        ]
        numbers, count = sorted(set().union(*others)), sum(map(bool, others))
        if not numbers:
            return ()
        axes = f"external ax{'es' if len(numbers) > 1 else 'is'} {', '.join(map(str, numbers))}"
        give = "1 target gives" if count == 1 else f"{count} targets give"
        return (
            f"{give} values of {axes}: these stay as they are. The robot file has no such joint (external = {numbers[0]}): what "
            "that axis moves, as a rail under the robot or a table under the piece, counts as standing still",
        )
