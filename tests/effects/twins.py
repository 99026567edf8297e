"""Twins: each effect with its values, beside the same cause in the simulator, written from its physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import casadi as ca
import numpy as np

import robots
from calflow.effects import Effect
from calflow.robot.mechanism import Row, State
from effects.bench import SESSIONS, Bench, made
from hidden import forms
from hidden.causes import ARM, COLUMN, ROCKS, WARM_UP, Hidden, base_tilt, gravity_compensator
from hidden.frame_causes import stepped
from hidden.random_functions import direction
from hidden.simulator import Rows
from hidden.tool_causes import LENGTH


@dataclass(frozen=True)
class Twin:
    """An effect with values by part and symbol, and the same cause in the simulator; compared at the rows of where.

    A cause that the simulator lacks is a function of its points and rows. Not soft: the joints do not give way besides.
    """

    effect: Effect
    values: dict[str, float]
    cause: Hidden | Callable[[np.ndarray, Rows], np.ndarray]
    where: np.ndarray | None = None
    close: float = 1e-3  # largest difference over largest effect
    soft: bool = True


def one(name: str, parameter: str, hidden: Hidden, **variant: Any) -> Callable[[Bench], Twin]:
    """An effect with one parameter, which is the hidden cause's size."""
    return lambda bench: Twin(made(bench, name, **variant), {parameter: hidden.size}, hidden)


def wave(name: str, joint: int, size: float, number: float = 1.0, **variant: Any) -> Callable[[Bench], Twin]:
    """A periodic error: the simulator's size and phase as cosine and sine."""
    hidden = Hidden(name, joint, size, number, seed=3)
    phase = hidden.rng.uniform(0, 2 * pi)
    values = {f"joint{joint}.cos": size * np.cos(phase), f"joint{joint}.sin": -size * np.sin(phase)}
    return lambda bench: Twin(made(bench, name, **variant), values, hidden)


def cubic(bench: Bench) -> Twin:
    """The simulator's torque is over the largest of all rows, calflow's over the rated one."""
    hidden = Hidden("nonlinear-joint-stiffness", 2, 1.5e-3)
    share = bench.rated(2) / np.abs(bench.torque(2, hidden)).max()
    return Twin(made(bench, hidden.cause), {"joint2.c3": hidden.size * share**3}, hidden)


def knee(bench: Bench) -> Twin:
    """The simulator's break is at half the largest torque."""
    hidden = Hidden("nonlinear-joint-stiffness", 2, 1.5e-3, "break")
    share = bench.rated(2) / np.abs(bench.torque(2, hidden)).max()
    return Twin(made(bench, hidden.cause, law="knee", knee=0.5 / share), {"joint2.c": 2 * hidden.size * share}, hidden)


def early_knee(bench: Bench) -> Twin:
    """The simulator's break is at a tenth of the largest torque."""
    hidden = Hidden("nonlinear-joint-stiffness", 2, 5e-4, 0.1)
    share = bench.rated(2) / np.abs(bench.torque(2, hidden)).max()
    return Twin(
        made(bench, hidden.cause, law="knee", knee=0.1 / share), {"joint2.c": hidden.size / 0.9 * share}, hidden
    )


def uneven(bench: Bench) -> Twin:
    """The simulator's two sides are of the largest torque, calflow's of the rated one."""
    hidden = Hidden("nonlinear-joint-stiffness", 2, 5e-4, "sides")
    share = bench.rated(2) / np.abs(bench.torque(2, hidden)).max()
    return Twin(made(bench, hidden.cause, law="uneven"), {"joint2.c1": hidden.size * share}, hidden)


