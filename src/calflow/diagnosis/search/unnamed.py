"""The unnamed rival: whether a cause explains the data better than a background of its own would without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.diagnosis.screening.screening import prior_cost
from calflow.diagnosis.search.background import Basis, Sizes
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects.cause import Cause


def unnamed(fitted: Fitted, cause: Cause, basis: Basis, variants: int) -> float:
    """Return the BIC of the model without a cause above that with it, each with the background that suits it best.

    Negative where what nobody can name explains the data better. variants is how many forms of the cause were tried. Linear,
    without a refit.
    """
    regressors = replace(fitted, background=None).regressors(())
    free = np.flatnonzero(~fitted.fit.at_bound)
    own = np.flatnonzero(np.isin(free, fitted.model.columns(cause)))
    value = fitted.fit.estimate[free][own]
    pull = value * np.sqrt(regressors.precision[own])
    without = regressors.without(own, regressors.jacobian[:, own] @ value, pull)
    weight = fitted.problem.weight
    both = [Sizes.of(one, basis, weight) for one in (regressors, without)]
    evidence = [sizes.evidence(sizes.believed()) for sizes in both]
    spent = cause.n_parameters * np.log(both[0].n) + 2 * np.log(variants)
    unusual = float(pull @ pull - prior_cost(np.array(pull @ pull), len(own)))
    return float(evidence[1] - evidence[0] - spent - unusual)
