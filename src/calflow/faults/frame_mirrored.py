"""Frame mirrored: positions in a left-handed frame, an axis of which was turned or two of which were exchanged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.faults.base import Check, Correction, Fault, fault
from calflow.faults.joint_sign import FAR_OFF, ROWS, Signs, likely
from calflow.faults.reference import Models, Reference, chosen_rows, lengths, level, motion, rough
from calflow.measurements.measurements import Measurements

FAR_BETTER = 5.0  # times by which the mirrored positions must be met better than as read
ALIKE = 2.0  # times the mirrored positions' error up to which turned joints explain as much
NEARER = (
    0.05  # m or rad by which turned joints must leave known markers, or a known base, nearer to where they are stated
)
NEAR = np.deg2rad(45.0)  # of the base as stated: only there one of the six ways to mirror is meant
LARGEST = 2.5  # rad: a relative rotation beyond may as well be one the other way about

RIGHT = np.eye(3)
REFLECTIONS = {  # what was done to the axes, by the quantity that is mended
    "x": np.diag([-1.0, 1.0, 1.0]),
    "y": np.diag([1.0, -1.0, 1.0]),
    "z": np.diag([1.0, 1.0, -1.0]),
    "x and y": RIGHT[[1, 0, 2]],
    "x and z": RIGHT[[2, 1, 0]],
    "y and z": RIGHT[[0, 2, 1]],
}


@dataclass(frozen=True)
class PlacedRobot:
    """The nominal robot where it fits best: error [m], the base's turn (3, 3), and how far known markers are off [m]."""

    error: float
    turn: np.ndarray
    tool: float

    @staticmethod
    def of(few: Measurements, models: Models, signs: Signs = (), mirror: np.ndarray = RIGHT) -> PlacedRobot:
        """Place it with the signs of some joints (index from 0) turned, at positions that are mirrored (3, 3)."""
        conditions, position = few.conditions.copy(), few.position @ mirror.T
        conditions[list(signs)] *= -1
        turn, shift, _ = motion(models.nominal.position(models.nominal.nominal, conditions), position)
        fit = rough(models.placed, conditions, position, turn, shift)
        markers = {name for name, marker in few.robot.markers.items() if marker.known}
        moved = [value for p, value in zip(fit.model.parameters, fit.estimate, strict=True) if p.part in markers]
        error = float(level(lengths(position - fit.predicted(conditions))))
        return PlacedRobot(error, turn, float(np.abs(moved).max(initial=0.0)))


class FrameMirrored(Check):
    """Compare how the nominal robot meets the positions as read, and mirrored.

    Of a robot that is its own mirror image, a mirrored frame looks like joints that count the other way: of one such joint it is
    that joint; of several it is the frame, unless they leave a known base or marker nearer to its place.
    """

    id: ClassVar[str] = "frame-mirrored"
    title: ClassVar[str] = "the measuring frame is left-handed"
    order: ClassVar[int] = 5

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return one fault, of all positions."""
        few = data.only(chosen_rows(np.flatnonzero(data.train), ROWS, len(data)))
        far = FAR_OFF * reference.spread
        as_read = PlacedRobot.of(few, reference.models)
        if as_read.error < far:
            return ()
        mirror = REFLECTIONS["y"]
        mirrored = PlacedRobot.of(few, reference.models, mirror=mirror)
        if mirrored.error > min(far, as_read.error / FAR_BETTER):
            return ()
        expected = _expected(few, reference.models)
        from_there = {name: _angle(expected.T @ mend @ mirror @ mirrored.turn) for name, mend in REFLECTIONS.items()}
        name = min(from_there, key=from_there.__getitem__)
        signs = min(
            (j for j, error in likely(data, reference).items() if error < ALIKE * mirrored.error), key=len, default=()
        )
        if signs:
            turned = PlacedRobot.of(few, reference.models, signs)
            nearer = mirrored.tool - turned.tool
            if data.robot.base.known:
                nearer = max(nearer, from_there[name] - _angle(expected.T @ turned.turn))
            if len(signs) == 1 or nearer > NEARER:
                return ()
        certain = from_there[name] < NEAR and (data.robot.base.known or data.rotation is not None)
        return (self._fault(data, name, certain, as_read.error, mirrored.error, signs),)

    def _fault(
        self, data: Measurements, name: str, certain: bool, before: float, after: float, signs: tuple[int, ...]
    ) -> Fault:
        what = f"the axes {name} are exchanged" if " and " in name else f"the axis {name} points the other way"
        which = what if certain else f"{what}, or others, with the base turned otherwise"
        how = "exchanged" if " and " in name else "turned"
        *first, last = (str(joint + 1) for joint in signs) if signs else ("",)
        alike = f" (as they were if joints {', '.join(first)} and {last} counted the other way)" if signs else ""
        statement = (
            f"x, y, z are no right-handed frame: {which}; no base and no tool meet the positions to better than "
            f"{1e3 * before:.3g} mm, mirrored they are met to {1e3 * after:.2g} mm{alike}; {name} {how} here, correct the file"
        )
        # Other series have values of their own in these columns.
        rows = [0] if len(data.series) == 1 else range(1, len(data) + 1)
        factor = 1.0 if " and " in name else -1.0
        return fault(self, data, 0, [Correction(row, name, factor) for row in rows], "corrected", statement)


def _expected(few: Measurements, models: Models) -> np.ndarray:
    """Return how the base should be turned (3, 3): by what the tool's orientations do, whatever the tool, else as stated."""
    if few.rotation is not None:
        there = np.flatnonzero(np.isfinite(few.rotation).all(axis=(1, 2)))
        if len(there) > 3:
            predicted = Rotation.from_matrix(models.nominal.rotation(models.nominal.nominal, few.conditions[:, there]))
            seen = Rotation.from_matrix(few.rotation[there])
            axes, wanted = ((turns[1:] * turns[:-1].inv()).as_rotvec() for turns in (predicted, seen))
            clear = np.linalg.norm(axes, axis=1) < LARGEST
            if clear.sum() > 1:
                return np.asarray(Rotation.align_vectors(wanted[clear], axes[clear])[0].as_matrix())
    return np.asarray(Rotation.from_euler("XYZ", few.robot.base.rotation).as_matrix())


def _angle(turn: np.ndarray) -> float:
    """Return by how much a rotation (3, 3) turns [rad]."""
    return float(Rotation.from_matrix(turn).magnitude())