def loaded_wave(way: str) -> Callable[[Bench], Twin]:
    """The simulator's torque is over the largest of all rows, calflow's over the rated one; warmth is over 10 K in both."""
    hidden = Hidden("loaded-transmission-error", 2, 3e-4, way, seed=3)
    phase = hidden.rng.uniform(0, 2 * pi)

    def twin(bench: Bench) -> Twin:
        share = 1.0 if way == "warm" else bench.rated(2) / np.abs(bench.torque(2, hidden)).max()
        values = {"joint2.cos": share * hidden.size * np.cos(phase), "joint2.sin": -share * hidden.size * np.sin(phase)}
        return Twin(made(bench, hidden.cause, geared=way == "gear", warm=way == "warm"), values, hidden)

    return twin


def friction(bench: Bench) -> Twin:
    """The simulator's torque is over the largest of all rows, calflow's over the rated one."""
    hidden = Hidden("friction-wind-up", 2, 3e-4)
    share = bench.rated(2) / np.abs(bench.torque(2, hidden)).max()
    return Twin(made(bench, hidden.cause), {"joint2.h": hidden.size * share}, hidden)


def torque_backlash(bench: Bench) -> Twin:
    """The simulator's flank changes at once, calflow's over a few per cent of the rated torque."""
    hidden = Hidden("torque-backlash", 3, 3e-4)
    clear = np.abs(bench.torque(3, hidden)) > 0.05 * bench.rated(3)
    return Twin(made(bench, hidden.cause), {"joint3.b": hidden.size}, hidden, clear)


def hysteresis(bench: Bench) -> Twin:
    """The simulator remembers the way before a reversal, calflow does not: after far travel it is forgotten."""
    hidden = Hidden("joint-hysteresis", 2, 1e-4)
    far = bench.rows.travel[:, 1] > np.deg2rad(15)
    return Twin(made(bench, hidden.cause, length=np.deg2rad(5)), {"joint2.h": hidden.size}, hidden, far, close=0.01)


def bending(link: int, size: float) -> Callable[[Bench], Twin]:
    """The simulator spreads a link's own weight evenly about its centre, calflow at the centre and the beam's ends."""
    hidden = Hidden("link-bending", link, size)
    return lambda bench: Twin(made(bench, hidden.cause), {f"link{link}.1/EI": size}, hidden, close=0.01)


def bearing(joint: int, size: float) -> Callable[[Bench], Twin]:
    """A bearing that is softer about x than about y."""
    hidden = Hidden("bearing-compliance", joint, size, 0.3)
    values = {f"joint{joint}.cx": hidden.size, f"joint{joint}.cy": 0.3 * hidden.size}
    return lambda bench: Twin(made(bench, hidden.cause), values, hidden)


def bearing_play(bench: Bench) -> Twin:
    """The simulator's bearing changes its side at once, calflow's over a per cent of the largest rated torque beyond it."""
    hidden = Hidden("bearing-play", 4, 4e-4)
    moment = np.linalg.norm(bench.still.moment[:, 3, :2], axis=1)
    clear = moment > 0.2 * max(bench.rated(joint) for joint in range(4, 7))
    return Twin(made(bench, "bearing-play"), {"joint4.b": hidden.size}, hidden, clear, close=0.01)


def wobble(bench: Bench) -> Twin:
    """An axis that tilts round the housing twice a turn does so once a turn of the link."""
    hidden = Hidden("axis-wobble", 2, 2e-4, seed=4)
    phase = hidden.rng.uniform(0, 2 * pi)
    x, y = hidden.size * np.cos(phase), hidden.size * np.sin(phase)
    values = {"joint2.cos_x": x, "joint2.sin_x": -y, "joint2.cos_y": y, "joint2.sin_y": x}
    return Twin(made(bench, "axis-wobble", order=1), values, hidden)


def bearing_beside(bench: Bench) -> Twin:
    """A pivot beside the joint's frame: its lever counts to first order."""
    hidden = Hidden("offset-bearing", 4, 4e-8, 0.1, seed=2)
    pivot = 0.1 * forms.slanting(hidden.rng, np.array([0.0, 0.0, 1.0]), pi)
    values = {"joint4.cx": hidden.size, "joint4.cy": hidden.size}
    values |= {f"joint4.o{axis}": hidden.size * place for axis, place in zip("xyz", pivot, strict=True)}
    return Twin(made(bench, "bearing-compliance", aside=True), values, hidden, close=0.05)


