"""A fitted model as the diagnosis uses it: with its data and noise, and with rows far off counting less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calflow.diagnosis.regressors import Background, Regressors
from calflow.effects import Effect
from calflow.effects.base import Cause
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.error_model import ErrorModel, SmoothSizes, beside_smooth_errors, beyond_measured
from calflow.estimation.fit import Fit, SquaresTogether, fit, fit_reweighted
from calflow.estimation.lack_of_fit import LackOfFit
from calflow.estimation.least_squares import LeastSquares, Loss
from calflow.estimation.leverage import LeftOut, left_out
from calflow.estimation.noise import Noise, PerUnit, median_length
from calflow.measurements.measurements import Measurements
from calflow.model import Model

FAR = 4.5  # robust standard deviations
SETTLED = 0.1  # relative change of noise and weights below which a fit is not repeated
WEIGHINGS = 3  # fits in which the weights of rows far off settle


@dataclass(frozen=True)
class Fitted:
    """A fitted model with the training data and the noise it was fitted with.

    lack is the lack of fit against the noise alone, device the noise before rows far off were given less weight, far by how much
    less rows count than the others of their series, at least 1, (n_rows,), or (1,) where all count alike. background is
    what rows near each other share as far as the data show, that tests go by; without one what is left counts as independent.
    shared is the correlation of what markers of a standstill err, None where the residual alone is to say it.
    visited are the models that were fitted from it with other causes: a search that comes back to one does not fit it again.
    """

    fit: Fit
    data: Measurements
    noise: Noise
    lack: LackOfFit
    loss: Loss
    device: Noise
    background: Background | None = None
    shared: float | None = None
    visited: dict[frozenset[Cause], Fitted] = field(default_factory=dict, compare=False, repr=False)
    far: np.ndarray = field(default_factory=lambda: np.ones(1), compare=False, repr=False)

    @property
    def model(self) -> Model:
        """The model."""
        return self.fit.model

    @property
    def poses(self) -> np.ndarray:
        """The rows' poses, those of each series apart, numbered from 0, shape (n_rows,)."""
        pose = np.unique(self.data.table["pose"], return_inverse=True)[1]
        return np.asarray(pose * len(self.data.series) + self.data.series_number)

    def regressors(self, effects: Sequence[Effect], still: Cause | None = None) -> Regressors[Cause]:
        """Linearise the model with these effects at zero, against what its background leaves of independent noise.

        still is a cause of the model that is at nothing there.
        """
        problem, fit = self.problem, self.fit
        if still is not None:
            estimate = fit.estimate.copy()
            estimate[self.model.columns(still)] = 0.0
            fit = replace(fit, estimate=estimate)
        correlation = self.background.correlation(problem.weight) if self.background else None
        return Regressors.of(fit, problem, effects, self.poses, correlation)

    @cached_property
    def alone(self) -> Regressors[Cause]:
        """The model linearised without any other effect, against independent noise: what many tests ask of the same fit."""
        return replace(self, background=None, shared=self.intraclass).regressors(())

    @property
    def scale(self) -> float:
        """Geometric mean of the standard deviations that independent residuals were divided by, but for rows far off."""
        problem = self._problem
        alike = np.log(problem.total / np.broadcast_to(self.far, len(self.data))[problem.stacking.row])
        return float(np.exp(alike.mean() + problem.log_determinant / (2 * problem.size)))

    @cached_property
    def _beside(self) -> tuple[Fit, ErrorModel]:
        """The fit as sure as it is beside the smooth errors that the data allow, and what positions err by."""
        sizes = SmoothSizes.of(replace(self.fit, problem=self._problem), self.data, self.noise.known)
        unsure, errors = beside_smooth_errors(sizes, float(self.left_out.excess()))
        return unsure, beyond_measured(errors, sizes)

    @property
    def errors(self) -> ErrorModel:
        """What positions err by beside the device's noise."""
        return self._beside[1]

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the estimate beside these errors, shape (n_parameters, n_parameters)."""
        return replace(self.fit, information=self._beside[0].information).covariance

    @cached_property
    def left_out(self) -> LeftOut:
        """The errors of its poses, each left out in turn."""
        return left_out(self.fit, self.poses)

    @cached_property
    def together(self) -> SquaresTogether | None:
        """What its residual alone tells of the correlation of what markers of a standstill err."""
        return SquaresTogether.of(self.fit, self.data, self.noise)

    @property
    def intraclass(self) -> float:
        """That correlation."""
        if self.shared is not None:
            return self.shared
        return self.together.correlation if self.together else 0.0

    @property
    def beside(self) -> Regressors[Cause]:
        """The model linearised without any other effect, against what its background leaves of independent noise."""
        return self.regressors(()) if self.background else self.alone

    @property
    def far_off(self) -> float:
        """What rows far off cost beside their squares, which count for less (Huber 1964)."""
        return 2 * FAR**2 * float((self.far - 1).sum())

    @property
    def problem(self) -> LeastSquares:
        """The problem that was solved, robust weights included, and what markers of a standstill err in common."""
        return self._problem.reweighted(self.fit.estimate, self.loss)

    @property
    def _problem(self) -> LeastSquares:
        return LeastSquares.of(self.model, self.data, replace(self.noise, intraclass=self.intraclass))

    def weighed(self, sigma: np.ndarray) -> Fitted:
        """Fit anew with other noise (n_rows,), of residuals in the leading units."""
        noise = replace(self.device, sigma=sigma, discrepancy=PerUnit())
        return replace(
            _settled(self.model, self.data, noise, self.fit.estimate, self.loss),
            background=self.background,
            shared=self.shared,
        )

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, noise: Noise) -> Fitted:
        """Fit an identified model anew on training rows, from where identify left it."""
        bare = replace(noise, discrepancy=PerUnit(), intraclass=0.0)
        begun = _settled(calibrated.model, data, bare, calibrated.estimate, calibrated.loss)
        begun.visited[frozenset(begun.causes)] = begun
        return begun

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What has been found; the other effects are the study's own."""
        return tuple(effect for effect in self.model.effects if isinstance(effect, Cause))

    @property
    def plain(self) -> tuple[Effect, ...]:
        """The study's own effects."""
        return tuple(effect for effect in self.model.effects if not isinstance(effect, Cause))

    def own(self, cause: Cause) -> tuple[np.ndarray, np.ndarray]:
        """Return the numbers of a cause's parameters among those that are free, and their estimates."""
        free = np.flatnonzero(~self.fit.at_bound)
        columns = np.flatnonzero(np.isin(free, self.model.columns(cause)))
        return columns, self.fit.estimate[free[columns]]

    def fit_with(self, causes: Sequence[Cause]) -> Fit:
        """Fit the study's own effects with these causes once, by this model's weights: where no test is made of the fit."""
        model = replace(self.model, effects=(*self.plain, *causes))
        return fit(
            LeastSquares.of(model, self.data, self.noise),
            self.model.handed_on(self.fit.estimate, model)[None],
            self.loss,
        )[0]

    def with_causes(self, causes: Sequence[Cause], start: np.ndarray | None = None, share: float = 0.0) -> Fitted:
        """Fit the study's own effects with these causes, by IPOPT, unless they were fitted before.

        It starts from the estimates there are, what is new at nothing, unless start says otherwise. share is how much of chi²
        is expected to go: a noise that is not known starts smaller by it, and settles at once.
        """
        if (before := self.visited.get(frozenset(causes))) is None:
            before = self.visited[frozenset(causes)] = self._with_causes(causes, start, share)
        return replace(before, background=self.background, shared=self.shared, visited=self.visited)

    def _with_causes(self, causes: Sequence[Cause], start: np.ndarray | None, share: float) -> Fitted:
        model = replace(self.model, effects=(*self.plain, *causes))
        start = self.model.handed_on(self.fit.estimate, model) if start is None else start
        bare = replace(self.device, discrepancy=PerUnit())
        near = self.noise.sigma / self.far * np.sqrt(1 - share)
        bare = replace(bare, sigma=np.where(bare.estimated, near, bare.sigma))
        return _settled(model, self.data, bare, start, self.loss, self.far)


