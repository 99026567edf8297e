"""Registration: the unknown places of base, markers and device, from the measurements and the nominal robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from calflow.effects.geometry import DimensionError, Geometry
from calflow.estimation.accuracy import registered_on
from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise, Source
from calflow.files.deferred import Rotation
from calflow.files.problems import refuse
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from calflow.observations import Observation, observations
from calflow.observations.position import Position
from calflow.robot.frames import Vector, angles, vector
from calflow.robot.mechanism import Row, nominal_dimensions
from calflow.robot.parts import Base, Expected
from calflow.robot.robot import Robot

PARALLEL_TURNS = 0.999  # second over first singular value from which all motions turn about nearly the same line
NOMINAL_ERROR = 1e-3  # m and rad, standard error of a nominal robot: sets the scale of outliers in the robust fit
FEW_POSES = 3  # oriented poses below which the base's rotation is left to positions


def with_markers(robot: Robot, train: Measurements) -> Robot:
    """Return the robot with its unknown markers where positions in the measuring frame put them.

    A marker m on the flange (p, R) is seen at y = B (p + R m) + b. With the base known m is a mean; else Bᵀ y - R m - Bᵀ b = p is
    linear in Bᵀ, m and Bᵀ b, with Bᵀ an unconstrained matrix unless orientations determine it (see `base_turn`). Markers stated
    relative to the first shift with it. With too few rows, or too little rotation, markers stay as the robot file has them.
    """
    places = marker_places(robot)
    if not any(place >= 0 for place in places):
        return robot
    bare = replace(robot, base=Base(), tool_rotation=None,
                   markers={name: replace(marker, point=(0.0, 0.0, 0.0)) for name, marker in robot.markers.items()})  # fmt: skip
    model = build(bare, (), train.given)
    conditions = train.on(bare).conditions
    flange, turned = model.point(model.nominal, conditions), model.rotation(model.nominal, conditions)
    names = list(robot.markers)
    which = np.array([names.index(name) for name in train.table["marker"]])
    stated = np.array([marker.point for marker in robot.markers.values()])
    stands = Rotation.from_euler("XYZ", robot.base.rotation) if robot.base.known else base_turn(turned, train.rotation)
    nominal = flange + np.einsum("nij,nj->ni", turned, stated[which])
    origin = np.array(robot.base.origin) if robot.base.known else None
    solution = marker_shifts(places, which, train.position, nominal, turned, stands, origin)
    moved = {
        name: replace(marker, point=vector(stated[k] + solution[places[k]])) if places[k] >= 0 else marker
        for k, (name, marker) in enumerate(robot.markers.items())
    }
    return replace(robot, markers=moved)


def marker_places(robot: Robot) -> list[int]:
    """Return the index of each marker's unknown shift, -1 where its place is known."""
    numbers: list[int] = []
    for marker in robot.markers.values():
        number = max(numbers, default=-1) + 1
        numbers.append(numbers[0] if marker.relative_sd else -1 if marker.known else number)
    return numbers


def base_turn(turned: np.ndarray, measured: np.ndarray | None) -> Rotation | None:
    """Return the base's rotation B from nominal rotations R and measured B R X, (n, 3, 3), nan where missing (Shah 2013).

    B and X are leading singular vectors of the sum of R ⊗ B R X. None where all rotations share one axis.
    """
    oriented = np.zeros(0, dtype=int) if measured is None else np.flatnonzero(np.isfinite(measured).all(axis=(1, 2)))
    if measured is None or len(oriented) < FEW_POSES:
        return None
    total = np.einsum("nij,nkl->ikjl", measured[oriented], turned[oriented]).reshape(9, 9)
    left, sizes, _ = np.linalg.svd(total)
    if sizes[1] > PARALLEL_TURNS * sizes[0]:
        return None
    rotation = left[:, 0].reshape(3, 3)
    u, _, v = np.linalg.svd(np.sign(np.linalg.det(rotation)) * rotation)
    return Rotation.from_matrix(u @ v)


