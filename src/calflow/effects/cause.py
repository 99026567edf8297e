"""Causes: one effect at one place (joint, link, part), with free parameters or with those of an earlier estimate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import Any, Self

import casadi as ca
import numpy as np

from calflow.effects.base import ActingEffect, Effect
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


def _of_its_effect(name: str) -> Any:
    """Return a property that is the effect's."""
    return property(attrgetter(f"effect.{name}"))


@dataclass(frozen=True)
class Cause(ActingEffect):
    """An effect at one place: the parameters of one part are free, those of all other parts are zero.

    scale is that of its priors in a fit, over the effect's usual sizes (see `prior_scale`); it is the same cause in any.
    """

    effect: Effect
    part: str
    scale: float = field(default=1.0, compare=False)

    variant, family, alike, needs, is_curve = map(_of_its_effect, ("variant", "family", "alike", "needs", "is_curve"))

    @property
    def id(self) -> str:  # type: ignore[override]
        """The effect's id."""
        return self.effect.id

    @property
    def title(self) -> str:  # type: ignore[override]
        """The effect's name in reports."""
        return self.effect.in_words().name

    @property
    def detail(self) -> str:
        """The effect's variant in words, preceded by the part where neither joint nor name implies it."""
        part = "" if len(self.effect.parts) == 1 or self.joint or self.part == self.effect.whole else self.part
        return ", ".join(filter(None, (part, self.effect.detail_at(self.joint))))

    @property
    def joint(self) -> int:
        """Number of the joint or link, 0 for none."""
        return self.declared[0].joint

    @property
    def place(self) -> tuple[str, str]:
        """Effect id and part, which all variants at this place share."""
        return self.effect.id, self.part

    def later(self, series: Measurements | None) -> Self:
        """Return the cause for rows measured later."""
        return replace(self, effect=self.effect.later(series))

    def on(self, robot: Robot) -> Self:
        """Return the cause of another robot, with priors of the usual sizes."""
        return replace(self, effect=replace(self.effect, robot=robot), scale=1.0)

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return len(self.declared)

    @property
    def usual(self) -> Self:
        """The cause with priors of the usual sizes."""
        return self if self.scale == 1 else replace(self, scale=1.0)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lower and upper bounds of the parameters relative to nominal, shape (2, n_parameters)."""
        return np.array([(p.lower - p.nominal, p.upper - p.nominal) for p in self.declared]).T

    def same_form(self, other: Cause) -> bool:
        """Whether another cause is this one, in this variant or in one that excludes it."""
        return self.place == other.place and self.effect.same_as(other.effect)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the part's parameters."""
        return self.declared

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The part's parameters, as the effect names them."""
        own = (self.effect.declared[k] for k in self.effect.parts[self.part])
        return tuple(replace(parameter, prior_sd=self.scale * parameter.prior_sd) for parameter in own)

    def acting(self, p: ca.SX, row: Row) -> tuple[Effect, ca.SX]:
        """Return the effect and all its parameters, those of other parts zero."""
        whole = ca.SX(len(self.effect.declared), 1)
        whole[self.effect.parts[self.part]] = p
        return self.effect, whole

    def size_of(self, p: ca.SX) -> ca.SX:
        """Return the size of the part's parameters, as findings state it."""
        return self.effect.size(p, self.declared)


@dataclass(frozen=True)
class Carried(ActingEffect):
    """A cause with fixed parameter values from an earlier estimate, without free parameters."""

    cause: Cause
    values: tuple[float, ...]

    title = "known beforehand"

    def later(self, series: Measurements | None) -> Self:
        """Return the same for rows measured later."""
        return replace(self, cause=self.cause.later(series))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return none."""
        return ()

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """None."""
        return ()

    def acting(self, p: ca.SX, row: Row) -> tuple[Effect, ca.SX]:
        """Return the cause and its fixed values."""
        return self.cause, ca.SX(ca.DM(self.values))
