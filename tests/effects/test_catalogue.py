"""Every effect of the catalogue against the independent simulator, and what effects say of themselves."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from math import pi
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.design.candidates import pack
from calflow.effects import Effect, catalogue
from calflow.effects.cause import Cause
from calflow.effects.joint_error_map import AMPLITUDE, LENGTHS
from calflow.faults import checks, plain_checks
from calflow.measurements.columns import condition_columns, numbered
from calflow.measurements.measurements import Measurements
from calflow.measurements.reading import read_measurements
from calflow.measurements.series import Series, Station
from calflow.model import Model, over_rows
from calflow.robot.chain import Deflection
from calflow.robot.conditions import Row
from calflow.robot.dimensions import nominal_dimensions, nominal_loads
from calflow.robot.formats.robot_toml import RobotFile
from calflow.robot.frames import modified_dh
from calflow.robot.robot import Robot
from calflow.robot.statics import State, rated_torques, state
from calflow.robot.transforms import rot_x
from hidden import forms, simulator
from hidden.case import Case, draw, robot_file, stated_tables, write_case
from hidden.causes import (
    ARM,
    COLUMN,
    WARM_UP,
    Hidden,
    base_tilt,
    gravity_compensator,
    joint_error_map,
    measured_points,
    response,
)
from hidden.random_functions import direction
from hidden.simulator import Motion, Rows, equilibrium, statics
from hidden.tool_causes import LENGTH

ROBOTS = ("serial", "hh800")
BASE = ((3500.0, -500.0, -800.0), (0.4, -0.3, 165.0))  # mm and degrees: away from the measuring device
EVERYTHING = ("approach", "travel", "time", "temperature")
SESSIONS = ("mon", "tue", "wed", "fri")
DOCUMENT = Path(__file__).parents[2] / "docs" / "effects.md"


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


@dataclass(frozen=True)
class Bench:
    """One robot as stated, read by calflow from its files, and as the simulator knows it, at some rows of its file."""

    robot: Robot
    data: Measurements
    real: simulator.Robot
    rows: Rows
    few: np.ndarray  # of the data's rows, those in rows
    still: simulator.State  # loads in the commanded poses

    @property
    def table(self) -> Measurements:
        """The rows that are compared."""
        return self.data.only(self.few)

    def points(self, *causes: Hidden, soft: bool = True) -> np.ndarray:
        """The simulator's points."""
        real = self.real if soft else replace(self.real, compliance=0 * self.real.compliance)
        return measured_points(real, self.rows, causes)

    def torque(self, joint: int, *causes: Hidden) -> np.ndarray:
        """The simulator's torque on a joint at equilibrium."""
        _, loads = equilibrium(self.real, self.rows, lambda s: response(self.real, self.rows, s, causes))
        return loads.torque[:, joint - 1]

    def rated(self, joint: int) -> float:
        """Rated torque of a joint."""
        return float(rated_torques(self.robot)[joint - 1])