def _settled(
    model: Model, data: Measurements, device: Noise, start: np.ndarray, loss: Loss, far: np.ndarray | None = None
) -> Fitted:
    """Fit from a start; rows far beyond the others count no more than one at FAR does (Huber 1964).

    far (n_rows,) is by how much rows were beyond that in the fit before.
    """
    far = np.ones(len(data)) if far is None else far
    for _ in range(WEIGHINGS):
        weighed = replace(device, sigma=device.sigma * far)
        settled, noise, lack, _ = fit_reweighted(model, data, weighed, start[None], loss, SETTLED)
        before, far, start = far, _excess(settled, far), settled.estimate
        if np.allclose(far, before, rtol=SETTLED):
            break
    return Fitted(settled, data, noise, lack, loss, device, far=before)


def _excess(fit: Fit, far: np.ndarray) -> np.ndarray:
    """By how much each row's error exceeds FAR robust standard deviations, at least 1, shape (n_rows,)."""
    leading = fit.stacking.leading
    size = np.sqrt(fit.stacking.by_row(np.where(leading, fit.residual**2, 0.0))) * far
    units = fit.stacking.by_row(leading.astype(float)).astype(int)
    scale = float(np.median(size / median_length(units)))
    return np.asarray(np.maximum(1.0, size / (FAR * scale)))
