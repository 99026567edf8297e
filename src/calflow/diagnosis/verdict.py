"""The verdict: what each finding may be called, how surely, and what it cannot be told from.

The likeliest rivals are fitted in the place of the causes that were found. The models in reach of what was found are its causes
with one of them left out, one exchanged, or one added.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Generic, Literal

import numpy as np
import pandas as pd

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import H
from calflow.diagnosis.screening import Catalogue, Score, by_place
from calflow.diagnosis.stepwise import WITHIN, Detection, Linearisation, swapped
from calflow.effects.cause import UNEXPLAINED, Cause, NamedCause
from calflow.estimation.calibrated_model import MANY, Alternative, AlternativeParameter, Change, ModelInReach
from calflow.files.tables import to_frame

TEMPERED = (
    0.5  # of the evidence against it: the form of what nobody can name is itself a guess (Grünwald and van Ommen 2017)
)

Status = Literal["named", "one_of"]


@dataclass(frozen=True)
class Rival(Generic[H]):
    """What else could explain the data: an effect's id and its joint (0 for none); cost is relative to the finding's.

    score is of its best variant in the finding's place, None where the data could not test it; needs is what that would take.
    """

    id: str
    joint: int
    cost: float
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
    """Weigh a finding against all rivals in its place by their evidence, the variants of each taken together.

    untestable are ids of what may be behind it and could not be tested, with what that would take: as likely as the finding.
    """
    evidence = by_place(finding.scores)
    cause = finding.cause
    named_cost = evidence[cause.place][0]
    rivals = [
        Rival(best.cause.id, best.cause.joint, cost - named_cost, best)
        for place, (cost, best) in evidence.items()
        if place != cause.place and cost - named_cost < WITHIN
    ]
    tested = {(score.cause.id, score.cause.joint) for score in finding.scores}
    untested = [other for other in dict.fromkeys([*cause.alike, *untestable]) if (other, cause.joint) not in tested]
    rivals += [Rival(other, cause.joint, 0.0, None, untestable.get(other, "")) for other in untested]
    weights = [np.exp(-(cost - named_cost) / 2) for place, (cost, _) in evidence.items() if place != cause.place]
    against = TEMPERED * finding.unnamed
    if against < WITHIN:
        rivals.append(Rival(UNEXPLAINED, 0, against, None))
    weights += [float(np.exp(-max(rival.cost, 0.0) / 2)) for rival in rivals if rival.cause is None]
    probability = 1 / (1 + float(np.sum(weights)))
    ordered = tuple(sorted(rivals, key=lambda rival: rival.cost))
    return Verdict(finding, "one_of" if ordered else "named", probability, ordered, finding.carries_over)


def label(cause: str, joint: int) -> str:
    """Name a cause with its joint, if it has one."""
    return NamedCause(cause, joint).label


LEAST = 0.02  # probability below which a rival moves no interval
MOST_FITTED = 4  # that are fitted: the likeliest


@dataclass(frozen=True)
class FittedAlternative:
    """An alternative that was fitted, and how it came about: which cause (from 0) gives way, to which rival, if any."""

    number: int
    rival: Cause | None
    alternative: Alternative


def fitted_alternatives(verdicts: Sequence[Verdict], final: Fitted) -> tuple[FittedAlternative, ...]:
    """Fit the likeliest rivals in the causes' places, one at a time; a rival that could not be tested has no model."""
    asked = [
        (_probability(verdict, rival), k, rival.cause)
        for k, verdict in enumerate(verdicts)
        for rival in verdict.rivals
        if rival.cause is not None or rival.id == UNEXPLAINED
    ]
    likeliest = sorted(
        (alternative for alternative in asked if alternative[0] >= LEAST), key=lambda alternative: -alternative[0]
    )[:MOST_FITTED]
    alternatives = []
    for probability, k, rival in likeliest:
        stay = [cause for cause in final.causes if cause != verdicts[k].finding.cause]
        causes = [*stay, rival] if rival is not None and rival not in stay else stay
        fit = final.fit_with(causes)
        alternative = Alternative(fit.model, fit.estimate, probability)
        alternatives.append(FittedAlternative(k, rival if len(causes) > len(stay) else None, alternative))
    return tuple(alternatives)


