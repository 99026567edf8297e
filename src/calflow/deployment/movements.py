"""Movements: what may be elsewhere, or otherwise, than when a robot was calibrated, and what each would do to its poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
import numpy as np

from calflow.deployment.alignment import rigid_slope
from calflow.effects import catalogue
from calflow.effects.base import unmet
from calflow.effects.warming import REFERENCE
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.measurements.measurements import Measurements
from calflow.model import over_rows
from calflow.robot.parameter import Parameter

Kind = Literal["zero", "station", "tool", "dimension", "cause", "condition"]
ZERO_SD = 1e-3  # rad or m: what a joint's zero is off by after a collision, or a new motor
PLACED_SD = 1e-3  # m and rad: what station, base or tool have moved by
EASILY, HARDLY = 1.0, 0.1  # relative odds: zeros, tools and stations move, while lengths of castings do not
CHANGED = 0.3  # of a cause's usual size, by which it changes as a robot ages
EXPANSION_SD = 1e-4  # share by which links grow with temperature: some 8 K of steel
WARMER = 1.0  # K: growth is linear in it
MOST = 6  # parameters of one part, beyond which it is no single movement
ZEROS, CONDITIONS, FLANGE = (-1,), (-2,), (-3,)  # what the functions made here are known by among those of a model
SAME = 0.9999  # cosine from which two movements do the same


@dataclass(frozen=True)
class Movement:
    """One thing that may have moved: its name, what it is in words, and the derivatives of points by it (n, 3, k) [m per unit].

    sd (k,) is what it usually moves by, odds how easily beside others; joint is its number, 0 for none, parameter the name of the
    model's parameter that it changes, empty where it is none.
    """

    name: str
    kind: Kind
    meaning: str
    joint: int
    units: tuple[str, ...]
    symbols: tuple[str, ...]
    slope: np.ndarray
    sd: np.ndarray
    odds: float = EASILY
    parameter: str = ""

    @property
    def is_known(self) -> bool:
        """Whether it is a condition under which the robot works, and no drift of the robot."""
        return self.kind == "condition"


def movements(known: CalibratedModel, data: Measurements, station: bool) -> tuple[Movement, ...]:
    """Return what may have moved, with what it does to the rows' points.

    Args:
        known: the calibrated model, for the conditions that it is told of a row.
        data: the rows.
        station: whether the device's place, or the base's, is among them; not where it was fitted.
    """
    rows = data.stating(known.model.given).on(known.model.robot).rows
    found = [*_zeros(known, rows), *_tool(known, data, rows)]
    if station:
        found.append(_station(known.model.point(known.estimate, rows)))
    found += [one for one in _parameters(known, rows) if not any(_same(one, other) for other in found)]
    return (*found, *_conditions(known, data))


def _zeros(known: CalibratedModel, rows: np.ndarray) -> Iterator[Movement]:
    """The zero of each joint's reading, which couplings and loops carry on to where they lead."""
    model, n = known.model, known.model.robot.n_joints
    if ZEROS not in model.made:
        p, c, predicted = model.symbols
        model.made[ZEROS] = ca.Function("zeros", [p, c], [ca.densify(ca.jacobian(predicted.point, c[:n]).T)])
    slope = over_rows(model.made[ZEROS], known.estimate, rows)[0].T.reshape(rows.shape[1], 3, n)
    for i in model.robot.driven:
        unit = model.robot.joints[i].unit
        yield Movement(f"joint{i + 1}.zero", "zero", f"zero of joint {i + 1}", i + 1, (unit,), ("zero",), slope[:, :, i : i + 1],
                       np.array([ZERO_SD]))  # fmt: skip


def _tool(known: CalibratedModel, data: Measurements, rows: np.ndarray) -> Iterator[Movement]:
    """The place of all markers on the tool, in the flange's axes, and of each alone where there are several."""
    model = known.model
    if FLANGE not in model.made:
        p, c, predicted = model.symbols
        model.made[FLANGE] = ca.Function("flange", [p, c], [ca.densify(predicted.tool @ predicted.rotation.T)])
    turn = over_rows(model.made[FLANGE], known.estimate, rows)[0].T.reshape(-1, 3, 3)
    names = list(dict.fromkeys(data.table["marker"]))
    sd, told = np.full(3, PLACED_SD), ("m",) * 3
    yield Movement("tool", "tool", "tool on its flange", 0, told, ("x", "y", "z"), turn, sd)
    for name in names if len(names) > 1 else []:
        own = (data.table["marker"] == name).to_numpy()
        yield Movement(
            f"marker {name}",
            "tool",
            f"marker {name} on the tool",
            0,
            told,
            ("x", "y", "z"),
            turn * own[:, None, None],
            sd,
        )


