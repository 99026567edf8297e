"""Cases: a study folder for calflow with hidden causes in its data, and beside it the sealed answer."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hidden.backgrounds import Background, displaced
from hidden.causes import KNOWN, PAYLOADS, PHYSICAL, WIND_UP, Hidden, measured_points
from hidden.file_faults import ON_TABLE, XYZ
from hidden.frame_causes import session_names
from hidden.simulator import Array, Motion, Robot, Rows, frames, moved, read, worn

HH800 = Path(__file__).parents[2] / "studies" / "hh800" / "robot.toml"
GEARS = (203, 187.5, 215, 191.25, 224, 181)
COMPLIANCE = {
    "serial": (0.6e-6, 0.8e-6, 1.2e-6, 3e-6, 4e-6, 5e-6),
    "hh800": (1.85e-7, 1.792e-7, 1.915e-7, 1.959e-7, 1.82e-7, 1.9e-7),
}
REGION = {
    "serial": ((0.8, -1.8, -0.5), (3.0, 1.8, 2.6)),
    "hh800": ((1.5, -1.6, 0.5), (3.6, 1.6, 3.0)),
}  # m, of the base
MARKERS = ((0, 0, 0), (-0.05, -0.3, 0.05), (0.2, -0.2, -0.1))  # m, from the first one; about 0.3 m apart

SERIAL = """\
name = "Serial 210"
convention = "modified-dh"

[base]
origin_mm = [3500, 500, -800]
rotation_deg = [0.4, -0.3, 165]

[[joints]]
d_mm = 670
limits_deg = [-170, 170]
mass_kg = 420
com_mm = [100, -20, -200]

[[joints]]
alpha_deg = -90
a_mm = 312
theta_deg = -90
limits_deg = [-60, 75]
mass_kg = 260
com_mm = [500, 10, 100]

[[joints]]
a_mm = 1075
limits_deg = [-100, 65]
mass_kg = 230
com_mm = [100, -50, 30]

[[joints]]
alpha_deg = -90
a_mm = 225
d_mm = 1280
limits_deg = [-180, 180]
mass_kg = 85
com_mm = [10, 20, -400]

[[joints]]
alpha_deg = 90
limits_deg = [-120, 120]
mass_kg = 45
com_mm = [0, -30, 10]

[[joints]]
alpha_deg = -90
d_mm = 215
theta_deg = 180
limits_deg = [-180, 180]
mass_kg = 12
com_mm = [0, 2, -30]

[payloads.full]
mass_kg = 150
com_mm = [90, -50, 200]

[markers.E]
point_mm = [150, 120, 180]
"""


@dataclass(frozen=True)
class Case:
    """What is measured, and what is hidden in it; robot is "serial" or "hh800".

    noise is "gauss", "heavy", "range" or "outliers"; columns may hold "approach", "travel", "time", "temperature",
    "session" and "sigma"; effects are the study's. The real robot's joints are compliant where effects or hidden say so.
    base replaces the robot file's (origin in mm, rotation in degrees). relative_sd [m] is in the robot file where the
    markers keep their places beside the first. settings is text at the end of study.toml. background is what no catalogue has.
    The robot stands for pause [s] after half of the poses. A counterweight behind joint 3 lifts the arm where it carries nothing.
    """

    name: str = "case"
    robot: str = "serial"
    hidden: tuple[Hidden, ...] = ()
    noise: str = "gauss"
    sigma: float = 4e-5
    poses: int = 120
    payloads: tuple[str, ...] = ("none", "half", "full")
    counterweight: bool = False
    markers: int = 1
    relative_sd: float = 0.0
    repeats: int = 1
    effects: tuple[str, ...] = ("geometry", "joint-compliance")
    masses: bool = True
    columns: tuple[str, ...] = ("approach",)
    base: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    workflow: str = "diagnose"
    seed: int = 0
    settings: str = ""
    background: Background | None = None
    pause: float = 0.0


@dataclass(frozen=True)
class World:
    """One drawing of a case: the robot file's tables, the robot as stated and as built, what it did, what it hides."""

    tables: dict[str, Any]
    stated: Robot
    real: Robot
    rows: Rows
    pose: Array
    repeat: Array
    hidden: tuple[Hidden, ...]


