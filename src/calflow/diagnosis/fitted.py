"""A fitted model as the diagnosis uses it: with its data and noise, and with outliers down-weighted (Huber 1964)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calflow.diagnosis.regressors import Background, Regressors
from calflow.effects import Effect
from calflow.effects.cause import Cause
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.error_model import ErrorModel, SmoothVariances, beside_smooth_errors
from calflow.estimation.extrapolation import beyond_measured
from calflow.estimation.fit import (
    Fit,
    IntraclassLikelihood,
    alike,
    fit,
    lack_against_noise,
    reestimated,
    refitted_sharing,
)
from calflow.estimation.lack_of_fit import SIGNIFICANT, Evidence, LackOfFit
from calflow.estimation.least_squares import LeastSquares, Loss
from calflow.estimation.leverage import LeftOut, Studentised, excess, left_out
from calflow.estimation.noise import NO_DISCREPANCY, Noise, PerUnit
from calflow.estimation.prior_scale import on_likeliest_scale
from calflow.estimation.smooth_functions import Part
from calflow.measurements.measurements import Measurements
from calflow.model import Model

HUBER = 4.5  # standard deviations from which rows are down-weighted
SETTLED = 0.1  # relative change of noise and weights below which a fit is not repeated
ROUGH = 1e-4  # share of chi² by which a fit that serves to estimate the noise alone may miss its optimum
WEIGHINGS = 6  # fits at most, in which the noise, the weights of outliers and the scales of the causes' priors settle
ALIKE = np.ones(1)  # factor of all rows without outliers


@dataclass(frozen=True)
class Fitted:
    """A fitted model with the training data and the noise it was fitted with.

    lack: lack of fit against the noise alone; device: the noise before outliers were down-weighted;
    outlier_factor (n_rows,), or (1,) for all alike: factor of each row's total noise by that weighting; background:
    correlated errors in the covariance of tests (None: independent errors); shared: intraclass correlation of markers at one
    standstill (None: estimated from the residual alone); visited: cache of the models fitted from it with other causes; doubted:
    causes with the probability of an unnamed error in the place of each.
    """

    fit: Fit
    data: Measurements
    noise: Noise
    lack: LackOfFit
    device: Noise
    background: Background | None = None
    shared: float | None = None
    visited: dict[frozenset[Cause], Fitted] = field(default_factory=dict, compare=False, repr=False)
    outlier_factor: np.ndarray = field(default_factory=lambda: ALIKE, compare=False, repr=False)
    doubted: Mapping[Cause, float] = field(default_factory=dict)

    @property
    def model(self) -> Model:
        return self.fit.model

    @property
    def poses(self) -> np.ndarray:
        """Number of each row's pose, different for each series, shape (n_rows,)."""
        pose = np.unique(self.data.table["pose"], return_inverse=True)[1]
        return np.asarray(pose * len(self.data.series) + self.data.series_number)

    def regressors(self, effects: Sequence[Effect], at: Fit | None = None) -> Regressors[Cause]:
        """Return the model, at another estimate if asked, linearised with these effects at zero, beside its background."""
        return Regressors.of(at or self.fit, self.problem, effects, self.poses, self.background)

    def still(self, cause: Cause) -> Fitted:
        """Return the model with one of its causes set to zero, the other estimates as they are."""
        estimate = self.fit.estimate.copy()
        estimate[self.model.columns(cause)] = 0.0
        return replace(self, fit=replace(self.fit, estimate=estimate))

    @cached_property
    def alone(self) -> Regressors[Cause]:
        """The model linearised without further effects, with independent errors; cached, as many tests use it."""
        return Regressors.of(self.fit, self.problem, (), self.poses)

    @property
    def scale(self) -> float:
        """Geometric mean of the standard deviations by which independent residuals are divided, without outliers' factors."""
        problem = self._problem
        alike = np.log(problem.total / np.broadcast_to(self.outlier_factor, len(self.data))[problem.row])
        return float(np.exp(alike.mean() + problem.log_determinant / (2 * problem.size)))

    @cached_property
    def smooth(self) -> SmoothVariances:
        return self.smooth_in()

    def smooth_in(self, parts: Sequence[Part] = ()) -> SmoothVariances:
        """Return the variances of some parts beside the model, by default of all smooth errors."""
        return SmoothVariances.of(replace(self.fit, problem=self._problem), self.data, self.noise.known, parts)

    def with_smooth_errors(
        self, variance: np.ndarray, elsewhere: PerUnit = NO_DISCREPANCY
    ) -> tuple[np.ndarray, ErrorModel]:
        """Return the estimate's covariance and error model with smooth errors of variance (n_parts,) (`beside_smooth_errors`)."""
        unsure, errors = beside_smooth_errors(self.smooth, variance, elsewhere)
        covariance = replace(self.fit, information=unsure.information).covariance
        return covariance, beyond_measured(errors, self.smooth, variance)

    @cached_property
    def _beside(self) -> tuple[np.ndarray, ErrorModel]:
        # Where an unnamed error acts in a cause's place, smooth errors are as large as they are estimated without that cause.
        odds = [max(1 - sum(self.doubted.values()), 0.0), *self.doubted.values()]
        every = [self.smooth, *(self.smooth.without([cause]) for cause in self.doubted)]
        variance = np.average([sizes.variance for sizes in every], axis=0, weights=odds)
        return self.with_smooth_errors(variance, excess(self.fit, self.poses, self.left_out))

    @property
    def errors(self) -> ErrorModel:
        return self._beside[1]

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the estimate, smooth errors included, shape (n_parameters, n_parameters)."""
        return self._beside[0]

    @cached_property
    def left_out(self) -> LeftOut:
        """Leave-one-pose-out errors of the training poses."""
        return left_out(self.fit, self.poses)

    @cached_property
    def intraclass_likelihood(self) -> IntraclassLikelihood | None:
        """Restricted likelihood of the intraclass correlation of markers at one standstill, by the residual alone."""
        return IntraclassLikelihood.of(self.fit, self.data, self.noise)

    @property
    def intraclass(self) -> float:
        """Intraclass correlation of the errors of markers at one standstill."""
        if self.shared is not None:
            return self.shared
        return self.intraclass_likelihood.correlation if self.intraclass_likelihood else 0.0

    @property
    def beside(self) -> Regressors[Cause]:
        """The model linearised without further effects, beside its background."""
        return self.alone.beside(self.background, self.problem.weight)

    @cached_property
    def studentised(self) -> np.ndarray:
        """Studentised residuals of each row, (n_rows, n_units), nan where a row has fewer units."""
        return Studentised.of(self.fit, self.data, self.noise).values

    @property
    def lacks_fit(self) -> bool:
        return self.noise.known and self.lack.p < SIGNIFICANT and self.lack.reduced_chi2 > 1

    @property
    def outlier_loss(self) -> float:
        """The linear part of the Huber loss of outliers, beyond their down-weighted squares (Huber 1964)."""
        return 2 * HUBER**2 * float((self.outlier_factor - 1).sum())

    @cached_property
    def problem(self) -> LeastSquares:
        """The least-squares problem with robust weights and the intraclass correlation."""
        return self._problem.reweighted(self.fit.estimate, self.fit.loss)

    @cached_property
    def _problem(self) -> LeastSquares:
        return LeastSquares.of(self.model, self.data, replace(self.noise, intraclass=self.intraclass))

    def weighed(self, sigma: np.ndarray) -> Fitted:
        """Return the model refitted with another noise sigma (n_rows,) in the leading units."""
        noise = replace(self.device, sigma=sigma, discrepancy=PerUnit())
        return replace(
            _settled(self.model, self.data, noise, self.fit.estimate, self.fit.loss),
            background=self.background,
            shared=self.shared,
        )

    def sharing(self) -> Fitted:
        """Return the model refitted with the errors that markers of one standstill share, as identify fits it."""
        result, noise = refitted_sharing(self.fit, self.data, self.noise, self.intraclass)
        return replace(self, fit=result, noise=noise, shared=self.intraclass)

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, noise: Noise) -> Fitted:
        """Return an identified model refitted to training rows with outliers down-weighted, started from its estimate."""
        bare = replace(noise, discrepancy=PerUnit(), intraclass=0.0)
        begun = _settled(calibrated.model, data, bare, calibrated.estimate, calibrated.loss)
        begun.visited[frozenset(begun.causes)] = begun
        return begun

    @property
    def causes(self) -> tuple[Cause, ...]:
        return self.model.causes

    @property
    def plain(self) -> tuple[Effect, ...]:
        return tuple(effect for effect in self.model.effects if not isinstance(effect, Cause))

    def own(self, cause: Cause) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices of a cause's parameters among the free ones, and their estimates."""
        free = np.flatnonzero(~self.fit.at_bound)
        columns = np.flatnonzero(np.isin(free, self.model.columns(cause)))
        return columns, self.fit.estimate[free[columns]]

    def fit_with(self, causes: Sequence[Cause]) -> Fit:
        """Return a single fit of the study's effects with these causes, at this model's weights; not for tests."""
        model = self._with(causes)
        start = self.model.handed_on(self.fit.estimate, model)
        for _ in range(WEIGHINGS):
            result = fit(LeastSquares.of(model, self.data, self.noise), start[None], self.fit.loss)[0]
            model, start = scaled(result), result.estimate
            if model is result.model:
                break
        return result

    def _with(self, causes: Sequence[Cause]) -> Model:
        """Return the study's effects with these causes, those of the model on the scales that they have here."""
        own = {cause: cause for cause in self.causes}
        return replace(self.model, effects=(*self.plain, *(own.get(cause, cause) for cause in causes)))

    def with_causes(self, causes: Sequence[Cause], start: np.ndarray | None = None, share: float = 0.0) -> Fitted:
        """Return the model with these causes beside the study's effects, fitted by IPOPT unless cached.

        It starts from the present estimates, new causes at zero, or from start. An unknown noise starts smaller by the share of
        chi² that is expected to go, and settles at once.
        """
        held = frozenset(causes)
        if held not in self.visited:
            model = self._with(causes)
            start = self.model.handed_on(self.fit.estimate, model) if start is None else start
            near = self.noise.sigma / self.outlier_factor * np.sqrt(1 - share)
            sigma = np.where(self.device.estimated, near, self.device.sigma)
            bare = replace(self.device, discrepancy=PerUnit(), sigma=sigma)
            self.visited[held] = _settled(
                model, self.data, bare, start, self.fit.loss, self.outlier_factor, self.noise.discrepancy
            )
        return replace(self.visited[held], background=self.background, shared=self.shared, visited=self.visited)