def _station(points: np.ndarray) -> Movement:
    """The device, or the robot's foot: a shift of all points, and a turn about their middle."""
    symbols = ("x", "y", "z", "rx", "ry", "rz")
    words = "station of the device, or the robot's foot"
    return Movement(
        "station", "station", words, 0, ("m",) * 3 + ("rad",) * 3, symbols, rigid_slope(points), np.full(6, PLACED_SD)
    )


def _parameters(known: CalibratedModel, rows: np.ndarray) -> Iterator[Movement]:
    """Every dimension of a link, and every cause that the model has; where robot and tool stand is told otherwise."""
    model = known.model
    slope = model.point_jacobian(known.estimate, rows)
    devices = [k for effect in model.effects if effect.of_device() for k in model.columns(effect)]
    observed = [k for observation in model.observations for k in model.columns(observation)]
    parts: dict[tuple[str, str, str], list[int]] = {}
    for k, parameter in enumerate(model.parameters):
        if k not in devices and k not in observed:
            parts.setdefault((parameter.effect, parameter.variant, parameter.part), []).append(k)
    for (effect, _, part), columns in parts.items():
        if effect == "geometry":
            placed = part not in ("loop",) and not model.parameters[columns[0]].joint
            yield from (
                _of([model.parameters[k]], slope[:, :, [k]], "dimension", HARDLY) for k in columns if not placed
            )
        elif len(columns) <= MOST:
            yield _of([model.parameters[k] for k in columns], slope[:, :, columns], "cause", EASILY)


def _of(parameters: list[Parameter], slope: np.ndarray, kind: Kind, odds: float) -> Movement:
    first = parameters[0]
    single = len(parameters) == 1
    name = first.name if single else first.name.rpartition(".")[0]
    sd = np.array([one.prior_sd for one in parameters]) * (1.0 if kind == "dimension" else CHANGED)
    units, symbols = tuple(one.unit for one in parameters), tuple(one.symbol for one in parameters)
    return Movement(
        name, kind, first.meaning, first.joint, units, symbols, slope, sd, odds, first.name if single else ""
    )


def _conditions(known: CalibratedModel, data: Measurements) -> Iterator[Movement]:
    """What is no drift: warmth of all links, and a payload that is not as heavy as stated."""
    robot, plain = known.model.robot, data.on(known.model.robot).stating(known.model.given)
    rows = replace(plain, table=plain.table.assign(temperature=REFERENCE + WARMER))
    kinds = [catalogue()[name] for name in ("thermal-growth", "payload-mass")]
    probes = tuple(kind(robot) for kind in kinds if not unmet(kind.needs, robot, rows.given))
    n = len(known.estimate)
    if CONDITIONS not in known.model.made:
        p, c, predicted = replace(known.model, given=rows.given, probes=probes).symbols
        slopes = ca.jacobian(predicted.point, p[n:]).T
        known.model.made[CONDITIONS] = ca.Function("conditions", [p, c], [ca.densify(slopes)])
    nominal = [parameter.nominal for probe in probes for parameter in probe.declared]
    values = over_rows(known.model.made[CONDITIONS], np.concatenate([known.estimate, nominal]), rows.rows)[0]
    slope = values.T.reshape(len(data), 3, len(nominal))
    yield Movement("temperature", "condition", "temperature of all links", 0, ("1",), ("growth",), slope[:, :, :1] / WARMER,
                   np.array([EXPANSION_SD]))  # fmt: skip
    if len(probes) > 1 and np.abs(slope[:, :, 1]).max() > 0:
        yield Movement(
            "payload", "condition", "mass of the payload", 0, ("1",), ("error",), slope[:, :, 1:2], np.array([CHANGED])
        )


def _same(one: Movement, other: Movement) -> bool:
    """Whether two movements by a single number do the same to all points."""
    if one.slope.shape[2] != 1 or other.slope.shape[2] != 1:
        return False
    a, b = one.slope.ravel(), other.slope.ravel()
    return bool(abs(a @ b) >= SAME * np.linalg.norm(a) * np.linalg.norm(b))