def marker_shifts(
    places: list[int], which: np.ndarray, position: np.ndarray, nominal: np.ndarray, turned: np.ndarray,
    stands: Rotation | None, origin: np.ndarray | None,
) -> np.ndarray:  # fmt: skip
    """Return the markers' shifts from their stated places (n_places, 3) [m], zero where the rows do not determine them.

    places: index of each marker's shift; which (n_rows,): marker of each row; position (n_rows, 3): measured; nominal (n_rows, 3):
    predicted in the base frame; turned (n_rows, 3, 3): rotation of the flange; stands, origin (3,): the base's pose where known.
    """
    n_places = max(places) + 1
    of_row = np.array(places)[which]
    shifts = np.zeros((len(which), 3, 3 * n_places))
    for k in range(n_places):
        shifts[of_row == k, :, 3 * k : 3 * k + 3] = turned[of_row == k]
    there = np.broadcast_to(np.eye(3), (len(which), 3, 3))
    if stands:
        matrix = np.concatenate([shifts, there], axis=2) if origin is None else shifts
        wanted = stands.inv().apply(position - (0.0 if origin is None else origin)) - nominal
    else:
        base = np.einsum("ij,nk->nijk", np.eye(3), position).reshape(-1, 3, 9)
        matrix, wanted = np.concatenate([-shifts, base, -there], axis=2), nominal
    solution, _, rank, _ = np.linalg.lstsq(matrix.reshape(-1, matrix.shape[2]), wanted.ravel(), rcond=1e-6)
    if rank < matrix.shape[2]:
        return np.zeros((n_places, 3))
    return solution[: 3 * n_places].reshape(n_places, 3)


@dataclass(frozen=True)
class PlacementErrors(Geometry):
    """The geometry's errors of base and tool alone; not an effect in its own right."""

    @cached_property
    def errors(self) -> tuple[DimensionError, ...]:
        return tuple(
            error for error in super().errors if error.field in ("base", "markers", "markers_turn", "tool_rotation")
        )


def registered(
    robot: Robot, observed: tuple[Observation, ...], train: Measurements
) -> tuple[Robot, tuple[Observation, ...]]:
    """Return the nominal robot with base and tool placed by the training data, and the observations placed by its points.

    A robot that is not observed from outside stands in the measuring frame's origin.
    """
    check_one_tool(train)
    if any(observation.from_outside for observation in observed):
        robot = _located(robot, observed, train)
    else:
        robot, observed = replace(robot, base=Base(fixed=True)), tuple(each.beside_base() for each in observed)
        if max(marker_places(robot)) >= 0 and all(each.units[0] == METRE for each in observed):
            robot = _placed(robot, train, _objects_placed(robot, observed, train))
    return robot, _objects_placed(robot, observed, train)


def _objects_placed(robot: Robot, observed: tuple[Observation, ...], train: Measurements) -> tuple[Observation, ...]:
    """Return the observations with their objects where the robot's points put them."""
    nominal = build(robot, (), train.given)
    series = [train.only(train.of_series(k)) for k in range(len(observed))]
    return tuple(
        registered_on(observation, rows, nominal, nominal.nominal) if len(rows) else observation
        for observation, rows in zip(observed, series, strict=True)
    )


def registered_model(data: Measurements) -> tuple[Model, Measurements]:
    """Return the model of the nominal robot, `registered` by the data's training rows, and the data as that robot's."""
    train = data.only(data.train)
    robot, observed = registered(data.robot, observations(train), train)
    return build(robot, (), data.given, observed), data.on(robot)


def check_one_tool(measured: Measurements) -> None:
    """Refuse, by InputError, orientations of markers on several links, as a robot has a single tool rotation."""
    if measured.rotation is None:
        return
    robot, oriented = measured.robot, np.isfinite(measured.rotation).all(axis=(1, 2))
    links = dict.fromkeys(robot.markers[name].on for name in measured.table["marker"][oriented])
    if len({robot.link(on) for on in links}) > 1:
        names = " and ".join(f"'{robot.links[robot.link(on)]}'" for on in links)
        raise refuse(f"orientations are measured on links {names}, of which the robot has one tool_rotation: expected those of one "
                     "link, positions alone on the others", key=f"robot '{robot.name}'")  # fmt: skip


def _located(robot: Robot, observed: tuple[Observation, ...], train: Measurements) -> Robot:
    """Return the robot with markers placed (`with_markers`), its base registered (Kabsch 1976), both refined robustly."""
    here = in_measuring_frame(observed, train)
    if not here.any():
        return robot
    train = train.only(here)
    robot = with_markers(robot, train)
    if robot.base.known:
        return robot
    at_origin = replace(robot, base=Base(known=False))
    nominal = build(at_origin, (), train.given)
    points = nominal.position(nominal.nominal, train.on(at_origin).conditions)
    centre, measured_centre = points.mean(axis=0), train.position.mean(axis=0)
    if np.linalg.matrix_rank(train.position - measured_centre, tol=1e-6) < 2:
        raise refuse("base.known = false: the measured points lie on one line or in one place, so nothing says where the robot "
                     "stands; measure points that are spread out, or state the base", key=f"robot '{robot.name}'")  # fmt: skip
    turn, _ = Rotation.align_vectors(train.position - measured_centre, points - centre)
    placed = _with_base(at_origin, turn, measured_centre - turn.apply(centre))

    if train.rotation is not None:
        oriented = np.isfinite(train.rotation).all(axis=(1, 2))
        seen = Rotation.from_matrix(nominal.rotation(nominal.nominal, train.conditions[:, oriented]))
        tool = ((turn * seen).inv() * Rotation.from_matrix(train.rotation[oriented])).mean()
        placed = replace(placed, tool_rotation=_angles(_tool(placed) * tool))

    return _placed(placed, train)


