"""Statics: the loads on every joint, link and bearing, as the gradient of one potential energy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from calflow.files.problems import refuse
from calflow.robot.chain import Deflection, Posture, marker_point, pose, reachable
from calflow.robot.conditions import Row
from calflow.robot.dimensions import Dimensions, Loads, nominal_dimensions, nominal_loads, symbols_like
from calflow.robot.robot import Robot
from calflow.robot.transforms import apply

SMALLEST_RATED = 1.0  # Nm, where gravity loads no joint at all


@dataclass(frozen=True)
class State:
    """What one row's loads do, at the deflected pose.

    q are the driven joints' angles without deflection, torque what the loads exert on the driven joints (positive where
    they push q up; the motors hold its opposite). bearing and link are the wrenches (fx, fy, fz, mx, my, mz) that the
    loads exert at the frames of `Deflection`, in those frames. N, Nm. down (3,) is gravity's direction in the flange's frame.
    """

    q: ca.SX
    torque: ca.SX
    bearing: ca.SX
    link: ca.SX
    down: ca.SX

    @staticmethod
    def symbols(robot: Robot) -> State:
        """Return a state of symbols."""
        n = robot.n_joints
        sizes = {"q": (n, 1), "torque": (n, 1), "bearing": (6, n), "link": (6, n + 1), "down": (3, 1)}
        return State(**{name: ca.SX.sym(name, *size) for name, size in sizes.items()})

    def with_torque(self, extra: ca.SX | float) -> State:
        """Return the state with more torque on the driven joints [Nm]."""
        return replace(self, torque=self.torque + extra)


def potential_energy(robot: Robot, loads: Loads, row: Row, at: Posture) -> ca.SX:
    """Return the energy [J] of all links, the loop's bars and the row's payload in gravity."""
    gravity = ca.DM(robot.gravity)
    energy = ca.SX(0)
    for i, frame in enumerate(at.links):
        energy -= loads.mass[i] * ca.dot(gravity, at.grounded(robot, apply(frame, loads.com[:, i])))
    for i, frame in enumerate(at.bars):
        energy -= loads.bar_mass[i] * ca.dot(gravity, at.grounded(robot, apply(frame, loads.bar_com[:, i])))
    for i in range(len(robot.payloads)):
        mass = row.payload[i] * loads.payload_mass[i]
        energy -= mass * ca.dot(gravity, at.grounded(robot, apply(at.flange, loads.payload_com[:, i])))
    return energy


def state(robot: Robot, dims: Dimensions, loads: Loads, row: Row, deflected: Deflection) -> State:
    """Return the loads on the mechanism in a row's deflected pose.

    Each is minus the energy's derivative with respect to the motion it works on, so one expression covers joints,
    bearings, link ends and the closed loop. An applied wrench (row.wrench: force at the marker and moment, in the base
    frame) adds its virtual work; measured motor torques, where the row has them, replace the computed joint torques.
    """
    n = robot.n_joints
    there = (*vars(dims).values(), row.q, *vars(deflected).values())
    force, down = _of_gravity(robot)(*there, *vars(loads).values(), row.payload)
    if row.wrench.nnz():
        force += _of_wrench(robot)(*there, row.marker, row.wrench)
    force = ca.sparsify(force)
    torque = -row.torque if row.torque.nnz() else force[:n]
    return State(row.q, torque, ca.reshape(force[n : 7 * n], 6, n), ca.reshape(force[7 * n :], 6, n + 1), down)


@dataclass(frozen=True)
class _Symbols:
    """A robot's dimensions, joint angles and deflection as symbols, and its frames there."""

    dims: Dimensions
    q: ca.SX
    deflection: Deflection
    at: Posture

    @staticmethod
    def of(robot: Robot) -> _Symbols:
        dims, q = symbols_like(nominal_dimensions(robot)), ca.SX.sym("q", robot.n_joints)
        here = symbols_like(Deflection.zero(robot.n_joints))
        return _Symbols(dims, q, here, pose(robot, dims, q, here))

    @property
    def inputs(self) -> tuple[ca.SX, ...]:
        """The symbols, one after another."""
        return (*vars(self.dims).values(), self.q, *vars(self.deflection).values())

    @property
    def motion(self) -> ca.SX:
        """The deflection, packed."""
        return ca.vertcat(self.deflection.joint, ca.vec(self.deflection.bearing), ca.vec(self.deflection.link))


@lru_cache(maxsize=16)
def _of_gravity(robot: Robot) -> ca.Function:
    """Return the function (dimensions, q, deflection, loads, payload) -> forces of gravity along every motion, and its direction.

    To call it takes a twentieth of what it takes to differentiate the energy anew.
    """
    there, loads, row = _Symbols.of(robot), symbols_like(nominal_loads(robot)), Row.symbols(robot, ())
    force = ca.gradient(-potential_energy(robot, loads, row, there.at), there.motion)
    down = there.at.flange[:3, :3].T @ there.at.down(robot)
    return ca.Function("gravity", [*there.inputs, *vars(loads).values(), row.payload], [force, down])


