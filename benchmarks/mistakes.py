"""Mistakes of the user in robot file or table: whether the right one is named, and what is named on top of it.

python benchmarks/mistakes.py simulated --draws 1 (--robots heavy cobot --kinds twist-sign …)    23 kinds on four robots
python benchmarks/mistakes.py others STUDY … --draws 1 (--causes)                                the same in others' data

simulated: parameters within their usual limits and within wide ones, each draws of their own. Robots and measurements are
numpy's own: worn geometry, joints that give way under gravity, and noise. others: into a study's robot file and measurements
mistakes are put that need no truth beside them; without STUDY, into the real FANUC and UR10 and fourteen foreign robots of
CALFLOW_DATA in turn. A cause is named on top of a mistake where it is not named of the same draw without the mistake.
"""

from __future__ import annotations

import argparse
import os
import re
import time
import tomllib
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import tomli_w
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.effects.geometry import Geometry
from calflow.faults import examined
from calflow.files.problems import InputError
from calflow.robot.parts import Expected
from calflow.study import load_study

POSES, NOISE, WORN = 90, 3e-5, 3e-4  # m and rad
GRAVITY = np.array([0.0, 0.0, -9.80665])
WIDE = {"m": (2.0, 0.5), "rad": (3.2, 0.5)}  # bound and prior sd that a careless study allows
PLACE = ["x_mm", "y_mm", "z_mm"]
Row = dict[str, Any]


@dataclass(frozen=True)
class Arm:
    """A robot as stated: a row of figures a joint (alpha, a, d, theta [rad, m]), limits, masses [kg], centres [m], springs."""

    convention: str
    figures: np.ndarray
    limits: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    compliance: np.ndarray
    loads: dict[str, tuple[float, tuple[float, float, float]]]
    marker: tuple[float, float, float]
    base: np.ndarray
    known: bool
    prismatic: tuple[int, ...] = ()


def arms() -> dict[str, Arm]:
    """Return the four robots."""
    right, base = np.pi / 2, np.array([1.2, -0.7, 0.4, 0.03, -0.05, 0.6])
    wide = np.array([[-170.0, 170.0]] * 7)
    heavy = Arm(
        "modified-dh",
        np.array([[0, 0, 1.2, 0], [right, 0.515, 0, 0], [0, 1.6, 0, 0], [right, 0.35, 1.9, 0], [-right, 0, 0, 0],
                  [right, 0, 0.445, 0]]),
        np.array([[-170, 170], [30, 120], [-60, 60], [-180, 180], [-110, 110], [-180, 180.0]]),
        np.array([1900, 800, 1150, 380, 260, 90.0]),
        np.array([[0.1, 0, -0.45], [0.75, 0, 0], [0.25, 0.1, 0], [0, 0, -0.7], [0, -0.04, 0.02], [0, 0, -0.08]]),
        np.array([1.85, 1.79, 1.92, 19.6, 18.2, 19.0]) * 1e-7,
        {"none": (0.0, (0, 0, 0)), "half": (400.0, (0.1, 0.05, 0.25)), "full": (800.0, (0.12, 0.08, 0.30))},
        (0.18, -0.07, 0.31), base, True,
    )  # fmt: skip
    cobot = Arm(
        "dh",
        np.array([[right, 0, 0.1273, 0], [0, -0.612, 0, 0], [0, -0.5723, 0, 0], [right, 0, 0.1639, 0], [-right, 0, 0.1157, 0],
                  [0, 0, 0.0922, 0]]),
        np.array([[-170, 170], [-150, -30], [-130, 130], [-170, 170], [-170, 170], [-170, 170.0]]),
        np.array([7.8, 12.9, 3.9, 2.0, 2.0, 0.2]),
        np.array([[0, 0, 0], [0.38, 0, 0.158], [0.24, 0, 0.068], [0, 0, 0.018], [0, 0, 0.018], [0, 0, -0.03]]),
        np.array([2, 3, 4, 8, 8, 8]) * 1e-5,
        {"none": (0.0, (0, 0, 0)), "half": (4.0, (0.0, 0.02, 0.05)), "full": (9.0, (0.02, -0.05, 0.08))},
        (0.04, 0.09, 0.12), base, False,
    )  # fmt: skip
    scara = Arm(
        "dh",
        np.array([[0, 0.325, 0.24, 0], [np.pi, 0.225, 0, 0], [0, 0, 0.08, 0], [0, 0, 0.03, 0]]),
        np.array([[-130, 130], [-140, 140], [0, 200], [-170, 170.0]]),
        np.array([12, 6, 2, 1.0]), np.zeros((4, 3)), np.zeros(4),
        {"none": (0.0, (0, 0, 0)), "half": (2.0, (0.0, 0.02, 0.05)), "full": (5.0, (0.02, -0.05, 0.08))},
        (0.05, 0.02, 0.06), base, True, (2,),
    )  # fmt: skip
    seven = Arm(
        "modified-dh",
        np.array([[0, 0, 0.333, 0], [-right, 0, 0, 0], [right, 0, 0.316, 0], [right, 0.0825, 0, 0], [-right, -0.0825, 0.384, 0],
                  [right, 0, 0, 0], [right, 0.088, 0.107, 0]]),
        np.where(np.arange(7)[:, None] == 3, [[-170, -10]], 0.7 * wide),
        np.array([4, 4, 3, 3.5, 2, 1.5, 1.0]),
        np.array([[0, -0.02, -0.1], [0, -0.1, 0.02], [0.03, 0.02, -0.06], [-0.03, 0.05, 0.02], [0, 0.04, -0.1], [0.06, 0, 0],
                  [0, 0, 0.07]]),
        np.array([1, 4, 5, 6, 8, 9, 9]) * 1e-5,
        {"none": (0.0, (0, 0, 0)), "half": (1.5, (0.0, 0.02, 0.05)), "full": (3.0, (0.02, -0.05, 0.08))},
        (0.06, -0.03, 0.14), base, False,
    )  # fmt: skip
    return {"heavy": heavy, "cobot": cobot, "scara": scara, "seven": seven}


