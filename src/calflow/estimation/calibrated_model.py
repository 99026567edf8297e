"""The calibrated model: what predictions and all that builds on them need.

It holds the other models that explain the data about as well (Occam's window: models far less likely than the best are left out, so
that those few can be weighed in full; Madigan and Raftery 1994), and says how sure its positions are, apart from the device that
measures them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calflow.effects import Effect
from calflow.effects.base import Carried, Cause
from calflow.estimation.accuracy import error_jacobian, errors
from calflow.estimation.error_model import ErrorModel, of_parameters
from calflow.estimation.least_squares import Loss
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.noise import Noise, PerUnit, Source, stated_noise
from calflow.estimation.residual_field import ResidualField
from calflow.files.units import METRE, RADIAN, MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.model import Model


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another model of the same robot, its estimate (n_parameters,) in SI, and how probable it is.

    gone is the cause that gives way, None where none does, rival what comes in its place or besides, if anything does.
    """

    model: Model
    estimate: np.ndarray
    probability: float
    gone: Cause | None = None
    rival: Cause | None = None


def choice_errors(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return what each of independent standard normals does to positions because another model may be the right one.

    Shape (n_rows, 3, n_alternatives) [m]; squares add up to the mean square distance of the other models' predictions from this
    one's (Hoeting et al. 1999, Bayesian model averaging).
    """
    model, alternatives = calibrated.model, calibrated.alternatives
    apart = np.zeros((conditions.shape[1], 3, len(alternatives)))
    here = model.point(calibrated.estimate, conditions) if alternatives else 0.0
    for k, other in enumerate(alternatives):
        there = replace(other.model, given=model.given).point(other.estimate, conditions)
        apart[:, :, k] = np.sqrt(other.probability) * (there - here)
    return apart


MANY = 20  # parameters of one cause, beyond which sampling them would take days and say nothing new


@dataclass(frozen=True)
class SeriesNoise:
    """The noise of a series: sigma of a single row (of one that grows, at no distance), growth [m/m], and its source.

    typical is its rms over the rows; where none is given it is sigma. Both are in the series' leading unit.
    """

    sigma: float
    source: Source
    growth: float = 0.0
    typical: float = 0.0

    @property
    def at_rows(self) -> float:
        """Its rms where rows were measured."""
        return self.typical or self.sigma


@dataclass(frozen=True, eq=False)
class CalibratedModel:
    """The fitted model with its estimate, covariance (SI units), each series' noise, and the discrepancy it left, unit by unit.

    errors are what positions err by beside the device's noise; intraclass is the correlation of what the markers of a standstill
    err; alternatives are other models that explain the data about as well; field is a correction beside the model that is not
    physical.
    needed are the conditions that it must be told of a row, time_origin the reading of the clock from which its times count [s].
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

    @property
    def noise_known(self) -> bool:
        """Whether any series' noise is known apart from the fit."""
        return any(device.source != "estimated" for device in self.device)

    @property
    def sigma(self) -> float:
        """Noise of a single row of the first series [its leading unit]."""
        return self.device[0].sigma

    def noise(self, data: Measurements) -> Noise:
        """Return the noise of these rows, from where it was taken: of rows that state none, that of the rows which were fitted."""
        stated = stated_noise(data)
        sigma = stated.sigma.copy()
        for k, device in enumerate(self.device):
            rows = data.of_series(k)
            if device.growth:
                sigma[rows] = device.sigma + device.growth * data.table["range"].to_numpy()[rows]
            elif device.source == "file":
                sigma[rows] = np.where(np.isnan(sigma[rows]), device.at_rows, sigma[rows])
            else:
                sigma[rows] = device.sigma
            sigma[rows & np.isnan(sigma)] = device.at_rows  # rows that do not state theirs, of a device that did
        return replace(
            stated, sigma=sigma, sources=tuple(device.source for device in self.device), discrepancy=self.discrepancy,
            intraclass=self.intraclass,
        )  # fmt: skip


def with_maps_held(calibrated: CalibratedModel) -> tuple[CalibratedModel, tuple[Cause, ...]]:
    """Return the model with causes of very many parameters held at their estimates, and which these are."""
    effects: list[Effect] = []
    kept = [int(i) for observation in calibrated.model.observations for i in calibrated.model.columns(observation)]
    held = []
    for effect in calibrated.model.effects:
        columns = calibrated.model.columns(effect)
        if isinstance(effect, Cause) and len(columns) > MANY:
            effects.append(Carried(effect.robot, effect, tuple(map(float, calibrated.estimate[columns]))))
            held.append(effect)
        else:
            effects.append(effect)
            kept += list(columns)
    if not held:
        return calibrated, ()
    rest = np.setdiff1d(np.arange(len(calibrated.estimate)), kept)
    free = rest[~calibrated.at_bound[rest]]
    whole = calibrated.covariance
    given = whole[np.ix_(kept, free)] @ np.linalg.solve(whole[np.ix_(free, free)], whole[np.ix_(free, kept)])
    lean = replace(
        calibrated,
        model=replace(calibrated.model, effects=tuple(effects)),
        estimate=calibrated.estimate[kept],
        covariance=whole[np.ix_(kept, kept)] - given,
        at_bound=calibrated.at_bound[kept],
        errors=replace(
            calibrated.errors, slope=calibrated.errors.slope[:, kept], offset=calibrated.errors.offset[kept]
        ),
    )
    return lean, tuple(held)


def series_noise(noise: Noise, growth: tuple[float, float] | None = None) -> tuple[SeriesNoise, ...]:
    """Return the noise of each series; growth is its floor [m] and slope [m/m]."""
    devices = []
    for k, source in enumerate(noise.sources):
        typical = float(np.sqrt(np.mean(noise.sigma[noise.of_series(k)] ** 2)))
        sigma, slope = growth or (typical, 0.0)
        devices.append(SeriesNoise(sigma, source, slope, typical))
    return tuple(devices)


PART_ROWS = 100_000  # whose Jacobian is there at once: enough for machine code to pay
UNTOLD = 0.5  # of a direction's prior variance: what is left above it was hardly measured


def position_variance(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the variance of each row's predicted position per axis, shape (n_rows, 3) [m²].

    It holds what is not known of the parameters, the choice of the model, and what the model errs by beside, given the data there
    and then; of a residual field its own variance in the place of that. Where the noise was estimated from the fit, it is in.
    """
    of_choice = (choice_errors(calibrated, conditions) ** 2).sum(axis=2)
    if calibrated.field:
        return np.asarray(
            parameter_variance(calibrated, conditions) + of_choice + left_variance(calibrated, conditions)
        )
    return of_choice + calibrated.errors.variance(
        calibrated.model, calibrated.estimate, calibrated.covariance, conditions
    )


def shared_errors(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return what each of independent standard normals does to rows' predicted positions, shape (n_rows, 3, n) [m].

    They are what rows err by together: of the parameters, the smooth errors and the choice of the model. The squares add up to
    the variance (see `position_variance`) but for what each row errs by for itself. A residual field is not in it.
    """
    jacobian = calibrated.model.point_jacobian(calibrated.estimate, conditions)
    errors = calibrated.errors.at(calibrated.model, calibrated.estimate, conditions).shared(
        jacobian, calibrated.covariance
    )
    return np.concatenate([errors, choice_errors(calibrated, conditions)], axis=2)


def parameter_variance(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the variance of each row's predicted position per axis that is the parameters' (n_rows, 3) [m²], part by part.

    Their offset beside smooth errors (see `ErrorModel`) is none where a residual field takes it off.
    """
    parts = np.array_split(conditions, range(PART_ROWS, conditions.shape[1], PART_ROWS), axis=1)
    offset = calibrated.errors.offset if calibrated.field else np.zeros(len(calibrated.estimate))
    covariance = calibrated.covariance - np.outer(offset, offset)
    slopes = (calibrated.model.point_jacobian(calibrated.estimate, part) for part in parts)
    return np.concatenate([np.maximum(of_parameters(slope, covariance), 0.0) for slope in slopes])


def left_variance(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the variance of what positions err by beside the parameters' errors and the choice of the model [m²].

    Shape (n_rows, 3), or 1 for all axes. Smooth errors make up for errors of the parameters where rows were measured: it is what
    they leave of both together, drawn beside independent draws of the parameters.
    """
    if calibrated.field:
        return np.asarray(calibrated.field.variance(readings(calibrated, conditions))[:, None])
    whole = calibrated.errors.variance(calibrated.model, calibrated.estimate, calibrated.covariance, conditions)
    return np.maximum(whole - parameter_variance(calibrated, conditions), calibrated.errors.rest**2)


def expected_point(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return where the markers are to be expected, shape (n_rows, 3) [m]: by the model, and its residual field if it has one."""
    return calibrated.model.point(calibrated.estimate, conditions) + field_correction(calibrated, conditions)


def field_correction(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return what the residual field adds to the model's points, shape (n_rows, 3) [m]: nothing where there is none."""
    return (
        calibrated.field.correction(readings(calibrated, conditions))
        if calibrated.field
        else np.zeros((conditions.shape[1], 3))
    )


def readings(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the joint readings (n_rows, n_joints) of packed conditions."""
    return np.asarray(conditions[: calibrated.model.robot.n_joints].T)


def rotation_variance(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the variance of each row's predicted orientation about the tool's own axes, shape (n_rows, 3) [rad²].

    What no measurement told of is as sure as its prior says (see `untold_turns`).
    """
    jacobian = calibrated.model.rotation_jacobian(calibrated.estimate, conditions)
    return of_parameters(jacobian, calibrated.covariance) + calibrated.discrepancy[RADIAN] ** 2


def untold_turns(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the share (3,) of the variance of the tool's turn about each own axis that no measurement told anything of.

    It comes from the directions of the parameters, scaled by their priors, whose variance the data left above UNTOLD of
    what the priors alone make it; mean over the rows.
    """
    sd = calibrated.model.prior_sd
    left, directions = np.linalg.eigh(calibrated.covariance / np.outer(sd, sd))
    turned = calibrated.model.rotation_jacobian(calibrated.estimate, conditions) @ (sd[:, None] * directions)
    parts = (turned**2).mean(axis=0) * np.maximum(left, 0.0)
    total = parts.sum(axis=1)
    return np.asarray(np.divide(parts[:, left > UNTOLD].sum(axis=1), total, out=np.zeros(3), where=total > 0))


def promised_variance(calibrated: CalibratedModel, data: Measurements, unit: MeasurementUnit) -> np.ndarray:
    """Return the mean square of each row's errors along each axis as the calibrated model promises it, the device's noise in it.

    Shape (n_rows, n_axes) [unit²]; 0 where a row has no value in the unit. data have the conditions that the model was stated for.
    """
    device = calibrated.noise(data).sigma[:, None] ** 2 if calibrated.noise_known else 0.0
    if unit == METRE and data.has_positions:
        return np.asarray(position_variance(calibrated, data.conditions) + device)
    there = np.isfinite(errors(calibrated.model, calibrated.estimate, data, unit))
    values = np.maximum(there.sum(axis=1), 1)
    return there * ((variance_in_unit(calibrated, data, unit, values) / values)[:, None] + device)


def variance_in_unit(
    calibrated: CalibratedModel, data: Measurements, unit: MeasurementUnit, values: np.ndarray
) -> np.ndarray:
    """Return the same of rows with so many values in the unit (n_rows,), without the device's noise where that is known."""
    slope = error_jacobian(calibrated.model, calibrated.estimate, data)
    of_parameters = np.einsum("nai,ij,naj->n", slope, calibrated.covariance, slope)
    left = calibrated.discrepancy[unit] if calibrated.noise_known else calibrated.noise(data).sigma
    return np.asarray(of_parameters + values * left**2)


def promised_distance(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the distances that positions are promised to, root mean square, shape (n_rows,) [m]."""
    return np.asarray(np.sqrt(position_variance(calibrated, conditions).sum(axis=1)))


def distance_moved(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return how far positions are expected from where the maker's figures put them, shape (n_rows,) [m]."""
    moved = calibrated.model.point(calibrated.model.nominal, conditions) - expected_point(calibrated, conditions)
    return np.asarray(np.linalg.norm(moved, axis=1))
