"""Hidden causes: what a real robot does, each a few lines of physics. SI units."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hidden import beams, forms, frame_causes, joint_causes
from hidden.file_faults import ON_TABLE
from hidden.frame_causes import stepped
from hidden.random_functions import direction, random_function
from hidden.simulator import Array, Motion, Robot, Rows, State, carried, close, equilibrium, frames, tool_point
from hidden.tool_causes import ON_TOOL

WIND_UP = np.deg2rad(5.0)  # travel over which friction winds a joint up
WARM_UP = 3600.0  # s
COLUMN, ARM = 0.6, 0.15  # m: where a gas cylinder is hinged, below joint 2 and along the arm
HUNG_UP, REEL = np.array([[0.5, -0.3, 2.8], [0.4, 0.9, 0.0]])  # m from the base: where hoses come from
SLACK = 1.5  # m: length of hoses that pull where they are taut alone
PAYLOADS = ("none", "half", "full")


@dataclass(frozen=True)
class Hidden:
    """A cause: its id, the joint or link (from 1; 0 where there is none), its size, a variant, and its random figures' seed."""

    cause: str
    joint: int = 0
    size: float = 0.0
    extra: float | str = ""
    seed: int = 0

    @property
    def rng(self) -> np.random.Generator:
        """A generator that always draws the same phase, direction or moment."""
        return np.random.default_rng(self.seed)

    @property
    def number(self) -> float:
        """The variant as a number, 1 where none is given."""
        return float(self.extra or 1)


def measured_points(robot: Robot, rows: Rows, hidden: tuple[Hidden, ...]) -> Array:
    """Where the device sees each row's marker, without noise (rows, 3) [m]."""
    for h in hidden:
        if h.cause in ON_ROBOT:
            robot = ON_ROBOT[h.cause](h, robot, rows)
    motion, state = equilibrium(robot, rows, lambda state: response(robot, rows, state, hidden))
    point = tool_point(robot, rows, motion, state.frames.tips[-1])
    for h in hidden:
        if h.cause in ON_DEVICE:
            point = ON_DEVICE[h.cause](h, robot, rows, point)
    return point


def response(robot: Robot, rows: Rows, state: State, hidden: tuple[Hidden, ...]) -> Motion:
    """What gives way under given loads."""
    helped = sum((ON_TORQUE[h.cause](h, state) for h in hidden if h.cause in ON_TORQUE), np.zeros(len(rows)))
    torque = state.torque.copy()
    torque[:, 1] += helped
    for h in hidden:
        if h.cause == "dress-pack":
            torque += dress_pack(h, robot, rows, state)
    motion = replace(Motion.none(len(rows), robot.n), joint=robot.compliance * torque)
    for h in hidden:
        if h.cause in ON_JOINT:
            motion.joint[:, _driven(h)] += ON_JOINT[h.cause](h, robot, rows, torque)
        elif h.cause in ON_MOTION:
            motion = motion + ON_MOTION[h.cause](h, robot, rows, replace(state, torque=torque))
    return motion


def _driven(h: Hidden) -> int:
    """Index of the joint that a cause turns; the wrist's coupling names it in its variant, cables pull at joint 5."""
    if h.cause == "wrist-coupling":
        return int(str(h.extra or "54")[0]) - 1
    return 4 if h.cause == "cable-drag" else h.joint - 1


# --- Joints: rad added to one driven joint (rows,) ---------------------------------------------------


