"""The dimensions and loads that effects may change: the maker's figures, as numbers or as expressions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from calflow.robot.robot import Robot

Parts = TypeVar("Parts", bound=Any)


@dataclass(frozen=True)
class Dimensions:
    """Every length and angle of a robot and its tool.

    base (6,) and tool_rotation (3,) are errors in the base's and the tool's own frame (see `transforms.placement`); steps
    are the values of the frames' steps, joint by joint (see `Robot.step_index`); bars (crank, rod, rocker) is (3,); markers
    is (3, n_markers); markers_turn (3,) turns the markers whose places beside the first are known about it. SI units.
    """

    base: ca.SX
    steps: ca.SX
    bars: ca.SX
    tool_rotation: ca.SX
    markers: ca.SX
    markers_turn: ca.SX


@dataclass(frozen=True)
class Loads:
    """Every mass that gravity acts on.

    mass is (n_joints,) and com (3, n_joints) in the links' frames; bar_mass (2,) and bar_com (3, 2) are the crank's and
    the rod's; payload_mass (n_payloads,) and payload_com (3, n_payloads) are in the flange's frame.
    """

    mass: ca.SX
    com: ca.SX
    bar_mass: ca.SX
    bar_com: ca.SX
    payload_mass: ca.SX
    payload_com: ca.SX


def nominal_dimensions(robot: Robot) -> Dimensions:
    """Return the dimensions that the maker states."""
    loop = robot.loop
    return Dimensions(
        base=_column([0.0] * 6),
        steps=_column([step.value for step in robot.steps]),
        bars=_column([loop.crank.length, loop.rod.length, loop.rocker] if loop else []),
        tool_rotation=_column([0.0] * 3),
        markers=_points([marker.point for marker in robot.markers.values()]),
        markers_turn=_column([0.0] * 3),
    )


def nominal_loads(robot: Robot) -> Loads:
    """Return the masses that the maker states; a missing mass counts as zero."""
    bars = [robot.loop.crank, robot.loop.rod] if robot.loop else []
    payloads = robot.payloads.values()
    return Loads(
        mass=_column([joint.mass or 0.0 for joint in robot.joints]),
        com=_points([joint.com for joint in robot.joints]),
        bar_mass=_column([bar.mass or 0.0 for bar in bars]),
        bar_com=_points([bar.com for bar in bars]),
        payload_mass=_column([payload.mass or 0.0 for payload in payloads]),
        payload_com=_points([payload.com for payload in payloads]),
    )


def symbols_like(parts: Parts) -> Parts:
    """Return symbols in the place of what a data class of expressions has, each of the same shape."""
    return replace(parts, **{name: ca.SX.sym(name, *value.shape) for name, value in vars(parts).items()})


def _column(values: object) -> ca.SX:
    return ca.SX(ca.DM(np.array(values, dtype=float).reshape(-1, 1)))


def _points(points: object) -> ca.SX:
    return ca.SX(ca.DM(np.array(points, dtype=float).reshape(-1, 3).T))
