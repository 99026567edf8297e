"""Causes: one effect at one place (joint, link, part), with free parameters or with those of an earlier estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import ActingEffect, Effect
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class Cause(ActingEffect):
    """An effect at one place: the parameters of one part are free, those of all other parts are zero."""

    effect: Effect
    part: str

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
        alone = all(parameter.part == self.part for parameter in self.effect.declared)
        part = "" if alone or self.joint or self.part == self.effect.whole else self.part
        return ", ".join(filter(None, (part, self.effect.detail_at(self.joint))))

    @property
    def variant(self) -> str:
        """The effect's variant in short."""
        return self.effect.variant

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

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return len(self.declared)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lower and upper bounds of the parameters relative to nominal, shape (2, n_parameters)."""
        return np.array([(p.lower - p.nominal, p.upper - p.nominal) for p in self.declared]).T

    @property
    def family(self) -> str:  # type: ignore[override]
        """The effect's family."""
        return self.effect.family

    @property
    def alike(self) -> tuple[str, ...]:  # type: ignore[override]
        """Ids of the effects that no pose distinguishes from it."""
        return self.effect.alike

    @property
    def needs(self) -> tuple[str, ...]:  # type: ignore[override]
        """What the effect needs of robot and data."""
        return self.effect.needs

    def same_form(self, other: Cause) -> bool:
        """Whether another cause is this one, in this variant or in one that excludes it."""
        return self.place == other.place and self.effect.same_as(other.effect)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the part's parameters."""
        return self.declared

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The part's parameters, as the effect names them."""
        return tuple(parameter for parameter in self.effect.declared if parameter.part == self.part)

    @cached_property
    def _indices(self) -> list[int]:
        return [k for k, parameter in enumerate(self.effect.declared) if parameter.part == self.part]

    def acting(self, p: ca.SX) -> tuple[Effect, ca.SX]:
        """Return the effect and all its parameters, those of other parts zero."""
        whole = ca.SX(len(self.effect.declared), 1)
        whole[self._indices] = p
        return self.effect, whole

    def size_of(self, p: ca.SX) -> ca.SX:
        """Return the size of the part's parameters, as findings state it."""
        return self.effect.size(p, self.declared)

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Return the effect's contribution to the standard deviation."""
        return self.effect.scatter(self.acting(p)[1], row)


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

    def acting(self, p: ca.SX) -> tuple[Effect, ca.SX]:
        """Return the cause and its fixed values."""
        return self.cause, ca.SX(ca.DM(self.values))


def parts(effect: Effect) -> dict[str, np.ndarray]:
    """Return, for each part, the indices of its parameters."""
    named = [parameter.part for parameter in effect.declared]
    return {part: np.flatnonzero(np.array(named) == part) for part in dict.fromkeys(named)}
