"""Findings as an engineer reads them: causes with a name and a place, sizes in readable units, chances in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from calflow.diagnosis.findings.tables import UNEXPLAINED, FindingRow
from calflow.effects import catalogue
from calflow.effects.base import Words
from calflow.files.results import Results
from calflow.reporting.words import effect_words, listed, number, percent, with_sd

TOLD = ("named", "one_of")  # statuses of what is in the extended model, or in its noise
CERTAIN = 0.99  # probability beyond which only this is said
PLACE = {"x", "y", "z"}  # inputs that say where the tool is
IN_WORDS = {"pose": "the pose (its markers err alike)", "joints": "the angles of several joints together"}
OTHER_INPUTS = {*PLACE, *IN_WORDS, "order", "time", "payload"}  # than single joints
SMALL = 1e-6  # chance below which only this is said


UNITS = {
    "rad": (1e6, "µrad"), "m": (1e3, "mm"), "1": (100.0, "%"), "rad/Nm": (1e9, "µrad/kNm"), "m/N": (1e6, "µm/N"),
    "Nm2": (1e-6, "MNm²"), "1/Nm2": (1e6, "1/MNm²"), "Nm": (1e-3, "kNm"), "m/s": (3.6e6, "mm/h"), "rad/s": (3.6e6, "mrad/h"),
    "1/K": (1e6, "µm/m per °C"), "m/m": (1e6, "µm/m"),
}  # fmt: skip
FLEXIBILITY = "1/Nm2"
LARGE_ANGLE = 2e-3  # rad from which mrad are said


@dataclass(frozen=True)
class Alternative:
    """What else could explain a finding: an effect's id and its joint (0 for none)."""

    cause: str
    joint: int

    @property
    def name(self) -> str:
        """Its name with its place."""
        return cause_name(self.cause, self.joint)


@dataclass(frozen=True)
class Found:
    """A row of findings.csv; nan where a figure is not known. order counts what is told, from 1."""

    status: str
    cause: str
    joint: int
    detail: str
    estimate: float
    sd: float
    unit: str
    p: float
    probability: float
    gain: tuple[float, float, float]
    left: float
    rivals: tuple[Alternative, ...]
    alike: tuple[str, ...]
    depends_on: tuple[str, ...]
    order: int
    statement: str
    not_tested: tuple[str, ...] = ()
    carries_over: bool | None = None
    numbers: tuple[int, ...] = ()

    @property
    def told(self) -> bool:
        """Whether it is a cause with a name, not a fault of the data or something unexplained."""
        return self.status in TOLD

    @property
    def of_family(self) -> bool:
        """Whether its family is sure but not which of it: an error of one joint's angle, say, whose order is not resolved."""
        return bool(_family(self.cause)) and self.status == "one_of" and (bool(self.kin) or not self.rivals)

    @property
    def kin(self) -> tuple[str, ...]:
        """Ids of its own family, at its own joint, that it cannot be told from."""
        near = [rival.cause for rival in self.rivals if self._is_kin(rival)]
        elsewhere = {rival.cause for rival in self.rivals}
        more = [name for name in self.alike if name not in elsewhere and _family(name) == _family(self.cause)]
        return tuple(dict.fromkeys([*near, *more])) if _family(self.cause) else ()

    @property
    def others(self) -> tuple[Alternative, ...]:
        """The rivals that a name of its family does not cover, what nobody can name last."""
        rivals = [rival for rival in self.rivals if not self._is_kin(rival)]
        return tuple(sorted(rivals, key=lambda rival: rival.cause == UNEXPLAINED))

    def _is_kin(self, rival: Alternative) -> bool:
        return bool(_family(self.cause)) and _family(rival.cause) == _family(self.cause) and rival.joint == self.joint

    @property
    def name(self) -> str:
        """Its name with its place, as far as it is sure."""
        if self.of_family:
            return f"{_family(self.cause)} of joint {self.joint}" if self.joint else _family(self.cause)
        return cause_name(self.cause, self.joint)

    @property
    def names(self) -> str:
        """Its name with its detail, and the names of what it cannot be told from."""
        own = f"{self.name} ({self.detail})" if self.detail and not self.of_family else self.name
        more = " or another cause" if len(self.others) > 2 else ""
        return " or ".join([own, *(rival.name for rival in self.others[:2])]) + more

    @property
    def amount(self) -> str:
        """Its size with its standard deviation, in a unit that is easy to read."""
        return amount(self.cause, self.estimate, self.sd, self.unit)

    @property
    def in_short(self) -> str:
        """What was found in a line: a cause with its size, what something unexplained depends on, else the verdict itself."""
        if self.told:
            return f"{self.names}, {self.amount}"
        if self.status == "unexplained" and not self.is_misfit:
            return f"something unexplained that depends on {self.inputs}"
        return self.statement

    @property
    def is_misfit(self) -> bool:
        """Whether it is a lack of fit as such, told whether an input explains it or not."""
        return self.status == "unexplained" and not self.depends_on

    @property
    def inputs(self) -> str:
        """What something unexplained depends on, in words."""
        joints = [name[1:] for name in self.depends_on if name not in OTHER_INPUTS]
        if len(joints) == len(self.depends_on):
            return f"the {'angle of joint' if len(joints) == 1 else 'angles of joints'} {listed(joints)}"
        if self.depends_on[0] in IN_WORDS:
            return IN_WORDS[self.depends_on[0]]
        if set(self.depends_on) >= PLACE:
            return "where the tool is (x, y and z)"
        detail = f" ({self.detail})" if self.detail else ""
        if "payload" in self.depends_on:
            return f"the payload{detail}"
        return f"when it was measured{detail}" if "order" in self.depends_on else f"the time{detail}"