def base_by_direction(bench: Bench) -> Twin:
    """A foundation that is softer in one direction."""
    hidden = Hidden("base-compliance", 0, 1e-8, 0.3)
    tilt = base_tilt(hidden)
    values = {"base.cx": tilt[0, 0], "base.cy": tilt[1, 1], "base.cxy": tilt[0, 1]}
    return Twin(made(bench, hidden.cause, directions=2), values, hidden)


def base_play(bench: Bench) -> Twin:
    """The simulator's foot changes its side at once, calflow's over a few per cent of the largest rated torque."""
    hidden = Hidden("base-play", 0, 4e-4)
    moment = bench.still.base_moment @ np.array([np.cos(ROCKS), np.sin(ROCKS), 0.0])
    clear = np.abs(moment) > 0.05 * max(bench.rated(joint) for joint in range(1, 7))
    return Twin(made(bench, "base-play", about=ROCKS), {"base.b": hidden.size}, hidden, clear)


def compensator(bench: Bench) -> Twin:
    """The phase of the cylinder's torque; its hinge is as far below as the simulator's."""
    hidden = Hidden("gravity-compensator", 2, 2e4)
    effect = made(bench, hidden.cause, ratio=ARM / COLUMN)
    values = np.linalg.lstsq(compensator_basis(bench, effect), gravity_compensator(hidden, bench.still), rcond=None)[0]
    names = [f"{parameter.part}.{parameter.symbol}" for parameter in effect.declared]
    return Twin(effect, dict(zip(names, values, strict=True)), hidden, close=0.01)  # its column is not quite upright


def compensator_basis(bench: Bench, effect: Effect) -> np.ndarray:
    """What each parameter of the compensator adds to joint 2's torque (rows, 2)."""
    loads, p = State.symbols(bench.robot), ca.SX.sym("p", 2)
    added = ca.jacobian(effect.torque(p, loads, Row.symbols(bench.robot)), p)
    at = ca.Function("added", [loads.q], [added])
    every = np.array([np.array(at(q)) for q in bench.table.joints])
    assert not every[:, [0, 2, 3, 4, 5]].any()
    return every[:, 1]


def payload_com(bench: Bench) -> Twin:
    """A shift in a direction that is drawn."""
    hidden = Hidden("payload-com", 0, 0.1, seed=4)
    shift = hidden.size * direction(hidden.rng)
    return Twin(
        made(bench, hidden.cause), dict(zip(("payloads.x", "payloads.y", "payloads.z"), shift, strict=True)), hidden
    )


def marker_place(bench: Bench) -> Twin:
    """The first marker sits elsewhere on the simulator's robot, and no other."""
    name, shift, markers = next(iter(bench.robot.markers)), np.array([3e-4, -1e-4, 2e-4]), bench.real.markers.copy()
    markers[0] += shift
    elsewhere = replace(bench, real=replace(bench.real, markers=markers))
    values = dict(zip((f"{name}.x", f"{name}.y", f"{name}.z"), shift, strict=True))
    return Twin(made(bench, "marker-place"), values, lambda points, rows: elsewhere.points())


def tool_alike(bench: Bench) -> Twin:
    """The simulator's payload does not move with the tool, so that joints must not feel it."""
    hidden = Hidden("tool-deflection", 0, 3e-7)
    return Twin(made(bench, hidden.cause), {"tool.c": hidden.size}, hidden, soft=False)