def _placed(placed: Robot, train: Measurements, observed: tuple[Observation, ...] = ()) -> Robot:
    """Return a roughly placed robot with base and tool refined by a robust fit to the training rows."""
    # Priors stated by name concern errors about the registered place, and do not apply here.
    bare = replace(placed, expected=tuple(expected for expected in placed.expected if not expected.name))
    model = Model(bare, (PlacementErrors(bare),), train.given, observed)
    rough = np.full(len(train), NOMINAL_ERROR)
    noise = Noise(
        rough, tuple[Source, ...]("estimated" for _ in train.series),
        rotation=None if train.rotation is None else rough,
    )  # fmt: skip
    result, _ = fit(LeastSquares.of(model, train.on(placed), noise), loss="soft_l1")
    corrections = result.estimate[result.model.columns(model.effects[0])]
    dims = PlacementErrors(placed).dimensions(ca.SX(corrections), nominal_dimensions(placed), Row.symbols(placed))
    moved = with_placement_errors(
        placed, *(np.array(ca.evalf(errors)) for errors in (dims.base, dims.tool_rotation, dims.markers))
    )
    return replace(moved, expected=about_places(placed, moved))


def in_measuring_frame(observed: tuple[Observation, ...], data: Measurements) -> np.ndarray:
    """Return the mask of rows that are positions in the measuring frame itself, shape (n_rows,)."""
    here = np.zeros(len(data), dtype=bool)
    for k, observation in enumerate(observed):
        rows = data.of_series(k)
        if isinstance(observation, Position):
            here[rows] = ~np.any(observation.which(data.table[rows]), axis=0)
    return here


def with_placement_errors(robot: Robot, base: np.ndarray, tool: np.ndarray, markers: np.ndarray) -> Robot:
    """Return the robot with errors of base (6, 1) and tool (3, 1), in their own frames, and markers at places (3, n_markers)."""
    turn = Rotation.from_euler("XYZ", robot.base.rotation)
    placed = {
        name: replace(marker, point=vector(point))
        for (name, marker), point in zip(robot.markers.items(), markers.T, strict=True)
    }
    origin = np.array(robot.base.origin) + turn.apply(base[:3, 0])
    moved = replace(_with_base(robot, turn * Rotation.from_euler("XYZ", base[3:, 0]), origin), markers=placed)
    if robot.tool_rotation is None:
        return moved
    return replace(moved, tool_rotation=_angles(_tool(robot) * Rotation.from_euler("XYZ", tool[:, 0])))


def about_places(stated: Robot, placed: Robot) -> tuple[Expected, ...]:
    """Return the robot's statements, those on known markers about where these now are instead of the robot file's places."""
    before, after = (np.array([marker.point for marker in robot.markers.values()]) for robot in (stated, placed))
    known = {
        name: k for k, (name, marker) in enumerate(stated.markers.items()) if marker.known and not marker.relative_sd
    }
    shifts = {f"{name}.{axis}": (after - before)[k, i] for name, k in known.items() for i, axis in enumerate("xyz")}
    beside = [k for k, marker in enumerate(stated.markers.values()) if marker.relative_sd]
    if beside and 0 in known.values():
        turn = Rotation.align_vectors(after[beside] - after[0], before[beside] - before[0])[0]
        shifts |= zip(("markers.rx", "markers.ry", "markers.rz"), turn.as_euler("XYZ"), strict=True)

    def about(expected: Expected) -> Expected:
        shift, held = float(shifts[expected.name]), (expected.value or 0.0) if expected.fixed else None
        mean, lower, upper, value = (
            None if figure is None else figure - shift
            for figure in (expected.mean, expected.lower, expected.upper, held)
        )
        return replace(expected, mean=mean, lower=lower, upper=upper, value=value)

    return tuple(about(expected) if expected.name in shifts else expected for expected in stated.expected)


def _with_base(robot: Robot, turn: Rotation, origin: np.ndarray) -> Robot:
    base = Base(origin=vector(origin), rotation=_angles(turn), known=False)
    return replace(robot, base=base)


def _tool(robot: Robot) -> Rotation:
    return Rotation.from_euler("XYZ", robot.tool_rotation or (0.0, 0.0, 0.0))


def _angles(turn: Rotation) -> Vector:
    return vector(angles(turn))
