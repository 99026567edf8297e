"""Geometry: errors of the lengths and angles that the robot's maker states (kinematic parameters)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca

from calflow.effects.base import Effect, Words
from calflow.robot.frames import placement
from calflow.robot.mechanism import Dimensions, Row
from calflow.robot.parts import PLACED_BOUND, PLACED_SD, UNKNOWN_BOUND, UNKNOWN_SD, Parameter
from calflow.robot.robot import Robot

# In m and rad: tolerances of machining and assembly, and the size beyond which a figure is mistaken rather than inexact.
LINK_SD, LINK_BOUND = 2e-3, 20e-3
USUAL_BOUNDS = -LINK_BOUND, LINK_BOUND
MISTAKE = 20.0  # standard deviations of a marker's stated relative place beyond which it is a mistake

MEANINGS = {  # by field of `Dimensions`
    "base": "base, {symbol}",
    "bars": "length of the loop's {symbol}",
    "markers": "{symbol} of marker {part}",
    "tool_rotation": "turn of the tool, {symbol}",
    "markers_turn": "turn of the markers about the first, {symbol}",
}
FIGURES = {  # by symbol of an elementary transform of a frame
    "alpha": "twist alpha of link {link}",
    "beta": "twist beta of link {link}",
    "theta": "zero of joint {link}",
    "a": "length a of link {link}",
    "d": "length d of link {link}",
    "x": "place of joint {link} along x of link {before}",
    "y": "place of joint {link} along y of link {before}",
    "z": "place of joint {link} along z of link {before}",
    "rx": "tilt of the axis of joint {link} about x of its frame",
    "ry": "tilt of the axis of joint {link} about y of its frame",
    "rz": "tilt of the axis of joint {link} about z of its frame",
}
OF_A_SLIDE = {"theta": "turn of link {link} about its slide", "d": "zero of joint {link}"}  # it moves along d


@dataclass(frozen=True)
class DimensionError:
    """A parameter with the entry of `Dimensions` to which it is added: field, and index in column-major order."""

    parameter: Parameter
    field: str
    index: int

    @property
    def is_length(self) -> bool:
        """Whether it is an error of a length of the robot itself, not of its base placement."""
        return self.parameter.unit == "m" and self.field != "base"


@dataclass(frozen=True)
class Geometry(Effect):
    """Rx(alpha + d alpha) Tx(a + d a) Ry(d beta) Rz(theta + d theta + q) Tz(d + d d) per link, or in DH's order; base, tool, loop.

    Of two figures that move the tool identically in every pose, one is omitted: the first joint's place is the base's, the
    rocker's length the crank's, and between nearly parallel axes beta replaces d (each frame states its free figures). The
    redundancy of last joint and tool, and that of prismatic joints and planar arms, is kept for the identifiability
    analysis to report. Markers whose places relative to the first are known translate and rotate with it.

    unstated: symbols of the figures that no joint counts as stated (`without_mistaken`): an arm assembled by hand has other
    zeros than a maker's. tool_as_stated: whether known markers are where the robot file says, since nothing measures their places
    (`unseen`).
    """

    unstated: tuple[str, ...] = ()
    tool_as_stated: bool = False

    id = "geometry"
    title = "geometry (link lengths, twists and offsets, base, tool)"
    words = Words("geometry error", "a length or an angle is not what the robot file says", "size")
    tag = ""
    unnamed = ("unstated", "tool_as_stated")  # a figure is the same parameter whether or not it counts as stated

    def without_mistaken(self, at_bound: Iterable[Parameter]) -> Geometry:
        """Return the effect for which no figure of a kind counts as stated, if one of these parameters is mistaken in it.

        That is one at the bound of what a maker's robot is off; where a user stated the bound, it holds.
        """
        own = (
            p for p in at_bound if p.effect == self.id and p.joint and p.symbol not in _with_flange(self.robot, p.joint)
        )
        mistaken = {p.symbol for p in own if (p.lower, p.upper) == USUAL_BOUNDS}
        return replace(self, unstated=tuple(sorted({*self.unstated, *mistaken})))

    def unseen(self) -> Self:
        """Return the effect for measurements by which no marker is placed: a known one is the tool that is meant."""
        return replace(self, tool_as_stated=True)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of this robot's lengths and angles."""
        return tuple(error.parameter for error in self.errors)

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the dimensions with each error added."""
        moved = dims
        for field in dict.fromkeys(error.field for error in self.errors):
            which = [k for k, error in enumerate(self.errors) if error.field == field]
            changed = ca.SX(getattr(dims, field))
            changed.nz[[self.errors[k].index for k in which]] += p[which]
            moved = replace(moved, **{field: changed})
        beside = [k for k, marker in enumerate(self.robot.markers.values()) if marker.relative_sd]
        if not beside:
            return moved
        first, turn = moved.markers[:, 0], placement(ca.vertcat(0, 0, 0, moved.markers_turn))[:3, :3]
        markers = ca.SX(moved.markers)
        for k in beside:
            shift = moved.markers[:, k] - dims.markers[:, k]
            markers[:, k] = first + turn @ (dims.markers[:, k] - dims.markers[:, 0]) + shift
        return replace(moved, markers=markers)

    @cached_property
    def errors(self) -> tuple[DimensionError, ...]:
        """Each parameter with the entry of `Dimensions` that it changes."""
        return (
            *_base(self.robot),
            *_links(self.robot, self.unstated),
            *_loop(self.robot),
            *_tool(self.robot, self.tool_as_stated),
        )


def _error(
    part: str, symbol: str, field: str, index: int, sd: float, bound: float, figure: float = 0.0
) -> DimensionError:
    """Return an error of a dimension outside the chain of frames; figure is the maker's value, 0 for placements."""
    unit = "rad" if symbol in ("rx", "ry", "rz") else "m"
    words = MEANINGS[field].format(symbol=symbol, part=part)
    parameter = Parameter(Geometry.id, part, symbol, unit, sd, -bound, bound, figure=figure, meaning=words)
    return DimensionError(parameter, field, index)


