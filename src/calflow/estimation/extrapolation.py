"""Extrapolation: readings beyond the measured range, and a model's errors past a measured travel and at other times.

Past its travel an angle error curve is another one of its size, and at other times device and robot drift on. A smooth curve is
estimated as zero between readings, so that its own root mean square depends on how densely the travel was measured. Its size is
that of its posterior as a Gaussian process instead, averaged over the scale of its prior.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np
import scipy

from calflow.effects.base import OF_THE_FRAME, Cause, Effect, Travel
from calflow.effects.warming import Warming
from calflow.estimation.error_model import ErrorModel, SmoothVariances, usual_sizes
from calflow.estimation.fit import Fit
from calflow.estimation.model_tables import Extrapolation
from calflow.estimation.smooth_functions import AtAnyTime, BeyondTravel, Cooling, InTime, Later, SmoothFunction, in_time
from calflow.estimation.variance_components import SIZES
from calflow.measurements.measurements import Measurements

CANDIDATE_SIZES = np.geomspace(SIZES.min(), SIZES.max(), 65)  # over the usual one
MIN_REDUCTION = 1e-12  # least relative reduction of a variance by the data
MOMENT = 1.0  # s after the measurement, within which the shift by a cause grows to its full value
BEYOND = 0.1  # share of a joint's travel by which a held-out reading may lie outside the fitted range


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve's amplitudes, their covariance (n, n) and prior standard deviation (n,), and the prior root mean square of curves."""

    estimate: np.ndarray
    covariance: np.ndarray
    usual: np.ndarray
    usual_rms: float
    travel: Travel

    @classmethod
    def of(cls, cause: Cause, estimate: np.ndarray, covariance: np.ndarray) -> Self | None:
        """Return a cause's curve; None without one."""
        travel = cause.effect.travel(cause.joint) if cause.joint else None
        if travel is None:
            return None
        usual = np.array([parameter.prior_sd for parameter in cause.declared])
        return cls(estimate, covariance, usual, float(ca.evalf(cause.effect.size(ca.SX(usual)))), travel)

    @cached_property
    def weight(self) -> np.ndarray:
        """Posterior probability of each of CANDIDATE_SIZES, (n_sizes,).

        The sum of squares of the shrunken estimates is approximately a scaled chi-squared variable (Satterthwaite 1946); the prior
        of sizes is that of causes.
        """
        usual, variance = self.usual**2, np.diag(self.covariance)
        told = np.maximum(usual - variance, MIN_REDUCTION * usual)
        expected = told / usual * (CANDIDATE_SIZES[:, None] ** 2 * told + variance)
        whole = expected.sum(axis=1)
        freedom = whole**2 / (expected**2).sum(axis=1)
        logs = scipy.stats.chi2.logpdf(self.estimate @ self.estimate * freedom / whole, freedom)
        logs += np.log(freedom / whole) - np.log(np.maximum(CANDIDATE_SIZES, 1.0))
        weight = np.exp(logs - logs.max())
        return np.asarray(weight / weight.sum())

    @property
    def rms_elsewhere(self) -> float:
        """Root mean square of another curve of the same kind."""
        return self.usual_rms * float(np.sqrt(self.weight @ CANDIDATE_SIZES**2))

    @property
    def rms_over_travel(self) -> tuple[float, float]:
        """Root mean square over the travel, between readings included, and its standard deviation."""
        scale, identity = np.outer(self.usual, self.usual), np.eye(len(self.usual))
        # Information of the data along its principal axes.
        known, axes = np.linalg.eigh(np.linalg.inv(self.covariance / scale + MIN_REDUCTION * identity) - identity)
        known = np.maximum(known, MIN_REDUCTION)
        products = axes.T @ (self.travel.products * scale) @ axes
        variance = 1 / (known + CANDIDATE_SIZES[:, None] ** -2.0)
        mean = variance * (known + 1) * (axes.T @ (self.estimate / self.usual))
        # Mean and variance of a quadratic form of normal amplitudes (Searle 1971).
        along = mean @ products
        square = (along * mean).sum(axis=1) + variance @ np.diag(products)
        spread = 4 * (along**2 * variance).sum(axis=1) + 2 * (variance @ products**2 * variance).sum(axis=1)
        average = float(self.weight @ square)
        return average**0.5, float(self.weight @ (spread + (square - average) ** 2) / average) ** 0.5 / 2


def beyond_measured(errors: ErrorModel, sizes: SmoothVariances, variance: np.ndarray) -> ErrorModel:
    """Return an error model extended beyond the measurement: curves past their travel, and drifts as random walks in time.

    A cause of the device's frame is a drift, too: its walk has the variance estimated without that cause, and starts from the
    cause's last value. During the measurement the cause describes it, and it is no error of the robot. A warm-up goes on, but
    the robot may be switched off.

    Args:
        errors: the error model at the measured rows.
        sizes: what smooth errors there may be beside the model.
        variance: of each of their parts, (n_parts,).
    """
    functions = [*_beyond_causes(sizes.result, sizes.data)]
    further = errors.with_functions(functions, usual_sizes(sizes.result.model, functions))
    return _beyond_time(further, sizes, _walks(sizes, variance))