# --- Mechanics -----------------------------------------------------------------------------------------


def turning(axis: int, angle: np.ndarray) -> np.ndarray:
    """Return turns about an axis, (n, 4, 4)."""
    frame = np.tile(np.eye(4), (len(angle), 1, 1))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    frame[:, i, i] = frame[:, j, j] = np.cos(angle)
    frame[:, j, i], frame[:, i, j] = np.sin(angle), -np.sin(angle)
    return frame


def shifted(axis: int, length: np.ndarray) -> np.ndarray:
    """Return shifts along an axis, (n, 4, 4)."""
    frame = np.tile(np.eye(4), (len(length), 1, 1))
    frame[:, axis, 3] = length
    return frame


def placed(figures: np.ndarray) -> np.ndarray:
    """Return a frame (4, 4) from x, y, z and angles about them in turn."""
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.from_euler("XYZ", figures[3:]).as_matrix(), figures[:3]
    return frame


def measured_points(arm: Arm, q: np.ndarray, load: np.ndarray, marker: np.ndarray) -> np.ndarray:
    """Return where the marker is (n, 3) [m] once the joints have given way; load (n,) numbers the loads, marker (n, 3)."""
    masses = np.array([mass for mass, _ in arm.loads.values()])[load]
    centres = np.array([com for _, com in arm.loads.values()])[load]
    given, n = np.zeros_like(q), len(q)
    stands = placed(arm.base)
    for _ in range(6):
        at, axes, links = np.tile(np.eye(4), (n, 1, 1)), [], []
        for i, (alpha, a, d, theta) in enumerate(arm.figures):
            every = np.ones(n)
            slide = i in arm.prismatic
            turn = turning(2, theta + (0 * every if slide else q[:, i] + given[:, i]))
            along = shifted(2, d + (q[:, i] if slide else 0 * every))
            link = shifted(0, a * every), turning(0, alpha * every)
            if arm.convention == "dh":
                axes.append(at)
                at = at @ turn @ along @ link[0] @ link[1]
            else:
                at = at @ link[0] @ link[1]
                axes.append(at)
                at = at @ turn @ along
            links.append(at)
        weights = [
            (frame[:, :3, :3] @ com + frame[:, :3, 3], np.full(n, mass))
            for frame, com, mass in zip(links, arm.com, arm.mass, strict=True)
        ]
        weights.append((np.einsum("nij,nj->ni", at[:, :3, :3], centres) + at[:, :3, 3], masses))
        for i, axis in enumerate(axes):
            moment = sum(
                np.cross(place - axis[:, :3, 3], mass[:, None] * GRAVITY @ stands[:3, :3])
                for place, mass in weights[i:]
            )
            given[:, i] = arm.compliance[i] * (moment * axis[:, :3, 2]).sum(axis=1)
    tip = np.einsum("nij,nj->ni", at[:, :3, :3], marker) + at[:, :3, 3]
    return tip @ stands[:3, :3].T + stands[:3, 3]


