"""The calibrated robot as a corrector of programs: the controller's nominal kinematics and the calibrated model.

It maps a program's axes to the robot's joints, finds all solutions of the nominal inverse kinematics, and determines
the posture (shoulder, elbow, wrist) of a six-joint arm from the nominal joint axes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import casadi as ca
import numpy as np
import scipy

from calflow.deployment.compensation import base_placement, compensate_rows
from calflow.deployment.inverse_kinematics import DRAWN, Targets, drawn_readings, features, landing
from calflow.deployment.prediction import Missing, as_stated
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.noise import members
from calflow.files.problems import refuse
from calflow.files.units import in_si
from calflow.measurements.measurements import Measurements
from calflow.model import Model, SymbolicPrediction
from calflow.programs.target import ArmPosture, Reason, Target
from calflow.robot.frames import placement_matrix
from calflow.robot.mechanism import nominal_posture
from calflow.robot.robot import Robot

TURNING = (0, 3, 5)  # joints of an arm, from 0, whose turns configurations count
MEETING = 1e-3  # m: distance below which axes count as meeting in a point
FREE = 6  # joints needed to correct position and orientation
SAME = 1e-5  # rad or m: difference below which two inverse-kinematics solutions are the same
LARGEST_CHANGE = np.deg2rad(10.0)  # a correction that turns a joint further shows that the target is at a singularity


@dataclass(frozen=True)
class Axes:
    """A robot's joints (from 0) as programs state them: those of the arm in order, and external axes by their numbers."""

    robot: Robot

    @cached_property
    def arm(self) -> list[int]:
        """The arm's joints."""
        return self.robot.arm

    @cached_property
    def external(self) -> dict[int, int]:
        """The joint of each external axis, by its number from 1."""
        return dict(sorted((self.robot.joints[i].external or 0, i) for i in self.robot.external))

    @cached_property
    def _endless(self) -> np.ndarray:
        """Which joints are the arm's and have no limits (n_joints,)."""
        arm = np.isin(np.arange(self.robot.n_joints), self.arm)
        return np.asarray(arm & np.isinf(self.robot.stops).all(axis=1))

    def with_turns(self, ways: np.ndarray) -> np.ndarray:
        """Return solutions (n, n_joints), also a turn further of endless joints whose turns configurations count."""
        for joint in (self.arm[k] for k in TURNING if k < len(self.arm) and self._endless[self.arm[k]]):
            ways = np.concatenate([ways + 2 * np.pi * turn * np.eye(len(self._endless))[joint] for turn in (0, -1, 1)])
        return ways

    def turned_near(self, ways: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return solutions (n, n_joints), endless joints turned by whole turns nearest to readings (n_joints,)."""
        return np.asarray(ways + 2 * np.pi * np.round((near - ways) / (2 * np.pi)) * self._endless)

    def external_problem(self, target: Target) -> str:
        """Return which external axis a target leaves undetermined, in words; empty if none."""
        for number, joint in self.external.items():
            if number not in target.external:
                return f"gives no value of external axis {number}, which the robot file has"
            stated, unit = target.external[number].unit, self.robot.joints[joint].shown[0]
            if stated not in ("", unit):
                return f"gives external axis {number} in {stated}, which by the robot file is in {unit}"
        return ""

    def external_readings(self, target: Target) -> np.ndarray:
        """Return readings (n_joints,) [rad or m] with the external axes of a target, and zero for the arm."""
        values = np.zeros(self.robot.n_joints)
        for number, joint in self.external.items():
            values[joint] = in_si(self.robot.joints[joint].shown[0], target.external[number].value)
        return values

    def readings(self, target: Target, arm: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return readings (n_joints,) of the arm's readings (n,) and the external axes of a target."""
        values = self.external_readings(target)
        values[self.arm] = arm
        return values

    def unknown_axes_note(self, targets: Iterable[Target]) -> tuple[str, ...]:
        """Return a note if targets give non-zero values of external axes that the robot does not have."""
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
            "that axis moves, as a rail under the robot or a table under the workpiece, counts as fixed",
        )


