"""The calibrated model: estimate, covariance, noise and error model, and the predictive variance of what it predicts.

It also holds alternatives of similar probability (Occam's window: models far less probable than the best are left out, so that
the few others can be evaluated in full; Madigan and Raftery 1994). Predictive variances exclude the measuring device's noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Self

import numpy as np
import scipy

from calflow.effects.cause import Carried, Cause
from calflow.estimation.accuracy import completed, error_jacobian, errors, judged_unit
from calflow.estimation.error_model import ErrorModel, of_parameters
from calflow.estimation.extrapolation import beyond
from calflow.estimation.lack_of_fit import WORTH_TELLING
from calflow.estimation.least_squares import Loss
from calflow.estimation.needed_conditions import NeededCondition, depended_on, to_state
from calflow.estimation.noise import Label, Noise, PerUnit, Source, stated_noise
from calflow.estimation.residual_field import ResidualField
from calflow.files.units import METRE, RADIAN, MeasurementUnit
from calflow.files.words import first_up, rounded
from calflow.measurements.measurements import Measurements
from calflow.model import Model

MANY = 20  # parameters of one cause, beyond which sampling them would take days without further insight
ROWS = 1000  # rows at which smooth errors are evaluated at once
PART_ROWS = 100_000  # rows whose Jacobian is evaluated at once: enough for compiled code to pay
RANK = 1e-9  # relative size below which a singular value, or what a fit leaves of a value, is rounding
CERTAIN = 0.95  # probability of a smaller error than the nominal robot's, from which a gain is called certain
UNMEASURED = 0.5  # posterior over prior variance of a direction, above which it was hardly measured
MOST_UNTOLD = 0.5  # share of a variance left to the priors, from which that is said
LOOK: dict[Label, str] = {"session": "what was different then", "marker": "whether it sits firmly"}


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another model of the same robot, its estimate (n_parameters,) in SI, and its posterior probability.

    gone is the cause that it lacks (None: none), rival the cause that replaces it or is added (None: none).
    """

    model: Model
    estimate: np.ndarray
    probability: float
    gone: Cause | None = None
    rival: Cause | None = None


Quantity = Callable[[Model, np.ndarray], np.ndarray]  # (model, estimate) -> values of rows (n_rows, n)
Slope = Callable[
    [Model, np.ndarray, np.ndarray], np.ndarray
]  # (model, estimate, packed rows) -> Jacobian (n_rows, 3, n)


def offsets(alternatives: Sequence[Alternative], model: Model, estimate: np.ndarray, quantity: Quantity) -> np.ndarray:
    """Return the offsets of a quantity by alternatives from that by the model which they replace, (n_rows, n, n_alternatives)."""
    here = quantity(model, estimate)
    every = [quantity(replace(other.model, given=model.given), other.estimate) for other in alternatives]
    return np.stack(every, axis=2) - here[:, :, None] if every else np.zeros((*here.shape, 0))


def choice_errors(
    alternatives: Sequence[Alternative], model: Model, estimate: np.ndarray, quantity: Quantity
) -> np.ndarray:
    """Return a square root of a quantity's variance by the choice of the model (Bayesian model averaging, Hoeting et al. 1999).

    Shape (n_rows, n, n_alternatives), the factors of independent standard normals: the squares add up to the mean square
    distance of the alternatives' predictions from this model's, weighted by their probabilities.
    """
    moved = offsets(alternatives, model, estimate, quantity)
    return moved * np.sqrt([other.probability for other in alternatives])


def points_at(conditions: np.ndarray, places: np.ndarray | None = None) -> Quantity:
    """Return the positions (n_rows, 3) [m] of the markers, or of places on the last link, as a quantity of packed conditions."""
    return lambda model, estimate: model.point(estimate, conditions, places)