@dataclass(frozen=True)
class Truth:
    """The real robot of a world, and what it did."""

    arm: Arm
    q: np.ndarray
    load: np.ndarray
    marker: np.ndarray


@dataclass(frozen=True)
class World:
    """A robot file as tables, and the measurements beside it; where numpy made them, the truth.

    base is where the base is, where that is known; known says whether the robot file states it.
    """

    robot: dict[str, Any]
    table: pd.DataFrame
    known: bool
    gives_way: bool
    base: np.ndarray | None = None
    truth: Truth | None = None

    @property
    def joints(self) -> list[Row]:
        """The joints' tables."""
        joints: list[Row] = self.robot["joints"]
        return joints

    @property
    def revolute(self) -> list[int]:
        """The joints (from 0) that turn."""
        return [i for i, joint in enumerate(self.joints) if joint.get("kind") != "prismatic"]


def drawn(arm: Arm, rng: np.random.Generator) -> World:
    """Wear a robot and measure it."""
    n = len(arm.figures)
    low, high = arm.limits.T
    unit = np.where(np.isin(np.arange(n), arm.prismatic), 1e-3, np.pi / 180)
    q = unit * rng.uniform(low + 0.05 * (high - low), high - 0.05 * (high - low), (POSES, n))
    true = replace(
        arm, figures=arm.figures + rng.normal(0, WORN, arm.figures.shape), compliance=arm.compliance * rng.normal(1, 0.1, n),
        base=arm.base + rng.normal(0, 2e-3, 6),
    )  # fmt: skip
    load = rng.integers(0, len(arm.loads), POSES)
    marker = np.tile(np.array(arm.marker) + rng.normal(0, 1e-3, 3), (POSES, 1))
    place = measured_points(true, q, load, marker) + rng.normal(0, NOISE, (POSES, 3))
    columns: Row = {"pose": np.arange(1, POSES + 1)}
    for i in range(n):
        columns[f"q{i + 1}_{'mm' if i in arm.prismatic else 'deg'}"] = q[:, i] / unit[i]
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * place.T, strict=True))
    columns |= {"payload": np.array([*arm.loads])[load], "marker": "E"}
    table, truth = pd.DataFrame(columns), Truth(true, q, load, marker)
    return World(tables(arm), table, arm.known, bool(arm.compliance.any()), arm.base, truth)


@cache
def read(study: Path) -> tuple[Row, pd.DataFrame]:
    """Return robot file and measurements of a study of others, as tables in mm and degrees."""
    data, folder = load_study(study).measurements(), study if study.is_dir() else study.parent
    robot = tomllib.loads((folder / "robot.toml").read_text(encoding="utf-8"))
    for joint in robot["joints"]:
        for unit, (other, factor) in {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi)}.items():
            for name in ("a", "d", "alpha", "theta"):
                if f"{name}_{unit}" in joint:
                    joint[f"{name}_{other}"] = factor * joint.pop(f"{name}_{unit}")
        joint |= {key: joint.get(key, 0.0) for key in ("alpha_deg", "a_mm", "d_mm", "theta_deg")}
    degrees = {f"q{i + 1}_deg": np.rad2deg(data.joints[:, i]) for i in range(data.robot.n_joints)}
    place = dict(zip(PLACE, 1e3 * data.position.T, strict=True))
    labels = {name: data.table[name].to_numpy() for name in ("pose", "marker", "payload")}
    table = pd.DataFrame(labels | degrees | place)
    return robot, table if robot.get("payloads") else table.drop(columns="payload")


def of_others(study: Path) -> World:
    """Return what others made and measured."""
    robot, table = read(study)
    masses = [load["mass_kg"] for load in robot.get("payloads", {}).values()]
    return World(deepcopy(robot), table.copy(), robot.get("base", {}).get("known", True), any(masses))


