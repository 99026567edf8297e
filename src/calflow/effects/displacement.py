"""Displacements of points, linear in a few figures: a shift, a rigid motion, a scale, a lens that changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import Effect
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class Displacement:
    """A displacement of points by figures, of symbol, unit and words each; moved returns it (3,) at a point (3,)."""

    figures: tuple[tuple[str, str, str], ...]
    moved: Callable[[ca.SX, ca.SX], ca.SX]

    def parameters(
        self, effect: Effect, part: str, sds: Mapping[str, float], bound: float, what: Mapping[str, str],
        per: str = "", endings: Sequence[str] = ("",),
    ) -> Iterator[Parameter]:  # fmt: skip
        """Yield an effect's parameters of a part, each figure with every ending: sds and what are by unit, bound is in sds."""
        for symbol, unit, words in self.figures:
            sd = sds[unit]
            for ending in endings:
                yield Parameter(effect.id, part, symbol + ending, unit + per, sd, -bound * sd, bound * sd,
                                meaning=f"{what[unit]} {words}")  # fmt: skip


def displaced(p: ca.SX, point: ca.SX) -> ca.SX:
    """Return a point's displacement (3,) by a shift p (3,), or a shift and a small rotation about the origin (6,)."""
    return p[:3] + (ca.cross(p[3:], point) if p.numel() == 6 else 0)


def refocused(p: ca.SX, point: ca.SX) -> ca.SX:
    """Return the displacement (3,) of a point in a camera's frame whose image changes as by longer focal lengths, times 1 + p[0],
    and a centre shifted by p[1:3] focal lengths.
    """
    return ca.vertcat(p[0] * point[:2] + p[1:3] * point[2], 0)


SHIFT = Displacement(tuple((axis, "m", f"along {axis}") for axis in "xyz"), displaced)
MOTION = Displacement((*SHIFT.figures, *((f"r{axis}", "rad", f"about {axis}") for axis in "xyz")), displaced)
SCALE = Displacement((("s", "1", "of the scale"),), lambda p, point: p * point)
OF_CENTRE = tuple((axis, "1", f"of the centre of the image along {axis}") for axis in "xy")
LENS = Displacement((("f", "1", "of the focal lengths"), *OF_CENTRE), refocused)


@dataclass(frozen=True)
class Rigid(Effect):
    """An effect that shifts points, and with turning rotates them about the origin, too."""

    turning: bool = False

    @property
    def displacement(self) -> Displacement:
        """The shift, with the rotation if it turns."""
        return MOTION if self.turning else SHIFT

    @property
    def detail(self) -> str:
        """The form, and whether it rotates."""
        return f"{super().detail}{', turned too' if self.turning else ''}"
