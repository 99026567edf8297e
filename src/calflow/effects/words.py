"""Causes in words: their names and places, and sizes in units that are easy to read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects import effect_class
from calflow.effects.base import Words
from calflow.files.words import effect_words, listed, with_sd

UNEXPLAINED = "unexplained"  # stands for a cause where something without a name depends on the same input
UNITS = {
    "rad": (1e6, "µrad"), "m": (1e3, "mm"), "1": (100.0, "%"), "rad/Nm": (1e9, "µrad/kNm"), "m/N": (1e6, "µm/N"),
    "Nm2": (1e-6, "MNm²"), "1/Nm2": (1e6, "1/MNm²"), "Nm": (1e-3, "kNm"), "m/s": (3.6e6, "mm/h"), "rad/s": (3.6e6, "mrad/h"),
    "1/K": (1e6, "µm/m per °C"), "m/m": (1e6, "µm/m"),
}  # fmt: skip
FLEXIBILITY = "1/Nm2"
LARGE_ANGLE = 2e-3  # rad from which mrad are said


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
    factor, said = readable_size(cause, unit)
    if said == "µrad" and abs(estimate) >= LARGE_ANGLE:
        factor, said = 1e3, "mrad"
    value, deviation = with_sd(factor * estimate, factor * sd)
    return f"{value} ± {deviation} {said}" if deviation != "–" else f"{value} {said}"
