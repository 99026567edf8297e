"""The verdict: what each finding may be called, how surely, and what it cannot be told from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Generic, Literal

import numpy as np

from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import by_place
from calflow.diagnosis.search.linearisation import Detection
from calflow.effects.words import UNEXPLAINED, NamedCause

WITHIN = 10.0  # of the best BIC: closer rivals cannot be told apart (Kass and Raftery 1995: "very strong" beyond)

TEMPERED = (
    0.5  # of the evidence against it: the form of what nobody can name is itself a guess (Grünwald and van Ommen 2017)
)

Status = Literal["named", "one_of"]


@dataclass(frozen=True)
class Rival(Generic[H]):
    """What else could explain the data: an effect's id and its joint (0 for none); bic is relative to the finding's.

    score is of its best variant in the finding's place, None where the data could not test it; needs is what that would take.
    """

    id: str
    joint: int
    bic: float
    score: Score[H] | None
    needs: str = ""

    @property
    def cause(self) -> H | None:
        """The best variant, if it could be tested."""
        return self.score.cause if self.score else None


@dataclass(frozen=True)
class Verdict(Generic[H]):
    """A finding with its status, probability and rivals, the nearest first.

    carries_over says whether it holds in blocks of the training poses that it was not fitted to; None: not looked at.
    """

    finding: Detection[H]
    status: Status
    probability: float
    rivals: tuple[Rival[H], ...]
    carries_over: bool | None = None

    @property
    def family(self) -> str:
        """The family to name it by where all that it could be are of one family, at one joint; empty otherwise."""
        cause = self.finding.cause
        family = cause.family
        same = all(
            rival.cause is not None and rival.cause.family == family and rival.joint == cause.joint
            for rival in self.rivals
        )
        return family if family and self.rivals and same else ""


def verdict(finding: Detection[H], untestable: Mapping[str, str] = MappingProxyType({})) -> Verdict[H]:
    """Weigh a finding against all rivals in its place by their BIC, the variants of each taken together.

    untestable are ids of what may be behind it and could not be tested, with what that would take: as likely as the finding.
    """
    evidence = by_place(finding.scores)
    cause = finding.cause
    named_bic = evidence[cause.place][0]
    rivals = [
        Rival(best.cause.id, best.cause.joint, bic - named_bic, best)
        for place, (bic, best) in evidence.items()
        if place != cause.place and bic - named_bic < WITHIN
    ]
    tested = {(score.cause.id, score.cause.joint) for score in finding.scores}
    untested = [other for other in dict.fromkeys([*cause.alike, *untestable]) if (other, cause.joint) not in tested]
    rivals += [Rival(other, cause.joint, 0.0, None, untestable.get(other, "")) for other in untested]
    weights = [np.exp(-(bic - named_bic) / 2) for place, (bic, _) in evidence.items() if place != cause.place]
    against = TEMPERED * finding.unnamed
    if against < WITHIN:
        rivals.append(Rival(UNEXPLAINED, 0, against, None))
    weights += [float(np.exp(-max(rival.bic, 0.0) / 2)) for rival in rivals if rival.cause is None]
    probability = 1 / (1 + float(np.sum(weights)))
    ordered = tuple(sorted(rivals, key=lambda rival: rival.bic))
    return Verdict(finding, "one_of" if ordered else "named", probability, ordered, finding.carries_over)


def label(cause: str, joint: int) -> str:
    """Name a cause with its joint, if it has one."""
    return NamedCause(cause, joint).label