def _beyond_causes(result: Fit, data: Measurements) -> Iterator[SmoothFunction]:
    """Yield the continuations of causes: of curves past their travel, and of warm-ups past the end."""
    model = result.model
    for cause in (effect for effect in model.effects if isinstance(effect, Cause)):
        own, warming = model.columns(cause), cause.effect
        if curve := Curve.of(cause, result.estimate[own], result.covariance[np.ix_(own, own)]):
            at = curve.travel
            yield BeyondTravel(data.robot, cause.joint - 1, at.low, at.high, at.length, curve.rms_elsewhere)
        if isinstance(warming, Warming) and warming.constant and not warming.of_measuring():
            growth, end = float(model.values(cause, result.estimate)[0]), float(data.table["time"].max())
            once = replace(warming, pauses=()).figures_text
            yield Cooling(data.robot, cause.id, once, cause.part, growth, end)


def _beyond_time(errors: ErrorModel, sizes: SmoothVariances, left: dict[str, float]) -> ErrorModel:
    """Return it with walks in time; left are those beside the model (see `_walks`)."""
    result, data = sizes.result, sizes.data
    # Which session it was says all of its frame: the next one's is placed anew.
    causes = [
        effect for effect in result.model.effects if effect.family == OF_THE_FRAME and "session" not in effect.needs
    ]
    steps = in_time(data)
    if not steps or not (causes or any(left.values())):
        return errors
    by_order = steps[0].clock == "order"
    if by_order:
        # The order starts anew in each measurement.
        errors = errors.only(lambda function: not isinstance(function, InTime))
    walks = _walks(apart := sizes.without(causes), apart.variance) if causes else left
    for of, walk in walks.items():
        functions: list[SmoothFunction]
        if by_order:
            # With causes twice the variance: their drift, extrapolated to other rows, and the drift there are independent.
            functions = [*in_time(data, of)]
            share = np.full(len(functions), walk * (np.sqrt(2) if causes else 1.0))
        else:
            begin, end = steps[0].begin, steps[-1].end
            later = Later(data.robot, of, begin=begin, end=end)
            functions = [later, AtAnyTime(data.robot, of, begin=begin, end=end)]
            share = np.array([later.change(end - begin) * walk, left[of]])
        sd = usual_sizes(result.model, functions)
        sd = sd * np.repeat(share, len(sd) // len(share))
        # Functions of zero variance would only cost time at every predicted row.
        if sd.any():
            errors = errors.with_functions(functions, sd)
    if causes and not by_order:
        end, slope = steps[-1].end, _moved(causes, result, data)
        come = [InTime(data.robot, begin=end, end=end + MOMENT)]
        sd = usual_sizes(result.model, come)
        slope /= sd[:, None]
        errors = errors.with_functions(come, sd, (slope @ (result.estimate + errors.offset), -slope))
    return errors


def _walks(sizes: SmoothVariances, variance: np.ndarray) -> dict[str, float]:
    """Return the standard deviation of each quantity's random walk in time, over the usual one; 0 without a walk."""
    level = sizes.components.level(variance)
    return {
        functions[0].of: float(np.sqrt(level * own))
        for (_, functions), own in zip(sizes.kinds, variance, strict=True)
        if isinstance(functions[0], InTime)
    }


def _moved(causes: Sequence[Effect], result: Fit, data: Measurements) -> np.ndarray:
    """Return the derivatives of the mean shift of reported points, by causes at the end of the measurement, (3, n) [m]."""
    model = result.model
    last = {name: data.table[name].max() for name in ("time", "order") if name in data.table}
    rows = replace(data, table=data.table.assign(**last)).conditions
    of_causes = np.isin(np.arange(len(result.estimate)), np.concatenate([model.columns(cause) for cause in causes]))
    return np.asarray(model.position_jacobian(result.estimate, rows).mean(axis=0) * of_causes)


def extrapolation(data: Measurements) -> tuple[Extrapolation, ...]:
    """Return the joints whose held-out readings lie beyond the fitted range, where held-out accuracy is extrapolation."""
    if not data.held_out.any():
        return ()
    every = data.joints[data.train | data.held_out]
    rows = beyond(data.joints[data.held_out], data.joints[data.train], np.ptp(every, axis=0)).sum(axis=0)
    return tuple(Extrapolation(joint=int(i) + 1, rows=int(rows[i])) for i in np.flatnonzero(rows))


def beyond(readings: np.ndarray, measured: np.ndarray, travel: np.ndarray | None = None) -> np.ndarray:
    """Return the mask of joint readings (n_rows, n_joints) outside the measured range (n_measured, n_joints).

    They are so by more than a tenth of a travel (n_joints,), by default that range.
    """
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = BEYOND * (high - low if travel is None else travel)
    return np.asarray((readings < low - margin) | (readings > high + margin))