def scaled(result: Fit) -> Model:
    """Return the model with the priors of its causes on their likeliest scales, itself where they are."""
    model, scales = result.model, dict[Cause, float]()
    for cause in model.causes:
        own = model.columns(cause)
        prior, covariance = (model.prior_mean[own], model.prior_sd[own]), result.covariance[np.ix_(own, own)]
        scales[cause] = on_likeliest_scale(result.estimate[own], covariance, prior, cause.scale)[0]
    if all(cause.scale == scale for cause, scale in scales.items()):
        return model
    effects = (replace(each, scale=scales[each]) if isinstance(each, Cause) else each for each in model.effects)
    return replace(model, effects=tuple(effects))


def _settled(
    model: Model,
    data: Measurements,
    device: Noise,
    start: np.ndarray,
    loss: Loss,
    outlier_factor: np.ndarray = ALIKE,
    discrepancy: PerUnit = NO_DISCREPANCY,
) -> Fitted:
    """Return the fit from a start, with rows beyond HUBER standard deviations weighted as by Huber (1964), priors scaled.

    outlier_factor (n_rows,) is the factor by which rows exceeded that in the fit before, and discrepancy that fit's. Rough fits
    settle the noise, the weights and the scales, from which a last one starts.
    """
    noise = _down_weighted(device, outlier_factor, discrepancy)
    for _ in range(WEIGHINGS):
        evidence = Evidence.of(data, noise)
        rough, _ = fit(LeastSquares.of(model, data, noise), start[None], loss, ROUGH)
        now = reestimated(rough, noise, evidence)
        there, start = Fit.at(LeastSquares.of(model, data, now), rough.estimate, loss), rough.estimate
        bare = np.where(now.estimated, now.sigma / outlier_factor, device.sigma)
        before = now.total / replace(now, sigma=bare).total
        outlier_factor, again = _excess(there, before), scaled(there)
        known = np.allclose(outlier_factor, before, rtol=SETTLED) and alike(now, noise, SETTLED)
        if known and again is there.model:
            break
        model, noise = again, _down_weighted(replace(device, sigma=bare), outlier_factor, now.discrepancy)
    settled, _ = fit(there.problem, start[None], loss)
    return Fitted(settled, data, now, lack_against_noise(settled, now, evidence), device, outlier_factor=before)


def _down_weighted(device: Noise, factor: np.ndarray, discrepancy: PerUnit) -> Noise:
    """Return noise with a discrepancy by which each row's total grows by its factor: else an outlier keeps its weight."""
    total = replace(device, discrepancy=discrepancy).total
    return replace(device, sigma=np.sqrt(device.sigma**2 + (factor**2 - 1) * total**2), discrepancy=discrepancy)


def _excess(fit: Fit, outlier_factor: np.ndarray) -> np.ndarray:
    """Return each row's error over HUBER standard deviations, at least 1, shape (n_rows,).

    Their scale is that of all rows so weighted, Huber's proposal 2: the noise and discrepancy of the fit. A median would be smaller
    where a smooth error is left, and its peaks would count as outliers.
    """
    squared = np.where(fit.problem.leading, fit.residual**2, 0.0)
    size = np.sqrt(np.bincount(fit.problem.row, squared, fit.problem.n_rows)) * outlier_factor
    return np.asarray(np.maximum(1.0, size / HUBER))
