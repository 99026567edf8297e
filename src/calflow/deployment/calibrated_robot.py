"""A calibrated robot: the maker's figures with what was identified of them added, as a robot of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from calflow.effects import Effect
from calflow.estimation.calibrated import Identified
from calflow.estimation.certainty import expected_point
from calflow.estimation.residual_field import NOT_PHYSICAL
from calflow.files.tables import column
from calflow.model import Model
from calflow.robot.angles import angles
from calflow.robot.chain import Deflection
from calflow.robot.conditions import OPTIONAL, Row
from calflow.robot.dimensions import Dimensions, Loads, nominal_dimensions, nominal_loads
from calflow.robot.frames import Frame, Step
from calflow.robot.parts import Vector, vector
from calflow.robot.robot import Robot
from calflow.robot.statics import State
from calflow.robot.transforms import placement

EVERYTHING = "everything that is not a figure of the robot"


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """What a robot's figures cannot hold, and what is lost without it."""

    effect: str = column("id of the effect, or what else it is")
    parts: tuple[str, ...] = column("the parts of the robot that it is of")
    mean_mm: float = column("how far the tool is off without it, mean over the measured rows", "mm")
    max_mm: float = column("the same, at most", "mm")


@dataclass(frozen=True)
class Exported:
    """A calibrated robot's own figures, which stand in the place of the maker's, and what they cannot hold.

    nominal is the maker's robot; without is all that is left out together, then each effect alone.
    """

    robot: Robot
    nominal: Robot
    without: tuple[LeftOut, ...]


def exported(known: Identified, rows: np.ndarray) -> Exported:
    """Return a calibrated model's robot, and what leaving the other effects out costs at packed rows (n_conditions, n)."""
    model, p = known.model, known.estimate
    kept = [effect for effect in model.effects if is_of_figures(effect)]
    others = [effect for effect in model.effects if effect not in kept]
    robot = _with(model.robot, _dimensions(model, kept, p))
    every = expected_point(known, rows)
    bare = Model(robot, (), model.given).point(np.zeros(0), rows)
    costs = [cost(EVERYTHING, (), every, bare)]
    for name in dict.fromkeys(effect.id for effect in others):
        own = [effect for effect in others if effect.id == name]
        rest = [effect for effect in model.effects if effect not in own]
        lean = replace(model, effects=tuple(rest))
        without = lean.point(np.concatenate([p[:0], *(p[model.columns(part)] for part in lean.parts)]), rows)
        parts = dict.fromkeys(one.part for effect in own for one in effect.declared)
        costs.append(cost(name, tuple(parts), model.point(p, rows), without))
    if known.field:
        costs.append(cost(f"residual field ({NOT_PHYSICAL})", (), every, model.point(p, rows)))
    lost = tuple(one for one in costs if one.max_mm > 0)  # what only the measuring device does costs nothing
    return Exported(robot, model.robot, lost if others or known.field else ())


def is_of_figures(effect: Effect) -> bool:
    """Whether an effect only changes lengths and angles of the robot, alike in every row."""
    robot, p = effect.robot, ca.SX.sym("p", len(effect.declared))
    conditions = ca.SX.sym("c", sum(Row.sizes(robot, OPTIONAL).values()))
    row, state = Row.unpack(robot, conditions, OPTIONAL), State.symbols(robot)
    dims = _packed(effect.dimensions(p, nominal_dimensions(robot), row))
    moves = effect.deflection(p, state, row, Deflection.zero(robot.n_joints))
    torque = ca.sparsify(ca.SX(effect.torque(p, state, row)))
    loads = _packed(effect.loads(p, nominal_loads(robot), row))
    elsewhere = not moves.is_zero or torque.nnz() > 0 or ca.depends_on(loads, p)
    return bool(ca.depends_on(dims, p) and not ca.depends_on(dims, conditions) and not elsewhere)


def _packed(parts: Dimensions | Loads) -> ca.SX:
    return ca.vertcat(*(ca.vec(ca.SX(part)) for part in vars(parts).values()))


def cost(name: str, parts: Sequence[str], every: np.ndarray, without: np.ndarray) -> LeftOut:
    """Return what leaving something out costs, from points (n, 3) [m] with it and without."""
    off = 1e3 * np.linalg.norm(every - without, axis=1)
    return LeftOut(effect=name, parts=tuple(parts), mean_mm=float(off.mean()), max_mm=float(off.max()))


def _dimensions(model: Model, kept: Sequence[Effect], p: np.ndarray) -> dict[str, np.ndarray]:
    """The dimensions as these effects have them, by field of `Dimensions`."""
    dims, row = nominal_dimensions(model.robot), Row.symbols(model.robot)
    for effect in kept:
        dims = effect.dimensions(ca.SX(p[model.columns(effect)]), dims, row)
    return {name: np.array(ca.DM(ca.evalf(ca.densify(ca.SX(value))))) for name, value in vars(dims).items()}


def _with(robot: Robot, dims: dict[str, np.ndarray]) -> Robot:
    """The robot with these dimensions for its own."""
    steps = iter(dims["steps"].ravel())
    frames = [_frame(joint.frame, [float(next(steps)) for _ in joint.frame.steps]) for joint in robot.joints]
    joints = tuple(replace(joint, frame=frame) for joint, frame in zip(robot.joints, frames, strict=True))
    stands = _matrix([*robot.base.origin, *robot.base.rotation]) @ _matrix(dims["base"].ravel())
    base = replace(robot.base, origin=vector(stands[:3, 3]), rotation=_angles(stands), known=True)
    markers = {
        name: replace(marker, point=vector(point), known=True)
        for (name, marker), point in zip(robot.markers.items(), dims["markers"].T, strict=True)
    }
    turn = dims["tool_rotation"].ravel()
    tool = robot.tool_rotation
    if tool is not None:
        tool = _angles(_matrix([0, 0, 0, *tool]) @ _matrix([0, 0, 0, *turn]))
    loop = robot.loop
    if loop is not None:
        crank, rod, rocker = map(float, dims["bars"].ravel())
        loop = replace(loop, crank=replace(loop.crank, length=crank), rod=replace(loop.rod, length=rod), rocker=rocker)
    return replace(robot, joints=joints, base=base, markers=markers, tool_rotation=tool, loop=loop)


def _frame(frame: Frame, values: Sequence[float]) -> Frame:
    """The frame with other values of its steps, in their order."""
    left = iter(values)

    def own(steps: Sequence[Step]) -> tuple[Step, ...]:
        return tuple(replace(step, value=next(left)) for step in steps)

    reach, mount = own(frame.reach), own(frame.mount)
    (turn,) = own([frame.turn])
    return replace(frame, reach=reach, mount=mount, turn=turn, body=own(frame.body))


def _matrix(six: Sequence[float] | np.ndarray) -> np.ndarray:
    return np.array(ca.DM(ca.evalf(placement(ca.DM(list(map(float, six)))))))


def _angles(stands: np.ndarray) -> Vector:
    return vector(angles(Rotation.from_matrix(stands[:3, :3])))