def tool_by_direction(bench: Bench) -> Twin:
    """A tool that is stiffer across x."""
    hidden = Hidden("tool-deflection", 0, 3e-7, "anisotropic")
    values = {"tool.cx": hidden.size, "tool.cy": 0.5 * hidden.size, "tool.cz": 0.1 * hidden.size}
    return Twin(made(bench, hidden.cause, shape="direction"), values, hidden, soft=False)


def bracket(bench: Bench) -> Twin:
    """A cantilever along the flange's axis turns by 1.5 / length times what it gives way."""
    hidden = Hidden("tool-bracket", 0, 3e-8)
    values = {"tool.c": hidden.size, "tool.t": 1.5 / LENGTH * hidden.size}
    return Twin(made(bench, "tool-deflection", shape="bracket"), values, hidden, soft=False)


def adapter(bench: Bench) -> Twin:
    """An adapter that is stiffer about y."""
    hidden = Hidden("tool-adapter", 0, 3e-7)
    values = {"tool.mx": hidden.size, "tool.my": 0.5 * hidden.size}
    return Twin(made(bench, "tool-deflection", shape="adapter"), values, hidden, soft=False)


def sagging_bracket(bench: Bench) -> Twin:
    """The same under its own weight."""
    hidden = Hidden("tool-sag", 0, 1e-4)
    values = {"tool.c": hidden.size, "tool.t": 1.5 / LENGTH * hidden.size}
    return Twin(made(bench, hidden.cause), values, hidden, soft=False)


def sagging_bar(bench: Bench) -> Twin:
    """A bar in any direction; what it gives way alike in all directions moves the base, and is no parameter."""
    hidden = Hidden("tool-sag", 0, 1e-4, "bar", seed=7)
    along = direction(hidden.rng)
    matrix = hidden.size * (along[2] ** 2 * np.eye(3) - np.outer(along, along))  # zero in its last entry
    alike = hidden.size * (1 - along[2] ** 2) * robots.base_frame(bench.robot)[:3, :3] @ [0.0, 0.0, -1.0]
    values = {f"tool.c{'xyz'[i]}{'xyz'[j] if i != j else ''}": matrix[i, j] for i in range(3) for j in range(i, 3)}
    del values["tool.cz"]
    moved = lambda point, rows: bench.points(hidden, soft=False) - alike  # noqa: E731
    return Twin(made(bench, hidden.cause, shape="symmetric"), values, moved, soft=False)


def stand(constant: float, turning: bool) -> Callable[[Bench], Twin]:
    """The simulator's stand bends in a drawn direction, or creeps otherwise: written here."""
    size = np.array([2e-5, -1e-5, 3e-5, 1e-5, -2e-5, 1.5e-5])[: 6 if turning else 3]
    left = 0.0 if constant else 293.15  # when the stand is where it is without growth
    names = ("device.x", "device.y", "device.z", "device.rx", "device.ry", "device.rz")

    def moved(point: np.ndarray, rows: Rows) -> np.ndarray:
        grown = 1 - np.exp(-rows.time / constant) if constant else rows.temperature - 20
        return point + grown[:, None] * (size[:3] + (np.cross(size[3:], point) if turning else 0))

    return lambda bench: Twin(
        made(bench, "stand-growth", constant=constant, turning=turning, left=left),
        dict(zip(names, size, strict=False)),
        moved,
    )


def scale(constant: float) -> Callable[[Bench], Twin]:
    """A weather station that reads the air wrong, or a device that warms up: all lengths from it grow."""
    left = 0.0 if constant else 293.15

    def moved(point: np.ndarray, rows: Rows) -> np.ndarray:
        return point * (1 + 1e-5 * (1 - np.exp(-rows.time / constant) if constant else rows.temperature - 20)[:, None])

    return lambda bench: Twin(made(bench, "scale-growth", constant=constant, left=left), {"device.s": 1e-5}, moved)


