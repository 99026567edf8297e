"""Registration: where the robot stands in the measuring frame, when nobody wrote it down."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from calflow.effects.geometry import DimensionError, Geometry
from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise, Source
from calflow.estimation.unknown_markers import with_markers
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.robot.angles import angles
from calflow.robot.conditions import Row
from calflow.robot.dimensions import nominal_dimensions
from calflow.robot.parts import Base, Vector, vector
from calflow.robot.robot import Robot

NOMINAL_ERROR = 1e-3  # m and rad, of a robot as its maker describes it: only sets what counts as an outlier here


@dataclass(frozen=True)
class PlacementErrors(Geometry):
    """The part of the geometry that says where base and tool are; not an effect of its own."""

    @cached_property
    def errors(self) -> tuple[DimensionError, ...]:
        """The errors of base, markers and tool."""
        return tuple(
            error for error in super().errors if error.field in ("base", "markers", "markers_turn", "tool_rotation")
        )


def registered(
    robot: Robot, observed: tuple[Observation, ...], train: Measurements
) -> tuple[Robot, tuple[Observation, ...]]:
    """Return the robot with base and tool where the training data put them, all links as the maker says, and what is observed.

    A robot whose base and markers are known, or that nothing sees from outside, is returned as it is. Stations, anchors and what
    was touched are placed by the nominal robot's points.
    """
    if any(observation.from_outside for observation in observed):
        robot = _stood(robot, observed, train)
    else:
        robot = replace(robot, base=Base(fixed=True))
    nominal = build(robot, (), train.given)
    points, turned = (of(nominal.nominal, train.rows) for of in (nominal.point, nominal.rotation))
    placed = []
    for k, observation in enumerate(observed):
        own = train.of_series(k)
        placed.append(observation.registered(points[own], turned[own], train.table[own]) if own.any() else observation)
    return robot, tuple(placed)


def _stood(robot: Robot, observed: tuple[Observation, ...], train: Measurements) -> Robot:
    """The robot's unknown markers by what its flange does, its base by the rigid motion that takes its nominal points to the
    measured ones (Kabsch 1976), and base and tool together by a robust fit started there."""
    here = in_measuring_frame(observed, train)
    if not here.any():
        return robot
    train = train.only(here)
    robot = with_markers(robot, train)
    if robot.base.known:
        return robot
    at_origin = replace(robot, base=Base(known=False))
    nominal = build(at_origin, (), train.given)
    points = nominal.position(nominal.nominal, train.on(at_origin).rows)
    centre, measured_centre = points.mean(axis=0), train.position.mean(axis=0)
    if np.linalg.matrix_rank(train.position - measured_centre, tol=1e-6) < 2:
        raise refuse("base.known = false: the measured points lie on one line or in one place, so nothing says where the robot "
                     "stands; measure points that are spread out, or state the base", key=f"robot '{robot.name}'")  # fmt: skip
    turn, _ = Rotation.align_vectors(train.position - measured_centre, points - centre)
    placed = _with_base(at_origin, turn, measured_centre - turn.apply(centre))

    if train.rotation is not None:
        oriented = np.isfinite(train.rotation).all(axis=(1, 2))
        seen = Rotation.from_matrix(nominal.rotation(nominal.nominal, train.rows[:, oriented]))
        tool = ((turn * seen).inv() * Rotation.from_matrix(train.rotation[oriented])).mean()
        placed = replace(placed, tool_rotation=_angles(_tool(placed) * tool))

    model = Model(placed, (PlacementErrors(placed),), train.given)
    rough = None if train.rotation is None else np.full(len(train), NOMINAL_ERROR)
    noise = Noise(
        np.full(len(train), NOMINAL_ERROR), tuple[Source, ...]("estimated" for _ in train.series), rotation=rough
    )
    result, _ = fit(LeastSquares.of(model, train.on(placed), noise), loss="soft_l1")
    found = result.estimate[result.model.columns(model.effects[0])]
    dims = PlacementErrors(placed).dimensions(ca.SX(found), nominal_dimensions(placed), Row.symbols(placed))
    markers = np.array(ca.DM(ca.evalf(dims.markers))).T
    return _moved(
        placed, {(p.part, p.symbol): value for p, value in zip(model.parameters, found, strict=True)}, markers
    )


def in_measuring_frame(observed: tuple[Observation, ...], data: Measurements) -> np.ndarray:
    """Which rows are positions in the measuring frame itself, shape (n_rows,)."""
    here = np.zeros(len(data), dtype=bool)
    for k, observation in enumerate(observed):
        own = data.of_series(k)
        if isinstance(observation, Position):
            here[own] = ~observation.frames.which(data.table[own]).any(axis=0)
    return here


def _moved(robot: Robot, found: dict[tuple[str, str], float], markers: np.ndarray) -> Robot:
    turn = Rotation.from_euler("XYZ", robot.base.rotation)
    small = Rotation.from_euler("XYZ", [found["base", axis] for axis in ("rx", "ry", "rz")])
    origin = np.array(robot.base.origin) + turn.apply([found["base", axis] for axis in "xyz"])
    placed = {
        name: replace(marker, point=vector(point))
        for (name, marker), point in zip(robot.markers.items(), markers, strict=True)
    }
    moved = replace(_with_base(robot, turn * small, origin), markers=placed)
    if robot.tool_rotation is None:
        return moved
    tool = _tool(robot) * Rotation.from_euler("XYZ", [found["tool", axis] for axis in ("rx", "ry", "rz")])
    return replace(moved, tool_rotation=_angles(tool))


def _with_base(robot: Robot, turn: Rotation, origin: np.ndarray) -> Robot:
    base = Base(origin=vector(origin), rotation=_angles(turn), known=False)
    return replace(robot, base=base)


def _tool(robot: Robot) -> Rotation:
    return Rotation.from_euler("XYZ", robot.tool_rotation or (0.0, 0.0, 0.0))


def _angles(turn: Rotation) -> Vector:
    return vector(angles(turn))
