"""The mechanics of a real robot in plain numpy: modified DH, a four-bar loop closed exactly, statics where it has sagged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

Array = np.ndarray
WEIGHT = np.array([0.0, 0.0, -9.80665])  # of 1 kg, in the base frame [N]
LEVERS = np.cross(np.eye(3), WEIGHT)  # v @ LEVERS is v × WEIGHT
SUFFIXES = {"_m": 1.0, "_mm": 1e-3, "_rad": 1.0, "_deg": np.pi / 180, "_kg": 1.0}
NEARLY_PARALLEL = 0.1  # rad
STILL = 1e-11  # m: equilibrium is reached when no tool moves farther in a turn
FREE = 1e-3  # m: play moves a tool by less


@dataclass(frozen=True)
class Loop:
    """Bars (crank, rod, rocker) that drive a joint (index from 0) from a motor on the axis before; side is the assembly."""

    joint: int
    side: int
    offset: float
    bars: Array
    mass: Array
    com: Array


@dataclass(frozen=True)
class Robot:
    """A robot in modified DH, SI units; lengths may have one row per measured row, (rows, n) instead of (n,)."""

    alpha: Array
    a: Array
    d: Array
    theta: Array
    beta: Array
    limits: Array
    gears: Array
    mass: Array
    com: Array
    base: Array
    payload_mass: Array
    payload_com: Array
    markers: Array
    compliance: Array
    loop: Loop | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.alpha)


@dataclass(frozen=True)
class Rows:
    """What was done: a row per measured point. q, approach, travel and wound are (rows, n), the rest (rows,)."""

    q: Array
    payload: Array
    marker: Array
    approach: Array
    travel: Array  # rad since the last reversal
    wound: Array  # -1 ... 1, the friction wind-up that the way to this pose has left
    time: Array
    temperature: Array

    def __len__(self) -> int:
        return len(self.q)


@dataclass(frozen=True)
class Motion:
    """What gives way: driven joints, bearings (rotation), link tips (twist), base (tilt), tool (in the flange frame)."""

    joint: Array
    bearing: Array
    tip: Array
    base: Array
    tool: Array

    @staticmethod
    def none(rows: int, n: int) -> Motion:
        """Nothing gives way."""
        return Motion(*(np.zeros((rows, *shape)) for shape in ((n,), (n, 3), (n, 6), (3,), (3,))))

    def __add__(self, other: Motion) -> Motion:
        return Motion(*(mine + its for mine, its in zip(vars(self).values(), vars(other).values(), strict=True)))


@dataclass(frozen=True)
class Closure:
    """A closed loop: the frame of its plane at P, S in that plane, and the directions of crank, rod and rocker."""

    ground: Array
    s: Array
    crank: Array
    rod: Array
    rocker: Array


@dataclass(frozen=True)
class Frames:
    """Frames (rows, 4, 4) in the base frame: joints turned but not tilted, links, links' far ends, crank and rod."""

    joints: list[Array] = field(default_factory=list)
    links: list[Array] = field(default_factory=list)
    tips: list[Array] = field(default_factory=list)
    bars: list[Array] = field(default_factory=list)
    closure: Closure | None = None


@dataclass(frozen=True)
class State:
    """What weighs on the robot in a pose: torque on driven joints; moments in joint frames; tip wrenches in link frames."""

    frames: Frames
    torque: Array
    moment: Array
    tip_force: Array
    tip_moment: Array
    base_moment: Array


# --- Reading and wearing -----------------------------------------------------------------------------


def figure(table: Mapping[str, Any], name: str, default: Any = 0.0) -> Array:
    """A quantity of a robot file in SI, whatever unit its key names."""
    known = [
        factor * np.array(table[name + unit], dtype=float) for unit, factor in SUFFIXES.items() if name + unit in table
    ]
    return known[0] if known else np.array(default, dtype=float)


def read(table: Mapping[str, Any], compliance: Array) -> Robot:
    """The robot that a robot file's tables state."""
    joints, payloads = table["joints"], table["payloads"].values()
    dh = {name: np.array([figure(joint, name) for joint in joints]) for name in ("alpha", "a", "d", "theta", "beta")}
    limits = np.array([figure(joint, "limits") for joint in joints])
    base = table.get("base", {})
    return Robot(
        **dh,
        limits=limits,
        gears=np.array([joint.get("gear_ratio", np.nan) for joint in joints], dtype=float),
        mass=np.array([figure(joint, "mass") for joint in joints]),
        com=np.array([figure(joint, "com", np.zeros(3)) for joint in joints]),
        base=placed(np.r_[figure(base, "origin", np.zeros(3)), figure(base, "rotation", np.zeros(3))]),
        payload_mass=np.array([figure(payload, "mass") for payload in payloads]),
        payload_com=np.array([figure(payload, "com", np.zeros(3)) for payload in payloads]),
        markers=np.array([figure(marker, "point") for marker in table["markers"].values()]),
        compliance=np.asarray(compliance, dtype=float),
        loop=_read_loop(table["loop"], dh["theta"], limits.mean(axis=1)) if "loop" in table else None,
    )


