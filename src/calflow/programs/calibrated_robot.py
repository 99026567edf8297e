"""The calibrated robot as a program's corrector: its controller's kinematics, and where it truly is.

A program's joint values and its values of external axes are of some of the robot's joints; how an arm of six joints stands is
read off the nominal robot's axes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import casadi as ca
import numpy as np
import scipy

from calflow.deployment.compensation import (
    DRAWN,
    Compensation,
    Targets,
    base_placement,
    compensate_rows,
    drawn_readings,
    features,
    landing,
)
from calflow.deployment.conventions import inverse
from calflow.deployment.prediction import Missing, as_stated
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.noise import members
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.model import Model, SymbolicPrediction
from calflow.programs.target import ArmPosture, Reason, Target
from calflow.robot.frames import placement_matrix
from calflow.robot.mechanism import Deflection, nominal_dimensions, pose
from calflow.robot.robot import Robot

SCALES = {"mm": 1e-3, "deg": np.pi / 180}
TURNING = (0, 3, 5)  # joints of an arm, from 0, that can turn more than once around
APART = 1e-3  # m: axes that pass a point by less meet in it
FREE = 6  # joints that it takes to mend place and orientation
ALIKE = 1e-5  # rad or m by which two ways to a pose must differ
MOST_CHANGE = np.deg2rad(10.0)  # a correction that turns a joint further is none: the target is at a singularity


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
            axis_unit = target.external[number].unit
            if axis_unit not in ("", unit):
                return f"gives external axis {number} in {axis_unit}, which by the robot file is in {unit}"
        return ""

    def at(self, target: Target) -> np.ndarray:
        """Return readings (n_joints,) [rad, or m] with those of the external axes at a target, the arm's at 0."""
        values = np.zeros(self.number)
        for number, joint in self.external.items():
            values[joint] = target.external[number].value * SCALES[self.units[number]]
        return values

    def readings(self, target: Target, arm: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return readings (n_joints,) of an arm (n,) where the external axes are as at a target."""
        values = self.at(target)
        values[list(self.arm)] = arm
        return values

    def unknown_words(self, targets: Iterable[Target]) -> tuple[str, ...]:
        """Say that targets give values of external axes that the robot has not; nothing where it gives none but 0."""
        others = [
            {number for number, axis in target.external.items() if axis.value and number not in self.external}
            for target in targets
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
class ArmGeometry:
    """How a robot's arm stands; of one of six revolute joints whose last three axes meet in a wrist its two sides are known.

    sides are by joint angles (n_joints,): above 0 where the wrist is before the first axis, and where the elbow is up. None: no
    such arm.
    """

    robot: Robot
    sides: ca.Function | None

    @staticmethod
    def of(robot: Robot) -> ArmGeometry:
        """Return a robot's arm, in axes that stand on the floor."""
        if len(robot.arm) != 6 or any(robot.joints[i].kind != "revolute" for i in robot.arm):
            return ArmGeometry(robot, None)
        q = ca.SX.sym("q", robot.n_joints)
        at = pose(robot, nominal_dimensions(robot), q, Deflection.zero(robot.n_joints))
        floor = at.links[robot.ground - 1][:3, :3].T if robot.ground else ca.SX.eye(3)
        axes = [floor @ at.joints[i][:3, 2:4] for i in robot.arm]
        directions, points = [axis[:, 0] for axis in axes], [axis[:, 1] for axis in axes]
        wrist, off = _meeting(directions[3:], points[3:])
        out, up, apart = (
            np.array(value).ravel()
            for value in ca.Function("stretched", [q], [wrist - points[0], directions[0], off])(
                np.zeros(robot.n_joints)
            )
        )
        outward = out - up * (up @ out)
        if apart.max() > APART or np.linalg.norm(outward) < APART:
            return ArmGeometry(robot, None)
        forward = _turned(ca.DM(outward), directions[0], q[robot.arm[0]])
        upper = points[2] - points[1]
        upper -= directions[1] * ca.dot(directions[1], upper)
        side = ca.cross(ca.if_else(directions[0][2] >= 0, directions[0], -directions[0]), forward)
        front = ca.dot(wrist - points[0], forward)
        elbow = ca.dot(side, ca.cross(upper, wrist - points[2]))
        return ArmGeometry(robot, ca.Function("sides", [q], [ca.densify(ca.vertcat(front, elbow))]))

    def postures(self, readings: np.ndarray) -> list[ArmPosture]:
        """Return how the arm stands at readings (n, n_joints): external axes move all of it, so as if they were at 0."""
        arm = [tuple(reading) for reading in readings[:, self.robot.arm].tolist()]
        if self.sides is None:
            return [ArmPosture(reading, None, None) for reading in arm]
        return [ArmPosture(reading, *side) for reading, side in zip(arm, self.sides_of(readings).tolist(), strict=True)]

    def sides_of(self, readings: np.ndarray) -> np.ndarray:
        """Return whether the wrist is in front, and the elbow up, (n, 2); (n, 0) of an arm without sides."""
        if self.sides is None or not len(readings):
            return np.zeros((len(readings), 0 if self.sides is None else 2), dtype=bool)
        flipped = readings.copy()
        flipped[:, self.robot.external] = 0.0
        return np.array(self.sides(self.robot.reading_matrix @ flipped.T)).T > 0


def _meeting(directions: Sequence[ca.SX], points: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX]:
    """The point that is nearest to three axes, and how far each is from it."""
    across = [ca.SX.eye(3) - direction @ direction.T for direction in directions]
    wrist = ca.solve(sum(across), sum(projector @ point for projector, point in zip(across, points, strict=True)))
    far = [ca.norm_2(projector @ (wrist - point)) for projector, point in zip(across, points, strict=True)]
    return wrist, ca.vertcat(*far)


def _turned(vector: ca.DM, axis: ca.SX, angle: ca.SX) -> ca.SX:
    return (
        vector * ca.cos(angle)
        + ca.cross(axis, vector) * ca.sin(angle)
        + axis * ca.dot(axis, vector) * (1 - ca.cos(angle))
    )


@dataclass(frozen=True)
class CalibratedRobot:
    """A calibrated robot: known as its controller does, and as it is. Poses are transforms (4, 4) in the robot's base, in SI.

    rows makes the rows of a program's targets, with what they carry and under which conditions, from readings (n, n_joints).
    in_order: the targets follow each other, so that the side from which each joint comes follows from them.
    """

    calibrated: CalibratedModel
    rows: Callable[[np.ndarray], Measurements]
    in_order: bool = False
    missing: Missing = "refuse"
    seed: int = 1

    def __post_init__(self) -> None:
        if not set(self.robot.arm) <= set(self.robot.chain(self.robot.n_joints)):
            raise refuse(
                "programs are of one arm up to the last link: expected further joints to be external axes",
                key=f"robot '{self.robot.name}'",
            )

    @property
    def robot(self) -> Robot:
        """The robot, placed where the calibration has it."""
        return self.calibrated.model.robot

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.robot.n_joints

    @cached_property
    def axes(self) -> Axes:
        """Which joints are the arm's, and which external axes."""
        return Axes.of(self.robot)

    def flange(self, readings: np.ndarray) -> np.ndarray:
        """Return where the controller takes the flange to be, (n, 4, 4), at readings (n, n_joints)."""
        seen, tool = _frames(self._rigid, np.zeros(0), self._conditions(readings))
        return inverse(self._stands) @ seen @ inverse(tool)

    def solutions(
        self, flanges: np.ndarray, starts: int, near: Sequence[np.ndarray | None], external: np.ndarray
    ) -> list[np.ndarray]:
        """Return for each of the poses (n, 4, 4) the readings (k, n_joints) at which the controller has the flange there.

        Of external (n, n_joints) the readings of external axes are what they have at each pose. They are looked for from so many
        joint positions, the more the surer it is that none is missed, and from readings near each, where there are such.
        """
        solutions: list[np.ndarray] = [np.empty((0, self.n_joints))] * len(flanges)
        places, of = np.unique(external[:, self.robot.external], axis=0, return_inverse=True)
        for place, rows in zip(places, members(of.ravel()), strict=True):
            ways = self._at_one_place(flanges[rows], starts, [near[i] for i in rows], place)
            for i, way in zip(rows, ways, strict=True):
                solutions[i] = way
        return solutions

    def continued(self, flanges: np.ndarray, begun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return readings (k, n_joints) that lead to poses (n, 4, 4) from others (n, n_joints), and to which of these."""
        return self._reached(flanges, np.arange(len(flanges)), begun)

    def _at_one_place(
        self, flanges: np.ndarray, starts: int, near: Sequence[np.ndarray | None], place: np.ndarray
    ) -> list[np.ndarray]:
        """The solutions where the external axes are at one place.

        Each pose is approached from so many joint positions that are nearest of many, and from the readings near it. Where the
        arm has sides and a wrist each side has but one way to turn over: then from fewer, on every side, and from those in which
        the wrist of what is found is turned over.
        """
        robot, drawn = self.robot, self._drawn(tuple(place))
        each = -(-starts // (2 * len(drawn))) if len(drawn) > 1 else starts
        close = [k for k, readings in enumerate(near) if readings is not None]
        begun, every = [reading[None] for reading in near if reading is not None], [np.array(close, dtype=int)]
        places = features(flanges[:, :3, 3], flanges[:, :3, :3])
        for readings, tree in drawn:
            nearest = tree.query(places, k=np.arange(1, min(each, len(readings)) + 1))[1]
            begun.append(readings[nearest].reshape(-1, self.n_joints))
            every.append(np.repeat(np.arange(len(flanges)), nearest.shape[1]))
        solutions, of = self._reached(flanges, np.concatenate(every), np.concatenate(begun))
        if self._arm.sides is not None:
            over, (fourth, fifth, sixth) = solutions.copy(), robot.arm[3:]
            over[:, [fourth, sixth]] = _wrapped(over[:, [fourth, sixth]] + np.pi)
            over[:, fifth] = _wrapped(-over[:, fifth])
            flipped, of_flipped = self._reached(flanges, of, over)
            solutions, of = np.concatenate([solutions, flipped]), np.concatenate([of, of_flipped])
        solutions, of = self._all_turns(solutions, of)
        order = np.argsort(of, kind="stable")
        ways = np.split(solutions[order], np.searchsorted(of[order], np.arange(1, len(flanges))))
        return [_different(way) for way in ways]

    @cached_property
    def _drawn(self) -> Callable[[tuple[float, ...]], list[tuple[np.ndarray, scipy.spatial.KDTree]]]:
        """Readings (n, n_joints) within the limits, and where their flanges are, of each of the arm's sides."""

        def drawn(place: tuple[float, ...]) -> list[tuple[np.ndarray, scipy.spatial.KDTree]]:
            readings = drawn_readings(self.robot, place, DRAWN, np.random.default_rng(self.seed))
            flanges = self.flange(readings)
            every = features(flanges[:, :3, 3], flanges[:, :3, :3])
            of_sides = members(np.unique(self._arm.sides_of(readings), axis=0, return_inverse=True)[1].ravel())
            return [(readings[rows], scipy.spatial.KDTree(every[rows])) for rows in of_sides]

        return cache(drawn)

    def _reached(self, flanges: np.ndarray, of: np.ndarray, begun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The readings found from starts for the poses that they are of (by number), and of which each is."""
        if not len(of):
            return begun, of
        aims = (self._stands @ flanges @ self._nominal_tool)[of]
        conditions = self._conditions(begun)
        landed = landing(self._rigid, np.zeros(0), conditions, Targets(aims[:, :3, 3], aims[:, :3, :3]), begun)
        return landed.readings[landed.reached], of[landed.reached]

    def postures(self, readings: np.ndarray) -> list[ArmPosture]:
        """Return how the arm stands at readings (n, n_joints)."""
        return self._arm.postures(readings)

    def corrected(self, readings: np.ndarray, names: Sequence[str]) -> tuple[Compensation, list[Reason | None]]:
        """Return readings that land the flange, and so a rigid tool, where the controller has it at given readings.

        Beside them stands of each what is in the way where it does not get there. names are what each is called in notes.
        """
        data = self.rows(readings)
        data = replace(data, table=data.table.assign(pose=list(names)))
        # of where base and tool are: the sides of approach come later
        stated = as_stated(self.calibrated, data, "widen")
        _, tool = _frames(stated.calibrated.model, self.calibrated.estimate, stated.data.conditions)
        aims = base_placement(stated.calibrated, stated.data.conditions) @ self.flange(readings) @ tool
        oriented = len(self.axes.arm) >= FREE
        asked = Targets(aims[:, :3, 3], aims[:, :3, :3] if oriented else None)
        landed = compensate_rows(
            self.calibrated, data, asked, start=readings, in_order=self.in_order, missing=self.missing
        )
        change = np.abs(landed.readings - readings).max(axis=1)
        reasons: list[Reason | None] = [
            None if reached and far < MOST_CHANGE else "singularity" if reached else "out of reach"
            for reached, far in zip(landed.reached, change, strict=True)
        ]
        lacking = (
            () if oriented else (f"{len(self.axes.arm)} joints cannot correct the orientation: the marker's place is",)
        )
        return replace(landed, notes=(*landed.notes, *lacking)), reasons

    @cached_property
    def _arm(self) -> ArmGeometry:
        return ArmGeometry.of(self.robot)

    @cached_property
    def _rigid(self) -> Model:
        return Model(self.robot, (), ())

    @cached_property
    def _stands(self) -> np.ndarray:
        return placement_matrix((*self.robot.base.origin, *self.robot.base.rotation))

    @cached_property
    def _nominal_tool(self) -> np.ndarray:
        return _frames(self._rigid, np.zeros(0), self._carried)[1][0]

    @cached_property
    def _carried(self) -> np.ndarray:
        return self.rows(np.zeros((1, self.n_joints))).stating(()).conditions

    def _conditions(self, readings: np.ndarray) -> np.ndarray:
        """The packed conditions of the nominal robot at readings (n, n_joints): it carries the same at all."""
        return np.vstack([readings.T, np.tile(self._carried[self.n_joints :], len(readings))])

    def _all_turns(self, readings: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same ways with whole turns of revolute joints more or less, within the limits, and of which pose each is."""
        robot = self.robot
        low, high = robot.limits.T
        every = readings @ robot.reading_matrix.T
        for joint in (i for i in robot.arm if robot.joints[i].kind == "revolute"):
            if robot.loop and joint in (robot.loop.joint - 2, robot.loop.joint - 1):
                continue
            turned = np.concatenate([every + 2 * np.pi * k * np.eye(self.n_joints)[joint] for k in (-2, -1, 0, 1, 2)])
            within = (turned[:, joint] >= low[joint] - ALIKE) & (turned[:, joint] <= high[joint] + ALIKE)
            every, of = turned[within], np.tile(of, 5)[within]
        return every @ robot.angle_matrix.T, of


def _frames(model: Model, p: np.ndarray, conditions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the measured tool frame is in the measuring frame, and in the flange's, (n, 4, 4) each."""

    def transform(rotation: ca.SX, point: ca.SX) -> ca.SX:
        return ca.vertcat(ca.horzcat(rotation, point), ca.SX([[0, 0, 0, 1]]))

    def frames(p: ca.SX, c: ca.SX, at: SymbolicPrediction) -> list[ca.SX]:
        return [transform(at.rotation, at.point), transform(at.tool, at.dims.markers @ at.row.marker)]

    tool, on_flange = model.figures("frames", frames, p, conditions)
    return tool, on_flange


def _different(readings: np.ndarray) -> np.ndarray:
    """Readings without those that are the same as one before."""
    alike = np.abs(readings[:, None] - readings).max(axis=2) <= ALIKE
    return np.asarray(readings[~np.triu(alike, 1).any(axis=0)])


def _wrapped(angles: np.ndarray) -> np.ndarray:
    return np.asarray((angles + np.pi) % (2 * np.pi) - np.pi)
