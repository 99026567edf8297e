"""The models in reach: the causes found with some left out or exchanged, or one added, with probabilities by the verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, islice
from typing import Literal

import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Place
from calflow.diagnosis.screening import Catalogue, Score
from calflow.diagnosis.stepwise import REACH
from calflow.diagnosis.trial import Detection
from calflow.diagnosis.verdict import Untested, in_its_place
from calflow.effects.cause import Cause
from calflow.estimation.calibrated_model import MANY

MOST_IN_REACH = 24  # models, the likeliest

Change = Literal["found", "without", "instead", "besides", "several"]
Others = list[tuple[Cause | Untested | None, float]]  # what may come, None: nothing, with its log odds


@dataclass(frozen=True)
class ModelInReach:
    """A model in reach, by its causes: those found, less some, with others in their places, or with one more.

    log_prior is its log prior probability relative to a model without causes, log_weight its log posterior probability relative to
    the model found.
    """

    causes: tuple[Cause | Untested, ...]
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
    """Return the models in reach, the one to be used first, then by probability; empty without findings.

    suspected are findings that are not in use; beside are the scores of all candidates that the final model lacks. A priori each
    place that the data can show holds a cause with odds of one to the number of such places, shared evenly by its forms: one is
    expected of the whole catalogue, however large. Causes of very many parameters do not come besides.
    """
    if not findings:
        return ()
    places = float(np.log(len(rivals_shown(findings, beside))))

    def log_prior(causes: Sequence[Cause | Untested]) -> float:
        return -sum(places + float(np.log(catalogue.variants.get(cause.place, 1))) for cause in causes)

    models = [ModelInReach(final.causes, "found", log_prior(final.causes), 0.0)]
    # The prior of a form is in the evidence already, that of a place is not.
    besides: Others = [(score.cause, -score.cost / 2 - places) for score in beside if score.cause.n_parameters <= MANY]
    instead: list[tuple[Cause, Others]] = []
    for finding in findings:
        forms = (finding.own.cost - finding.cost) / 2  # log odds of its place against its form
        others = in_its_place(finding, catalogue.untestable(finding.cause.id))
        instead.append((finding.cause, [(comes, log_odds + forms) for comes, log_odds in others]))
    for goes, others in (*instead, (None, besides)):
        near = [(model, *other) for model in models for other in others if model.log_weight + other[1] > -REACH]
        near.sort(key=lambda change: -(change[0].log_weight + change[2]))
        every = (_changed(model, goes, comes, log_odds) for model, comes, log_odds in near)
        likeliest = islice((model for model in every if _differ(model.causes)), MOST_IN_REACH)
        models[1:] = sorted([*models[1:], *likeliest], key=lambda model: -model.log_weight)[: MOST_IN_REACH - 1]
    if suspected:
        used = models[0]
        for cause, others in instead:
            if cause in {finding.cause for finding in suspected}:
                used = replace(_changed(used, cause, *others[-1]), change="without")
        models = [used, *(model for model in models if set(model.causes) != set(used.causes))]
    return tuple(replace(model, log_prior=log_prior(model.causes)) for model in models)


def rivals_shown(findings: Sequence[Detection[Cause]], beside: Sequence[Score[Cause]]) -> dict[Place, Cause]:
    """Return the places that the data can show, in place of a finding or beside it, each with a cause there."""
    scores = [*beside, *(score for finding in findings for score in finding.scores)]
    return {score.cause.place: score.cause for score in scores}


def _changed(model: ModelInReach, goes: Cause | None, comes: Cause | Untested | None, log_odds: float) -> ModelInReach:
    """Return a model with one cause in the place of another, with one besides (goes None), or without one (comes None)."""
    come = [comes] if comes else []
    places = [come if cause == goes else [cause] for cause in model.causes]
    causes = (*chain.from_iterable(places), *(come if goes is None else []))
    change: Change = "without" if comes is None else "besides" if goes is None else "instead"
    return ModelInReach(causes, change if model.change == "found" else "several", 0.0, model.log_weight + log_odds)


def _differ(causes: Sequence[Cause | Untested]) -> bool:
    """Whether no two causes are forms of the same cause."""
    untested = [cause for cause in causes if isinstance(cause, Untested)]
    tested = [cause for cause in causes if isinstance(cause, Cause)]
    shared = len({cause.place for cause in tested}) < len(tested)  # hardly ever: forms are compared then alone
    twice = shared and any(cause.same_form(other) for cause, other in combinations(tested, 2))
    return not twice and len(set(untested)) == len(untested)


def probabilities(models: Sequence[ModelInReach]) -> np.ndarray:
    """Return the probability of each model if one of them is right, (n_models,)."""
    return np.asarray(scipy.special.softmax([model.log_weight for model in models])) if models else np.zeros(0)
