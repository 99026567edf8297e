"""A trial: a model that the search tried, what it costs in BIC, and how to go on to another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.screening import Family, prior_cost
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.linearisation import Finding, Linearisation
from calflow.effects.cause import Cause


@dataclass(frozen=True)
class Trial:
    """A model that was tried, and how to look at it: the catalogue, and the first screening's cost of the tests."""

    fitted: Fitted
    catalogue: Catalogue
    family: Family

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Its causes."""
        return self.fitted.causes

    @cached_property
    def linearisation(self) -> Linearisation:
        """The linearised model."""
        return Linearisation.at(self.fitted, self.catalogue)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Its causes, each weighed against all candidates in its place."""
        return tuple(self.linearisation.findings(self.family)) if self.causes else ()

    @cached_property
    def bic(self) -> float:
        """What it costs, to be compared with other trials: misfit, parameters, and the variants that were tried."""
        fitted = self.fitted
        n = fitted.fit.residual.size
        scale = float(np.median(np.hypot(fitted.noise.sigma / fitted.far, fitted.noise.discrepancy)))
        scans = sum(np.log(self.catalogue.variants.get(cause.place, 1)) for cause in self.causes)
        misfit = (fitted.misfit - sum(map(self._relief, self.causes))) * scale**2
        parameters = fitted.fit.effective_parameters + sum(map(self._at_bound, self.causes))
        return float(n * np.log(misfit) + parameters * np.log(n) + 2 * scans)

    def _at_bound(self, cause: Cause) -> int:
        """How many of a cause's parameters have no effect: they were there to be fitted, and count like the others."""
        return int(self.fitted.fit.at_bound[self.fitted.model.columns(cause)].sum())

    def _relief(self, cause: Cause) -> float:
        """By how much a cause's parameters pull at their priors beyond what that costs."""
        model = self.fitted.model
        own = model.columns(cause)
        offset = self.fitted.fit.estimate[own] - model.nominal[own]
        pulled = float(((offset / model.prior_sd[own]) ** 2).sum())
        return pulled - float(prior_cost(np.array(pulled), len(own)))


def same(causes: Sequence[Cause], others: Sequence[Cause]) -> bool:
    """Whether these are the same causes, in any order."""
    return len(causes) == len(others) and all(cause in others for cause in causes)


def is_new(causes: Sequence[Cause], tried: Sequence[Trial]) -> bool:
    """Whether no trial had these causes."""
    return not any(same(causes, trial.causes) for trial in tried)


def swapped(causes: Sequence[Cause], gone: Cause, come: Cause) -> list[Cause]:
    """Return the causes with one in the place of another."""
    return [come if cause == gone else cause for cause in causes]


def among(trail: Sequence[Fitted], causes: Sequence[Cause]) -> Fitted:
    """Return the model with these causes from the models fitted on the way, or fit it from the one most like it."""

    def differing(fitted: Fitted) -> int:
        missing = sum(cause not in fitted.causes for cause in causes)
        return missing + sum(cause not in causes for cause in fitted.causes)

    near = min(reversed(trail), key=differing)
    return near if list(near.causes) == list(causes) else near.with_causes(causes)
