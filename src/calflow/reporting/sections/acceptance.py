"""Acceptance: measurement conditions, the comparison with the required tolerance, and the place to sign."""

from __future__ import annotations

from dataclasses import dataclass, replace

import scipy

from calflow.deployment.usability import is_useless
from calflow.files.deferred import pd
from calflow.files.words import listed, mm, percent, plural
from calflow.reporting.blocks import Block, Card, Look, Paragraph, Signatures, Table, in_a_line
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.study import Acceptance, StudyFile

PASSED, FAILED, NOT_YET = "✓ PASSED", "✗ FAILED", "NOT YET"
LOOKS: dict[str, Look] = {PASSED: "dark", FAILED: "framed"}
CONFIDENCE = 0.95  # of the bound on the share of poses within tolerance
NO_TOLERANCE = "State the tolerance for acceptance: the report then says whether the robot passes."
SIMULATED = "Simulated measurements: no robot was measured."
KELVIN = 273.15
OPEN = "open: not stated"
SIGN = ("Calibrated by: name, date, signature", "Accepted by: name, date, signature")
JUDGED = (
    "Judged is the distance between the predicted and the measured position of the tool at the held-out poses, the "
    "noise included. The robot comes this close only with corrected commands."
)


@dataclass(frozen=True)
class Judged:
    """Held-out poses against a tolerance [mm]: number within, largest error [mm], and whether the model is useless."""

    tolerance: float
    poses: int
    within: int
    largest: float
    useless: bool

    @property
    def card(self) -> Card:
        """The verdict as a card: passed, failed, or not judged, with the reason and what the robot must be given."""
        if not self.poses:
            return sign_card("NOT JUDGED", "no poses were held out")
        if self.useless:
            return sign_card(FAILED, "the model is not to be used")
        beyond = self.poses - self.within
        limit = f"{mm(self.tolerance)} mm, with corrected commands"
        if beyond:
            return sign_card(FAILED, f"{beyond} of {self.poses} held-out poses beyond {limit}")
        return sign_card(PASSED, f"all {self.poses} held-out poses within {limit}")

    @property
    def verdict(self) -> str:
        """The verdict in a sentence, with the largest error."""
        largest = f" The largest error is {mm(self.largest)} mm." if self.poses and not self.useless else ""
        return f"{self.card.big}: {self.card.small}.{largest}"

    @property
    def share(self) -> float:
        """Lower bound, with 95 % confidence, of the share of such poses within tolerance (Clopper and Pearson 1934)."""
        beyond = self.poses - self.within
        return float(scipy.stats.beta.ppf(1 - CONFIDENCE, self.within, beyond + 1)) if self.within else 0.0

    @property
    def share_words(self) -> str:
        """The bound on the share of other poses within tolerance, in words."""
        if not self.poses:
            return ""
        return (
            f"With {percent(CONFIDENCE)} confidence, {plural(self.poses, 'pose')} show that at least {100 * self.share:.1f} % "
            "of all poses like those measured are within the tolerance."
        )


def _facts(request: StudyFile) -> dict[str, str]:
    """Return the facts that a signature requires, as the study states them, empty where it does not."""
    asked = request.acceptance or Acceptance.model_construct()
    return {
        "serial number": asked.serial_number,
        "date": asked.date.isoformat() if asked.date else "",
        "instrument": asked.instrument,
        "operator": asked.operator,
    }


def unstated(request: StudyFile) -> list[str]:
    """Return the required facts that the study does not state."""
    return [name for name, value in _facts(request).items() if not value]


def identity(request: StudyFile) -> str:
    """Return a line on robot, date, instrument and operator, as far as the study states them, and what is missing."""
    verb, missing = "simulated" if is_simulated(request) else "measured", unstated(request)
    stated = [f"{verb if name == 'date' else name} {value}" for name, value in _facts(request).items() if value]
    return in_a_line(*stated, f"not stated: {', '.join(missing)}" if missing else "")


def held_against_tolerance(material: Material) -> Judged | None:
    """Compare the model with the study's tolerance, None without one; a pose is within it where all its rows are."""
    asked = material.request.acceptance
    if asked is None or asked.tolerance is None:
        return None
    tolerance = 1e3 * asked.tolerance
    largest = material.largest if material.certainty.split == "holdout" else pd.Series(dtype=float)
    return Judged(
        tolerance,
        len(largest),
        int((largest <= tolerance).sum()),
        float(largest.iloc[0]) if len(largest) else 0.0,
        is_useless(material),
    )


def is_simulated(request: StudyFile) -> bool:
    """Whether the study states that its data are simulated."""
    return request.acceptance is not None and request.acceptance.simulated


def simulated(request: StudyFile) -> list[Block]:
    """Return the note on simulated data, where the study states them."""
    return [Paragraph(SIMULATED, 12, bold=True)] if is_simulated(request) else []


def verdict_card(material: Material) -> Card:
    """Return the card on whether the report may be signed."""
    verdict = held_against_tolerance(material)
    card = verdict.card if verdict else sign_card(NOT_YET, "no tolerance for acceptance is stated")
    if card.big == PASSED and (missing := unstated(material.request)):
        card = sign_card(NOT_YET, f"{card.small}; not stated: {', '.join(missing)}")
    return replace(card, head="simulated: nothing to sign", look="pale") if is_simulated(material.request) else card


def sign_card(verdict: str, why: str) -> Card:
    """Return a verdict as a card: dark for passed, framed for failed."""
    return Card("may it be signed?", verdict, why, LOOKS.get(verdict, "pale"), "")


@section(3, "Acceptance", "identify/residuals.csv", lambda material: material.request.acceptance is not None)
def acceptance_section(material: Material) -> list[Block]:
    """Return the facts stated by the study, and the verdict."""
    asked = material.request.acceptance
    assert asked is not None
    verdict = held_against_tolerance(material)
    seen = [Paragraph(verdict.verdict, 12, bold=True)] if verdict else []
    return [
        *simulated(material.request),
        *seen,
        Table(("what", "stated"), _stated(material, asked), "ll", wide=1),
        *_why(material, verdict),
        *_signed(material.request),
    ]


def _signed(request: StudyFile) -> list[Block]:
    """Return the lines for signatures, or the facts to be stated first."""
    if is_simulated(request):
        return []
    if missing := unstated(request):
        return [Paragraph(f"Not to be signed yet. State the {listed(missing)} first.", 11, bold=True)]
    return [Signatures(SIGN)]


def _stated(material: Material, asked: Acceptance) -> list[tuple[str, str]]:
    """Return the stated facts to sign; missing required facts are marked as open, other missing ones omitted."""
    temperature = "" if asked.temperature is None else f"{asked.temperature - KELVIN:.1f} °C"
    facts = {
        "robot": material.robot.name,
        **_facts(material.request),
        "certificate of the instrument": asked.certificate,
        "temperature": temperature,
        "tolerance": f"{mm(1e3 * asked.tolerance)} mm" if asked.tolerance else "",
    }
    missing = unstated(material.request)
    return [(name, value or OPEN) for name, value in facts.items() if value or name in missing]


def _why(material: Material, verdict: Judged | None) -> list[Block]:
    """Return sentences on what was judged, and what it implies for other poses."""
    if verdict is None:
        return []
    splits = material.tables["identify/residuals.csv"]["split"]
    out = int((~splits.isin(["train", "holdout"])).sum())
    left_out = f" {plural(out, 'row')} of the measurement file were left out as faulty, and not judged." if out else ""
    return [Paragraph(f"{JUDGED} {verdict.share_words}{left_out}".replace("  ", " "))]