def tables(arm: Arm) -> dict[str, Any]:
    """Return a robot file's tables."""
    joints = []
    for i, (alpha, a, d, theta) in enumerate(arm.figures):
        joint: Row = {"alpha_deg": np.rad2deg(alpha), "a_mm": 1e3 * a, "d_mm": 1e3 * d, "theta_deg": np.rad2deg(theta)}
        joint |= {f"limits_{'mm' if i in arm.prismatic else 'deg'}": arm.limits[i].tolist()}
        joint |= {"mass_kg": float(arm.mass[i]), "com_mm": (1e3 * arm.com[i]).tolist()}
        joints.append(joint | ({"kind": "prismatic"} if i in arm.prismatic else {}))
    return {
        "name": "arm", "convention": arm.convention,
        "base": {"origin_mm": (1e3 * arm.base[:3]).tolist(), "rotation_deg": np.rad2deg(arm.base[3:]).tolist(),
                 "known": arm.known} if arm.known else {"known": False},
        "joints": joints,
        "gravity": (GRAVITY @ placed(arm.base)[:3, :3]).tolist(),
        "payloads": {name: {"mass_kg": mass, "com_mm": [1e3 * v for v in com]} for name, (mass, com) in arm.loads.items()},
        "markers": {"E": {"point_mm": [1e3 * v for v in arm.marker]}},
    }  # fmt: skip


# --- Mistakes ------------------------------------------------------------------------------------------
# Each changes robot file or table in place, and returns what is right to say (a pattern), None where it cannot be made.

Draw = np.random.Generator


def figures_of(world: World, *names: str) -> list[tuple[int, str]]:
    """Return the joints (from 0) and keys of figures that are not zero and that base or tool do not make up for."""
    out = made_up_for(world)
    if len(world.revolute) < len(world.joints):  # all axes are parallel: the base makes up for any length along them
        names = tuple(name for name in names if name != "d_mm")
    return [
        (i, key)
        for i, joint in enumerate(world.joints)
        for key in names
        if abs(joint[key]) > 1e-9 and (i, key) not in out
    ]


def made_up_for(world: World) -> set[tuple[int, str]]:
    """Return the joints (from 0) and keys of figures that a base and a marker that may be anywhere make up for."""
    if world.known:
        return set()
    turn, link, last = ("theta_deg", "d_mm"), ("alpha_deg", "a_mm"), len(world.joints) - 1
    first, after = (turn, turn + link) if world.robot["convention"] == "dh" else (turn + link, turn)
    return {(0, key) for key in first} | {(last, key) for key in after}


def picked(rng: Draw, things: list[Any]) -> Any:
    """Draw one of some things."""
    return things[rng.integers(len(things))]


def twist_sign(world: World, rng: Draw) -> str | None:
    twists = [(i, key) for i, key in figures_of(world, "alpha_deg") if abs(abs(world.joints[i][key]) - 90) < 60]
    if not twists:
        return None
    i, key = picked(rng, twists)
    world.joints[i][key] *= -1
    return rf"joint {i + 1}: the twist alpha has the wrong sign"


def joint_sign(world: World, rng: Draw) -> str:
    i = picked(rng, world.revolute)
    world.table[f"q{i + 1}_deg"] *= -1
    return rf"joint {i + 1}: all readings have the wrong sign"


def zero_offset(world: World, rng: Draw) -> str:
    out = made_up_for(world)
    i = picked(rng, [i for i in world.revolute if (i, "theta_deg") not in out])
    world.joints[i]["theta_deg"] += picked(rng, [90, -90, 180])
    return rf"joint {i + 1}: its zero is off"


def lengths_exchanged(world: World, rng: Draw) -> str | None:
    lengths = figures_of(world, "a_mm", "d_mm")
    joints = world.joints
    pairs = [(m, k) for m in lengths for k in lengths if m < k and abs(joints[m[0]][m[1]] - joints[k[0]][k[1]]) > 15]
    if not pairs:
        return None
    (i, one), (j, other) = picked(rng, pairs)
    joints[i][one], joints[j][other] = joints[j][other], joints[i][one]
    first, second = (rf"{key[0]} of joint {k + 1}" for k, key in ((i, one), (j, other)))
    return rf"({first} and {second}|{second} and {first}) are exchanged"


def length_mistyped(world: World, rng: Draw) -> str:
    while True:
        i, key = picked(rng, figures_of(world, "a_mm", "d_mm"))
        right = world.joints[i][key]
        digits = [*f"{abs(right):.1f}"]
        m, k = rng.choice(len(digits), 2, replace=False)
        digits[m], digits[k] = digits[k], digits[m]
        if digits.count(".") == 1 and digits[0] != "." and abs(float("".join(digits)) - abs(right)) > 25:
            break
    world.joints[i][key] = float(np.copysign(float("".join(digits)), right))
    return rf"{key[0]} of joint {i + 1} is mistyped"