def _read_loop(table: Mapping[str, Any], theta: Array, middle: Array) -> Loop:
    k, bars = table["joint"] - 1, (table["crank"], table["rod"])
    between = np.sin(middle[k] - middle[k - 1] - theta[k - 1])
    return Loop(
        joint=k,
        side=int(np.sign(between)) * (1 if table.get("assembly", "open") == "open" else -1),
        offset=float(figure(table, "offset")),
        bars=np.array([*(figure(bar, "length") for bar in bars), figure(table, "rocker")]),
        mass=np.array([figure(bar, "mass") for bar in bars]),
        com=np.array([figure(bar, "com", np.zeros(3)) for bar in bars]),
    )


def worn(robot: Robot, rng: np.random.Generator, rigid: bool = False) -> Robot:
    """The robot as built: geometry off by tenths of a millimetre, base and tool by more, compliance by a tenth.

    rigid keeps the markers' places beside the first: they move with it and turn about it.
    """
    small = {name: getattr(robot, name) + rng.normal(0, 3e-4, robot.n) for name in ("alpha", "a", "d", "theta")}
    parallel = np.abs(np.sin(robot.alpha)) < NEARLY_PARALLEL
    parallel[0] = False  # the base turns about y too
    loop = robot.loop and replace(robot.loop, bars=robot.loop.bars + rng.normal(0, 3e-4, 3))
    return replace(
        robot,
        **small,
        beta=robot.beta + parallel * rng.normal(0, 3e-4, robot.n),
        base=robot.base @ placed(rng.normal(0, 2e-3, 6)),
        markers=robot.markers + rng.normal(0, 1e-3, robot.markers.shape) if not rigid else _as_one(robot.markers, rng),
        compliance=robot.compliance * rng.normal(1, 0.1, robot.n),
        loop=loop,
    )


def _as_one(markers: Array, rng: np.random.Generator) -> Array:
    turn = placed(np.append(np.zeros(3), rng.normal(0, 5e-3, 3)))[:3, :3]
    return markers[0] + rng.normal(0, 1e-3, 3) + (markers - markers[0]) @ turn.T


# --- Kinematics --------------------------------------------------------------------------------------


def turned(axis: int, angle: Any) -> Array:
    """Rotation (..., 4, 4) about x, y or z."""
    angle = np.asarray(angle, dtype=float)
    matrix = np.zeros((*angle.shape, 4, 4)) + np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[..., i, i] = matrix[..., j, j] = np.cos(angle)
    matrix[..., j, i] = np.sin(angle)
    matrix[..., i, j] = -matrix[..., j, i]
    return matrix


def shifted(x: Any = 0.0, y: Any = 0.0, z: Any = 0.0) -> Array:
    """Translation (..., 4, 4)."""
    vector = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    matrix = np.zeros((*vector.shape[:-1], 4, 4)) + np.eye(4)
    matrix[..., :3, 3] = vector
    return matrix


def tilted(angles: Array) -> Array:
    """Rotations about x, y and z in turn, (..., 4, 4)."""
    if not angles.any():  # as most bearings and tips have none: a quarter of the time
        return np.broadcast_to(np.eye(4), (*angles.shape[:-1], 4, 4))
    x, y, z = np.moveaxis(angles, -1, 0)
    return turned(0, x) @ turned(1, y) @ turned(2, z)


def placed(twist: Array) -> Array:
    """Translation, then rotations about x, y and z in turn, (..., 4, 4)."""
    return shifted(*np.moveaxis(twist[..., :3], -1, 0)) @ tilted(twist[..., 3:])


def moved(frame: Array, point: Array) -> Array:
    """Points (..., 3) given in frames."""
    return (frame[..., :3, :3] @ point[..., None])[..., 0] + frame[..., :3, 3]


