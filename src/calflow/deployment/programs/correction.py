"""Correction: where a program must send the robot, as its controller counts, so that it lands where the program says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calflow.deployment.programs.axes import Axes
from calflow.deployment.programs.configuration import Posture


@dataclass(frozen=True)
class Correction:
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

    def posture(self, readings: np.ndarray) -> Posture:
        """Return how the arm stands at readings (n_joints,)."""
        ...

    def corrected(self, readings: np.ndarray, names: Sequence[str]) -> Correction:
        """Return readings that land the flange, and so a rigid tool on it, where the controller has it at given ones.

        names are what each is called in notes.
        """
        ...
