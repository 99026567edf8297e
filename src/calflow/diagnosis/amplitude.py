"""The amplitude of a cause: its size as one figure, with deviation and interval over all its forms."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.trial import Detection
from calflow.effects.cause import Cause

CERTAIN = 1.96  # standard deviations of a 95 % interval
INTERVAL = np.array([0.025, 0.975])  # quantiles at the ends of a 95 % interval
DRAWS = 4000  # sizes drawn for an interval
SIZE = "its size; of an angle error curve its root mean square over the measured travel, between readings included"


@dataclass(frozen=True)
class Amplitude:
    """A cause's size as one figure, with its standard deviation and the ends of its 95 % interval."""

    estimate: float
    sd: float
    low: float
    high: float

    @staticmethod
    def of_squares(estimate: float, sd: float) -> Amplitude:
        """Return a root of a sum of squares, which is approximately a scaled chi² variable (Satterthwaite 1946)."""
        freedom = (estimate / sd) ** 2 / 2
        low, high = estimate * np.sqrt(scipy.stats.chi2.ppf(INTERVAL, freedom) / freedom)
        return Amplitude(estimate, sd, float(low), float(high))

    @property
    def differs_from_zero(self) -> bool:
        """Whether zero is further than CERTAIN standard deviations: the ends of a length's interval exclude it always."""
        return abs(self.estimate) > CERTAIN * self.sd


def amplitude(cause: Cause, values: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Return one figure for a cause's parameters, and its standard deviation; a single parameter keeps its sign."""
    (figure,), (slope,) = sizes(cause, values[None])
    return float(figure), float(np.sqrt(slope @ covariance @ slope))


def sizes(cause: Cause, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the size of a cause for values of its parameters (n, n_parameters), as findings state it, (n,), and its gradient."""
    if values.shape[1] == 1:
        return values[:, 0], np.ones(values.shape)
    figures, slopes = _size(cause)(values.T)
    return np.array(figures).ravel(), np.array(slopes).T


@lru_cache(maxsize=1024)
def _size(cause: Cause) -> ca.Function:
    """Return a cause's parameters -> its size and gradient; cached, as each form of each finding is asked several times."""
    p = ca.SX.sym("p", cause.n_parameters)
    size = cause.size_of(p)
    return ca.Function("size", [p], [size, ca.gradient(size, p)])


def found_amplitude(finding: Detection, fitted: Fitted) -> Amplitude:
    """Return a found cause's amplitude in the final model, with deviation and interval over all its forms.

    Each form is weighted by its evidence (Bayesian model averaging: Hoeting et al. 1999). The interval is that of sizes drawn from
    the posterior: a length is not normal about its estimate, nor are two forms of different amplitudes.
    """
    cause = finding.cause
    columns = fitted.model.columns(cause)
    own = fitted.fit.estimate[columns], fitted.covariance[np.ix_(columns, columns)]
    estimate, sd = amplitude(cause, *own)
    if sd == 0:
        return Amplitude(estimate, sd, estimate, estimate)  # at a bound
    forms = [(finding.own.cost, cause, *own)]
    for score in finding.scores:
        if score.cause.place == cause.place and score.cause != cause and same_quantities(score.cause, cause):
            forms.append((score.cost, score.cause, *score.likeliest))
    shares = scipy.special.softmax([-cost / 2 for cost, *_ in forms])
    rng, drawn, square = np.random.default_rng(0), list[np.ndarray](), 0.0
    for share, (_, form, values, covariance) in zip(shares, forms, strict=True):
        other, other_sd = amplitude(form, values, covariance)
        square += share * (other_sd**2 + (other - estimate) ** 2)
        if number := round(DRAWS * share):
            drawn.append(sizes(form, rng.multivariate_normal(values, covariance, number, method="eigh"))[0])
    low, high = np.quantile(np.concatenate(drawn), INTERVAL)
    return Amplitude(estimate, float(np.sqrt(square)), float(low), float(high))


def same_quantities(cause: Cause, other: Cause) -> bool:
    """Whether the parameters of two forms of a cause have the same symbols and units."""
    first, second = ([(p.symbol, p.unit) for p in form.declared] for form in (cause, other))
    return first == second