def frames(robot: Robot, q: Array, motion: Motion) -> Frames:
    """All frames at joint readings q (rows, n)."""
    driven, found, loop = q + motion.joint, Frames(), robot.loop
    at = tilted(motion.base) @ shifted(robot.a[..., 0])
    for i in range(robot.n):
        before = at @ turned(0, robot.alpha[i]) @ turned(1, robot.beta[i])
        angle = driven[:, i]
        if loop and i == loop.joint - 1:
            ground = before
        if loop and i == loop.joint:
            tip = np.linalg.inv(ground) @ at
            closure = close(loop, ground, tip[:, 0, 3] + 1j * tip[:, 1, 3], angle)
            found = replace(found, closure=closure, bars=_bar_frames(loop, closure))
            angle = np.angle(closure.rocker * np.conj(tip[:, 0, 0] + 1j * tip[:, 1, 0])) + loop.offset
        joint = before @ turned(2, robot.theta[..., i] + angle)
        link = joint @ tilted(motion.bearing[:, i]) @ shifted(z=robot.d[..., i])
        far = link if i == robot.n - 1 else link @ shifted(robot.a[..., i + 1])
        at = far @ placed(motion.tip[:, i])
        for kept, frame in ((found.joints, joint), (found.links, link), (found.tips, at)):
            kept.append(frame)
    return found


def close(loop: Loop, ground: Array, s: Array, crank_angle: Array) -> Closure:
    """Close the loop: R lies a rod away from the crank's end Q and a rocker away from S (complex numbers in the plane)."""
    crank, rod, rocker = np.moveaxis(loop.bars, -1, 0)
    crank_direction = np.exp(1j * crank_angle)
    q = crank * crank_direction
    diagonal = s - q
    cosine = (rod**2 - rocker**2 - np.abs(diagonal) ** 2) / (2 * rocker * np.abs(diagonal))
    with np.errstate(invalid="ignore"):  # not a number where it cannot be closed
        rocker_direction = diagonal / np.abs(diagonal) * np.exp(1j * loop.side * np.arccos(cosine))
    return Closure(ground, s, crank_direction, (s + rocker * rocker_direction - q) / rod, rocker_direction)


def _bar_frames(loop: Loop, closed: Closure) -> list[Array]:
    crank = closed.ground @ turned(2, np.angle(closed.crank))
    rod = crank @ shifted(loop.bars[..., 0]) @ turned(2, np.angle(closed.rod / closed.crank))
    return [crank, rod]


def tool_point(robot: Robot, rows: Rows, motion: Motion, flange: Array) -> Array:
    """Each row's marker (rows, 3) in the measuring frame."""
    return moved(robot.base, moved(flange, robot.markers[rows.marker] + motion.tool))


# --- Statics -----------------------------------------------------------------------------------------


def energy(robot: Robot, rows: Rows, motion: Motion) -> Array:
    """Potential energy (rows,) [J] of all links, bars and the payload in gravity."""
    mass, centre = _bodies(robot, rows, frames(robot, rows.q, motion))
    return -(mass * (centre @ WEIGHT)).sum(axis=1)


def statics(robot: Robot, rows: Rows, motion: Motion) -> State:
    """The loads in the deflected pose: each joint carries the weight of all that lies beyond it."""
    n, loop = robot.n, robot.loop
    found = frames(robot, rows.q, motion)
    mass, centre = _bodies(robot, rows, found)
    chain = slice(0, n + 1)
    # what weighs beyond joint i, and on the tip of link i: sums of m and of m · centre
    beyond = np.concatenate([mass[..., None], mass[..., None] * centre], axis=2)
    joint_load = np.cumsum(beyond[:, chain][:, ::-1], axis=1)[:, ::-1]
    tip_load = joint_load[:, 1:].copy()
    if loop:  # the bars stand on the link before the two driven joints
        bars = beyond[:, n + 1 :].sum(axis=1)[:, None]
        joint_load[:, : loop.joint - 1] += bars
        tip_load[:, : loop.joint - 1] += bars
    joints, tips = np.stack(found.joints, axis=1), np.stack(found.tips, axis=1)
    moment = _moment(joint_load[:, :n], joints[..., :3, 3])
    tip_moment, tip_force = _moment(tip_load, tips[..., :3, 3]), tip_load[..., :1] * WEIGHT
    crank_torque = np.zeros(len(rows))
    if loop:
        k = loop.joint
        crank_torque, force, couple = _rod(loop, found, beyond[:, n + 1 :], moment[:, k])
        arm = tips[:, k - 1, :3, 3] - joints[:, k - 1, :3, 3]
        moment[:, k - 1] += np.cross(arm, force) + couple
        tip_force[:, k - 1] += force
        tip_moment[:, k - 1] += couple
    torque = (moment * joints[..., :3, 2]).sum(axis=2)
    if loop:
        torque[:, loop.joint] = crank_torque
    links = np.stack(found.links, axis=1)
    return State(
        found, torque, _in_frame(joints, moment), _in_frame(links, tip_force), _in_frame(links, tip_moment),
        _moment(beyond.sum(axis=1), np.zeros(3)),
    )  # fmt: skip