def _probability(verdict: Verdict, rival: Rival) -> float:
    """The rival's share, as the verdict weighs it: what could not be tested never counts for more than the cause."""
    cost = rival.cost if rival.cause else max(rival.cost, 0.0)
    return float(verdict.probability * np.exp(-cost / 2))


def alternatives_table(
    alternatives: Sequence[FittedAlternative], causes: Sequence[Cause], final: Fitted
) -> pd.DataFrame:
    """Return the table of `AlternativeParameter`s; causes are those found, in the order of their verdicts."""
    order = list(final.causes)
    rows = [
        AlternativeParameter(
            alternative=number, probability=item.alternative.probability, instead_of=order.index(causes[item.number]) + 1,
            effect=item.rival.effect.id if item.rival else "", part=item.rival.part if item.rival else "",
            variant=json.dumps(item.rival.effect.figures) if item.rival else "",
            parameter=parameter.name, estimate=float(estimate),
        )
        for number, item in enumerate(alternatives, start=1)
        for parameter, estimate in zip(item.alternative.model.parameters, item.alternative.estimate, strict=True)
    ]  # fmt: skip
    return to_frame(rows, AlternativeParameter)


REACH = 7.0  # in the logarithm: a model this much less likely than what was found, by the linear tests, has a chance of 0.1 %
MOST_IN_REACH = 24  # models: the likeliest


def models_in_reach(
    final: Fitted, findings: Sequence[Detection[Cause]], catalogue: Catalogue
) -> tuple[ModelInReach, ...]:
    """Return the models in reach, what was found first, then by how likely the linear tests make them; none of nothing found.

    Before the data each place of the catalogue that they can show is a cause with odds of one to the number of these places,
    and its forms share them evenly: one cause is to be expected of the whole catalogue, however large it is. Causes of very many
    parameters stay as they are in all models.
    """
    if not any(_is_small(finding.cause) for finding in findings):
        return ()
    beside = Linearisation.at(final, catalogue).beside.scores
    places = float(np.log(len(rivals_shown(findings, beside))))

    def log_prior(causes: Sequence[Cause]) -> float:
        return -sum(places + float(np.log(catalogue.variants.get(cause.place, 1))) for cause in causes)

    independent = final.background is None and final.alone.shared == 1
    near = [
        ModelInReach(tuple(causes), change, log_prior(causes), weight, independent)
        for causes, change, weight in _neighbours(final, findings, beside, places)
        if weight > -REACH
    ]
    current = ModelInReach(final.causes, "found", log_prior(final.causes), 0.0, independent)
    return (current, *sorted(near, key=lambda model: -model.log_weight)[: MOST_IN_REACH - 1])


def rivals_shown(findings: Sequence[Detection[Cause]], beside: Sequence[Score[Cause]]) -> dict[tuple[str, str], Cause]:
    """Return the places that the data show, in place of what was found or beside it, each with a cause there."""
    scores = [*beside, *(score for finding in findings for score in finding.scores)]
    return {score.cause.place: score.cause for score in scores}


def _neighbours(
    final: Fitted, findings: Sequence[Detection[Cause]], beside: Sequence[Score[Cause]], places: float
) -> Iterator[tuple[list[Cause], Change, float]]:
    """Yield the causes of all models one step away, the step, and the logarithm of how likely it makes them.

    What a form costs is in the evidence already, what a place costs (its logarithm) is not.
    """
    causes = list(final.causes)
    for finding in findings:
        if not _is_small(finding.cause):
            continue
        cost = finding.own.cost
        yield [cause for cause in causes if cause != finding.cause], "without", cost / 2 + places
        for score in finding.scores:
            if score.cause != finding.cause and _is_small(score.cause):
                yield swapped(causes, finding.cause, score.cause), "instead", (cost - score.cost) / 2
    for score in beside:
        if _is_small(score.cause):
            yield [*causes, score.cause], "besides", -score.cost / 2 - places


def _is_small(cause: Cause) -> bool:
    return cause.n_parameters <= MANY
