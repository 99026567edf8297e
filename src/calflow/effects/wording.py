"""How causes and their sizes are named in reports, given the ids of their effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects.base import Words, effect_class
from calflow.files.words import effect_words, listed, rounded, with_sd

UNEXPLAINED = "unexplained"  # in place of a cause: an unnamed error that depends on the same input
UNITS = {
    "rad": (1e6, "µrad"), "m": (1e3, "mm"), "1": (100.0, "%"), "rad/Nm": (1e9, "µrad/kNm"), "m/N": (1e6, "µm/N"),
    "Nm2": (1e-6, "MNm²"), "1/Nm2": (1e6, "1/MNm²"), "Nm": (1e-3, "kNm"), "m/s": (3.6e6, "mm/h"), "rad/s": (3.6e6, "mrad/h"),
    "1/K": (1e6, "µm/m per °C"), "m/m": (1e6, "µm/m"),
}  # fmt: skip
FLEXIBILITY = "1/Nm2"
LARGE_ANGLE = 2e-3  # rad: angles from here on are stated in mrad


@dataclass(frozen=True)
class NamedCause:
    """The id of an effect with the number of its joint or link (0 for none)."""

    cause: str
    joint: int

    @property
    def label(self) -> str:
        """The id, followed by the number of its joint if it has one."""
        return f"{self.cause} {self.joint}" if self.joint else self.cause

    @property
    def name(self) -> str:
        """The cause's name in words, with its place."""
        return cause_name(self.cause, self.joint)

    def covers(self, other: NamedCause) -> bool:
        """Whether another is the same cause or of the same family at the same joint, and so goes by the family's name."""
        family = cause_family(self.cause)
        return other == self or (bool(family) and (cause_family(other.cause), other.joint) == (family, self.joint))


def cause_family(cause: str) -> str:
    """Return the family of an effect, given its id; empty where it has none."""
    kind = effect_class(cause)
    return kind.family if kind else ""


def cause_name(cause: str, joint: int | None = None, part: str = "") -> str:
    """Return a cause's name with its joint or link, else with its part in brackets."""
    name = cause_words(cause).name
    if joint:
        return f"{name} of {_place_word(cause)} {joint}"
    return f"{name} ({part})" if part else name


def place_name(cause: str, joint: int | None, part: str) -> str:
    """Return a cause's name with its place, given its joint or link (if any) and its part."""
    kind = effect_class(cause)
    return cause_name(cause, joint, "" if joint or (kind and kind.whole == part) else part)


def place_names(cause: str, places: Sequence[tuple[int | None, str]]) -> str:
    """Return a cause's name with all its places, each given as joint or link (if any) and part."""
    numbered = [joint for joint, _ in places if joint]
    if len(numbered) < 2 or len(numbered) < len(places):
        return listed([place_name(cause, joint, part) for joint, part in places])
    return f"{cause_words(cause).name} of {_place_word(cause)}s {listed(numbered)}"


def cause_words(cause: str) -> Words:
    """Return the wording of a cause, given the id of its effect."""
    if cause == UNEXPLAINED:
        return Words("something unexplained")
    kind = effect_class(cause)
    return kind.in_words() if kind else Words(effect_words(cause))


def _place_word(cause: str) -> str:
    kind = effect_class(cause)
    return kind.place_word if kind else "joint"


def readable_size(cause: str, unit: str) -> tuple[float, str]:
    """Return the factor from SI and the display unit of a cause's size."""
    kind = effect_class(cause)
    return (kind.readable.get(unit) if kind else None) or UNITS.get(unit) or (1.0, unit)


def as_stiffness(flexibility: float, unit: str) -> tuple[float, str]:
    """Return a flexibility as the stiffness that reports state, with its unit; any other size unchanged."""
    return (1 / flexibility, "Nm2") if unit == FLEXIBILITY and flexibility > 0 else (flexibility, unit)


def amount(cause: str, estimate: float, sd: float, unit: str) -> str:
    """Return an estimate with its standard deviation in display units; a flexibility is shown as a stiffness."""
    if unit == FLEXIBILITY and estimate > 0:
        sd /= estimate**2
    estimate, unit = as_stiffness(estimate, unit)
    factor, unit_shown = _display(cause, estimate, unit)
    value, deviation = with_sd(factor * estimate, factor * sd)
    return f"{value} ± {deviation} {unit_shown}" if deviation != "–" else f"{value} {unit_shown}"


def amount_between(cause: str, low: float, high: float, unit: str) -> str:
    """Return a 95 % interval in display units, likewise."""
    (low, shown), (high, _) = sorted(as_stiffness(end, unit) for end in (low, high))
    factor, unit_shown = _display(cause, high, shown)
    return f"{rounded(factor * low, 2)} to {rounded(factor * high, 2)} {unit_shown} (95 %)"


def _display(cause: str, size: float, unit: str) -> tuple[float, str]:
    """Return the factor from SI and the display unit of a cause of this size."""
    factor, shown = readable_size(cause, unit)
    return (1e3, "mrad") if shown == "µrad" and abs(size) >= LARGE_ANGLE else (factor, shown)
