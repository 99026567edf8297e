"""The models in reach of what was found: its causes with some of them left out or exchanged, and one added.

Each is as probable as the verdicts on its causes say: by the evidence of names, and a prior that expects one cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Literal

import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Catalogue, Score, by_place
from calflow.diagnosis.stepwise import REACH, Detection
from calflow.diagnosis.verdict import log_odds_of_nothing
from calflow.effects.base import Cause
from calflow.estimation.calibrated_model import MANY
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame

MOST_IN_REACH = 24  # models: the likeliest
Change = Literal["found", "without", "instead", "besides", "several"]


@dataclass(frozen=True)
class ModelInReach:
    """A model in reach by its causes: what was found, less some causes, with others in their places, or with one more.

    log_prior is the logarithm of its prior probability, over that of a model without causes, log_weight that of how probable it
    is, prior and evidence, over what was found.
    """

    causes: tuple[Cause, ...]
    change: Change
    log_prior: float
    log_weight: float


def models_in_reach(
    final: Fitted,
    findings: Sequence[Detection[Cause]],
    beside: Sequence[Score[Cause]],
    catalogue: Catalogue,
    suspected: Sequence[Detection[Cause]] = (),
) -> tuple[ModelInReach, ...]:
    """Return the models in reach, that to be used first, then the likeliest; none of nothing found.

    suspected are the findings that are not in the model to be used;
    beside are the scores of all candidates of the catalogue that the final model does not have.

    Before the data each place of the catalogue that they can show is a cause with odds of one to the number of these places,
    and its forms share them evenly: one cause is to be expected of the whole catalogue, however large it is. What is in the place
    of one cause says nothing of what is in another's. Causes of very many parameters stay as they are in all models.
    """
    small = [finding for finding in findings if _is_small(finding.cause)]
    if not small:
        return ()
    places = float(np.log(len(rivals_shown(findings, beside))))

    def log_prior(causes: Sequence[Cause]) -> float:
        return -sum(places + float(np.log(catalogue.variants.get(cause.place, 1))) for cause in causes)

    models = [ModelInReach(final.causes, "found", log_prior(final.causes), 0.0)]
    for choices in (*map(_in_its_place, small), _besides(beside, places)):
        chosen = [_changed(model, choice) for model in models for choice in choices]
        models += [model for model in chosen if model.log_weight > -REACH and _differ(model.causes)]
        models = [models[0], *sorted(models[1:], key=lambda model: -model.log_weight)[: MOST_IN_REACH - 1]]
    if suspected:
        used = models[0]
        for finding in suspected:
            used = replace(_changed(used, _in_its_place(finding)[-1]), change="without")
        models = [used, *(model for model in models if set(model.causes) != set(used.causes))]
    return tuple(replace(model, log_prior=log_prior(model.causes)) for model in models)


def rivals_shown(findings: Sequence[Detection[Cause]], beside: Sequence[Score[Cause]]) -> dict[tuple[str, str], Cause]:
    """Return the places that the data show, in place of what was found or beside it, each with a cause there."""
    scores = [*beside, *(score for finding in findings for score in finding.scores)]
    return {score.cause.place: score.cause for score in scores}


@dataclass(frozen=True)
class _Choice:
    """A step from what was found: a cause goes, another comes (None for none); log_weight is that of the step."""

    change: Change
    goes: Cause | None
    comes: Cause | None
    log_weight: float


def _in_its_place(finding: Detection[Cause]) -> list[_Choice]:
    """Return what else may be in a finding's place: a rival, another form, or nothing; relative to the form that was found."""
    cause, cost = finding.cause, finding.own.cost
    forms = (cost - by_place(finding.scores)[cause.place][0]) / 2
    others = [
        _Choice("instead", cause, score.cause, (cost - score.cost) / 2)
        for score in finding.scores
        if score.cause != cause and _is_small(score.cause)
    ]
    return [*others, _Choice("without", cause, None, forms + log_odds_of_nothing(finding))]


def _besides(beside: Sequence[Score[Cause]], places: float) -> list[_Choice]:
    """Return what may act besides: what a form costs is in the evidence already, what a place costs is not."""
    return [
        _Choice("besides", None, score.cause, -score.cost / 2 - places) for score in beside if _is_small(score.cause)
    ]


def _changed(model: ModelInReach, choice: _Choice) -> ModelInReach:
    come = [choice.comes] if choice.comes else []
    places = [come if cause == choice.goes else [cause] for cause in model.causes]
    causes = (*chain.from_iterable(places), *(come if choice.goes is None else []))
    change: Change = choice.change if model.change == "found" else "several"
    return ModelInReach(causes, change, 0.0, model.log_weight + choice.log_weight)


def _differ(causes: Sequence[Cause]) -> bool:
    """Whether no two causes are forms of the same thing."""
    return not any(cause.place == other.place and cause.same_form(other) for cause, other in combinations(causes, 2))


def _is_small(cause: Cause) -> bool:
    return cause.n_parameters <= MANY


def probabilities(models: Sequence[ModelInReach]) -> np.ndarray:
    """Return how probable each model is if one of them is right, (n_models,)."""
    return np.asarray(scipy.special.softmax([model.log_weight for model in models])) if models else np.zeros(0)


ONLY = "-"  # instead of the form of a cause that has no other


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """A model that may be right, by its causes, the likeliest first. No row: diagnose found nothing that may be something else."""

    model: int = column("its number; 1 is what was found")
    change: Change = column(
        "what makes it: as found, without a cause, with one instead of another, with one besides, or several of these"
    )
    causes: tuple[str, ...] = column("ids of its causes; empty: none")
    joints: tuple[int, ...] = column("the joint or link of each; 0: none")
    parts: tuple[str, ...] = column("the part of the robot that each is a cause of")
    details: tuple[str, ...] = column("the form of each, in words; -: it has only one", separator="; ")
    log_evidence: float = column("logarithm of the data's probability under it, over that of what diagnose found")
    log_prior: float = column("logarithm of its prior probability, over that of a model without causes")
    probability: float = column("that it is right, if one of these models is")


@dataclass(frozen=True, kw_only=True)
class CauseProbability:
    """A cause of any of these models, the likeliest first."""

    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none")
    part: str = column("the part of the robot")
    probability: float = column(
        "that it acts, in whatever form and beside whatever else, if one of these models is right"
    )
    found: bool = column("whether diagnose put it into the model")


def models_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `ModelRow`s of the models in reach, what was found first."""
    rows = [
        ModelRow(
            model=number, change=model.change, causes=tuple(cause.id for cause in model.causes),
            joints=tuple(cause.joint for cause in model.causes), parts=tuple(cause.part for cause in model.causes),
            details=tuple(cause.detail or ONLY for cause in model.causes),
            log_evidence=model.log_weight - model.log_prior + models[0].log_prior, log_prior=model.log_prior,
            probability=float(probability),
        )
        for number, (model, probability) in enumerate(zip(models, probabilities(models), strict=True), start=1)
    ]  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), ModelRow)


def cause_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `CauseProbability`s of the models in reach, what was found first."""
    acting = {cause.place: cause for model in reversed(models) for cause in reversed(model.causes)}
    rows = []
    for place, cause in reversed(acting.items()):
        having = np.array([any(other.place == place for other in model.causes) for model in models])
        rows.append(
            CauseProbability(
                cause=cause.id, joint=cause.joint or None, part=cause.part,
                probability=float(probabilities(models)[having].sum()), found=bool(having[0]),
            )
        )  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), CauseProbability)