def drift(bench: Bench) -> Twin:
    """The simulator's size is from beginning to end."""
    hidden = Hidden("frame-drift", 0, 3e-4, seed=5)
    velocity = hidden.size * direction(hidden.rng) / bench.rows.time.max()
    return Twin(
        made(bench, hidden.cause), dict(zip(("device.vx", "device.vy", "device.vz"), velocity, strict=True)), hidden
    )


def turning_drift(bench: Bench) -> Twin:
    """The simulator's device does not turn: written here."""
    rate = np.array([2e-8, -3e-8, 5e-8])
    values = dict(zip(("device.wx", "device.wy", "device.wz"), rate, strict=True))
    turned = lambda point, rows: point + rows.time[:, None] * np.cross(rate, point)  # noqa: E731
    return Twin(made(bench, "frame-drift", turning=True), values, turned)


def drift_by_rows(bench: Bench) -> Twin:
    """Without a clock, the rows are one."""
    shift, order = np.array([1e-4, -2e-4, 5e-5]), bench.table.table["order"].to_numpy(float)
    drifted = lambda point, rows: point + (order / order.max())[:, None] * shift  # noqa: E731
    values = dict(zip(("device.vx", "device.vy", "device.vz"), shift, strict=True))
    return Twin(made(bench, "frame-drift", rows=float(order.max())), values, drifted)


def drift_by_session(bench: Bench) -> Twin:
    """The device warms up anew in each session."""
    session, velocity = bench.table.table["session"], np.array([4e-8, 8e-8, -2e-8])
    whole = bench.data.table
    first = {name: float(whole.loc[whole["session"] == name, "time"].min()) for name in SESSIONS}
    since = bench.rows.time - session.map(first).to_numpy()
    drifted = lambda point, rows: point + since[:, None] * velocity  # noqa: E731
    values = dict(zip(("device.vx", "device.vy", "device.vz"), velocity, strict=True))
    effect = made(bench, "frame-drift", sessions=SESSIONS, starts=tuple(first.values()))
    return Twin(effect, values, drifted, close=2e-3)


def wander(bench: Bench) -> Twin:
    """The third wave of a curve in time, about its mean; it ends a twentieth of the time before and after all rows."""
    end, shift = float(bench.data.table["time"].max()), np.array([1e-4, -2e-4, 5e-5])
    values = dict(zip(("device.wave3x", "device.wave3y", "device.wave3z"), shift, strict=True))
    wave = lambda share: np.sin(3 * pi * (share + 0.05) / 1.1)  # noqa: E731
    curve = wave(bench.rows.time / end) - wave(np.linspace(0.0, 1.0, 10_001)).mean()
    wandered = lambda point, rows: point + curve[:, None] * shift  # noqa: E731
    return Twin(made(bench, "frame-drift", length=0.5, end=end), values, wandered)


def frames_of_sessions(bench: Bench) -> Twin:
    """Each session has a frame of its own; those left at zero are the first one's."""
    shift, turn = np.array([2e-4, -1e-4, 3e-4]), np.array([5e-5, -3e-5, 2e-5])
    names = [f"sessions.{symbol}{axis}-wed" for symbol in ("", "r") for axis in "xyz"]
    moved = (bench.table.table["session"] == "wed").to_numpy()
    stood = lambda point, rows: point + moved[:, None] * (shift + np.cross(turn, point))  # noqa: E731
    return Twin(made(bench, "session-frame", sessions=SESSIONS), dict(zip(names, (*shift, *turn), strict=True)), stood)


def frame_from_a_session_on(bench: Bench) -> Twin:
    """The device was moved between two sessions and stayed."""
    shift = np.array([2e-4, -1e-4, 3e-4])
    moved = bench.table.table["session"].isin(["wed", "fri"]).to_numpy()
    stood = lambda point, rows: point + moved[:, None] * shift  # noqa: E731
    effect = made(bench, "session-frame", sessions=SESSIONS, turning=False, since=2)
    return Twin(effect, dict(zip(("sessions.x", "sessions.y", "sessions.z"), shift, strict=True)), stood)