def equilibrium(robot: Robot, rows: Rows, response: Callable[[State], Motion]) -> tuple[Motion, State]:
    """Let everything give way until the loads in the deflected pose are those that deflect it.

    A joint that hangs free in its backlash has no such pose: friction keeps it on the side where it is.
    """
    motion = Motion.none(len(rows), robot.n)
    state = statics(robot, rows, motion)
    point = tool_point(robot, rows, motion, state.frames.tips[-1])
    step = np.inf
    for _ in range(40):
        motion = response(state)
        state = statics(robot, rows, motion)
        before, point = point, tool_point(robot, rows, motion, state.frames.tips[-1])
        step = np.abs(point - before).max(initial=0.0)
        if step <= STILL:
            break
    if not step < FREE:
        raise RuntimeError("no equilibrium: the robot is too soft, or its loop cannot be closed")
    return motion, state


def carried(robot: Robot, rows: Rows) -> Array:
    """The payload's mass (rows,) [kg]; a robot's payload_mass may differ from row to row, (payloads, rows)."""
    masses = np.broadcast_to(robot.payload_mass.T, (len(rows), len(robot.payload_com)))
    return np.asarray(np.take_along_axis(masses, rows.payload[:, None], axis=1)[:, 0])


def _bodies(robot: Robot, rows: Rows, found: Frames) -> tuple[Array, Array]:
    """Masses (rows, bodies) and their centres (rows, bodies, 3): links, payload, bars."""
    masses = [*np.broadcast_to(robot.mass[:, None], (robot.n, len(rows))), carried(robot, rows)]
    centres = [moved(frame, com) for frame, com in zip(found.links, robot.com, strict=True)]
    centres.append(moved(found.tips[-1], robot.payload_com[rows.payload]))
    if robot.loop:
        masses += [np.full(len(rows), mass) for mass in robot.loop.mass]
        centres += [moved(frame, com) for frame, com in zip(found.bars, robot.loop.com, strict=True)]
    return np.stack(masses, axis=1), np.stack(centres, axis=1)


def _moment(load: Array, about: Array) -> Array:
    return (load[..., 1:] - load[..., :1] * about) @ LEVERS


def _in_frame(frame: Array, vector: Array) -> Array:
    return np.einsum("...ji,...j->...i", frame[..., :3, :3], vector)


def _rod(loop: Loop, found: Frames, bars: Array, moment: Array) -> tuple[Array, Array, Array]:
    """Torque on the crank's motor, and what rod and rocker do to the link before: a force at S and a couple.

    The loop's velocities follow from crank · crank' + rod · rod' = S' + rocker · rocker' (each across its bar).
    """
    closed, k = found.closure, loop.joint
    assert closed
    crank, rod, rocker = np.moveaxis(loop.bars, -1, 0)

    def sine(to: Array, of: Array) -> Array:
        return np.imag(to * np.conj(of))

    def in_base(direction: Array) -> Array:
        plane = np.stack([direction.real, direction.imag, np.zeros(len(direction))], axis=-1)
        return (closed.ground[:, :3, :3] @ plane[..., None])[..., 0]

    per_rocker, per_rod = rocker * sine(closed.rod, closed.rocker), rod * sine(closed.rocker, closed.rod)
    normal = closed.ground[:, :3, 2]
    p, q = closed.ground[:, :3, 3], found.bars[1][:, :3, 3]
    axis = found.joints[k][:, :3, 2]
    on_rocker = (moment * axis).sum(axis=1)
    on_rod = (_moment(bars[:, 1], q) * normal).sum(axis=1)
    on_crank = (_moment(bars[:, 0], p) + np.cross(q - p, bars[:, 1, :1] * WEIGHT)) * normal
    torque = on_crank.sum(axis=1)
    torque += on_rocker * crank * sine(closed.rod, closed.crank) / per_rocker
    torque -= on_rod * crank * sine(closed.rocker, closed.crank) / per_rod
    force = in_base(on_rod / per_rod * closed.rocker - on_rocker / per_rocker * closed.rod)
    return torque, force, -on_rocker[:, None] * axis
