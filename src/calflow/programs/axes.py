"""Axes: which of a robot's joints a program's joint values and its values of external axes are of.

Correction: where a program must send the robot, as its controller counts, so that it lands where the program says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calflow.programs.configuration import ArmPosture
from calflow.programs.target import Program, Target
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


@dataclass(frozen=True)
class CorrectedReadings:
    """Joint readings (n, n_joints) [rad, or m] that land a tool where the nominal robot has it at others.

    remaining (n,) [m] and turned (n,) [rad] are how far from there it lands by the calibrated model; why (n,) says what is in the
    way where it does not get there, and is empty elsewhere. notes say what else is to be known.
    """

    readings: np.ndarray
    remaining: np.ndarray
    turned: np.ndarray
    why: tuple[str, ...]
    notes: tuple[str, ...] = ()


class Corrector(Protocol):
    """What knows a robot as its controller does, and as it is. Poses are transforms (4, 4) in the robot's base, in SI."""

    @property
    def axes(self) -> Axes:
        """Which joints are the arm's, and which external axes."""
        ...

    def flange(self, readings: np.ndarray) -> np.ndarray:
        """Return where the controller takes the flange to be, (n, 4, 4), at readings (n, n_joints)."""
        ...

    def solutions(
        self, flanges: np.ndarray, starts: int, near: Sequence[np.ndarray | None], external: np.ndarray
    ) -> Sequence[np.ndarray]:
        """Return for each of the poses (n, 4, 4) the readings (k, n_joints) at which the controller has the flange there.

        Of external (n, n_joints) the readings of external axes are what they have at each pose.
        They are looked for from so many joint positions, the more the surer it is that none is missed, and from readings near
        each, where there are such.
        """
        ...

    def posture(self, readings: np.ndarray) -> ArmPosture:
        """Return how the arm stands at readings (n_joints,)."""
        ...

    def corrected(self, readings: np.ndarray, names: Sequence[str]) -> CorrectedReadings:
        """Return readings that land the flange, and so a rigid tool on it, where the controller has it at given ones.

        names are what each is called in notes.
        """
        ...