def step(cause: str, part: str, joint: int = 0) -> Callable[[Bench], Twin]:
    """The simulator's moment is a time, calflow's a place in measuring order; a shift is in a drawn direction."""
    hidden = Hidden(cause, joint, 2e-4, "before", seed=6)

    def twin(bench: Bench) -> Twin:
        rng = hidden.rng
        before = stepped(hidden, rng, bench.rows) < 0
        moment = float(bench.table.table["order"][before].max()) + 0.5
        shift = {"jump": hidden.size} if joint else dict(zip("xyz", hidden.size * direction(rng), strict=True))
        return Twin(made(bench, cause, moment=moment), {f"{part}.{name}": size for name, size in shift.items()}, hidden)

    return twin


def payload_step(bench: Bench) -> Twin:
    """The one step that acts on the rows after it: those before have the payload that the table says."""
    hidden = Hidden("payload-step", 0, 0.2, seed=6)
    before = stepped(hidden, hidden.rng, bench.rows) == 0
    moment = float(bench.table.table["order"][before].max()) + 0.5
    return Twin(made(bench, "payload-step", moment=moment), {"payloads.e": hidden.size}, hidden)


def turning_step(bench: Bench) -> Twin:
    """The simulator's device does not turn: written here."""
    turn = np.array([2e-5, -3e-5, 5e-5])
    moment = float(np.median(bench.table.table["order"])) + 0.25
    before = bench.table.table["order"].to_numpy() < moment
    turned = lambda point, rows: point - before[:, None] * np.cross(turn, point)  # noqa: E731
    values = dict(zip(("device.rx", "device.ry", "device.rz"), turn, strict=True))
    return Twin(made(bench, "frame-step", moment=moment, turning=True), values, turned)