def nonlinear_stiffness(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """A cubic part, a stiffer branch past some share (extra; "break" is half) of the largest torque, or two unlike "sides"."""
    load = torque[:, h.joint - 1] / np.abs(torque[:, h.joint - 1]).max()
    if h.extra == "sides":
        return h.size * np.abs(load)
    if h.extra:
        knee = 0.5 if h.extra == "break" else h.number
        return -h.size * np.sign(load) * np.maximum(np.abs(load) - knee, 0) / (1 - knee)
    return h.size * load**3


def joint_backlash(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """Half the play, on the side that the joint came from."""
    return h.size / 2 * rows.approach[:, h.joint - 1]


def torque_backlash(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """Half the play, on the side that the load presses to."""
    return h.size / 2 * np.sign(torque[:, h.joint - 1])


def joint_hysteresis(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """Friction wind-up as the joint's whole way has left it."""
    return h.size * rows.wound[:, h.joint - 1]


def _harmonic(h: Hidden, rows: Rows, order: float) -> Array:
    return h.size * np.cos(order * rows.q[:, h.joint - 1] + h.rng.uniform(0, 2 * np.pi))


def joint_eccentricity(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """Once a turn, or extra times."""
    return _harmonic(h, rows, h.number)


def gear_transmission_error(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """Once a turn of the motor, or extra times."""
    return _harmonic(h, rows, h.number * robot.gears[h.joint - 1])


def third_order(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """Three times a turn."""
    return _harmonic(h, rows, 3.0)


def joint_error_map(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """A smooth random function of the joint's angle, its rms over the joint's range as stated."""
    smooth = random_function(h.rng, inputs=1, outputs=1, length=0.3)
    grid = smooth(np.linspace(*robot.limits[h.joint - 1], 1000)[:, None])
    return h.size * (smooth(rows.q[:, [h.joint - 1]]) - grid.mean())[:, 0] / grid.std()


def gear_ratio_error(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """In proportion to the joint's angle."""
    return h.size * rows.q[:, h.joint - 1]


def wrist_coupling(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """In proportion to the angle of a joint before: extra "54", "64" or "65"."""
    return h.size * rows.q[:, int(str(h.extra or "54")[1]) - 1]


def cable_drag(h: Hidden, robot: Robot, rows: Rows, torque: Array) -> Array:
    """A hose's pull, which no sum of functions of joint 4 and joint 6 makes up."""
    first, second = h.rng.uniform(0, 2 * np.pi, 2)
    q4, q6 = rows.q[:, 3], rows.q[:, 5]
    return h.size * (np.sin(q4 + first) * np.sin(q6 + second) + 0.5 * np.cos(q4 - q6 / 2))


# --- Links, bearings, base and tool ------------------------------------------------------------------


def _motion(robot: Robot, rows: Rows, part: str, values: Array, at: int | None = None) -> Motion:
    motion = Motion.none(len(rows), robot.n)
    getattr(motion, part)[:, slice(None) if at is None else at] = values
    return motion


def joint_compliance(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A linear spring at one joint."""
    return _motion(robot, rows, "joint", h.size * state.torque[:, h.joint - 1], h.joint - 1)


def bearing_compliance(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """Tilt off the joint's axis; extra is how much softer it is about y than about x."""
    soft = h.size * np.array([1.0, h.number, 0.0])
    return _motion(robot, rows, "bearing", soft * state.moment[:, h.joint - 1], h.joint - 1)


def bearing_play(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A worn bearing lies, by half the size, against the side to which the moment across its axis presses it."""
    across = state.moment[:, h.joint - 1] * np.array([1.0, 1.0, 0.0])
    side = across / np.linalg.norm(across, axis=1, keepdims=True)
    return _motion(robot, rows, "bearing", h.size / 2 * side, h.joint - 1)


def axis_wobble(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """An axis that tilts towards a direction which goes round the housing twice a turn, by a bearing of two lobes."""
    towards = h.rng.uniform(0, 2 * np.pi) + 2 * rows.q[:, h.joint - 1]
    in_link = towards - rows.q[:, h.joint - 1]
    tilt = h.size * np.stack([np.cos(in_link), np.sin(in_link), np.zeros(len(rows))], axis=1)
    return _motion(robot, rows, "bearing", tilt, h.joint - 1)


SOFT = 0.5  # rad from x


def base_compliance(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """Tilt of the base under the overturning moment; extra is how much softer it is across the direction at SOFT."""
    return _motion(robot, rows, "base", state.base_moment @ base_tilt(h))


def base_tilt(h: Hidden) -> Array:
    """Tilt per moment [rad/Nm], symmetric (3, 3)."""
    along = np.array([np.cos(SOFT), np.sin(SOFT), 0.0])
    return h.size * (h.number * np.diag([1.0, 1.0, 0.0]) + (1 - h.number) * np.outer(along, along))


ROCKS = 0.46  # rad from x: between the lines that are searched


def base_play(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A foot on loose bolts rocks about a level line at ROCKS, by half the size to the side that the moment presses to."""
    line = np.array([np.cos(ROCKS), np.sin(ROCKS), 0.0])
    return _motion(robot, rows, "base", h.size / 2 * np.sign(state.base_moment @ line)[:, None] * line)


def rod_play(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """The loop's rod is longer or shorter by half the size, so that the link it holds gives way to its load."""
    if robot.loop is None:
        return Motion.none(len(rows), robot.n)
    loop, closed = robot.loop, state.frames.closure
    load, crank = np.sign(state.moment[:, loop.joint, 2]), np.angle(closed.crank)
    rods = (loop.bars + way * h.size / 2 * np.array([0, 1, 0]) for way in (-1, 0, 1))
    rockers = [close(replace(loop, bars=bars), closed.ground, closed.s, crank).rocker for bars in rods]
    turns = [np.angle(rocker / rockers[1]) for rocker in rockers]
    given = np.where(np.sign(turns[2]) == load, turns[2], turns[0])
    return _motion(robot, rows, "bearing", given[:, None] * np.array([0.0, 0.0, 1.0]), loop.joint)


def gravity_compensator(h: Hidden, state: State) -> Array:
    """Torque [Nm] on joint 2 of a gas cylinder that pushes with a constant force between column and arm."""
    joint = state.frames.joints[1]
    arm = ARM * joint[:, :3, 0]
    push = arm - np.array([0.0, 0.0, -COLUMN])
    push /= np.linalg.norm(push, axis=1)[:, None]
    return h.size * (np.cross(arm, push) * joint[:, :3, 2]).sum(axis=1)


def dress_pack(h: Hidden, robot: Robot, rows: Rows, state: State) -> Array:
    """Torques [Nm] on the motors of hoses that pull a link's far end, as hard anywhere, towards a place above.

    With extra "below" the place is on the floor; with "taut" they are slack up to SLACK, and a spring beyond it.
    """
    end = state.frames.tips[h.joint - 1][:, :3, 3]
    way = (REEL if h.extra == "below" else HUNG_UP) - end
    length = np.linalg.norm(way, axis=1)[:, None]
    pull = h.size * (np.maximum(length - SLACK, 0) if h.extra == "taut" else 1.0) * way / length
    still, torque = Motion.none(len(rows), robot.n), np.zeros_like(state.torque)
    for i, step in enumerate(1e-5 * np.eye(robot.n)):
        there, here = (frames(robot, rows.q + by, still).tips[h.joint - 1][:, :3, 3] for by in (step, -step))
        torque[:, i] = ((there - here) * pull).sum(axis=1) / 2e-5  # by the work that the force does
    return torque


def tool_deflection(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """The payload's weight moves the tool; with extra "anisotropic" twice and ten times less across x."""
    soft = h.size * (np.array([1.0, 0.5, 0.1]) if h.extra == "anisotropic" else np.ones(3))
    down = -state.frames.tips[-1][:, 2, :3]
    return _motion(robot, rows, "tool", soft * down * 9.80665 * carried(robot, rows)[:, None])


# --- What differs from the robot file ----------------------------------------------------------------


def payload_mass(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """All payloads, or the one that extra names, are heavier than stated by this share."""
    wrong = np.array([h.extra in ("", name) for name in PAYLOADS])
    return replace(robot, payload_mass=robot.payload_mass * (1 + h.size * wrong))


def payload_step(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """From a moment on all payloads are heavier than stated by this share."""
    return replace(robot, payload_mass=robot.payload_mass[:, None] * (1 + h.size * stepped(h, h.rng, rows)))


def payload_com(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """The payloads' centre lies elsewhere."""
    return replace(robot, payload_com=robot.payload_com + h.size * direction(h.rng))


def link_mass(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """A link is heavier than stated by this share."""
    return replace(robot, mass=robot.mass * (1 + h.size * (np.arange(robot.n) == h.joint - 1)))


def thermal_growth(h: Hidden, robot: Robot, rows: Rows) -> Robot:
    """All lengths grow by size a kelvin above 20 °C, or with extra "warm-up" by size in the end."""
    warm = 1 - np.exp(-rows.time / WARM_UP) if h.extra == "warm-up" else rows.temperature - 20
    grown = (1 + h.size * warm)[:, None]
    loop = robot.loop and replace(robot.loop, bars=robot.loop.bars * grown)
    return replace(robot, a=robot.a * grown, d=robot.d * grown, loop=loop)


# --- The measuring device and its floor --------------------------------------------------------------

TURNED = 4.0  # m from the device


def _wandered(h: Hidden, rng: np.random.Generator, point: Array) -> Array:
    """A shift by size, or with extra "turning" a turn about the device that moves what is TURNED away by size."""
    axis = direction(rng)
    return h.size / TURNED * np.cross(axis, point) if h.extra == "turning" else h.size * axis + 0 * point


def frame_drift(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """Steadily in time, by size from beginning to end."""
    return point + (rows.time / rows.time.max())[:, None] * _wandered(h, h.rng, point)


def frame_step(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """At one moment."""
    rng = h.rng
    return point + stepped(h, rng, rows)[:, None] * _wandered(h, rng, point)


def tracker_scale(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """All distances from the tracker."""
    return point * (1 + h.size)


def floor_vibration(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """The floor goes up and down, once in 20 to 60 s."""
    period, phase = h.rng.uniform([20, 0], [60, 2 * np.pi])
    return point + h.size * np.sin(2 * np.pi * rows.time / period + phase)[:, None] * robot.base[:3, 2]


def random_field(h: Hidden, robot: Robot, rows: Rows, point: Array) -> Array:
    """A smooth random displacement, a function of the first extra (3) joints' angles."""
    smooth = random_function(h.rng, inputs=int(h.extra or 3), outputs=3, length=1.0)
    return point + h.size / np.sqrt(3) * smooth(rows.q[:, : int(h.extra or 3)])


ON_JOINT = {
    "nonlinear-joint-stiffness": nonlinear_stiffness,
    "joint-backlash": joint_backlash,
    "torque-backlash": torque_backlash,
    "joint-hysteresis": joint_hysteresis,
    "joint-eccentricity": joint_eccentricity,
    "periodic-joint-error": joint_eccentricity,
    "gear-transmission-error": gear_transmission_error,
    "third-order": third_order,
    "joint-error-map": joint_error_map,
    "gear-ratio-error": gear_ratio_error,
    "wrist-coupling": wrist_coupling,
    "cable-drag": cable_drag,
    **joint_causes.ON_JOINT,
}
ON_MOTION = {
    "joint-compliance": joint_compliance,
    "gravity-deflection": joint_compliance,  # the same spring, where the study does not know the masses
    "bearing-compliance": bearing_compliance,
    "bearing-play": bearing_play,
    "axis-wobble": axis_wobble,
    "base-compliance": base_compliance,
    "base-play": base_play,
    "rod-play": rod_play,
    "tool-deflection": tool_deflection,
    **beams.ON_MOTION,
    **forms.ON_MOTION,
    **ON_TOOL,
}
ON_ROBOT = {
    "payload-mass": payload_mass,
    "payload-com": payload_com,
    "payload-step": payload_step,
    "link-mass": link_mass,
    "thermal-growth": thermal_growth,
    **forms.ON_ROBOT,
    **frame_causes.ON_ROBOT,
}
ON_DEVICE = {
    "frame-drift": frame_drift,
    "frame-step": frame_step,
    "tracker-scale": tracker_scale,
    "floor-vibration": floor_vibration,
    "random-field": random_field,
    **frame_causes.ON_DEVICE,
}
ON_TORQUE = {"gravity-compensator": gravity_compensator, **forms.ON_TORQUE}  # Nm on joint 2
PHYSICAL = {*ON_JOINT, *ON_MOTION, *ON_ROBOT, *ON_DEVICE, *ON_TORQUE, "dress-pack"}
KNOWN = {*PHYSICAL, *ON_TABLE, "range-noise"}
