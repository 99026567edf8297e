"""Alternatives: models in which a rival, or nothing, is fitted in the place of a cause, by which predictions differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.models_in_reach import ModelInReach, probabilities
from calflow.diagnosis.verdict import Verdict
from calflow.effects.cause import Cause
from calflow.effects.wording import UNEXPLAINED
from calflow.estimation.calibrated_model import Alternative
from calflow.estimation.leverage import UNSURE
from calflow.estimation.needed_conditions import depended_on
from calflow.model import Model

NEGLIGIBLE = 0.02  # probability below which a rival does not affect intervals
MOST_FITTED = 4  # rivals that are fitted, the likeliest


def fitted_alternatives(
    verdicts: Sequence[Verdict], final: Fitted, suspected: Sequence[Verdict] = (), in_reach: Sequence[ModelInReach] = (),
    unnamed: Mapping[Cause, float] = MappingProxyType({}),
) -> tuple[Alternative, ...]:  # fmt: skip
    """Return models with the likeliest rivals fitted in the causes' places, one at a time, except untestable rivals.

    Forms of a cause by other conditions of a row are rivals too. Suspected causes and their rivals are further alternatives, as are
    probable causes beside those found: too small to be named for certain, they shift predictions all the same. unnamed is the
    share of an unnamed error in what it and a cause explain (see `share_unnamed`).
    """
    every = [*((verdict, verdict.cause) for verdict in verdicts), *((suspect, None) for suspect in suspected)]
    asked: list[tuple[float, Cause | None, Cause | None]] = [
        (verdict.of_rival(rival), gone, rival.cause)
        for verdict, gone in every
        for rival in verdict.rivals
        if rival.cause is not None
    ]
    asked += [
        (probability, verdict.cause, form)
        for verdict in verdicts
        for probability, form in _forms_by_other_conditions(verdict, final.model)
    ]
    # How well an unnamed error explains the data, its form being a guess, says which is likelier, but not by how much.
    asked += [
        (
            (verdict.probability + verdict.of_unnamed) / 2
            if UNEXPLAINED in {rival.id for rival in verdict.rivals}
            else verdict.probability * unnamed.get(verdict.cause, 0.0),
            verdict.cause,
            None,
        )
        for verdict in verdicts
    ]
    asked += [(suspect.probability, None, suspect.cause) for suspect in suspected]
    asked += [
        (probability, None, came)
        for model, probability in zip(in_reach, probabilities(in_reach).tolist(), strict=True)
        if model.change == "besides" and probability > UNSURE and isinstance(came := model.causes[-1], Cause)
    ]
    likeliest = sorted((other for other in asked if other[0] >= NEGLIGIBLE), key=lambda other: -other[0])[:MOST_FITTED]
    alternatives = []
    for probability, gone, rival in likeliest:
        stay = [verdict.cause for verdict in verdicts if verdict.cause != gone]
        come = [rival] if rival is not None and rival not in stay else []
        fit = final.fit_with([*stay, *come])
        alternatives.append(Alternative(fit.model, fit.estimate, probability, gone, next(iter(come), None)))
    return tuple(alternatives)


def _forms_by_other_conditions(verdict: Verdict, model: Model) -> list[tuple[float, Cause]]:
    """Return the best form of a cause by each other set of a row's conditions, with the probability of all forms by these.

    Forms by the same conditions agree wherever these were measured; others agree with them only for as long as their conditions
    change together, as the temperature and the time do while an arm warms up.
    """
    forms = [(verdict.probability * np.exp((verdict.cost - score.cost) / 2), score.cause) for score in verdict.scores
             if score.cause.place == verdict.cause.place]  # fmt: skip
    by_conditions: dict[tuple[str, ...], list[tuple[float, Cause]]] = {}
    for probability, form in forms:
        if probability >= NEGLIGIBLE:
            conditions = tuple(depended_on(replace(model, effects=(form,))))
            by_conditions.setdefault(conditions, []).append((float(probability), form))
    others = [group for group in by_conditions.values() if all(form != verdict.cause for _, form in group)]
    return [(sum(probability for probability, _ in group), max(group, key=lambda form: form[0])[1]) for group in others]