def write_case(folder: Path, case: Case, rng: np.random.Generator) -> None:
    """Write robot.toml, study.toml, measurements.csv and answer.json."""
    world = draw(case, rng)
    point = measured_points(world.real, world.rows, world.hidden)
    seen = point + displaced(case.background, world.real, world.rows) if case.background else point
    table, faulty = measure(case, world, seen, rng)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.toml").write_text(toml(robot_file(world.tables, case.masses)), encoding="utf-8")
    (folder / "study.toml").write_text(_study(case), encoding="utf-8")
    table.to_csv(folder / "measurements.csv", index=False)
    (folder / "answer.json").write_text(json.dumps(answer(world, point, faulty), indent=1), encoding="utf-8")


def effect_rms(case: Case, rng: np.random.Generator | None = None) -> list[float]:
    """How far each hidden cause moves the measured points, rms over the rows [mm]; nan where it moves none."""
    world = draw(case, rng or np.random.default_rng(case.seed))
    point = measured_points(world.real, world.rows, world.hidden)
    return [float(np.sqrt(np.mean(shift**2))) for shift in _shifts(world, point)]


def draw(case: Case, rng: np.random.Generator) -> World:
    """Draw the real robot, its poses and ways, and every cause's own random figures."""
    if unknown := [h.cause for h in case.hidden if h.cause not in KNOWN]:
        raise ValueError(f"unknown causes: {unknown}")
    tables = stated_tables(case)
    compliance = np.array(COMPLIANCE[case.robot])
    stated = read(tables, compliance)
    real = worn(stated, rng, rigid=case.relative_sd > 0)
    hidden = tuple(
        replace(h, joint=joint, size=size, seed=int(rng.integers(2**32)))
        for h in case.hidden
        for joint, size in _springs(h, real.compliance)
    )
    if "joint-compliance" not in case.effects:
        real = replace(real, compliance=0 * compliance)
    q = draw_poses(stated, case, rng)
    rows, pose, repeat = _measure_rows(stated, case, q, rng)
    return World(tables, stated, real, rows, pose, repeat, hidden)


def _springs(h: Hidden, compliance: Array) -> list[tuple[int, float]]:
    """A spring at joint 0 is one at every joint, of size times the usual compliance; all else is as it is."""
    if h.cause in ("joint-compliance", "gravity-deflection") and h.joint == 0:
        return [(i + 1, h.size * soft) for i, soft in enumerate(compliance)]
    return [(h.joint, h.size)]


# --- What the robot does -----------------------------------------------------------------------------


def stated_tables(case: Case) -> dict[str, Any]:
    """The tables of the maker's robot file, with three payloads, gear ratios and as many markers as asked for."""
    tables = tomllib.loads(SERIAL if case.robot == "serial" else HH800.read_text(encoding="utf-8"))
    full = dict(tables["payloads"].get("full") or tables["payloads"]["rated"])
    masses = (0.0, full["mass_kg"] / 2, full["mass_kg"])
    tables["payloads"] = {name: full | {"mass_kg": mass} for name, mass in zip(PAYLOADS, masses, strict=True)}
    for joint, ratio in zip(tables["joints"], GEARS, strict=True):
        joint["gear_ratio"] = ratio
    if case.counterweight:
        tables["joints"][2] |= {"mass_kg": 2000, "com_m": [0.25, 0.8, 0.0]}
    ((_, marker),) = tables["markers"].items()
    first = np.array(marker.get("point_mm") or 1000 * np.array(marker["point_m"]))
    points = [(first + 1000 * np.array(aside)).tolist() for aside in MARKERS[: case.markers]]
    tables["markers"] = {name: {"point_mm": point} for name, point in zip("EFG", points, strict=False)}
    if case.relative_sd:
        for name in list(tables["markers"])[1:]:
            tables["markers"][name]["relative_sd_mm"] = 1e3 * case.relative_sd
    if case.base:
        tables["base"] = {"origin_mm": list(case.base[0]), "rotation_deg": list(case.base[1])}
    return tables