def columns_exchanged(world: World, rng: Draw) -> str:
    i, j = sorted(rng.choice(world.revolute, 2, replace=False))
    names = [f"q{i + 1}_deg", f"q{j + 1}_deg"]
    world.table[names] = world.table[names[::-1]].to_numpy()
    return rf"columns q{i + 1} and q{j + 1} are exchanged"


def axes_exchanged(world: World, rng: Draw) -> str:
    names = list(rng.choice(PLACE, 2, replace=False))
    world.table[names] = world.table[names[::-1]].to_numpy()
    return "no right-handed frame"


def payloads_exchanged(world: World, rng: Draw) -> str | None:
    if not world.gives_way:
        return None
    there, loads = set(world.table["payload"]), list(world.robot["payloads"])
    one, other = picked(rng, [pair for pair in combinations(loads, 2) if there & {*pair}])
    world.table["payload"] = world.table["payload"].replace({one: other, other: one})
    return rf"payloads ({one} and {other}|{other} and {one}) are exchanged"


def rows_exchanged(world: World, rng: Draw) -> str:
    pose = world.table["pose"].to_numpy()
    while True:
        i, j = sorted(rng.choice(len(pose), 2, replace=False))
        if pose[i] != pose[j]:
            break
    world.table.loc[[i, j], PLACE] = world.table.loc[[j, i], PLACE].to_numpy()
    lines = rf"{i + 2} to {j + 2}" if j == i + 1 else rf"{i + 2}, {j + 2}"
    return rf"pairs of rows are exchanged in lines {lines};"


def rows_shifted(world: World, rng: Draw) -> str:
    later = np.arange(later_row(world, rng), len(world.table))
    world.table.loc[later, PLACE] = world.table.loc[np.roll(later, -1), PLACE].to_numpy()
    return "positions are a row too (early|late) against the readings"


def later_row(world: World, rng: Draw) -> int:
    """Return a row (from 0) in the middle third or so with which a pose begins."""
    pose = world.table["pose"].to_numpy()
    begins = np.flatnonzero(pose[1:] != pose[:-1]) + 1
    return int(picked(rng, begins[(begins > 0.3 * len(pose)) & (begins < 0.7 * len(pose))]))


def pounds(world: World, rng: Draw) -> str | None:
    if not world.gives_way:
        return None
    for load in world.robot["payloads"].values():
        load["mass_kg"] /= 0.45359237
    return "masses of all payloads are in pounds"


def inches(world: World, rng: Draw) -> str:
    if rng.random() < 0.5:
        for joint in world.joints:
            joint["a_mm"] /= 25.4
            joint["d_mm"] /= 25.4
        return "all lengths of the robot file are in inches"
    lengths = [(i, key) for i, key in figures_of(world, "a_mm", "d_mm") if abs(world.joints[i][key]) > 30]
    i, key = picked(rng, lengths)
    world.joints[i][key] /= 25.4
    return rf"{key[0]} of joint {i + 1} is mistyped \(inches\)"


def radians(world: World, rng: Draw) -> str | None:
    angles = figures_of(world, "alpha_deg")
    if not angles:
        return None
    i, key = picked(rng, angles)
    world.joints[i][key] = float(np.deg2rad(world.joints[i][key]))
    return rf"alpha of joint {i + 1} is in radians"


def marker_elsewhere(world: World, rng: Draw) -> str | None:
    if world.base is None:
        return None
    point = world.robot["markers"]["E"]["point_mm"]
    world.robot["base"] |= {  # else the poses place base and markers, wherever these are stated
        "known": True, "origin_mm": (1e3 * world.base[:3]).tolist(), "rotation_deg": np.rad2deg(world.base[3:]).tolist()
    }  # fmt: skip
    if rng.random() < 0.5:
        point[:] = (
            [point[0] + 212 * s for s in (1,)] + point[1:] if rng.random() < 0.5 else [*point[:2], point[2] + 212]
        )
    else:
        point[:] = [point[2], point[1] + 150.0, point[0]]
    return "marker E is mistyped"