@dataclass(frozen=True)
class ArmGeometry:
    """The posture of a robot's arm; shoulder and elbow sides exist for six revolute joints with a spherical wrist.

    sides: a function of joint angles (n_joints,), positive where the wrist is in front of the first axis, and where the
    elbow is up; None for other arms.
    """

    robot: Robot
    sides: ca.Function | None

    @staticmethod
    def of(robot: Robot) -> ArmGeometry:
        """Return the geometry of a robot's arm, in axes fixed to the ground."""
        if len(robot.arm) != 6 or any(robot.joints[i].kind != "revolute" for i in robot.arm):
            return ArmGeometry(robot, None)
        q = ca.SX.sym("q", robot.n_joints)
        at = nominal_posture(robot, q)
        floor = at.links[robot.ground - 1][:3, :3].T if robot.ground else ca.SX.eye(3)
        axes = [floor @ at.joints[i][:3, 2:4] for i in robot.arm]
        directions, points = [axis[:, 0] for axis in axes], [axis[:, 1] for axis in axes]
        turned = floor @ at.joints[robot.arm[0]][:3, :3]
        wrist, off = _nearest_point(directions[3:], points[3:])
        stretched = ca.Function("stretched", [q], [wrist - points[0], directions[0], off, turned])
        out, up, apart, home = (np.array(value).squeeze() for value in stretched(np.zeros(robot.n_joints)))
        outward = out - up * (up @ out)
        if apart.max() > MEETING or np.linalg.norm(outward) < MEETING:
            return ArmGeometry(robot, None)
        forward = turned @ ca.DM(home.T @ outward)
        upper = points[2] - points[1]
        upper -= directions[1] * ca.dot(directions[1], upper)
        side = ca.cross(ca.if_else(directions[0][2] >= 0, directions[0], -directions[0]), forward)
        front = ca.dot(wrist - points[0], forward)
        elbow = ca.dot(side, ca.cross(upper, wrist - points[2]))
        return ArmGeometry(robot, ca.Function("sides", [q], [ca.densify(ca.vertcat(front, elbow))]))

    def postures(self, readings: np.ndarray) -> list[ArmPosture]:
        """Return the arm's postures at readings (n, n_joints); external axes move all of it and have no effect."""
        arm = [tuple(reading) for reading in readings[:, self.robot.arm].tolist()]
        if self.sides is None:
            return [ArmPosture(reading, None, None) for reading in arm]
        return [ArmPosture(reading, *side) for reading, side in zip(arm, self.sides_of(readings).tolist(), strict=True)]

    def sides_of(self, readings: np.ndarray) -> np.ndarray:
        """Return whether the wrist is in front and the elbow up, (n, 2); (n, 0) for an arm without sides."""
        if self.sides is None or not len(readings):
            return np.zeros((len(readings), 0 if self.sides is None else 2), dtype=bool)
        flipped = readings.copy()
        flipped[:, self.robot.external] = 0.0
        return np.array(self.sides(self.robot.reading_matrix @ flipped.T)).T > 0