def draw_poses(robot: Robot, case: Case, rng: np.random.Generator) -> Array:
    """Random joint readings (poses, n) as a file states them: the tool before the robot, a loop off its dead points."""
    low, high = np.array(REGION[case.robot])
    found = np.empty((0, robot.n))
    while len(found) < case.poses:
        q = np.deg2rad(np.round(np.rad2deg(rng.uniform(*robot.limits.T, (2000, robot.n))), 4))
        if robot.loop:
            q = q[np.sin(q[:, robot.loop.joint] - q[:, robot.loop.joint - 1]) > 0.3]
        tool = moved(frames(robot, q, Motion.none(len(q), robot.n)).tips[-1], robot.markers[0])
        found = np.concatenate([found, q[((tool > low) & (tool < high)).all(axis=1)]])
    return found[: case.poses]


def _measure_rows(robot: Robot, case: Case, q: Array, rng: np.random.Generator) -> tuple[Rows, Array, Array]:
    poses, each = len(q), case.repeats * case.markers
    carried = np.array([PAYLOADS.index(name) for name in case.payloads])[np.arange(poses) % len(case.payloads)]
    approach, travel, wound = _ways(robot, q, rng)
    pose, within = np.repeat(np.arange(poses), each), np.tile(np.arange(each), poses)
    time = np.cumsum(rng.uniform(15, 45, poses))[pose] + 2.0 * within + case.pause * (pose >= poses // 2)
    swing, phase = rng.uniform(1, 2), rng.uniform(0, 2 * np.pi)
    temperature = 20 + 6 * (1 - np.exp(-time / 3000)) + swing * np.sin(2 * np.pi * time / 2500 + phase)
    rows = Rows(
        q=q[pose],
        payload=carried[pose],
        marker=within % case.markers,
        approach=approach[pose],
        travel=travel[pose],
        wound=wound[pose],
        time=time,
        temperature=np.round(temperature, 2),
    )
    return rows, pose + 1, within // case.markers + 1


def _ways(robot: Robot, q: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """How each joint comes to each pose: direction, travel since its reversal, and the wind-up of its friction there.

    A joint goes back to its reversal point, then to the pose; wind-up tends to the direction of travel exponentially.
    """
    low, high = robot.limits.T
    shortest, longest = np.deg2rad([0.5, 40.0])
    side = rng.choice([-1.0, 1.0], q.shape)
    room = np.where(side > 0, q - low, high - q)
    side = np.where(room < shortest, -side, side)
    room = np.where(side > 0, q - low, high - q)
    travel = np.minimum(rng.uniform(shortest, longest, q.shape), room)
    reversal = q - side * travel
    before = np.clip(reversal + side * rng.uniform(0.1, 0.7, q.shape), low, high)
    state, at, wound = rng.uniform(-1, 1, robot.n), before[0], np.empty_like(q)
    for i in range(len(q)):
        for goal in (before[i], reversal[i], q[i]):
            way = np.sign(goal - at)
            state = way + (state - way) * np.exp(-np.abs(goal - at) / WIND_UP)
            at = goal
        wound[i] = state
    return side, travel, wound


# --- What is written ---------------------------------------------------------------------------------


def measure(case: Case, world: World, point: Array, rng: np.random.Generator) -> tuple[pd.DataFrame, Array]:
    """The measurement table, and which of its rows are wrong."""
    rows, options = world.rows, case.columns
    seen, sigma = _noisy(case, world, point, rng)
    table = pd.DataFrame({"pose": world.pose})
    if case.repeats > 1:
        table["repeat"] = world.repeat
    table[[f"q{i + 1}_deg" for i in range(world.stated.n)]] = np.round(np.rad2deg(rows.q), 4)
    table[XYZ] = 1e3 * seen
    table["payload"] = np.array(list(world.tables["payloads"]))[rows.payload]
    table["marker"] = np.array(list(world.tables["markers"]))[rows.marker]
    for i in range(world.stated.n):
        if "approach" in options:
            table[f"approach{i + 1}"] = rows.approach[:, i].astype(int)
        if "travel" in options:
            table[f"travel{i + 1}_deg"] = np.round(np.rad2deg(rows.travel[:, i]), 3)
    if "time" in options:
        table["time_s"] = np.round(rows.time, 2)
    if "temperature" in options:
        table["temperature_degC"] = rows.temperature
    if "session" in options:
        table["session"] = session_names(rows)
    if "sigma" in options:
        table["sigma_mm"] = np.round(1e3 * sigma, 5)
    return _with_faults(case, world, table.round(dict.fromkeys(XYZ, 5)), rng)


def _with_faults(case: Case, world: World, table: pd.DataFrame, rng: np.random.Generator) -> tuple[pd.DataFrame, Array]:
    faults = [h for h in world.hidden if h.cause in ON_TABLE]
    if case.noise == "outliers":
        faults.append(Hidden("outlier", seed=int(rng.integers(2**32))))
    faulty = np.zeros(len(table), dtype=bool)
    for h in faults:
        table, wrong = ON_TABLE[h.cause](h, table, world.stated)
        faulty = faulty[: len(table)] | wrong
    return table.round(8), faulty


def _noisy(case: Case, world: World, point: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points with noise, and its standard deviation per axis (rows,)."""
    growing = [h.size for h in world.hidden if h.cause == "range-noise"] or [6e-6] * (case.noise == "range")
    sigma = np.full(len(point), case.sigma)
    if growing:
        sigma = 15e-6 + growing[0] * np.linalg.norm(point, axis=1)
    unit = rng.standard_t(3, point.shape) / np.sqrt(3) if case.noise == "heavy" else rng.standard_normal(point.shape)
    return point + sigma[:, None] * unit, sigma


def answer(world: World, point: Array, faulty: Array) -> dict[str, Any]:
    """What is hidden: causes, joints, sizes, how far each moves every row [mm], and the lines of the file that are wrong."""
    causes = []
    for h, shift in zip(world.hidden, _shifts(world, point), strict=True):
        moves = {"rms_mm": np.sqrt(np.mean(shift**2)), "max_mm": shift.max()} if len(shift) else {}
        rounded = {name: round(float(value), 6) for name, value in moves.items()}
        causes.append(asdict(h) | rounded | {"rows_mm": np.round(shift, 5).tolist()})
    return {
        "causes": causes,
        "faulty_lines": (np.flatnonzero(faulty) + 2).tolist(),
        "compliance_rad_per_Nm": world.real.compliance.tolist(),
    }


def _shifts(world: World, point: Array) -> list[Array]:
    """How far each cause moves each row [mm]: against the same robot without it; empty for faults and noise."""
    shifts = []
    for h in world.hidden:
        others = tuple(other for other in world.hidden if other is not h)
        physical = h.cause in PHYSICAL
        shift = point - measured_points(world.real, world.rows, others) if physical else np.empty((0, 3))
        shifts.append(1e3 * np.linalg.norm(shift, axis=1))
    return shifts


def robot_file(tables: Mapping[str, Any], masses: bool) -> dict[str, Any]:
    """The tables to be written, without the masses of links and bars if nobody knows them."""

    def bare(part: Mapping[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in part.items() if masses or not key.startswith(("mass_", "com_"))}

    written = dict(tables) | {"joints": [bare(joint) for joint in tables["joints"]]}
    if "loop" in tables:
        loop = tables["loop"]
        written["loop"] = loop | {bar: bare(loop[bar]) for bar in ("crank", "rod")}
    return written


def toml(table: Mapping[str, Any], path: str = "") -> str:
    """TOML text of nested tables."""
    lines, below = [], []
    for key, value in table.items():
        name = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            below.append(f"\n[{name}]\n{toml(value, name)}")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            below += [f"\n[[{name}]]\n{toml(item, name)}" for item in value]
        else:
            lines.append(f"{key} = {json.dumps(value)}\n")
    return "".join(lines + below)


def _study(case: Case) -> str:
    return f"""\
name = "{case.name}"
robot = "robot.toml"
workflow = "{case.workflow}"
seed = {case.seed}
effects = {json.dumps(case.effects)}

[measurements]
file = "measurements.csv"

[split]
holdout = 0.25

{case.settings}"""