def changed_at_a_row(world: World, rng: Draw) -> str:
    first = later_row(world, rng)
    later = np.arange(len(world.table)) >= first
    if world.truth and rng.random() < 0.5:
        by, true = rng.normal(0, 0.03, 3), world.truth
        moved = measured_points(true.arm, true.q, true.load, true.marker + later[:, None] * by)
        world.table[PLACE] = 1e3 * (moved + rng.normal(0, NOISE, moved.shape))
        return rf"from line {first + 2} on another tool"
    turned(world, later, 0.05, 0.1, rng)
    return rf"from line {first + 2} on the positions are in another frame"


def turned(world: World, rows: np.ndarray, angle: float, far: float, rng: Draw) -> None:
    """Place the device of some rows (n_rows,) anew, by so much [rad and m]."""
    turn, shift = Rotation.from_rotvec(rng.normal(0, angle, 3)), rng.normal(0, 1e3 * far, 3)
    world.table.loc[rows, PLACE] = turn.apply(np.array(world.table.loc[rows, PLACE])) + shift


def sessions_apart(world: World, rng: Draw) -> str:
    pose = world.table["pose"].to_numpy()
    number = np.unique(pose, return_inverse=True)[1]
    session = number * 3 // (number.max() + 1)
    for k in (1, 2):
        turned(world, session == k, 0.02, 0.03, rng)
    world.table["session"] = np.array(["Mon", "Tue", "Wed"])[session]
    return "state by_session = true"


def gravity_elsewhere(world: World, rng: Draw) -> str | None:
    """State a robot that stands on the floor for one on a wall, or one that hangs."""
    if not world.gives_way:
        return None
    turn = Rotation.from_euler(picked(rng, ["x", "y"]), picked(rng, [90, -90, 180]), degrees=True)
    world.robot["gravity"] = turn.apply(world.robot.get("gravity", GRAVITY)).tolist()
    return "gravity is"


def convention_taken_for_the_other(world: World, rng: Draw) -> str | None:
    if "loop" in world.robot or world.robot.get("convention") not in ("dh", "modified-dh"):
        return None
    right = world.robot["convention"]
    world.robot["convention"] = "modified-dh" if right == "dh" else "dh"
    return rf"are of the convention {right}"


def joint_coupled(world: World, rng: Draw) -> str:
    """Let a joint's column count from the link before the last, as of a parallelogram's motors."""
    i = picked(rng, [i for i in world.revolute if i and i - 1 in world.revolute])
    world.table[f"q{i + 1}_deg"] += picked(rng, [1, -1]) * world.table[f"q{i}_deg"]
    world.joints[i].pop("limits_deg", None)
    return rf"column q{i + 1} do not count from the previous link"


def column_shifted(world: World, rng: Draw) -> str:
    """Let one joint's readings stand a pose late, all of them or those from a row on."""
    i, pose = picked(rng, world.revolute), world.table["pose"].to_numpy()
    begins = np.flatnonzero(np.r_[True, pose[1:] != pose[:-1]])
    before = begins[np.maximum(np.searchsorted(begins, np.arange(len(pose)), side="right") - 2, 0)]
    rows = np.arange(len(pose)) >= (later_row(world, rng) if rng.random() < 0.5 else 0)
    column = world.table[f"q{i + 1}_deg"].to_numpy(copy=True)
    world.table[f"q{i + 1}_deg"] = np.where(rows, column[before], column)
    return rf"column q{i + 1} are a pose too late"