STEPS = {"frame-step", "joint-step", "payload-step", "tool-slip"}
TWINS: dict[str, Callable[[Bench], Twin]] = {
    "joint-compliance": one("joint-compliance", "joint2.s", Hidden("joint-compliance", 2, 5e-8)),
    "nonlinear-joint-stiffness, cubic": cubic,
    "nonlinear-joint-stiffness, knee": knee,
    "nonlinear-joint-stiffness, early knee": early_knee,
    "nonlinear-joint-stiffness, uneven": uneven,
    **{f"loaded-transmission-error, {way}": loaded_wave(way) for way in ("", "gear", "warm")},
    "friction-wind-up": friction,
    "joint-backlash": one("joint-backlash", "joint3.b", Hidden("joint-backlash", 3, 1.5e-4)),
    "torque-backlash": torque_backlash,
    "joint-hysteresis": hysteresis,
    "joint-eccentricity, first order": wave("joint-eccentricity", 1, 3e-4, 1, order=1),
    "joint-eccentricity, second order": wave("joint-eccentricity", 5, 3e-4, 2, order=2),
    "periodic-joint-error": wave("periodic-joint-error", 2, 1.5e-4, 7.3, order=7.3),
    "gear-transmission-error, once": wave("gear-transmission-error", 2, 1e-4, 1, multiple=1),
    "gear-transmission-error, twice": wave("gear-transmission-error", 3, 1e-4, 2, multiple=2),
    "gear-ratio-error": one("gear-ratio-error", "joint4.kappa", Hidden("gear-ratio-error", 4, 2e-3)),
    **{
        f"wrist-coupling, {pair}": one("wrist-coupling", f"joint{pair[0]}.k{pair}", Hidden("wrist-coupling", 0, 2e-3, pair))
        for pair in ("54", "64", "65")
    },
    **{f"bearing-compliance, joint {j}": bearing(j, c) for j, c in ((1, 1e-8), (2, 5e-8), (3, 5e-8), (5, 1e-7))},
    **{
        f"link-torsion, link {link}": one("link-torsion", f"link{link}.1/GJ", Hidden("link-torsion", link, size))
        for link, size in enumerate((3e-8, 3e-7, 3e-7, 3e-7), start=1)
    },
    **{f"link-bending, link {link}": bending(link, size) for link, size in enumerate((3e-9, 5e-8, 1e-7, 5e-8), start=1)},
    "bearing-compliance, beside its joint": bearing_beside,
    "axis-wobble": wobble,
    "base-compliance, alike": one("base-compliance", "base.c", Hidden("base-compliance", 0, 1e-8)),
    "base-compliance, by direction": base_by_direction,
    "bearing-play": bearing_play,
    "base-play": base_play,
    "gravity-compensator": compensator,
    "payload-mass, all": one("payload-mass", "payloads.e", Hidden("payload-mass", 0, 0.2)),
    "payload-mass, one": one("payload-mass", "full.e", Hidden("payload-mass", 0, 0.2, "full")),
    "payload-com": payload_com,
    "link-mass": one("link-mass", "link3.e", Hidden("link-mass", 3, 0.3)),
    "tool-deflection, alike": tool_alike,
    "tool-deflection, by direction": tool_by_direction,
    "tool-deflection, bracket": bracket,
    "tool-deflection, adapter": adapter,
    "tool-sag, bracket": sagging_bracket,
    "tool-sag, bar": sagging_bar,
    "thermal-growth, temperature": one("thermal-growth", "links.alpha", Hidden("thermal-growth", 0, 2.3e-5)),
    "thermal-growth, warm-up": one("thermal-growth", "links.e", Hidden("thermal-growth", 0, 2.5e-4, "warm-up"), constant=WARM_UP),
    "thermal-growth, one link": one("thermal-growth", "link2.alpha", Hidden("link-growth", 2, 2.3e-5), apart=True),
    "thermal-growth, one link's warm-up": one("thermal-growth", "link4.e", Hidden("link-growth", 4, 2.5e-4, "warm-up"),
                                              constant=WARM_UP, apart=True),
    "housing-growth, temperature": one("housing-growth", "joint5.h", Hidden("housing-growth", 5, 1e-5)),
    "housing-growth, warm-up": one("housing-growth", "joint5.h", Hidden("housing-growth", 5, 1e-4, "warm-up"), constant=WARM_UP),
    "housing-growth, zero": one("housing-growth", "joint2.h", Hidden("warm-zero", 2, 1e-5), turning=True),
    "housing-growth, zero's warm-up": one("housing-growth", "joint4.h", Hidden("warm-zero", 4, 1e-4, "warm-up"),
                                          constant=WARM_UP, turning=True),
    "frame-drift, shifting": drift,
    "frame-drift, turning": turning_drift,
    "frame-drift, by the order of the rows": drift_by_rows,
    "frame-drift, anew in each session": drift_by_session,
    "frame-drift, wandering": wander,
    "stand-growth, temperature": stand(0.0, turning=False),
    "stand-growth, settling": stand(4000.0, turning=True),
    "scale-growth, temperature": scale(0.0),
    "scale-growth, warm-up": scale(4000.0),
    "session-frame, each session": frames_of_sessions,
    "session-frame, from a session on": frame_from_a_session_on,
    "frame-step, shifting": step("frame-step", "device"),
    "joint-step": step("joint-step", "joint3", 3),
    "payload-step": payload_step,
    "tool-slip": step("tool-slip", "tool"),
    "frame-step, turning": turning_step,
    "marker-place": marker_place,
    "tracker-scale": one("tracker-scale", "device.s", Hidden("tracker-scale", 0, 3e-5)),
}  # fmt: skip
APART = {
    "geometry",
    "axis-straightness",
    "gravity-deflection",
    "base-tilt",
    "joint-error-map",
    "range-noise",
}  # compared in tests of their own
# Effects that the common tests here compare one by one; another one has a test file of its own, called as it is.
SHARED = {name.split(",")[0] for name in TWINS} | APART