@lru_cache(maxsize=16)
def _of_wrench(robot: Robot) -> ca.Function:
    """Return the function (dimensions, q, deflection, marker, wrench) -> forces of the wrench along every motion."""
    there, row = _Symbols.of(robot), Row.symbols(robot, ("wrench",))
    work = ca.dot(row.wrench[:3], marker_point(there.dims, there.at, row.marker))
    force = ca.gradient(work, there.motion) + _moment_work(row.wrench[3:], there.at.flange, there.motion)
    return ca.Function("wrench", [*there.inputs, row.marker, row.wrench], [force])


def gravity_torque(robot: Robot) -> ca.Function:
    """Return the nominal robot's function (q, payload one-hot) -> motor torques that hold it still [Nm]."""
    packed = ca.SX.sym("row", sum(Row.sizes(robot).values()))
    q = ca.SX.sym("q", robot.n_joints)
    row = replace(Row.unpack(robot, packed), q=q)
    still = Deflection.zero(robot.n_joints)
    loads = state(robot, nominal_dimensions(robot), nominal_loads(robot), row, still)
    return ca.Function("gravity_torque", [q, row.payload], [ca.densify(-loads.torque)])


def moment_torques(robot: Robot) -> ca.Function:
    """Return the nominal robot's function (q) -> derivatives of the holding motor torques by all that the links may weigh.

    These are the links' and bars' masses [kg] and first moments [kg m], in which torques are linear whatever the masses are
    (Khalil and Dombre 2002); (n_joints, 4 times the number of bodies), without payload.
    """
    q, nominal = ca.SX.sym("q", robot.n_joints), nominal_loads(robot)
    free = Loads(
        ca.SX.sym("mass", nominal.mass.shape), ca.SX.sym("com", nominal.com.shape), ca.SX.sym("bar", nominal.bar_mass.shape),
        ca.SX.sym("bar_com", nominal.bar_com.shape), 0 * nominal.payload_mass, nominal.payload_com,
    )  # fmt: skip
    masses = ca.vertcat(free.mass, free.bar_mass)
    places = ca.vertcat(ca.vec(free.com), ca.vec(free.bar_com))
    packed = ca.SX.sym("row", sum(Row.sizes(robot).values()))
    row = replace(Row.unpack(robot, packed), q=q, payload=ca.SX(len(robot.payloads), 1))
    torque = -state(robot, nominal_dimensions(robot), free, row, Deflection.zero(robot.n_joints)).torque
    slopes = ca.substitute(
        ca.jacobian(torque, ca.vertcat(masses, places)),
        ca.vertcat(masses, places),
        ca.vertcat(ca.SX.ones(masses.shape), ca.SX.zeros(places.shape)),
    )
    return ca.Function("moment_torques", [q], [ca.densify(slopes)])


@lru_cache(maxsize=16)
def rated_torques(robot: Robot) -> np.ndarray:
    """Return each joint's rated torque [Nm], shape (n_joints,), read-only: the maker's, else what gravity asks of it.

    Where the maker is silent it is the largest gravity torque over the joints' ranges under the heaviest payload, and for
    a joint that gravity hardly loads (a vertical axis) a tenth of the most loaded joint's of its kind. A slide's is in N.
    """
    stated = np.array([joint.rated_torque or np.nan for joint in robot.joints])
    rated = np.where(np.isnan(stated), _gravity_torques(robot), stated) if np.isnan(stated).any() else stated
    rated.flags.writeable = False  # all who ask get the same array
    return rated


def _gravity_torques(robot: Robot) -> np.ndarray:
    """The largest torques that gravity asks of the joints, shape (n_joints,)."""
    from scipy.stats import qmc

    function = gravity_torque(robot)
    sample = qmc.scale(qmc.Sobol(robot.n_joints, scramble=False).random(256), *robot.limits.T)
    sample = sample[reachable(robot, sample)]
    if not len(sample):
        raise refuse("the four-bar loop closes nowhere within the joints' ranges", key=f"robot '{robot.name}': loop")
    heaviest = np.zeros(len(robot.payloads))
    if robot.payloads:
        heaviest[int(np.argmax([payload.mass or 0.0 for payload in robot.payloads.values()]))] = 1.0
    torques = np.abs(np.array(function.map(len(sample))(sample.T, np.tile(heaviest[:, None], len(sample)))))
    largest = np.nanmax(torques, axis=1)
    slides = np.array([joint.kind == "prismatic" for joint in robot.joints])
    for kind in (slides, ~slides):
        largest[kind] = np.maximum(largest[kind], max(SMALLEST_RATED, 0.1 * largest[kind].max(initial=0.0)))
    return np.asarray(largest)


def _moment_work(moment: ca.SX, flange: ca.SX, motion: ca.SX) -> ca.SX:
    """Generalised force of a pure moment on the flange: its work over the flange's rotation, by the rotation's Jacobian."""
    rotation = flange[:3, :3]
    # For a rotation by w the columns change by w x column, so 1/2 sum(column x change) is w itself.
    total = ca.SX(motion.numel(), 1)
    for k in range(3):
        arm = ca.cross(moment, rotation[:, k]) / 2
        total += ca.jtimes(rotation[:, k], motion, arm, True)
    return total