def _base(robot: Robot) -> Iterator[DimensionError]:
    sd, bound = (PLACED_SD, PLACED_BOUND) if robot.base.known else (UNKNOWN_SD, UNKNOWN_BOUND)
    for i, symbol in enumerate(() if robot.base.fixed else ("x", "y", "z", "rx", "ry", "rz")):
        yield _error("base", symbol, "base", i, sd, bound)


def _links(robot: Robot, unstated: Sequence[str]) -> Iterator[DimensionError]:
    for i, (frame, place) in enumerate(zip(robot.frames, robot.places, strict=True)):
        figures = FIGURES | OF_A_SLIDE if robot.joints[i].kind == "prismatic" else FIGURES
        for step in frame.free(place):
            words = figures.get(step.symbol, f"{step.symbol} of the frame of joint {{link}}").format(
                link=i + 1, before=robot.parents[i]
            )
            free = step.symbol in unstated and step.symbol not in _with_flange(robot, i + 1)
            # Figures of a robot that no maker set are as uncertain as places.
            sd, bound = (PLACED_SD, PLACED_BOUND) if free else (LINK_SD, LINK_BOUND)
            parameter = Parameter(Geometry.id, f"joint{i + 1}", step.symbol, step.unit, sd, -bound, bound,
                                  figure=step.value, meaning=words, joint=i + 1)  # fmt: skip
            yield DimensionError(parameter, "steps", robot.step_index(i, step.symbol))


def _with_flange(robot: Robot, link: int) -> set[str]:
    """Return the symbols of a joint's figures that only move a flange with all that is on it: loads alone contradict them."""
    frame = robot.frames[link - 1]
    return set() if robot.on(link) else {frame.turn.symbol, *(step.symbol for step in frame.body)}


def _loop(robot: Robot) -> Iterator[DimensionError]:
    if robot.loop:
        yield _error("loop", "crank", "bars", 0, LINK_SD, LINK_BOUND, robot.loop.crank.length)
        yield _error("loop", "rod", "bars", 1, LINK_SD, LINK_BOUND, robot.loop.rod.length)


def _tool(robot: Robot, as_stated: bool) -> Iterator[DimensionError]:
    for k, (name, marker) in enumerate(robot.markers.items()):
        sd, bound = (PLACED_SD, PLACED_BOUND) if marker.known else (UNKNOWN_SD, UNKNOWN_BOUND)
        if marker.relative_sd:
            sd, bound = marker.relative_sd, MISTAKE * marker.relative_sd
        for i, (symbol, figure) in enumerate(zip("xyz", marker.point, strict=True)):
            error = _error(name, symbol, "markers", 3 * k + i, sd, bound, figure)
            held = 0.0 if as_stated and marker.known and not marker.relative_sd else None
            yield replace(error, parameter=replace(error.parameter, held=held))
    if any(marker.relative_sd for marker in robot.markers.values()):
        for i, symbol in enumerate(("rx", "ry", "rz")):
            yield _error("markers", symbol, "markers_turn", i, PLACED_SD, PLACED_BOUND)
    if robot.tool_rotation is not None:
        for i, symbol in enumerate(("rx", "ry", "rz")):
            yield _error("tool", symbol, "tool_rotation", i, PLACED_SD, PLACED_BOUND)
