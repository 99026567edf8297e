"""A cause: one effect at one place of the robot, and a cause whose values were found before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import casadi as ca
import numpy as np

from calflow.effects.base import Effect
from calflow.robot.chain import Deflection
from calflow.robot.conditions import Row
from calflow.robot.dimensions import Dimensions, Loads
from calflow.robot.parameter import Parameter
from calflow.robot.statics import State

if TYPE_CHECKING:
    from calflow.measurements.measurements import Measurements


@dataclass(frozen=True)
class Cause(Effect):
    """One effect at one place: of its parameters only those of one part, the others at zero."""

    effect: Effect
    part: str

    @property
    def id(self) -> str:  # type: ignore[override]
        """The effect's id."""
        return self.effect.id

    @property
    def title(self) -> str:  # type: ignore[override]
        """The effect's title."""
        return self.effect.title

    @property
    def detail(self) -> str:
        """The effect's variant, after the part where it has several and neither joint nor name says which."""
        alone = all(parameter.part == self.part for parameter in self.effect.declared)
        part = "" if alone or self.joint or self.part == self.effect.whole else self.part
        return ", ".join(filter(None, (part, self.effect.detail)))

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
        """What stays the same in all its variants."""
        return self.effect.id, self.part

    @property
    def n_parameters(self) -> int:
        """How many parameters it has."""
        return len(self.declared)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Least and largest values of its parameters, from nominal, shape (2, n_parameters)."""
        return np.array([(p.lower - p.nominal, p.upper - p.nominal) for p in self.declared]).T

    @property
    def family(self) -> str:  # type: ignore[override]
        """The effect's family."""
        return self.effect.family

    @property
    def alike(self) -> tuple[str, ...]:  # type: ignore[override]
        """What the effect cannot be told from by any pose."""
        return self.effect.alike

    def same_form(self, other: Cause) -> bool:
        """Whether another is this cause, in this variant or one that cannot act beside it."""
        return self.place == other.place and self.effect.same_as(other.effect)

    def completing(self, data: Measurements) -> tuple[Effect, ...]:
        """Return what the effect does."""
        return self.effect.completing(data)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the part's parameters."""
        return self.declared

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The effect's parameters of the part, as the effect names them."""
        return tuple(parameter for parameter in self.effect.declared if parameter.part == self.part)

    @cached_property
    def _at(self) -> list[int]:
        return [k for k, parameter in enumerate(self.effect.declared) if parameter.part == self.part]

    @cached_property
    def _size(self) -> int:
        return len(self.effect.declared)

    def _whole(self, p: ca.SX) -> ca.SX:
        whole = ca.SX(self._size, 1)
        whole[self._at] = p
        return whole

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Act as the effect does."""
        return self.effect.dimensions(self._whole(p), dims, row)

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Act as the effect does."""
        return self.effect.loads(self._whole(p), loads, row)

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Act as the effect does."""
        return self.effect.torque(self._whole(p), state, row)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Act as the effect does."""
        return self.effect.deflection(self._whole(p), state, row, still)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Act as the effect does."""
        return self.effect.device(self._whole(p), point, row)

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Act as the effect does."""
        return self.effect.scatter(self._whole(p), row)


@dataclass(frozen=True)
class Carried(Effect):
    """A cause with values that were found before, and nothing left to fit."""

    cause: Cause
    values: tuple[float, ...]

    title: ClassVar[str] = "known beforehand"

    def completing(self, data: Measurements) -> tuple[Effect, ...]:
        """Return what the cause does."""
        return self.cause.completing(data)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return none."""
        return ()

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """None."""
        return ()

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Act as the cause does."""
        return self.cause.deflection(self._p, state, row, still)

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Act as the cause does."""
        return self.cause.dimensions(self._p, dims, row)

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Act as the cause does."""
        return self.cause.loads(self._p, loads, row)

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Act as the cause does."""
        return self.cause.torque(self._p, state, row)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Act as the cause does."""
        return self.cause.device(self._p, point, row)

    @property
    def _p(self) -> ca.SX:
        return ca.SX(ca.DM(self.values))


def parts(effect: Effect) -> dict[str, np.ndarray]:
    """Return the indices of each part's parameters."""
    named = [parameter.part for parameter in effect.declared]
    return {part: np.flatnonzero(np.array(named) == part) for part in dict.fromkeys(named)}