def findings(results: Results) -> list[Found]:
    """Return the rows of findings.csv, none where nothing was diagnosed."""
    if "diagnose/findings.csv" not in results:
        return []
    found: list[Found] = []
    for row in results.rows("diagnose/findings.csv", FindingRow):
        order = sum(other.told for other in found) + 1 if row.status in TOLD else 0
        rivals = zip(row.rival_causes, row.rival_joints, strict=True)
        found.append(
            Found(
                status=row.status,
                cause=row.cause,
                joint=row.joint or 0,
                detail=row.detail,
                estimate=row.estimate,
                sd=row.sd,
                unit=row.unit,
                p=row.p_family,
                probability=row.probability,
                gain=(row.gain_mean_mm, row.gain_low_mm, row.gain_high_mm),
                left=row.heldout_mean_mm,
                rivals=tuple(Alternative(cause, joint) for cause, joint in rivals),
                alike=row.cannot_tell_from,
                depends_on=row.inputs,
                order=order,
                statement=row.statement,
                not_tested=row.not_tested,
                carries_over=row.carries_over,
                numbers=row.numbers or (order,),
            )
        )
    return found


def cause_name(cause: str, joint: int = 0, part: str = "") -> str:
    """Return a cause's name with its place; part is said where it is neither joint nor link."""
    name = cause_words(cause).name
    if joint:
        return f"{name} of {_place_word(cause)} {joint}"
    return f"{name} ({part})" if part else name


def place_name(cause: str, joint: int, part: str) -> str:
    """Return a cause's name with its place, from its joint or link (0 for none) and the part that it belongs to."""
    kind = catalogue().get(cause)
    return cause_name(cause, joint, "" if joint or (kind and kind.whole == part) else part)


def place_names(cause: str, places: Sequence[tuple[int, str]]) -> str:
    """Return a cause's name with all its places, each a joint or link (0 for none) and a part."""
    numbered = [joint for joint, _ in places if joint]
    if len(numbered) < 2 or len(numbered) < len(places):
        return listed([place_name(cause, joint, part) for joint, part in places])
    return f"{cause_words(cause).name} of {_place_word(cause)}s {listed(numbered)}"


def cause_words(cause: str) -> Words:
    """Return a cause in its effect's words."""
    if cause == UNEXPLAINED:
        return Words("something unexplained")
    kind = catalogue().get(cause)
    return kind.in_words() if kind else Words(effect_words(cause))


def _place_word(cause: str) -> str:
    kind = catalogue().get(cause)
    return kind.place_word if kind else "joint"


def readable_size(cause: str, unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which a cause's size is easy to read."""
    kind = catalogue().get(cause)
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


def chance(p: float) -> str:
    """Return a small probability as words: one in so many."""
    if not math.isfinite(p):
        return "unknown"
    if p < SMALL:
        return "less than one in a million"
    if p > 0.1:
        return f"about {percent(p)}"
    digits = 10 ** max(0, math.floor(math.log10(1 / p)) - 1)
    return f"about one in {round(1 / p / digits) * digits:,}"


def chance_figure(p: float) -> str:
    """Return a small probability for a table."""
    if not math.isfinite(p):
        return "–"
    return "< 10⁻⁶" if p < SMALL else f"{p:.2g}" if p >= 1e-3 else number(p, ".0e")


def sureness(probability: float) -> str:
    """Return a probability as percent that never claims certainty."""
    if not math.isfinite(probability):
        return "–"
    return f"> {percent(CERTAIN)}" if probability > CERTAIN else percent(probability)


def _family(cause: str) -> str:
    kind = catalogue().get(cause)
    return kind.family if kind else ""
