"""A cause: one effect at one place of the robot, its name and size in words, and a cause whose values were found before."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from calflow.effects import effect_class
from calflow.effects.base import Effect, Words
from calflow.files.words import effect_words, listed, with_sd
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Deflection, Dimensions, Loads, Row, State
from calflow.robot.parts import Parameter

UNEXPLAINED = "unexplained"  # stands for a cause where something without a name depends on the same input
UNITS = {
    "rad": (1e6, "µrad"), "m": (1e3, "mm"), "1": (100.0, "%"), "rad/Nm": (1e9, "µrad/kNm"), "m/N": (1e6, "µm/N"),
    "Nm2": (1e-6, "MNm²"), "1/Nm2": (1e6, "1/MNm²"), "Nm": (1e-3, "kNm"), "m/s": (3.6e6, "mm/h"), "rad/s": (3.6e6, "mrad/h"),
    "1/K": (1e6, "µm/m per °C"), "m/m": (1e6, "µm/m"),
}  # fmt: skip
FLEXIBILITY = "1/Nm2"
LARGE_ANGLE = 2e-3  # rad from which mrad are said


@dataclass(frozen=True)
class ActingEffect(Effect):
    """An effect that acts as another one does, with a column of that one's parameters."""

    @abstractmethod
    def acting(self, p: ca.SX) -> tuple[Effect, ca.SX]:
        """Return what acts, and its parameters, for the column of this effect's."""

    def completing(self, data: Measurements) -> tuple[Effect, ...]:
        """Return what the one that acts does."""
        return self._acts.completing(data)

    def is_noise(self) -> bool:  # type: ignore[override]
        """Whether the one that acts is a noise."""
        return self._acts.is_noise()

    def of_device(self) -> bool:  # type: ignore[override]
        """Whether the one that acts is the measuring device's."""
        return self._acts.of_device()

    @property
    def _acts(self) -> Effect:
        return self.acting(ca.SX(len(self.declared), 1))[0]

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Act as the other does."""
        effect, values = self.acting(p)
        return effect.dimensions(values, dims, row)

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Act as the other does."""
        effect, values = self.acting(p)
        return effect.loads(values, loads, row)

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Act as the other does."""
        effect, values = self.acting(p)
        return effect.torque(values, state, row)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Act as the other does."""
        effect, values = self.acting(p)
        return effect.deflection(values, state, row, still)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Act as the other does."""
        effect, values = self.acting(p)
        return effect.device(values, point, row)

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Act as the other does."""
        effect, values = self.acting(p)
        return effect.target(values, point, row)


@dataclass(frozen=True)
class Cause(ActingEffect):
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

    def acting(self, p: ca.SX) -> tuple[Effect, ca.SX]:
        """Return the effect with all its parameters, those of other parts at zero."""
        whole = ca.SX(len(self.effect.declared), 1)
        whole[self._at] = p
        return self.effect, whole

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Act as the effect does."""
        return self.effect.scatter(self.acting(p)[1], row)


@dataclass(frozen=True)
class Carried(ActingEffect):
    """A cause with values that were found before, and nothing left to fit."""

    cause: Cause
    values: tuple[float, ...]

    title = "known beforehand"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return none."""
        return ()

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """None."""
        return ()

    def acting(self, p: ca.SX) -> tuple[Effect, ca.SX]:
        """Return the cause with its values."""
        return self.cause, ca.SX(ca.DM(self.values))


def parts(effect: Effect) -> dict[str, np.ndarray]:
    """Return the indices of each part's parameters."""
    named = [parameter.part for parameter in effect.declared]
    return {part: np.flatnonzero(np.array(named) == part) for part in dict.fromkeys(named)}


@dataclass(frozen=True)
class NamedCause:
    """An effect by its id, at a joint or link (0 for none)."""

    cause: str
    joint: int

    @property
    def label(self) -> str:
        """Its id with its joint, if it has one."""
        return f"{self.cause} {self.joint}" if self.joint else self.cause

    @property
    def name(self) -> str:
        """Its name with its place, in words."""
        return cause_name(self.cause, self.joint)


def cause_family(cause: str) -> str:
    """Return the family that an effect belongs to; empty where it belongs to none."""
    kind = effect_class(cause)
    return kind.family if kind else ""


def cause_name(cause: str, joint: int | None = None, part: str = "") -> str:
    """Return a cause's name with its place; part is said where it is neither joint nor link."""
    name = cause_words(cause).name
    if joint:
        return f"{name} of {_place_word(cause)} {joint}"
    return f"{name} ({part})" if part else name


def place_name(cause: str, joint: int | None, part: str) -> str:
    """Return a cause's name with its place, from its joint or link, if it has one, and the part that it belongs to."""
    kind = effect_class(cause)
    return cause_name(cause, joint, "" if joint or (kind and kind.whole == part) else part)


def place_names(cause: str, places: Sequence[tuple[int | None, str]]) -> str:
    """Return a cause's name with all its places, each a joint or link, if it has one, and a part."""
    numbered = [joint for joint, _ in places if joint]
    if len(numbered) < 2 or len(numbered) < len(places):
        return listed([place_name(cause, joint, part) for joint, part in places])
    return f"{cause_words(cause).name} of {_place_word(cause)}s {listed(numbered)}"


def cause_words(cause: str) -> Words:
    """Return a cause in its effect's words."""
    if cause == UNEXPLAINED:
        return Words("something unexplained")
    kind = effect_class(cause)
    return kind.in_words() if kind else Words(effect_words(cause))


def _place_word(cause: str) -> str:
    kind = effect_class(cause)
    return kind.place_word if kind else "joint"


def readable_size(cause: str, unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which a cause's size is easy to read."""
    kind = effect_class(cause)
    return (kind.readable.get(unit) if kind else None) or UNITS.get(unit) or (1.0, unit)


def amount(cause: str, estimate: float, sd: float, unit: str) -> str:
    """Return a size with its standard deviation and unit; a flexibility as the stiffness that it is one over."""
    if unit == FLEXIBILITY and estimate > 0:
        estimate, sd, unit = 1 / estimate, sd / estimate**2, "Nm2"
    factor, unit_shown = readable_size(cause, unit)
    if unit_shown == "µrad" and abs(estimate) >= LARGE_ANGLE:
        factor, unit_shown = 1e3, "mrad"
    value, deviation = with_sd(factor * estimate, factor * sd)
    return f"{value} ± {deviation} {unit_shown}" if deviation != "–" else f"{value} {unit_shown}"