@dataclass(frozen=True)
class SeriesNoise:
    """The noise of a series: sigma of a single row (at zero range), its source, and its growth with range [m/m].

    typical is its root mean square over the measured rows. Both are in the series' leading unit. factors: of the noise by what a
    label names, in those sessions or of those markers where it is another. series: its name; empty: the only one.
    """

    sigma: float
    source: Source
    typical: float
    growth: float = 0.0
    label: Label = "session"
    factors: Mapping[str, float] = field(default_factory=dict)
    series: str = ""

    @property
    def statement(self) -> str:
        """A sentence on the noisiest session, or marker, of a series whose noise nobody stated; empty where all are alike."""
        times = max(self.factors.values(), default=1.0) / min(self.factors.values(), default=1.0)
        if self.source == "file" or times <= WORTH_TELLING:
            return ""
        noisiest = max(self.factors, key=lambda name: self.factors[name]) or "without a name"
        named = f"{first_up(self.label)} {noisiest}{f' of {self.series}' if self.series else ''}"
        return f"{named} scatters {rounded(times)} times as much as the quietest: see {LOOK[self.label]}."

    def of_rows(self, data: Measurements, stated: np.ndarray | float = np.nan) -> np.ndarray:
        """Return each row's noise (n_rows,), given that which it states (nan: none); typical where nothing tells it."""
        own = np.full(len(data), stated if self.source == "file" and not self.growth else self.sigma)
        if self.growth:
            own += self.growth * (data.table["range"].to_numpy() if "range" in data.given else np.nan)
        own *= [self.factors.get(name, 1.0) for name in data.labels(self.label)]
        return np.where(np.isnan(own), self.typical, own)

    @property
    def shared(self) -> float:
        """What all rows have of it where it is told by the fit alone, whose errors then hold it."""
        return self.typical if self.growth else self.sigma * min([1.0, *self.factors.values()])


