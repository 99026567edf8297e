"""The amplitude of a cause: one figure for its parameters, and how sure that is whatever its form."""

from __future__ import annotations

import casadi as ca
import numpy as np

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.stepwise import Detection
from calflow.effects.cause import Cause


def amplitude(cause: Cause, values: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Return one figure for a cause's parameters, and its standard deviation; a single parameter keeps its sign."""
    if len(values) == 1:
        return float(values[0]), float(np.sqrt(covariance[0, 0]))
    p = ca.SX.sym("p", len(values))
    size = cause.effect.size(p)
    figure, slope = (
        np.array(output).ravel() for output in ca.Function("size", [p], [size, ca.gradient(size, p)])(values)
    )
    return float(figure[0]), float(np.sqrt(slope @ covariance @ slope))


def found_amplitude(finding: Detection, fitted: Fitted) -> tuple[float, float]:
    """Return a found cause's amplitude in the final model, and its standard deviation whatever its form may be.

    Another form in its place (another order, say) can explain the data as well with another amplitude. Each form counts by its
    evidence (Bayesian model averaging: Hoeting et al. 1999), about the estimate of the best one.
    """
    cause = finding.cause
    columns = fitted.model.columns(cause)
    estimate, sd = amplitude(cause, fitted.fit.estimate[columns], fitted.covariance[np.ix_(columns, columns)])
    if sd == 0:
        return estimate, sd  # at a bound
    forms = [score for score in finding.scores if score.cause.place == cause.place]
    others = [s for s in forms if s.cause != cause and same_quantities(s.cause, cause)]
    least = min(score.cost for score in forms)
    variances, weights = [sd**2], [np.exp((least - finding.own.cost) / 2)]
    for score in others:
        other, other_sd = amplitude(score.cause, score.estimate, score.covariance)
        variances.append(other_sd**2 + (other - estimate) ** 2)
        weights.append(np.exp((least - score.cost) / 2))
    return estimate, float(np.sqrt(np.average(variances, weights=weights)))


def same_quantities(cause: Cause, other: Cause) -> bool:
    """Whether the parameters of two forms of a cause mean the same."""
    first, second = ([(p.symbol, p.unit) for p in form.declared] for form in (cause, other))
    return first == second
