"""A trial of a robot's model: fitted anew by IPOPT with each set of causes.

Refinement: a cause with an inner unknown (an order, a moment, a time constant) between its neighbours in the scan.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import Screening
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.linearisation import Linearisation
from calflow.diagnosis.search.trial import Trial, bic, relief, swapped
from calflow.effects.cause import Cause
from calflow.estimation.fit import Fit

STEPS = 4  # at most, of one inner unknown each, when a rival is refined before it is fitted
CLEARLY_FINER = 2.0  # of BIC: by how much a variant must be better than its neighbour for another fit


def finest(score: Score[Cause], now: Fitted) -> Score[Cause]:
    """Return the best variant of a cause that is not in the model yet."""
    finer = _finer(score.cause, now)
    if not finer:
        return score
    scores = Screening(now.regressors(finer)).scores
    best = max(scores, key=lambda s: s.drop, default=score)
    return best if best.drop > score.drop else score


def refined_causes(now: Fitted) -> Iterator[list[Cause]]:
    """Yield a model's causes with one in a variant that is clearly better, now that the others are in the model."""
    finer = [_finer(cause, now) for cause in now.causes]
    if not any(finer):
        return
    linearisation = Linearisation.at(now, Catalogue(tuple(chain.from_iterable(finer)), {}))
    for cause in (cause for cause, variants in zip(now.causes, finer, strict=True) if variants):
        near = [score for score in linearisation.apart([cause]).scores if score.cause.place == cause.place]
        bic = next((score.delta_bic for score in near if score.cause == cause), np.inf)
        if near and near[0].delta_bic < bic - CLEARLY_FINER:
            yield swapped(now.causes, cause, near[0].cause)


def in_place(now: Fitted, gone: Sequence[Cause], cause: Cause) -> Cause:
    """Return the form of a cause that is best in the place of others, from the best that was tried by steps that are better."""
    for _ in range(STEPS):
        finer = _finer(cause, now)
        if not finer:
            return cause
        scores = Linearisation.at(now, Catalogue((cause, *finer), {})).apart(gone).scores
        best = next((score.cause for score in scores if score.cause.place == cause.place), cause)
        if best == cause:
            return cause
        cause = best
    return cause


def _finer(cause: Cause, now: Fitted) -> list[Cause]:
    return [replace(cause, effect=effect) for effect in cause.effect.finer(now.data)]


@dataclass(frozen=True)
class FittedTrial(Trial[Cause]):
    """A fitted model that was tried, and the catalogue to look at it with."""

    fitted: Fitted
    catalogue: Catalogue

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Its causes."""
        return self.fitted.causes

    @property
    def n_residuals(self) -> int:
        """How many residuals it was fitted to."""
        return self.fitted.fit.residual.size

    @cached_property
    def linearisation(self) -> Linearisation[Cause]:
        """The linearised model."""
        return Linearisation.at(self.fitted, self.catalogue)

    @cached_property
    def bic(self) -> float:
        """What it costs, to be compared with other trials: misfit, parameters, and the variants that were tried."""
        fitted = self.fitted
        scale = float(np.median(replace(fitted.noise, sigma=fitted.noise.sigma / fitted.far).total))
        misfit = (fitted.misfit - sum(map(self._relief, self.causes))) * scale**2
        parameters = fitted.fit.effective_parameters + sum(map(self._at_bound, self.causes))
        variants = [self.catalogue.variants.get(cause.place, 1) for cause in self.causes]
        return bic(misfit, self.n_residuals, parameters, variants)

    def with_causes(self, causes: Sequence[Cause], added: Score[Cause] | None = None) -> FittedTrial:
        """Fit the study's own effects with these causes, a new one from where it is expected."""
        if added is None:
            return replace(self, fitted=self.fitted.with_causes(causes))
        start = np.concatenate([self.fitted.fit.estimate, added.estimate])
        return replace(self, fitted=self.fitted.with_causes(causes, start, added.explained))

    def finest(self, score: Score[Cause]) -> Score[Cause]:
        """Return the best variant between a cause and its neighbours in the scan."""
        return finest(score, self.fitted)

    def refined(self) -> Iterator[list[Cause]]:
        """Yield the causes with one in a variant between its neighbours that is clearly better."""
        return refined_causes(self.fitted)

    def in_place(self, gone: Sequence[Cause], cause: Cause) -> Cause:
        """Return the form of a cause that is best in the place of others."""
        return in_place(self.fitted, gone, cause)

    def _at_bound(self, cause: Cause) -> int:
        """How many of a cause's parameters have no effect: they were there to be fitted, and count like the others."""
        return int(self.fitted.fit.at_bound[self.fitted.model.columns(cause)].sum())

    def _relief(self, cause: Cause) -> float:
        model = self.fitted.model
        columns = model.columns(cause)
        return relief(self.fitted.fit.estimate[columns] - model.prior_mean[columns], model.prior_sd[columns])


def among(trail: Sequence[Fitted], causes: Sequence[Cause]) -> Fit:
    """Return the fit with these causes from the models fitted on the way, or fit it from the one most like it."""

    def differing(fitted: Fitted) -> int:
        missing = sum(cause not in fitted.causes for cause in causes)
        return missing + sum(cause not in causes for cause in fitted.causes)

    near = min(reversed(trail), key=differing)
    return near.fit if list(near.causes) == list(causes) else near.fit_with(causes)