@pytest.fixture(scope="module")
def benches(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Bench]:
    """Both robots with files in which nothing is missing."""
    found = {}
    for name in ROBOTS:
        folder = tmp_path_factory.mktemp(name)
        case = Case(robot=name, poses=500, columns=EVERYTHING, base=BASE)
        write_case(folder, case, np.random.default_rng(1))
        world = draw(case, np.random.default_rng(1))
        robot = Robot.from_toml(folder / "robot.toml")
        data = read_measurements(folder / "measurements.csv", robot)
        data = Measurements(robot, data.table.assign(session=np.repeat(SESSIONS, 500 // len(SESSIONS))))
        few = np.arange(len(data)) % 8 == 0
        rows = Rows(**{part: values[few] for part, values in vars(world.rows).items()})
        rows = replace(rows, time=np.round(rows.time, 2) - world.rows.time.min().round(2))
        still = statics(world.stated, rows, Motion.none(len(rows), world.stated.n))
        found[name] = Bench(robot, data, world.stated, rows, few, still)
    return found


# --- Against the simulator ---------------------------------------------------------------------------


def made(bench: Bench, name: str, **variant: Any) -> Effect:
    """An effect of the catalogue."""
    return catalogue()[name](bench.robot, **variant)


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
    return Twin(made(bench, hidden.cause, knee=0.5 / share), {"joint2.c": 2 * hidden.size * share}, hidden)


def early_knee(bench: Bench) -> Twin:
    """The simulator's break is at a tenth of the largest torque."""
    hidden = Hidden("nonlinear-joint-stiffness", 2, 5e-4, 0.1)
    share = bench.rated(2) / np.abs(bench.torque(2, hidden)).max()
    return Twin(made(bench, hidden.cause, knee=0.1 / share), {"joint2.c": hidden.size / 0.9 * share}, hidden)


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


def bearing(joint: int, size: float) -> Callable[[Bench], Twin]:
    """A bearing that is softer about x than about y."""
    hidden = Hidden("bearing-compliance", joint, size, 0.3)
    values = {f"joint{joint}.cx": hidden.size, f"joint{joint}.cy": 0.3 * hidden.size}
    return lambda bench: Twin(made(bench, hidden.cause), values, hidden)


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
    """The third wave of a curve in time, tied to zero a twentieth of the time before the first row and after the last."""
    end, shift = float(bench.data.table["time"].max()), np.array([1e-4, -2e-4, 5e-5])
    values = dict(zip(("device.wave3x", "device.wave3y", "device.wave3z"), shift, strict=True))
    curve = np.sin(3 * pi * (bench.rows.time / end + 0.05) / 1.1)
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


def step(bench: Bench) -> Twin:
    """The simulator's moment is a time, calflow's a place in measuring order."""
    hidden = Hidden("frame-step", 0, 2e-4, seed=6)
    rng = hidden.rng
    before = bench.rows.time <= rng.uniform(0.25, 0.75) * bench.rows.time.max()
    moment = float(bench.table.table["order"][before].max()) + 0.5
    shift = hidden.size * direction(rng)
    values = dict(zip(("device.x", "device.y", "device.z"), shift, strict=True))
    return Twin(made(bench, hidden.cause, moment=moment), values, hidden)


def turning_step(bench: Bench) -> Twin:
    """The simulator's device does not turn: written here."""
    turn = np.array([2e-5, -3e-5, 5e-5])
    moment = float(np.median(bench.table.table["order"])) + 0.25
    after = bench.table.table["order"].to_numpy() > moment
    turned = lambda point, rows: point + after[:, None] * np.cross(turn, point)  # noqa: E731
    values = dict(zip(("device.rx", "device.ry", "device.rz"), turn, strict=True))
    return Twin(made(bench, "frame-step", moment=moment, turning=True), values, turned)


TWINS: dict[str, Callable[[Bench], Twin]] = {
    "joint-compliance": one("joint-compliance", "joint2.s", Hidden("joint-compliance", 2, 5e-8)),
    "nonlinear-joint-stiffness, cubic": cubic,
    "nonlinear-joint-stiffness, knee": knee,
    "nonlinear-joint-stiffness, early knee": early_knee,
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
        f"link-{kind}, link {link}": one(f"link-{kind}", f"link{link}.1/{key}", Hidden(f"link-{kind}", link, size))
        for kind, key, sizes in (("bending", "EI", (3e-9, 5e-8, 1e-7, 5e-8)), ("torsion", "GJ", (3e-8, 3e-7, 3e-7, 3e-7)))
        for link, size in enumerate(sizes, start=1)
    },
    "bearing-compliance, beside its joint": bearing_beside,
    "base-compliance, alike": one("base-compliance", "base.c", Hidden("base-compliance", 0, 1e-8)),
    "base-compliance, by direction": base_by_direction,
    "gravity-compensator": compensator,
    "payload-mass, all": one("payload-mass", "payloads.e", Hidden("payload-mass", 0, 0.2)),
    "payload-mass, one": one("payload-mass", "full.e", Hidden("payload-mass", 0, 0.2, "full")),
    "payload-com": payload_com,
    "link-mass": one("link-mass", "link3.e", Hidden("link-mass", 3, 0.3)),
    "tool-deflection, alike": tool_alike,
    "tool-deflection, by direction": tool_by_direction,
    "tool-deflection, bracket": bracket,
    "tool-sag, bracket": sagging_bracket,
    "tool-sag, bar": sagging_bar,
    "thermal-growth, temperature": one("thermal-growth", "links.alpha", Hidden("thermal-growth", 0, 2.3e-5)),
    "thermal-growth, warm-up": one("thermal-growth", "links.e", Hidden("thermal-growth", 0, 2.5e-4, "warm-up"), constant=WARM_UP),
    "thermal-growth, one link": one("thermal-growth", "link2.alpha", Hidden("link-growth", 2, 2.3e-5), apart=True),
    "thermal-growth, one link's warm-up": one("thermal-growth", "link4.e", Hidden("link-growth", 4, 2.5e-4, "warm-up"),
                                              constant=WARM_UP, apart=True),
    "housing-growth, temperature": one("housing-growth", "joint5.h", Hidden("housing-growth", 5, 1e-5)),
    "housing-growth, warm-up": one("housing-growth", "joint5.h", Hidden("housing-growth", 5, 1e-4, "warm-up"), constant=WARM_UP),
    "frame-drift, shifting": drift,
    "frame-drift, turning": turning_drift,
    "frame-drift, by the order of the rows": drift_by_rows,
    "frame-drift, anew in each session": drift_by_session,
    "frame-drift, wandering": wander,
    "session-frame, each session": frames_of_sessions,
    "session-frame, from a session on": frame_from_a_session_on,
    "frame-step, shifting": step,
    "frame-step, turning": turning_step,
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


@pytest.fixture(scope="module")
def compared(benches: dict[str, Bench]) -> Callable[[str], tuple[dict[str, Twin], Callable[..., np.ndarray]]]:
    """All twins of a robot in one graph, and its points with springs and one twin's values."""

    @lru_cache
    def of(name: str) -> tuple[dict[str, Twin], Callable[..., np.ndarray]]:
        bench = benches[name]
        twins = {key: make(bench) for key, make in TWINS.items()}
        springs = made(bench, "joint-compliance")
        effects = (springs, *(twin.effect for twin in twins.values()))
        model = Model(bench.robot, effects, bench.data.given)
        p, c = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("c", model.n_conditions)
        position = ca.Function("position", [p, c], [ca.densify(model.expression(p, c).position)])
        sizes = [len(effect.declared) for effect in effects]

        def points(key: str, soft: bool = True) -> np.ndarray:
            values = np.zeros(len(model.parameters))
            values[: sizes[0]] = soft * bench.real.compliance
            if key:
                k = list(twins).index(key) + 1
                names = [f"{parameter.part}.{parameter.symbol}" for parameter in effects[k].declared]
                for parameter, value in twins[key].values.items():
                    values[sum(sizes[:k]) + names.index(parameter)] = value
            return over_rows(position, values, bench.table.rows)[0].T

        return twins, points

    return of


def test_every_effect_is_compared() -> None:
    """Breaks if an effect was added without a comparison, or without its row in the document."""
    assert {name.split(",")[0] for name in TWINS} | APART == set(catalogue())
    rows = re.findall(r"^\| `([\w-]+)` \|", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(rows) == sorted([*catalogue(), *{check.id for check in (*plain_checks(), *checks())}])


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("soft", [True, False])
def test_effects_at_zero_are_absent(benches: dict[str, Bench], compared: Any, name: str, soft: bool) -> None:
    """Breaks if an effect acts though its parameters are zero, or leaves something that is no number."""
    assert_allclose(compared(name)[1]("", soft), benches[name].points(soft=soft), rtol=0, atol=2e-8)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("key", TWINS)
def test_an_effect_moves_the_tool_as_the_simulator_does(
    benches: dict[str, Bench], compared: Any, name: str, key: str
) -> None:
    """Breaks if sign, factor, frame, place or reference of an effect differ: neither program knows the other."""
    bench = benches[name]
    twins, points = compared(name)
    twin = twins[key]
    plain = bench.points(soft=twin.soft)
    real = bench.points(twin.cause, soft=twin.soft) if isinstance(twin.cause, Hidden) else twin.cause(plain, bench.rows)
    where = slice(None) if twin.where is None else twin.where
    effect = np.linalg.norm(real - plain, axis=1)[where]
    assert len(effect) > 20
    assert 5e-6 < np.sqrt(np.mean(effect**2)) < 3e-3
    apart = np.linalg.norm(points(key, twin.soft) - real, axis=1)[where]
    assert apart.max() < twin.close * effect.max()


def modified(of: Robot) -> Robot:
    """The same robot in modified DH: a link's frame is where its axis is, not where the next one is."""
    joints, aside, twist = [], 0.0, 0.0
    for joint in of.joints:
        figures = joint.frame.figures
        rotation = np.array(ca.DM(rot_x(figures["alpha"])))[:3, :3]
        com = rotation @ np.array(joint.com) + [figures["a"], 0.0, 0.0]
        joints.append(replace(joint, frame=modified_dh(**figures | {"a": aside, "alpha": twist}), com=com))
        aside, twist = figures["a"], figures["alpha"]
    assert aside == twist == 0  # the flange's frame is the last link's
    return replace(of, joints=joints)


OF_ONE_CONVENTION = {
    "geometry",
    "gravity-deflection",
    "joint-error-map",
    "range-noise",
    "session-frame",
    "axis-straightness",
}  # their parameters are frames' own, sessions', or rails'


@pytest.fixture(scope="module")
def conventions() -> Callable[[str], list[np.ndarray]]:
    """Points of a UR10 stated in both conventions, with springs and one effect as large as its prior, or none."""
    dh = replace(robots.ur10(), base=robots.ASKEW)
    geared = tuple(replace(joint, gear_ratio=100.0) for joint in dh.joints)
    dh = replace(dh, joints=geared)
    q, rng = robots.poses(dh, 20), np.random.default_rng(9)
    given = (*EVERYTHING, "order")
    names = [name for name in catalogue() if name not in OF_ONE_CONVENTION]
    found = []
    for robot in (dh, modified(dh)):
        model = Model(robot, tuple(catalogue()[name](robot) for name in names), given)
        p, c = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("c", model.n_conditions)
        position = ca.Function("position", [p, c], [ca.densify(model.expression(p, c).position)])
        found.append((model, position))
    rows = pack(found[0][0], q, "load", "E")
    rest = [rng.choice([-1.0, 1.0], (6, 20)), rng.uniform(0, 1, (6, 20)), rng.uniform(0, 7e3, (1, 20)),
            rng.uniform(290, 310, (1, 20)), np.arange(20.0)[None]]  # fmt: skip
    rows[-15:] = np.vstack(rest)

    def points(name: str) -> list[np.ndarray]:
        share = {"joint-compliance": 0.1} | {name: 1.0}
        return [
            over_rows(position, model.prior_sd * [share.get(p.effect, 0.0) for p in model.parameters], rows)[0].T
            for model, position in found
        ]

    return points


@pytest.mark.parametrize("name", [name for name in catalogue() if name not in OF_ONE_CONVENTION])
def test_effects_are_the_same_in_both_conventions(conventions: Callable[[str], list[np.ndarray]], name: str) -> None:
    """Breaks if an effect takes a link's far end, axis or frame for what it is in the other convention."""
    (plain, other_plain), (dh, other) = conventions(""), conventions(name)
    assert_allclose(plain, other_plain, rtol=0, atol=1e-12)
    effect = np.abs(dh - plain).max()
    assert effect > 1e-6
    assert_allclose(dh, other, rtol=0, atol=2e-3 * effect)


@pytest.mark.parametrize("name", ROBOTS)
def test_gravity_deflection_stands_for_springs(benches: dict[str, Bench], name: str) -> None:
    """Breaks if first moments and compliance, of a robot without masses, leave a part of what springs do under any load."""
    bench = benches[name]
    bare = without_masses(name)
    model = Model(bare, (catalogue()["gravity-deflection"](bare),), bench.data.given)
    real, plain = bench.points(), bench.points(soft=False)
    seen = np.arange(len(real)) % 4 != 1
    assert {0, 1, 2} == set(bench.rows.payload[seen]) == set(bench.rows.payload[~seen])
    rows, p = bench.table.rows, np.zeros(len(model.parameters))
    for _ in range(2):
        slope = model.position_jacobian(p, rows[:, seen]).reshape(-1, len(p)) * model.prior_sd
        left = (real[seen] - model.position(p, rows[:, seen])).ravel()
        p = p + model.prior_sd * np.linalg.lstsq(slope, left, rcond=1e-9)[0]
    apart, effect = (np.linalg.norm(shift[~seen], axis=1) for shift in (model.position(p, rows) - real, real - plain))
    assert effect.max() > 2e-3
    assert apart.max() < 0.01 * effect.max()


def without_masses(name: str) -> Robot:
    """The robot whose links' masses nobody knows."""
    file = robot_file(stated_tables(Case(robot=name, base=BASE)), masses=False)
    return Robot(**RobotFile.model_validate(file).fields())


def waves(effect: Effect, joint: int, angle: np.ndarray) -> np.ndarray:
    """What each parameter of a joint's error adds to it at these angles (n_angles, n_parameters)."""
    loads = State.symbols(effect.robot)
    terms = effect.terms(joint - 1, loads, Row.symbols(effect.robot))
    values = ca.Function("terms", [loads.q], [ca.vertcat(*(term.value for term in terms))])
    q = np.zeros((effect.robot.n_joints, len(angle)))
    q[joint - 1] = angle
    return np.array(values(q)).T


@pytest.fixture(scope="module")
def dense(benches: dict[str, Bench]) -> Measurements:
    """Readings all over the joints' travel."""
    robot = benches["serial"].robot
    q = np.random.default_rng(8).uniform(*robot.limits.T, (800, robot.n_joints))
    return Measurements(robot, pd.DataFrame(q, columns=numbered("q", robot.n_joints)))


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("joint", [2, 6])
def test_a_joint_error_map_follows_a_smooth_curve(
    benches: dict[str, Bench], dense: Measurements, joint: int, length: float
) -> None:
    """Breaks if the waves do not reach the travel's ends, are too few, or their priors are those of other waves."""
    effect = next(e for e in catalogue()["joint-error-map"].variants(dense.robot, dense) if e.length == length)
    sd = np.array([parameter.prior_sd for parameter in effect.declared if parameter.joint == joint])
    angle = dense.joints[:, joint - 1]
    real = benches["serial"].real
    rows = replace(benches["serial"].rows, q=dense.joints)
    curve = joint_error_map(
        Hidden("joint-error-map", joint, AMPLITUDE, seed=7), real, rows, np.zeros_like(dense.joints)
    )
    seen, noise = np.arange(len(angle)) % 4 != 0, 0.01 * AMPLITUDE
    scaled = waves(effect, joint, angle) * sd
    found = np.linalg.solve(scaled[seen].T @ scaled[seen] + noise**2 * np.eye(len(sd)), scaled[seen].T @ curve[seen])
    left = (scaled @ found - curve)[~seen]
    assert np.sqrt(np.mean(left**2)) < 0.01 * curve.std()

    middle = np.array([(effect.low[joint - 1] + effect.high[joint - 1]) / 2])
    variance = ((waves(effect, joint, middle) * sd) ** 2).sum()
    assert variance == pytest.approx(AMPLITUDE**2, rel=0.03)


def test_far_travel_makes_hysteresis_backlash(benches: dict[str, Bench]) -> None:
    """Breaks if friction develops to another size than h, or does not begin on the side where the joint was before."""
    robot = benches["serial"].robot
    loads, row = State.symbols(robot), Row.symbols(robot)
    length = np.deg2rad(4.0)
    hysteresis, backlash = (
        made(benches["serial"], "joint-hysteresis", length=length),
        made(benches["serial"], "joint-backlash"),
    )
    terms = [effect.terms(2, loads, row)[0].value for effect in (hysteresis, backlash)]
    values = ca.Function("terms", [row.approach, row.travel], terms)
    for side in (-1.0, 1.0):
        approach, travel = np.full(6, side), np.full(6, 100 * length)
        h, b = (float(value) for value in values(approach, travel))
        assert h == pytest.approx(2 * b) == side  # as large for h = b / 2
        assert float(values(approach, 0 * travel)[0]) == -side
        assert float(values(approach, np.full(6, np.log(2) * length))[0]) == pytest.approx(0)


@pytest.mark.parametrize("name", ROBOTS)
def test_range_noise_grows_with_distance(benches: dict[str, Bench], name: str) -> None:
    """Breaks if the scatter is not that of noise in proportion to the distance from the device, or a point is moved."""
    bench = benches[name]
    model = Model(bench.robot, (made(bench, "range-noise"),), bench.data.given)
    p, c = ca.SX.sym("p"), ca.SX.sym("c", model.n_conditions)
    row = Row.unpack(bench.robot, c, bench.data.given)
    scatter = ca.Function("scatter", [p, c], [ca.densify(ca.SX(model.effects[0].scatter(p, row)))])
    found = over_rows(scatter, np.array([2.5e-5]), bench.table.rows)[0].ravel()
    assert_allclose(found, 2.5e-5 * np.linalg.norm(bench.table.position, axis=1), rtol=1e-12)
    assert model.effects[0].scatter(p, Row.unpack(bench.robot, c)) == 0  # of rows whose distance nobody knows
    assert not ca.jacobian(model.expression(p, c).position, p).nnz()


# --- What effects say of themselves ------------------------------------------------------------------

VARIANTS = {  # how many forms there are to try, where not one
    "base-compliance": 2,
    "nonlinear-joint-stiffness": 6,
    "loaded-transmission-error": 6,
    "torque-backlash": 2,
    "joint-eccentricity": 2,
    "gear-transmission-error": 2,
    "gravity-compensator": 5,
    "link-bending": 2,
    "bearing-compliance": 2,
    "joint-hysteresis": 5,
    "joint-error-map": 3,
    "tool-deflection": 3,
    "tool-sag": 3,
    "base-tilt": 3,
    "thermal-growth": 10,
    "housing-growth": 5,
    "frame-drift": 6,
    "session-frame": 8,
}


def figures(effect: Effect) -> tuple[Any, ...]:
    """What makes the variant."""
    return tuple(getattr(effect, field.name) for field in fields(effect) if field.name != "robot")


@pytest.fixture(scope="module")
def full(benches: dict[str, Bench], dense: Measurements) -> Measurements:
    """Rows in which nothing is missing, and that cover the joints' travel."""
    data = benches["serial"].data
    table = data.table.copy()
    table[numbered("q", 6)] = dense.joints[: len(table)]
    return Measurements(data.robot, table)


@pytest.mark.parametrize("name", [name for name in catalogue() if name != "axis-straightness"])  # neither has a rail
def test_variants_are_distinct_and_told_apart(full: Measurements, name: str) -> None:
    """Breaks if one form is tried twice, two forms are called alike, or one of several has no words of its own."""
    variants = catalogue()[name].variants(full.robot, full)
    assert all(type(effect) is catalogue()[name] and effect.robot == full.robot for effect in variants)
    if name not in ("periodic-joint-error", "frame-step"):
        assert len(variants) == VARIANTS.get(name, 1)
    assert len({figures(effect) for effect in variants}) == len(variants)
    details = {effect.detail for effect in variants}
    assert len(details) == len(variants)
    assert ("" in details) == (len(variants) == 1)
    for effect in variants[:8]:
        names = [parameter.name for parameter in effect.declared]
        assert names
        assert len(set(names)) == len(names)
    if name not in (
        "periodic-joint-error",
        "frame-step",
        "torque-backlash",
        "loaded-transmission-error",
        "gravity-compensator",
    ):
        assert variants[0].finer(full) == ()


@pytest.mark.parametrize("robot", ROBOTS)
def test_no_two_parameters_share_an_identity_or_a_name(benches: dict[str, Bench], robot: str) -> None:
    """Fails if two variants of an effect, or two effects at one place, have a parameter that goes by the same name."""
    stated, table = benches[robot].robot, benches[robot].data.table.copy()
    limits = np.where(np.isfinite(stated.limits), stated.limits, np.sign(stated.limits) * pi)
    table[numbered("q", 6)] = np.random.default_rng(8).uniform(*limits.T, (len(table), 6))
    data = Measurements(stated, table)
    forms: dict[tuple[Any, ...], Effect] = {}
    for name, kind in catalogue().items():
        variants = kind.variants(stated, data)
        assert variants or kind.lacking(stated, data)
        near = [finer for variant in variants[:2] for finer in variant.finer(data)]
        forms |= {
            (name, *(f"{figure:.12g}" if isinstance(figure, float) else figure for figure in figures(effect))): effect
            for effect in (*variants, *near)
        }  # 1800 and exp(log(1800)) are one
    parameters = [parameter for effect in forms.values() for parameter in effect.declared]
    assert len(parameters) > 3000
    assert len({parameter.identity for parameter in parameters}) == len(parameters)
    assert len({parameter.name for parameter in parameters}) == len(parameters)
    for parameter in parameters:
        plain = parameter.effect in ("geometry", "joint-compliance")
        assert (parameter.name == f"{parameter.part}.{parameter.symbol}") == plain
        assert plain or parameter.effect in parameter.name
        assert len(parameter.variant) < 40
        assert not set(parameter.variant) & set(",;[]")  # which lists of names, and names, are made with


def test_names_tell_the_variant_and_stay_the_same_at_one_place(benches: dict[str, Bench]) -> None:
    """Fails if a cause's parameters are called otherwise than its effect's, or a name hides which form it is of."""
    robot = benches["serial"].robot
    eccentric = made(benches["serial"], "joint-eccentricity", order=2)
    own = Cause(robot, eccentric, "joint3").declared
    assert [parameter.name for parameter in own] == [
        "joint3.joint-eccentricity[order 2].cos",
        "joint3.joint-eccentricity[order 2].sin",
    ]
    assert own == tuple(parameter for parameter in eccentric.declared if parameter.joint == 3)
    assert made(benches["serial"], "joint-backlash").declared[1].name == "joint2.joint-backlash.b"
    drift = made(benches["serial"], "frame-drift", turning=True).declared[0]
    assert drift.identity == ("frame-drift", "turning", "device", "vx")


def test_a_knee_between_two_that_are_tried_is_reached(full: Measurements) -> None:
    """Breaks if refinement leaves gaps between the knees, or does not become denser towards the best one."""
    variants = [effect for effect in catalogue()["nonlinear-joint-stiffness"].variants(full.robot, full) if effect.knee]
    knees = [effect.knee for effect in variants]
    for variant in variants:
        finer = np.array([effect.knee for effect in variant.finer(full)])
        assert finer.min() > 0
        assert np.diff(finer).max() < 0.05
        assert np.sort(np.abs(finer - variant.knee))[1] < 0.005
        assert all(np.abs(finer - other).min() < 0.05 for other in knees if abs(other - variant.knee) < 0.16)


def test_a_load_is_what_the_data_tell(full: Measurements) -> None:
    """Breaks if a wave is tried against a torque or a temperature that nobody knows, or a warm one keeps a loaded one out."""
    kind = catalogue()["loaded-transmission-error"]
    assert [effect.warm for effect in kind.variants(full.robot, full)] == [False] * 3 + [True] * 3
    cold, weightless = without(full, "temperature"), bare(full)
    assert not any(effect.warm for effect in kind.variants(cold.robot, cold))
    assert all(effect.warm for effect in kind.variants(weightless.robot, weightless))
    loaded = kind(full.robot, 1)
    assert loaded.same_as(kind(full.robot, 1))
    assert not any(loaded.same_as(other) for other in (kind(full.robot, 1, warm=True), kind(full.robot, 2)))
    assert [effect.order for effect in loaded.finer(full)] == [2]
    assert [effect.order for effect in kind(full.robot, 2, geared=True).finer(full)] == [1]


def test_backlash_does_not_become_a_stiffness(full: Measurements) -> None:
    """Breaks if a change of sides is refined until it is a smooth function of the torque, or not refined at all."""
    crossings = {effect.crossing for effect in catalogue()["torque-backlash"].variants(full.robot, full)}
    for _ in range(6):
        finer = {e.crossing for c in crossings for e in made_torque(full, c).finer(full)}
        assert finer
        crossings = {min(finer), max(finer)}
    assert min(crossings) < 0.001
    assert 0.025 < max(crossings) <= 0.05


def made_torque(data: Measurements, crossing: float) -> Effect:
    """Backlash by torque with one width of its change of sides."""
    return catalogue()["torque-backlash"](data.robot, crossing)


def test_orders_are_scanned_without_gaps(full: Measurements) -> None:
    """Breaks if an order between two that are tried could be missed, or refinement leaves the neighbourhood."""
    variants = catalogue()["periodic-joint-error"].variants(full.robot, full)
    orders = np.array([effect.order for effect in variants])
    half = np.ptp(full.joints, axis=0).max() / 2
    assert (np.diff(orders) > 0).all()
    assert np.diff(orders).max() * half < 1  # rad of phase at the ends of the longest travel
    assert orders[0] <= 2.5
    assert orders[-1] > 29.5
    finer = np.array([effect.order for effect in variants[20].finer(full)])
    assert orders[19] - 1e-9 <= finer.min() < orders[20] < finer.max() <= orders[21] + 1e-9
    assert np.diff(finer).max() < 0.3 * np.diff(orders).min()
    assert min(effect.order for effect in variants[0].finer(full)) > 2  # below is eccentricity


def test_every_moment_of_a_step_is_within_reach(full: Measurements) -> None:
    """Breaks if moments that a long scan leaves out are not tried about the best one, or lie at a row."""
    order = full.table["order"].to_numpy()
    variants = catalogue()["frame-step"].variants(full.robot, full)
    turned = np.array([effect.turning for effect in variants])
    moments = np.array([effect.moment for effect in variants])
    assert len(moments[~turned]) <= 120 < len(order)
    assert 0 < len(moments[turned]) <= 40
    assert not np.isin(moments, order).any()
    fewest = [(order < moments.min()).sum(), (order > moments.max()).sum()]
    assert min(fewest) >= 3
    for turning in (False, True):
        reached = {e.moment for variant in variants if variant.turning == turning for e in variant.finer(full)}
        change = np.flatnonzero(full.table["session"].iloc[1:].to_numpy() != full.table["session"].iloc[:-1].to_numpy())
        assert len(change) == 3
        borders = {*(order[change] + 0.5)}
        assert reached >= {*np.arange(order.min() + 2.5, order.max() - 2.5)} - borders
        assert not reached & borders  # a change between sessions is a session's frame
    assert all(effect.turning == variant.turning for variant in variants for effect in variant.finer(full))
    short = full.only(np.arange(len(full)) < 20)
    every = catalogue()["frame-step"].variants(short.robot, short)
    assert len(every) == 2 * (20 - 2 * 3 + 1)
    assert catalogue()["frame-step"].variants(short.robot, full.only(np.arange(len(full)) < 5)) == ()


def test_thermal_growth_goes_with_what_was_measured(full: Measurements) -> None:
    """Breaks if a thermometer that stood still is believed, or time is not taken where no temperature is."""
    kind = catalogue()["thermal-growth"]
    assert [effect.constant > 0 for effect in kind.variants(full.robot, full)] == [False, True, True, True, True] * 2
    timeless = without(full, "time")
    assert [effect.constant for effect in kind.variants(full.robot, timeless)] == [0.0, 0.0]
    still = Measurements(full.robot, full.table.assign(temperature=293.0))
    assert all(effect.constant > 0 for effect in kind.variants(full.robot, still))
    assert kind.lacking(full.robot, without(still, "time"))


def test_what_grows_on_its_own_is_as_little_as_can_be_told(benches: dict[str, Bench]) -> None:
    """Fails if a stub, or an offset that is a link's length or its neighbour's, is a place of its own."""
    parts = lambda name, **variant: [p.part for p in made(benches["serial"], name, **variant).declared]  # noqa: E731
    assert parts("thermal-growth") == ["links"]
    assert parts("thermal-growth", apart=True) == ["link1", "link2", "link3", "link4", "link6"]
    assert parts("housing-growth") == ["joint2", "joint5"]


def without(data: Measurements, *conditions: str) -> Measurements:
    """The rows without some optional conditions."""
    columns = [column for name in conditions for column in condition_columns(name, data.robot)]
    return Measurements(data.robot, data.table.drop(columns=columns))


def changed(data: Measurements, **fields: Any) -> Measurements:
    """The rows of a robot whose file says something else."""
    return Measurements(replace(data.robot, **fields), data.table)


def bare(data: Measurements) -> Measurements:
    """The rows of a robot whose file tells no masses."""
    return changed(data, joints=tuple(replace(joint, mass=None) for joint in data.robot.joints))


def gearless(data: Measurements) -> Measurements:
    """The rows of a robot whose file tells no gear ratio."""
    return changed(data, joints=tuple(replace(joint, gear_ratio=None) for joint in data.robot.joints))


OF_MASSES = (
    "joint-compliance", "nonlinear-joint-stiffness", "torque-backlash", "bearing-compliance", "link-bending",
    "link-torsion", "base-compliance", "gravity-compensator", "payload-mass", "payload-com", "link-mass",
    "friction-wind-up",
)  # fmt: skip
LACKING: list[tuple[str, Callable[[Measurements], Measurements], str]] = [
    *((name, bare, "mass_kg and com_mm") for name in OF_MASSES),
    *((name, lambda data: changed(data, payloads={}), "payload") for name in ("payload-mass", "payload-com", "tool-deflection")),
    ("gear-transmission-error", gearless, "gear_ratio"),
    ("joint-backlash", lambda data: without(data, "approach"), "approach1"),
    ("joint-hysteresis", lambda data: without(data, "approach"), "approach1"),
    ("friction-wind-up", lambda data: without(data, "approach"), "approach1"),
    ("loaded-transmission-error", lambda data: bare(without(data, "temperature")), "torques tau1_Nm .* temperature_degC"),
    ("joint-hysteresis", lambda data: without(data, "travel"), "travel1_deg"),
    ("thermal-growth", lambda data: without(data, "time", "temperature"), "temperature_degC .* time_s"),
    ("housing-growth", lambda data: without(data, "time", "temperature"), "temperature_degC .* time_s"),
    ("frame-drift", lambda data: without(data, "time", "order"), "time_s"),
    ("session-frame", lambda data: without(data, "session"), "column session"),
    ("session-frame", lambda data: data.only((data.table["session"] == "tue").to_numpy()), "two sessions"),
    ("session-frame", lambda data: replace(data, series=(Series(station=Station(by_session=True)),)), "by_session"),
    ("frame-step", lambda data: without(data, "order"), "measuring order"),
    ("range-noise", lambda data: without(data, "range"), "tracker_mm"),
    ("joint-error-map", lambda data: data.only(np.arange(len(data)) < 50), "readings per 0.05 rad"),
    ("axis-straightness", lambda data: data, "prismatic joint"),
    ("gravity-deflection", lambda data: data, "joint-compliance"),
    ("base-tilt", lambda data: data, "base-compliance"),
    ("tracker-scale", lambda data: data, "relative_sd_mm"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "taken", "words"), LACKING, ids=[f"{row[0]}-{row[2]}" for row in LACKING])
def test_what_is_lacking_is_told_in_words(
    full: Measurements, name: str, taken: Callable[[Measurements], Measurements], words: str
) -> None:
    """Breaks if an effect is looked for in data that cannot show it, or the column that would help is not named."""
    data = taken(full)
    kind = catalogue()[name]
    assert re.search(words, kind.superseded(data.robot) or kind.lacking(data.robot, data))
    if name not in ("gravity-deflection", "base-tilt", "tracker-scale", "axis-straightness"):
        assert catalogue()[name].lacking(full.robot, full) == ""


@pytest.mark.parametrize("name", [name for name in catalogue() if name not in {row[0] for row in LACKING}])
def test_the_others_need_nothing(full: Measurements, name: str) -> None:
    """Breaks if an effect asks for a column that its equation does not have."""
    poor = gearless(changed(bare(without(full, *full.given)), payloads={}))
    poor = poor.only(np.arange(len(poor)) < 50)
    assert catalogue()[name].lacking(poor.robot, poor) == ""
    assert catalogue()[name].variants(poor.robot, poor)


ANGLE = lambda bench, joint: np.rad2deg(bench.rows.q[:, joint - 1])  # noqa: E731
TORQUE = lambda bench, joint: bench.still.torque[:, joint - 1]  # noqa: E731
PLACE = lambda bench, joint: bench.table.table["order"].to_numpy()  # noqa: E731
LOAD = lambda bench, joint: bench.real.payload_mass[bench.rows.payload]  # noqa: E731
HOURS = lambda bench, joint: bench.rows.time / 3600  # noqa: E731
END = lambda bench, joint: np.linalg.norm(bench.still.tip_moment[:, joint - 1], axis=1)  # noqa: E731


def by_rule(bench: Bench) -> np.ndarray:
    """Overturning moment of links of half the mass of those before, each in the middle between its axis and its end."""
    at, moment, most, beyond = bench.still.frames, 0.0, 0.0, sum(0.5**i for i in range(bench.real.n))
    for i, (joint, tip) in enumerate(zip(at.joints, at.tips, strict=True)):
        start, end = joint[:, :3, 3], tip[:, :3, 3]
        length = np.linalg.norm(end - start, axis=1)[0]
        moment = moment + 0.5**i * np.cross((start + end) / 2, [0.0, 0.0, -1.0])
        beyond -= 0.5**i
        most += 0.5**i * max(length, 0.1) / 2 + beyond * length
    return np.linalg.norm(moment, axis=1) / most


AGAINST: dict[str, tuple[str, Callable[[Bench, int], np.ndarray]]] = {
    **dict.fromkeys(("joint-eccentricity", "periodic-joint-error", "gear-transmission-error", "joint-error-map",
                     "loaded-transmission-error",
                     "gear-ratio-error", "gravity-deflection", "gravity-compensator"), ("deg", ANGLE)),
    "wrist-coupling": ("deg", lambda bench, joint: ANGLE(bench, joint - 1)),
    **dict.fromkeys(("joint-compliance", "nonlinear-joint-stiffness", "torque-backlash"), ("Nm", TORQUE)),
    "friction-wind-up": ("Nm", lambda bench, joint: bench.rows.approach[:, joint - 1] * np.abs(TORQUE(bench, joint))),
    "link-mass": ("Nm", lambda bench, joint: TORQUE(bench, 2)),
    "joint-backlash": ("", lambda bench, joint: bench.rows.approach[:, joint - 1]),
    "joint-hysteresis": ("deg", lambda bench, joint: np.rad2deg(bench.rows.approach * bench.rows.travel)[:, joint - 1]),
    "bearing-compliance": ("Nm", lambda bench, joint: np.linalg.norm(bench.still.moment[:, joint - 1, :2], axis=1)),
    "base-compliance": ("Nm", lambda bench, joint: np.linalg.norm(bench.still.base_moment[:, :2], axis=1)),
    **dict.fromkeys(("link-bending", "link-torsion"), ("Nm", END)),
    "base-tilt": ("", lambda bench, joint: by_rule(bench)),
    "tool-sag": ("deg", lambda bench, joint: np.rad2deg(np.arccos(-bench.still.frames.tips[-1][:, 2, 2]))),
    **dict.fromkeys(("payload-mass", "payload-com", "tool-deflection"), ("kg", LOAD)),
    **dict.fromkeys(("thermal-growth", "housing-growth"), ("K", lambda bench, joint: bench.rows.temperature - 20)),
    "frame-drift": ("h", HOURS),
    **dict.fromkeys(("frame-step", "session-frame", "tracker-scale", "range-noise", "geometry"), ("", PLACE)),
}  # fmt: skip


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("effect", catalogue())
def test_effects_are_drawn_against_what_explains_them(benches: dict[str, Bench], name: str, effect: str) -> None:
    """Breaks if a curve's variable is that of another joint, in another unit, or called so."""
    bench = benches[name]
    model = Model(bench.robot, (), bench.data.given)
    c = ca.SX.sym("c", model.n_conditions)
    row = Row.unpack(bench.robot, c, bench.data.given)
    nominal, still = (nominal_dimensions(bench.robot), nominal_loads(bench.robot)), Deflection.zero(6)
    loads = state(bench.robot, *nominal, row, still)
    if effect == "axis-straightness":
        return  # neither robot has a rail
    found = catalogue()[effect].variants(bench.robot, bench.data)[0]
    joints = sorted({parameter.joint for parameter in found.declared})
    shown = [found.variable(joint) for joint in joints]
    values = ca.vertcat(*(variable.value(loads, row) for variable in shown))
    found_at = over_rows(
        ca.Function("variables", [model.symbols[0], c], [ca.densify(values)]), np.zeros(0), bench.table.rows
    )
    unit, expected = AGAINST[effect]
    for joint, variable, value in zip(joints, shown, found_at[0], strict=True):
        assert variable.unit == unit
        assert variable.label
        wanted = expected(bench, joint)
        finest = 6e-4 if effect == "joint-hysteresis" else 1e-6  # a file's travel is in thousandths of a degree
        assert_allclose(variable.factor * value, wanted, atol=finest * max(1.0, 1e-2 * np.abs(wanted).max()))


def test_warm_up_is_drawn_against_time(benches: dict[str, Bench]) -> None:
    """Breaks if growth in time is drawn against a temperature."""
    variable = made(benches["serial"], "thermal-growth", constant=1800.0).variable(0)
    assert (variable.label, variable.unit, variable.factor) == ("time", "h", 1 / 3600)


def test_a_size_is_of_one_unit(benches: dict[str, Bench]) -> None:
    """Breaks if metres and radians are added, or a map's size is not the curve's root mean square."""
    drift = made(benches["serial"], "frame-drift", turning=True)
    assert float(ca.DM(drift.size(ca.DM([3.0, 4.0, 0.0, 9.0, 9.0, 9.0])))) == 5.0
    of_map = made(benches["serial"], "joint-error-map", low=(-1.0,) * 6, high=(1.0,) * 6)
    values = np.zeros(sum(parameter.joint == 1 for parameter in of_map.declared))
    values[[1, 4]] = 3e-4, 4e-4
    curve = waves(of_map, 1, np.linspace(-1.1, 1.1, 2001)) @ values
    assert float(ca.DM(of_map.size(ca.DM(values)))) == pytest.approx(np.sqrt(np.mean(curve**2)), rel=1e-3)