def rows_read_otherwise(world: World, rng: Draw) -> str:
    """Let rows from one on, or of a day, have exchanged axes, inches, or a joint's other sign."""
    n = len(world.table)
    rows = np.arange(n) >= later_row(world, rng)
    if rng.random() < 0.5:
        day = np.array(["Mon", "Tue", "Wed"])[np.arange(n) * 3 // n]
        world.table["session"], rows = day, day == "Tue"
    way = picked(rng, ["axes", "inches", "sign"])
    if way == "axes":
        names = list(rng.choice(PLACE, 2, replace=False))
        world.table.loc[rows, names] = world.table.loc[rows, names[::-1]].to_numpy()
        return rf"axes {' and '.join(sorted(name[0] for name in names))} are exchanged"
    if way == "inches":
        world.table.loc[rows, PLACE] /= 25.4
        return "x, y, z are in inches"
    i = picked(rng, world.revolute)
    world.table.loc[rows, f"q{i + 1}_deg"] *= -1
    return rf"joint {i + 1}: all readings have the wrong sign"


def zero_changed(world: World, rng: Draw) -> str:
    """Set a joint's zero anew from a row on."""
    i, first = picked(rng, world.revolute[:-1]), later_row(world, rng)
    world.table.loc[np.arange(len(world.table)) >= first, f"q{i + 1}_deg"] += picked(rng, [2, -2])
    return rf"from line {first + 2} on the readings of joint {i + 1} are"


def payload_late(world: World, rng: Draw) -> str | None:
    """Load the robot three times in turn, and name each load some rows late."""
    if not (world.truth and world.gives_way):
        return None
    true, n, late = world.truth, len(world.table), int(rng.integers(7, 13))
    load = np.arange(n) * 3 // n
    place = measured_points(true.arm, true.q, load, true.marker)
    world.table[PLACE] = 1e3 * (place + rng.normal(0, NOISE, place.shape))
    world.table["payload"] = np.array([*true.arm.loads])[np.r_[load[:late], load[:-late]]]
    return rf"in lines (32 to {31 + late}|62 to {61 + late}|32 to {31 + late}, 62 to {61 + late}): payloads"


KINDS: dict[str, Callable[[World, Draw], str | None]] = {
    "twist-sign": twist_sign, "joint-sign": joint_sign, "zero-offset": zero_offset, "lengths-exchanged": lengths_exchanged,
    "length-mistyped": length_mistyped, "columns-exchanged": columns_exchanged, "axes-exchanged": axes_exchanged,
    "payloads-exchanged": payloads_exchanged, "rows-exchanged": rows_exchanged, "rows-shifted": rows_shifted, "pounds": pounds,
    "inches": inches, "radians": radians, "marker-elsewhere": marker_elsewhere, "changed-at-a-row": changed_at_a_row,
    "sessions-apart": sessions_apart, "none": lambda world, rng: "", "gravity-elsewhere": gravity_elsewhere,
    "convention": convention_taken_for_the_other, "joint-coupled": joint_coupled, "column-shifted": column_shifted,
    "rows-otherwise": rows_read_otherwise, "zero-changed": zero_changed, "payload-late": payload_late,
}  # fmt: skip


# --- Verdicts ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """What was said of a mistake: alone, listed, wrong or silent; the causes named, the seconds it took, and the words."""

    outcome: str
    causes: tuple[str, ...]
    seconds: float
    words: str


def widened(robot: cf.Robot) -> cf.Robot:
    """Return a robot whose geometry may be anything."""
    expected = tuple(
        Expected(
            "geometry", p.part, p.symbol, p.unit, 0.0, WIDE[p.unit][1], lower=-WIDE[p.unit][0], upper=WIDE[p.unit][0]
        )
        for p in Geometry(robot).parameters()
    )
    return replace(robot, expected=expected)


def judged(world: World, said: str, wide: bool, causes: bool) -> Verdict:
    """Check, diagnose for causes where nothing is unsettled, and hold what is said against what is right."""
    with TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "robot.toml").write_text(tomli_w.dumps(world.robot), encoding="utf-8")
        world.table.to_csv(path / "measurements.csv", index=False)
        begun, words, named = time.process_time(), [], ()
        try:
            robot = cf.Robot.from_toml(path / "robot.toml")
            robot = widened(robot) if wide else robot
            data = cf.Measurements.from_csv(path / "measurements.csv", robot).split(0.25)
            faults = examined(data)[1]
            words = [fault.statement for fault in faults]
            if causes and not any(fault.action == "unsettled" for fault in faults):  # else diagnose names nothing
                effects = ["geometry", "joint-compliance"] if world.gives_way else ["geometry"]
                found = cf.identify(robot, data, effects).diagnose().findings
                named = tuple(f"{f.cause} {f.joint or ''}" for f in found if f.status in ("named", "one_of"))
        except InputError as error:
            words = [str(error)]
    text = " | ".join(words)
    spent = time.process_time() - begun
    if not said:
        return Verdict("silent" if not text else "wrong", named, spent, text)
    if re.search(said, text):
        return Verdict("listed" if "(2)" in text else "alone", named, spent, text)
    return Verdict("wrong" if text else "silent", named, spent, text)