@dataclass(frozen=True, eq=False)
class CalibratedModel:
    """The fitted model with its estimate and covariance (SI units), each series' noise, and the discrepancy by unit.

    errors: error model beyond the device's noise; alternatives: other models of similar probability; field: a
    non-physical correction of predictions; intraclass: correlation of the errors of markers at one standstill; needed: the
    conditions of a row that predictions need; time_origin [s]: clock reading from which times count; payloads: those carried
    in the measurements; joint_range (2, n_joints): the least and the largest readings that were fitted; None: not known.
    """

    model: Model
    estimate: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray
    device: tuple[SeriesNoise, ...]
    discrepancy: PerUnit
    loss: Loss
    errors: ErrorModel
    alternatives: tuple[Alternative, ...] = ()
    field: ResidualField | None = None
    intraclass: float = 0.0
    needed: tuple[NeededCondition, ...] = ()
    time_origin: float | None = None
    payloads: tuple[str, ...] = ()
    joint_range: np.ndarray | None = None

    def beyond_range(self, readings: np.ndarray) -> np.ndarray:
        """Return the mask of readings (n_rows, n_joints) beyond the fitted range, without held-out poses, by over a tenth of it."""
        if self.joint_range is None:
            return np.zeros(readings.shape, dtype=bool)
        return beyond(readings, self.joint_range)

    def later(self, given: tuple[str, ...], series: Measurements | None = None) -> Self:
        """Return the model for rows measured later that state these conditions, or those of a series (see `Effect.later`)."""
        alternatives = tuple(replace(other, model=other.model.later(series)) for other in self.alternatives)
        return replace(self, model=replace(self.model.later(series), given=given), alternatives=alternatives)

    @cached_property
    def inputs(self) -> frozenset[str]:
        """The conditions of a row on which a prediction or its uncertainty depends: its own, of errors or of alternatives."""
        of_alternatives = (depended_on(other.model.later()) for other in self.alternatives)
        own = (*(need.condition for need in self.needed), *to_state(self.model.later()))
        return frozenset(own).union(self.errors.inputs, *of_alternatives)

    @property
    def _fitted(self) -> tuple[Model, np.ndarray]:
        return self.model, self.estimate

    @property
    def noise_known(self) -> bool:
        return any(device.source != "estimated" for device in self.device)

    @property
    def unit(self) -> MeasurementUnit:
        return judged_unit([observation.units[0] for observation in self.model.observations])

    def conditions_of(self, data: Measurements) -> np.ndarray:
        """Return the packed conditions (n_conditions, n_rows) of rows that state at least those that the model takes."""
        return data.stating(self.model.given).on(self.model.robot).conditions

    def device_sigma(self, data: Measurements) -> np.ndarray:
        """Return the device's noise of rows (n_rows,) [leading unit] beside the model's errors.

        Where it is not known apart from these, they hold it, and what rows have beyond that of the quietest, or of the typical
        where it grows with range, is returned.
        """
        if self.noise_known:
            return self.noise(data).sigma
        beyond = np.zeros(len(data))
        for k, device in enumerate(self.device):
            rows = data.of_series(k)
            beyond[rows] = np.sqrt(np.maximum(device.of_rows(data)[rows] ** 2 - device.shared**2, 0.0))
        return beyond

    def noise(self, data: Measurements) -> Noise:
        """Return the noise of rows by each series' source; rows that state none have that of the fitted rows."""
        stated = stated_noise(data)
        sigma = stated.sigma.copy()
        for k, device in enumerate(self.device):
            rows = data.of_series(k)
            sigma[rows] = device.of_rows(data, stated.sigma)[rows]
        return replace(
            stated, sigma=sigma, sources=tuple(device.source for device in self.device), discrepancy=self.discrepancy,
            intraclass=self.intraclass, corrected=any(device.factors for device in self.device),
        )  # fmt: skip

    def with_maps_held(self) -> tuple[CalibratedModel, tuple[Cause, ...]]:
        """Return the model conditional on its causes with very many parameters, held at their estimates, and these causes."""
        model, whole = self.model, self.covariance
        held = [cause for cause in model.causes if len(model.columns(cause)) > MANY]
        if not held:
            return self, ()
        values = {effect: tuple(map(float, self.estimate[model.columns(effect)])) for effect in held}
        effects = tuple(Carried(e.robot, e, values[e]) if e in values else e for e in model.effects)
        gone = np.concatenate([*map(model.columns, held)])
        kept, free = np.setdiff1d(np.arange(len(whole)), gone), gone[~self.at_bound[gone]]
        given = whole[np.ix_(kept, free)] @ np.linalg.solve(whole[np.ix_(free, free)], whole[np.ix_(free, kept)])
        lean = replace(
            self,
            model=replace(model, effects=effects),
            estimate=self.estimate[kept],
            covariance=whole[np.ix_(kept, kept)] - given,
            at_bound=self.at_bound[kept],
            errors=replace(self.errors, slope=self.errors.slope[:, kept], offset=self.errors.offset[kept]),
        )
        return lean, tuple(held)

    def position_variance(self, conditions: np.ndarray, places: np.ndarray | None = None) -> np.ndarray:
        """Return the predictive variance of each row's position by axis, (n_rows, 3) [m²]; of noise that estimated from the fit.

        It is of the markers, or of places (n_rows, 3) [m] in the last link's frame: a marker's error says nothing of what the data
        cannot tell from its place on the link, as the last link's length.
        """
        of_choice = (choice_errors(self.alternatives, *self._fitted, points_at(conditions, places)) ** 2).sum(axis=2)
        every = (self.errors.slopes(*self._fitted, *part) for part in _parts(conditions, places))
        return self._beside_field(of_choice + self._variances(every, METRE)[0], conditions)

    def shared_errors(self, conditions: np.ndarray, places: np.ndarray | None = None) -> np.ndarray:
        """Return the errors that rows share, by parameters, smooth errors and choice of the model, as factors (n_rows, 3, n) [m].

        Their squares add up to `position_variance` less the part that is independent from row to row.
        """
        slopes = self.errors.slopes(*self._fitted, conditions, places)
        choice = choice_errors(self.alternatives, *self._fitted, points_at(conditions, places))
        shared = np.concatenate([self.errors.shared(slopes, self.covariance), choice], axis=2)
        whole = (shared**2).sum(axis=2) + self.errors.rest[METRE] ** 2
        return shared * np.sqrt(self._beside_field(whole, conditions) / whole)[:, :, None] if self.field else shared

    def parameter_variance(self, conditions: np.ndarray) -> np.ndarray:
        """Return the variance of each row's position per axis (n_rows, 3) [m²] by the parameters, with their offset."""
        slopes = (self.model.point_jacobian(self.estimate, *part) for part in _parts(conditions, rows=PART_ROWS))
        return np.concatenate([np.maximum(of_parameters(slope, self.covariance), 0.0) for slope in slopes])

    def left_variance(self, conditions: np.ndarray) -> np.ndarray:
        """Return the variance of position errors beyond those by the parameters and the choice of the model [m²].

        Shape (n_rows, 3). Smooth errors and parameters are negatively correlated where rows were measured: this is the joint
        variance less the parameters', for use beside independent draws of the parameters, without a residual field.
        """
        return self._variances((self.errors.slopes(*self._fitted, *part) for part in _parts(conditions)), METRE)[1]

    def _variances(self, every: Iterable[np.ndarray], unit: MeasurementUnit) -> tuple[np.ndarray, np.ndarray]:
        """Return variances by parameters and smooth errors, given some rows' slopes at a time, and those beyond the parameters'."""
        covariance, rest, parts = self.covariance, self.errors.rest[unit] ** 2, list[tuple[np.ndarray, np.ndarray]]()
        for slopes in every:
            whole = (self.errors.shared(slopes, covariance) ** 2).sum(axis=2)
            alone = of_parameters(slopes[:, :, : len(covariance)], covariance)
            parts.append((whole + rest, np.maximum(whole - alone, 0.0) + rest))
        wholes, left = zip(*parts, strict=True)
        return np.concatenate(wholes), np.concatenate(left)

    def expected_point(self, conditions: np.ndarray) -> np.ndarray:
        """Return the predicted positions of the markers (n_rows, 3) [m], with the residual field's correction."""
        return self.model.point(self.estimate, conditions) + self.field_correction(conditions)

    def field_correction(self, conditions: np.ndarray) -> np.ndarray:
        """Return the residual field's correction of positions, shape (n_rows, 3) [m]; zero without a field."""
        return self.field.correction(self._readings(conditions)) if self.field else np.zeros((conditions.shape[1], 3))

    def _beside_field(self, variance: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return what a residual field, if there is one, leaves of a variance of positions (n_rows, 3) [m²]."""
        return self.field.left_of(variance, self._readings(conditions)) if self.field else variance

    def _readings(self, conditions: np.ndarray) -> np.ndarray:
        return np.asarray(conditions[: self.model.robot.n_joints].T)

    def rotation_variances(self, conditions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the predictive variance of rows' orientations about the tool's axes (n_rows, 3) [rad²], and as `left_variance`.

        Rotations that the data do not determine have the variance of their priors (see `untold`).
        """
        turned = (partial(Model.rotation_jacobian, conditions=part) for part, _ in _parts(conditions))
        return self._variances((self.errors.slopes_of(each, *self._fitted) for each in turned), RADIAN)

    def untold(self, jacobian: Slope, conditions: np.ndarray) -> np.ndarray:
        """Return the share (3,) of the variance of positions, or rotations, along each axis that the data leave to the priors.

        It is the share of those directions of the parameters, scaled by their priors, whose posterior variance is more than
        UNMEASURED of the prior's; mean over the rows.
        """
        sd, slopes = self.model.prior_sd, jacobian(self.model, self.estimate, conditions)
        left, directions = np.linalg.eigh(self.covariance / np.outer(sd, sd))
        parts = ((slopes @ (sd[:, None] * directions)) ** 2).mean(axis=0) * np.maximum(left, 0.0)
        total = parts.sum(axis=1)
        return np.asarray(np.divide(parts[:, left > UNMEASURED].sum(axis=1), total, out=np.zeros(3), where=total > 0))

    def promised_variance(self, data: Measurements, unit: MeasurementUnit) -> np.ndarray:
        """Return the predictive variance of each row's errors by axis, (n_rows, n_axes) [unit²], the device's noise included.

        It is 0 where a row has no value in the unit. data must have the conditions that the model needs.
        """
        found, device = self.errors_in_unit(data, unit), self.device_sigma(data)[:, None] ** 2
        variance = self._beside_field(found.variance, data.conditions) if unit == METRE else found.variance
        return np.where(np.isfinite(found.error), variance + device, 0.0)

    def errors_in_unit(self, data: Measurements, unit: MeasurementUnit) -> ErrorsInUnit:
        """Return the errors of rows in a unit.

        An object that the model lacks (a socket, a surface) is placed by its own rows. Their errors are what that fit leaves,
        divided by the root of one minus the leverage (MacKinnon and White 1985, HC2); nan for a value that its object's place
        follows alone.
        """
        model, estimate = completed(self.model, self.estimate, data)
        error, smooth = errors(model, estimate, data, unit), self.errors
        names = [parameter.name for parameter in model.parameters]
        known = [names.index(parameter.name) for parameter in self.model.parameters]
        new = np.setdiff1d(np.arange(len(names)), known)
        basis = np.zeros((*error.shape, 0))
        if len(new):
            placing = error_jacobian(model, estimate, data, unit)[:, :, new] * model.prior_sd[new]
            basis = scipy.linalg.orth(placing.reshape(error.size, -1), RANK).reshape(*error.shape, -1)
        share = 1.0 - (basis**2).sum(axis=2)
        root = np.sqrt(np.where(share > RANK, share, np.nan))
        columns = [*known, *range(len(names), len(names) + len(smooth.sd))]
        parts = [np.arange(len(data)) // ROWS == k for k in range(max(1, -(-len(data) // ROWS)))]

        def slopes(rows: np.ndarray) -> np.ndarray:
            some = partial(error_jacobian, measured=data.only(rows), unit=unit)
            return smooth.slopes_of(some, model, estimate)[:, :, columns]

        # What moves an object's rows alike moves the object with them.
        along = np.zeros((basis.shape[2], len(columns)))
        for rows in parts if basis.shape[2] else ():
            along += np.einsum("nak,nam->km", basis[rows], slopes(rows))
        every = (np.nan_to_num((slopes(rows) - basis[rows] @ along) / root[rows, :, None]) for rows in parts)
        whole, left = self._variances(every, unit)
        choice = choice_errors(self.alternatives, model, estimate, lambda m, p: errors(m, p, data, unit))
        of_choice = np.nan_to_num((choice / root[:, :, None]) ** 2).sum(axis=2)
        return ErrorsInUnit(error / root, whole + of_choice, left, basis.shape[2])

    def promised_distance(self, conditions: np.ndarray) -> np.ndarray:
        """Return the predictive standard deviation of positions: root mean square distance, shape (n_rows,) [m]."""
        return np.asarray(np.sqrt(self.position_variance(conditions).sum(axis=1)))

    def distance_moved(self, conditions: np.ndarray) -> np.ndarray:
        """Return the distance between nominal and calibrated prediction, shape (n_rows,) [m]."""
        moved = self.model.point(self.model.nominal, conditions) - self.expected_point(conditions)
        return np.asarray(np.linalg.norm(moved, axis=1))

    def gain_is_certain(self, conditions: np.ndarray) -> np.ndarray:
        """Return where the calibrated model's error is smaller than the nominal's almost certainly: a mask, shape (n_rows,).

        Both share what no measurement told. The calibrated error is the larger one where, along the correction, it is beyond half
        of it. Errors are taken as normal, without a residual field.
        """
        alone = replace(self, field=None)
        gained = [np.zeros(0, dtype=bool)]
        for part, _ in _parts(conditions):
            moved = self.model.point(self.model.nominal, part) - alone.expected_point(part)
            size = np.linalg.norm(moved, axis=1)
            along = (np.einsum("na,nak->nk", moved, alone.shared_errors(part)) ** 2).sum(axis=1)
            sd = np.sqrt(along + (size * self.errors.rest[METRE]) ** 2)  # times the size
            gained.append(0.5 * size**2 > scipy.special.ndtri(CERTAIN) * sd)
        return np.concatenate(gained)


def series_noise(noise: Noise, data: Measurements) -> tuple[SeriesNoise, ...]:
    """Return the noise of each series, as far as it is the same for all its rows."""
    typical = [float(np.sqrt(np.mean(noise.sigma[noise.of_series(k)] ** 2))) for k in range(len(noise.sources))]
    every = zip(typical, noise.sources, data.series, strict=True)
    return tuple(SeriesNoise(size, source, size, series=series.name) for size, source, series in every)


def _parts(
    conditions: np.ndarray, places: np.ndarray | None = None, rows: int = ROWS
) -> Iterable[tuple[np.ndarray, np.ndarray | None]]:
    """Return packed conditions in parts of some rows, each with its places, so that memory does not grow with the rows."""
    ends = range(rows, conditions.shape[1], rows)
    parts = np.array_split(conditions, ends, axis=1)
    return zip(parts, [None] * len(parts) if places is None else np.array_split(places, ends), strict=True)


@dataclass(frozen=True, eq=False)
class ErrorsInUnit:
    """Errors of what devices report in a unit, and their variances without a known noise, all (n_rows, 3 or more).

    error [unit]: predicted minus measured, nan where there is none; variance [unit²]: predictive, by parameters, choice of the
    model and its smooth errors given the data at that place and time, as for positions; left [unit²]: beyond parameters and choice
    (see `left_variance`); taken: degrees of freedom of the objects that the model lacked, which the rows placed.
    """

    error: np.ndarray
    variance: np.ndarray
    left: np.ndarray
    taken: int
