"""Alternatives to the extended model: the likeliest rivals fitted in the place of the causes that were found."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.diagnosis.findings.verdict import UNEXPLAINED, Rival, Verdict
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects.cause import Cause
from calflow.estimation.alternative import Alternative, AlternativeParameter
from calflow.estimation.fit import Fit
from calflow.files.tables import to_frame

LEAST = 0.02  # probability below which a rival moves no interval
MOST = 4  # that are fitted: the likeliest


@dataclass(frozen=True)
class FittedAlternative:
    """An alternative that was fitted: which cause (from 0) gives way, to which rival, if any, and how probable that is."""

    number: int
    rival: Cause | None
    fit: Fit
    probability: float

    @property
    def alternative(self) -> Alternative:
        """The model without how it came about."""
        return Alternative(self.fit.model, self.fit.estimate, self.probability)


def fitted_alternatives(verdicts: Sequence[Verdict], final: Fitted) -> tuple[FittedAlternative, ...]:
    """Fit the likeliest rivals in the causes' places, one at a time; a rival that could not be tested has no model."""
    asked = [
        (_probability(verdict, rival), k, rival.cause)
        for k, verdict in enumerate(verdicts)
        for rival in verdict.rivals
        if rival.cause is not None or rival.id == UNEXPLAINED
    ]
    likeliest = sorted((one for one in asked if one[0] >= LEAST), key=lambda one: -one[0])[:MOST]
    found = []
    for probability, k, rival in likeliest:
        stay = [cause for cause in final.causes if cause != verdicts[k].finding.cause]
        causes = [*stay, rival] if rival is not None and rival not in stay else stay
        found.append(
            FittedAlternative(k, rival if len(causes) > len(stay) else None, final.fit_with(causes), probability)
        )
    return tuple(found)


def _probability(verdict: Verdict, rival: Rival) -> float:
    """The rival's share, as the verdict weighs it: what could not be tested never counts for more than the cause."""
    bic = rival.bic if rival.cause else max(rival.bic, 0.0)
    return float(verdict.probability * np.exp(-bic / 2))


def alternatives_table(found: Sequence[FittedAlternative], causes: Sequence[Cause], final: Fitted) -> pd.DataFrame:
    """Return the table of `AlternativeParameter`s; causes are those found, in the order of their verdicts."""
    order = list(final.causes)
    rows = [
        AlternativeParameter(
            alternative=number, probability=one.probability, instead_of=order.index(causes[one.number]) + 1,
            effect=one.rival.effect.id if one.rival else "", part=one.rival.part if one.rival else "",
            variant=json.dumps(one.rival.effect.figures) if one.rival else "",
            parameter=parameter.name, estimate=float(estimate),
        )
        for number, one in enumerate(found, start=1)
        for parameter, estimate in zip(one.fit.model.parameters, one.fit.estimate, strict=True)
    ]  # fmt: skip
    return to_frame(rows, AlternativeParameter)