@dataclass(frozen=True)
class Case:
    """A kind of mistake in a world that a seed draws."""

    kind: str
    where: str
    limits: str
    seed: tuple[int, ...]
    draw: Callable[[Draw], World]

    def verdict(self, causes: bool) -> tuple[str, Verdict, tuple[str, ...]] | None:
        """Return what is right to say, what is said, and the causes named without the mistake; None where it cannot be made."""
        rng = np.random.default_rng(self.seed)
        world = self.draw(rng)
        said = KINDS[self.kind](world, rng)
        if said is None:
            return None
        verdict, wide = judged(world, said, self.limits == "wide", causes), self.limits == "wide"
        if not (said and verdict.causes):
            return said, verdict, ()
        return said, verdict, judged(self.draw(np.random.default_rng(self.seed)), "", wide, causes).causes


def simulated(asked: argparse.Namespace) -> Iterator[Case]:
    """Yield mistakes in robots of numpy's own."""
    for kind in asked.kinds:
        for name in asked.robots:
            for draw in range(asked.draws):
                for limits in asked.limits:
                    seed = (asked.seed, draw, [*arms()].index(name), [*KINDS].index(kind), [*LIMITS].index(limits))
                    yield Case(kind, name, limits, seed, partial(drawn, arms()[name]))


def others(asked: argparse.Namespace) -> Iterator[Case]:
    """Yield mistakes in data of others."""
    for study in asked.studies or studies_of_others():
        for kind in asked.kinds:
            for draw in range(asked.draws):
                seed = (asked.seed, draw, zlib.crc32(study.name.encode()), [*KINDS].index(kind))
                yield Case(kind, study.name, "narrow", seed, lambda _, study=study: of_others(study))


def studies_of_others() -> list[Path]:
    """Return studies with data that are not calflow's own, as far as they are there."""
    root, data = Path(__file__).parents[1] / "studies", os.environ.get("CALFLOW_DATA")
    return [root / "fanuc-r2000", root / "ur10-tmac", *sorted(Path(data or root, "foreign").glob("[0-9]*"))]


LIMITS = ("narrow", "wide")


def main() -> None:
    """Draw, judge and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    for cases in (simulated, others):
        command = commands.add_parser(cases.__name__)
        command.set_defaults(cases=cases, causes=cases is simulated)
        command.add_argument("--draws", type=int, default=1)
        command.add_argument("--seed", type=int, default=1)
        command.add_argument("--kinds", nargs="*", default=list(KINDS))
        if cases is simulated:
            command.add_argument("--robots", nargs="*", default=list(arms()))
            command.add_argument("--limits", nargs="*", choices=LIMITS, default=LIMITS)
        else:
            command.add_argument("studies", nargs="*", type=Path)
            command.add_argument("--causes", action="store_true", help="diagnose too, where nothing is unsettled")
    asked = parser.parse_args()
    counts, causes, anyway = Counter[tuple[str, str]](), Counter[str](), 0
    for case in asked.cases(asked):
        if (judgement := case.verdict(asked.causes)) is None:
            continue
        said, verdict, without = judgement
        on_top = [cause for cause in verdict.causes if said and cause not in without]
        counts[case.kind, verdict.outcome] += 1
        causes[case.kind] += bool(on_top)
        anyway += bool(verdict.causes) and not on_top
        right = verdict.outcome in ("alone", "listed") or (not said and verdict.outcome == "silent")
        named = f"on top: {', '.join(on_top)}" if on_top else ""
        also = f"without the mistake too: {', '.join(without)}" if without else ""
        detail = "" if right and not on_top else f"expected {said} | found {verdict.words[:700]}"
        print(f"{case.kind:18} {case.where:11} {case.limits:6} {verdict.outcome:7} {verdict.seconds:5.1f} s "
              f"{named} {also} {detail}".rstrip(), flush=True)  # fmt: skip
    print(f"{'':18} {'alone':>7} {'listed':>7} {'wrong':>7} {'silent':>7} {'false causes':>13}")
    for kind in asked.kinds:
        row = [counts[kind, outcome] for outcome in ("alone", "listed", "wrong", "silent")]
        print(f"{kind:18} " + " ".join(f"{value:7}" for value in row) + f" {causes[kind]:13}")
    made = [(outcome, count) for (kind, outcome), count in counts.items() if kind != "none"]
    total = sum(count for _, count in made)
    right = sum(count for outcome, count in made if outcome in ("alone", "listed"))
    print(f"right, alone or in a list of three: {right} of {total} ({right / max(total, 1):.3f}); false causes on top: "
          f"{sum(causes[kind] for kind in asked.kinds if kind != 'none')}; named without the mistake too: {anyway}")  # fmt: skip


if __name__ == "__main__":
    main()