def _nearest_point(directions: Sequence[ca.SX], points: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return the point nearest to three axes (least squares), and the distance of each axis from it (3,)."""
    across = [ca.SX.eye(3) - direction @ direction.T for direction in directions]
    wrist = ca.solve(sum(across), sum(projector @ point for projector, point in zip(across, points, strict=True)))
    far = [ca.norm_2(projector @ (wrist - point)) for projector, point in zip(across, points, strict=True)]
    return wrist, ca.vertcat(*far)


@dataclass(frozen=True)
class CorrectedReadings:
    """Readings (n, n_joints) with which the real flange lands where targets have it; remaining (n,), sd (n, 3) [m].

    ways: for each target the readings (k, n_joints) that land from the side of each of its moves; a target has one
    correction, the middle of these. reasons: why a target is not reached, or None.
    """

    readings: np.ndarray
    ways: tuple[np.ndarray, ...]
    remaining: np.ndarray
    sd: np.ndarray
    reasons: tuple[Reason | None, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class CalibratedRobot:
    """A calibrated robot with its controller's nominal kinematics; poses (4, 4) are in the robot's base, in SI.

    rows: returns the rows of readings (n, n_joints), with payload and conditions; in_order: whether the robot moves in
    the order of the file, so that each joint's side of approach follows from it.
    """

    calibrated: CalibratedModel
    rows: Callable[[np.ndarray], Measurements]
    in_order: bool = False
    missing: Missing = "refuse"
    seed: int = 1

    def __post_init__(self) -> None:
        if not set(self.robot.arm) <= set(self.robot.chain(self.robot.n_joints)):
            raise refuse(
                "a program moves one arm up to the last link: expected all other joints to be external axes",
                key=f"robot '{self.robot.name}'",
            )

    @property
    def robot(self) -> Robot:
        """The robot, with the base placement of the calibration."""
        return self.calibrated.model.robot

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.robot.n_joints

    @cached_property
    def axes(self) -> Axes:
        """The joints of the arm and the external axes."""
        return Axes(self.robot)

    def flange(self, readings: np.ndarray) -> np.ndarray:
        """Return the flange poses (n, 4, 4) of the controller's forward kinematics at readings (n, n_joints)."""
        seen, tool = _frames(self._rigid, np.zeros(0), self._conditions(readings))
        return np.linalg.inv(self._base) @ seen @ np.linalg.inv(tool)

    def solutions(
        self, flanges: np.ndarray, starts: int, near: Sequence[np.ndarray | None], external: np.ndarray
    ) -> list[np.ndarray]:
        """Return for each flange pose (n, 4, 4) all solutions (k, n_joints) of the controller's inverse kinematics.

        external (n, n_joints): readings with those of the external axes at each pose. The iteration starts from so many
        joint positions (more starts miss fewer solutions), and from the readings near each pose if given.
        """
        solutions: list[np.ndarray] = [np.empty((0, self.n_joints))] * len(flanges)
        places, of = np.unique(external[:, self.robot.external], axis=0, return_inverse=True)
        for place, rows in zip(places, members(of.ravel()), strict=True):
            ways = self._at_one_place(flanges[rows], starts, [near[i] for i in rows], place)
            for i, way in zip(rows, ways, strict=True):
                solutions[i] = way
        return solutions

    def continued(self, flanges: np.ndarray, begun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the solutions (k, n_joints) for poses (n, 4, 4) from initial readings, and their pose indices (k,)."""
        return self._reached(flanges, np.arange(len(flanges)), begun)

    def _at_one_place(
        self, flanges: np.ndarray, starts: int, near: Sequence[np.ndarray | None], place: np.ndarray
    ) -> list[np.ndarray]:
        """Return the solutions at the same position of the external axes.

        The iteration starts from the nearest of many drawn joint positions, and from the readings near each pose. With
        a spherical wrist fewer starts per side suffice: the second solution starts from the flipped wrist of the first.
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
        return [_unique(way) for way in ways]

    @cached_property
    def _drawn(self) -> Callable[[tuple[float, ...]], list[tuple[np.ndarray, scipy.spatial.KDTree]]]:
        """For each side of the arm, drawn readings (n, n_joints) and a search tree of their flange poses."""

        def drawn(place: tuple[float, ...]) -> list[tuple[np.ndarray, scipy.spatial.KDTree]]:
            readings = drawn_readings(self.robot, place, DRAWN, np.random.default_rng(self.seed))
            flanges = self.flange(readings)
            every = features(flanges[:, :3, 3], flanges[:, :3, :3])
            of_sides = members(np.unique(self._arm.sides_of(readings), axis=0, return_inverse=True)[1].ravel())
            return [(readings[rows], scipy.spatial.KDTree(every[rows])) for rows in of_sides]

        return cache(drawn)

    def _reached(self, flanges: np.ndarray, of: np.ndarray, begun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the converged solutions and their pose indices; of: the pose index of each start."""
        if not len(of):
            return begun, of
        aims = (self._base @ flanges @ self._nominal_tool)[of]
        conditions = self._conditions(begun)
        landed = landing(self._rigid, np.zeros(0), conditions, Targets(aims[:, :3, 3], aims[:, :3, :3]), begun)
        return landed.readings[landed.reached], of[landed.reached]

    def postures(self, readings: np.ndarray) -> list[ArmPosture]:
        """Return the postures of the arm at readings (n, n_joints)."""
        return self._arm.postures(readings)

    def corrected(
        self, readings: np.ndarray, tools: np.ndarray, names: Sequence[str], runs: Sequence[Sequence[int]]
    ) -> CorrectedReadings:
        """Return readings that bring the real flange to its nominal pose at given readings (n, n_joints).

        tools: places (n, 3) [m] on the flange to which the standard deviations apply (to the marker, where an arm cannot
        correct its orientation); names: the targets' names in notes; runs: which target each move goes to, in order, every
        target once or more, in runs before which nothing is known of where the robot is.
        """
        runs = runs if self.in_order else [range(len(readings))]
        order = np.concatenate(runs).astype(int)
        moves = [np.flatnonzero(order == k) for k in range(len(readings))]
        readings, tools = readings[order], tools[order]
        data = self.rows(readings)
        data = replace(data, table=data.table.assign(pose=np.array(names)[order]))
        # For base and tool only, so that sides of approach may be missing here.
        stated = as_stated(self.calibrated, data, "widen")
        _, tool = _frames(stated.calibrated.model, self.calibrated.estimate, stated.data.conditions)
        aims = base_placement(stated.calibrated, stated.data.conditions) @ self.flange(readings) @ tool
        oriented = len(self.axes.arm) >= FREE
        asked = Targets(aims[:, :3, 3], aims[:, :3, :3] if oriented else None)
        of_run = np.repeat(np.arange(len(runs)), [len(run) for run in runs])
        landed = [
            compensate_rows(
                self.calibrated, data.only(one), asked.only(one), start=readings[one], in_order=self.in_order,
                missing=self.missing, places=tools[one] if oriented else None,
            )
            for one in of_run == np.arange(len(runs))[:, None]
        ]  # fmt: skip
        found, remaining, sd, reached = (
            np.concatenate([getattr(run, name) for run in landed])
            for name in ("readings", "remaining", "sd", "reached")
        )
        notes = tuple(dict.fromkeys(note for run in landed for note in run.notes))
        change = np.abs(found - readings).max(axis=1)
        reasons: list[Reason | None] = [
            "out of reach" if not reached[k].all() else None if change[k].max() < LARGEST_CHANGE else "singularity"
            for k in moves
        ]
        note = f"{len(self.axes.arm)} joints cannot correct the orientation: only the marker's position is corrected"
        ways = tuple(found[k] for k in moves)
        return CorrectedReadings(
            np.stack([(way.max(axis=0) + way.min(axis=0)) / 2 for way in ways]),
            ways,
            np.array([remaining[k].max() for k in moves]),
            np.stack([sd[k].max(axis=0) for k in moves]),
            tuple(reasons),
            notes if oriented else (*notes, note),
        )

    @cached_property
    def _arm(self) -> ArmGeometry:
        return ArmGeometry.of(self.robot)

    @cached_property
    def _rigid(self) -> Model:
        return Model(self.robot, (), ())

    @cached_property
    def _base(self) -> np.ndarray:
        return placement_matrix((*self.robot.base.origin, *self.robot.base.rotation))

    @cached_property
    def _nominal_tool(self) -> np.ndarray:
        return _frames(self._rigid, np.zeros(0), self._carried)[1][0]

    @cached_property
    def _carried(self) -> np.ndarray:
        return self.rows(np.zeros((1, self.n_joints))).stating(()).conditions

    def _conditions(self, readings: np.ndarray) -> np.ndarray:
        """Return the packed conditions of the nominal robot at readings (n, n_joints), with the same payload."""
        return np.vstack([readings.T, np.tile(self._carried[self.n_joints :], len(readings))])

    def _all_turns(self, readings: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return solutions with all whole turns of revolute joints within the limits, and their pose indices."""
        robot = self.robot
        low, high = robot.limits.T
        every = readings @ robot.reading_matrix.T
        for joint in (i for i in robot.arm if robot.joints[i].kind == "revolute"):
            if robot.loop and joint in (robot.loop.joint - 2, robot.loop.joint - 1):
                continue
            turned = np.concatenate([every + 2 * np.pi * k * np.eye(self.n_joints)[joint] for k in (-2, -1, 0, 1, 2)])
            within = (turned[:, joint] >= low[joint] - SAME) & (turned[:, joint] <= high[joint] + SAME)
            every, of = turned[within], np.tile(of, 5)[within]
        return every @ robot.angle_matrix.T, of


def _frames(model: Model, p: np.ndarray, conditions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses of the measured tool frame in the measuring frame and in the flange frame, (n, 4, 4) each."""

    def transform(rotation: ca.SX, point: ca.SX) -> ca.SX:
        return ca.vertcat(ca.horzcat(rotation, point), ca.SX([[0, 0, 0, 1]]))

    def frames(p: ca.SX, c: ca.SX, at: SymbolicPrediction) -> list[ca.SX]:
        return [transform(at.rotation, at.point), transform(at.tool, at.dims.markers @ at.row.marker)]

    tool, on_flange = model.figures("frames", frames, p, conditions)
    return tool, on_flange


def _unique(readings: np.ndarray) -> np.ndarray:
    """Return readings without duplicates of earlier ones."""
    alike = np.abs(readings[:, None] - readings).max(axis=2) <= SAME
    return np.asarray(readings[~np.triu(alike, 1).any(axis=0)])


def _wrapped(angles: np.ndarray) -> np.ndarray:
    return np.asarray((angles + np.pi) % (2 * np.pi) - np.pi)
