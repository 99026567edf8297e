"""The calibrated model: what predictions and all that builds on them need, and the tables that keep it.

It knows the conditions that it must be told of a row, the other models that explain the data about as well (Occam's window: models
far less likely than the best are left out, so that those few can be weighed in full; Madigan and Raftery 1994), how its fit ended,
and how sure its positions are, apart from the device that measures them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from typing import Any, Literal

import casadi as ca
import numpy as np
import scipy

from calflow.effects import Effect, effect_class
from calflow.effects.base import Carried, Cause
from calflow.estimation.accuracy import error_jacobian, errors, judged_unit
from calflow.estimation.error_model import ErrorModel, error_table, of_parameters, read_errors
from calflow.estimation.fit import Fit
from calflow.estimation.lack_of_fit import SIGNIFICANT, LackOfFit, NoiseDoubt
from calflow.estimation.least_squares import Loss
from calflow.estimation.noise import Noise, PerUnit, Source, representative, stated_noise
from calflow.estimation.parameters import FittedParameter, covariance_table
from calflow.estimation.residual_field import SUMMARY as FIELD
from calflow.estimation.residual_field import ResidualField, read_field
from calflow.files.deferred import pd
from calflow.files.problems import InputError, Problem, refuse
from calflow.files.tables import Results, column, to_frame
from calflow.files.toml import adapter
from calflow.files.units import METRE, RADIAN, SUFFIXES, MeasurementUnit
from calflow.files.words import mm
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import column_names, condition_columns
from calflow.model import Model
from calflow.observations import Observation, observation_kinds
from calflow.robot.frames import vector
from calflow.robot.mechanism import Row
from calflow.robot.parts import Base
from calflow.robot.robot import Robot

HOW_TO_GO_ON = '--without-conditions (missing = "widen") goes on with a wider standard deviation'


@dataclass(frozen=True, kw_only=True)
class NeededCondition:
    """A condition of a row on which it depends where the calibrated robot will be."""

    condition: str = column("its name: approach, travel, wrench, torque, time, temperature, order")
    effects: tuple[str, ...] = column("ids of the effects that depend on it")
    columns: str = column("the columns that state it, in words")
    spread_mm: float = column(
        "what the model is off without it, per axis: root mean square over the rows that were fitted", "mm"
    )


def needed_conditions(model: Model, estimate: np.ndarray, data: Measurements) -> tuple[NeededCondition, ...]:
    """Return the optional conditions on which the markers' places depend, and what each does over the rows fitted.

    It is read off the graph, so that an effect need not say what it looks at. What only the measuring device depends on is
    not where the robot will be.
    """
    rows = data.only(data.train)
    needed = []
    for condition in _depended_on(model):
        dependent = [
            effect.id for effect in model.effects if condition in _depended_on(replace(model, effects=(effect,)))
        ]
        left = tuple(name for name in model.given if name != condition)
        lost = _points(model, estimate, rows) - _points(replace(model, given=left), estimate, rows)
        needed.append(
            NeededCondition(
                condition=condition, effects=tuple(dict.fromkeys(dependent or (effect.id for effect in model.effects))),
                columns=_columns(condition, model.robot), spread_mm=1e3 * float(np.sqrt((lost**2).mean(axis=0)).max()),
            )
        )  # fmt: skip
    return tuple(needed)


def check_stated(needed: Iterable[NeededCondition], given: Sequence[str], instead: str = "") -> None:
    """Check that rows state what they must; instead says how to go on where they do not.

    Raises:
        InputError: they do not; with a problem for each effect and condition.
    """
    remedy = f"; {instead}" if instead else ""
    problems = [
        Problem(f"effect '{effect}' needs {need.columns}, which the rows lack{remedy}")
        for need in needed if need.condition not in given for effect in need.effects
    ]  # fmt: skip
    if problems:
        raise InputError(problems)


def _points(model: Model, estimate: np.ndarray, rows: Measurements) -> np.ndarray:
    """Where the markers are by what the model is given alone, shape (n_rows, 3) [m]."""
    return model.point(estimate, rows.stating(model.given).conditions)


AT_REST = ("speed", "acceleration")  # of which nobody need say that there is none


def _depended_on(model: Model) -> list[str]:
    """The optional conditions that a marker's place depends on, and that must be stated."""
    _, c, predicted = model.symbols
    depends = np.array(ca.which_depends(predicted.point, c, 1, False), dtype=bool)
    spans = Row.spans(model.robot, model.given)
    return [name for name, span in spans.items() if name in model.given and name not in AT_REST and depends[span].any()]


def _columns(condition: str, robot: Robot) -> str:
    """Name the columns of a condition, with the SI unit of those that have one."""
    dimensions = column_names(robot)
    names = condition_columns(condition, robot)
    if not set(names) <= set(dimensions):
        return "rows in measuring order"
    units = [SUFFIXES[dimensions[name]][0] if dimensions[name] else "" for name in names]
    spelled = [f"{name}_{unit}" if unit else name for name, unit in zip(names, units, strict=True)]
    return f"columns {spelled[0]} … {spelled[-1]}" if len(spelled) > 1 else f"a column {spelled[0]}"


@dataclass(frozen=True, kw_only=True)
class AlternativeParameter:
    """A parameter of a model that explains the data about as well: one cause gives way to a rival, or to nothing."""

    alternative: int = column("number of the model")
    probability: float = column("that it is this one, as far as the data tell")
    instead_of: int = column("which of the causes in effects.csv is not in it, in their order; 0: none of them")
    effect: str = column("id of the rival in its place, or of what is suspected besides; empty: none")
    part: str = column("the part of the robot that the rival is a cause of")
    variant: str = column("the figures that make its variant, as JSON")
    parameter: str = column("the parameter's name")
    estimate: float = column("what the fit found, in the parameter's SI unit")


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


def alternatives_table(alternatives: Sequence[Alternative], model: Model) -> pd.DataFrame:
    """Return the table of `AlternativeParameter`s beside a model."""
    causes = [effect for effect in model.effects if isinstance(effect, Cause)]
    rows = [
        AlternativeParameter(
            alternative=number, probability=other.probability,
            instead_of=causes.index(other.gone) + 1 if other.gone else 0,
            effect=other.rival.effect.id if other.rival else "", part=other.rival.part if other.rival else "",
            variant=other.rival.effect.figures_text if other.rival else "",
            parameter=parameter.name, estimate=float(estimate),
        )
        for number, other in enumerate(alternatives, start=1)
        for parameter, estimate in zip(other.model.parameters, other.estimate, strict=True)
    ]  # fmt: skip
    return to_frame(rows, AlternativeParameter)


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


@dataclass(frozen=True, kw_only=True)
class Solver:
    """How the solver ended."""

    name: str = column("which it was", default="IPOPT")
    status: str = column("what it says of its end")
    iterations: int = column("how many it made")

    @property
    def words(self) -> str:
        """The same in words."""
        return f"{self.name}: {self.status}, {self.iterations} iterations"


@dataclass(frozen=True, kw_only=True)
class FitSummary:
    """What is known of a fit's noise, and what the model leaves beyond it."""

    noise_sources: tuple[Source, ...] = column("where the noise of each series is known from: repeats, file, estimated")
    sigma_mm: float | None = column(
        "the noise of a row, per axis; of noise that grows with range, that at no distance; null: no lengths were measured",
        "mm",
    )
    noise_growth_mm_per_m: float = column("by how much the noise grows with range", "mm/m", default=0.0)
    discrepancy_mm: float = column(
        "what the model leaves of lengths beyond the noise, per axis; 0 without lengths", "mm"
    )
    rotation_discrepancy_mrad: float | None = column(
        "the same of orientations; null: not measured", "mrad", default=None
    )
    discrepancies: dict[str, float] = column(
        "what the model leaves beyond the noise, by the unit it is in: mm, mrad, px, …"
    )
    new_poses_mm: float | None = column(
        "root mean square distance by which poses like those measured, but not fitted, are to be missed, the device's noise not in "
        "it: by leaving out one training pose at a time; null: no lengths were measured",
        "mm",
        default=None,
    )
    new_poses_limit_mm: float | None = column(
        "what that is no more than with a probability of 95 %: its square is as unsure as the mean of as many squares as there are "
        "training poses; null: no lengths were measured",
        "mm",
        default=None,
    )
    rest_mm: float = column(
        "what positions err by, per axis, beside the parameters' errors, smooth errors (see errors.csv) and the device's noise, "
        "which is in it where it came from the fit; where no smooth error shows, as seen at training poses left out one at a time",
        "mm",
    )
    intraclass: float = column(
        "correlation of what the markers of a standstill err, axis by axis; 0: each for itself", default=0.0
    )
    loss: Loss = column("of the fit")
    reduced_chi2: float | None = column("chi² per degree of freedom; null: cannot be told, the noise came from the fit")
    lack_of_fit_p: float | None = column("chance of so much where the model is right; null: cannot be told")
    solver: Solver = column("name, status, iterations")
    converged: bool = column("whether the solver reached its optimum")

    @property
    def noise_known(self) -> bool:
        """Whether any of it is known apart from the fit."""
        return any(source != "estimated" for source in self.noise_sources)

    def discrepancy_of(self, observed: Sequence[Observation]) -> PerUnit:
        """Return the discrepancies in the units of what was observed."""
        units = {unit.label: unit for observation in observed for unit in observation.units}
        return PerUnit(tuple((units[label], size / units[label].scale) for label, size in self.discrepancies.items()))

    @property
    def lack_of_fit(self) -> float:
        """How many times the noise the model leaves; nan where the noise was estimated from the fit itself."""
        if not self.noise_known or self.reduced_chi2 is None:
            return float("nan")
        return float(np.sqrt(self.reduced_chi2))

    @property
    def lacks_fit(self) -> bool:
        """Whether the model leaves more than its noise, beyond chance."""
        return self.lack_of_fit_p is not None and self.lack_of_fit_p < SIGNIFICANT and self.lack_of_fit > 1

    @property
    def times_noise(self) -> float:
        """By how many times the device's noise poses like those measured are to be missed; 0 where that cannot be told."""
        if self.new_poses_mm is None or not self.sigma_mm:
            return 0.0
        return self.new_poses_mm / (float(np.sqrt(3)) * self.sigma_mm)

    @property
    def at_new_poses(self) -> str:
        """In words by how much new poses are to be missed; empty where no lengths were measured."""
        if self.new_poses_mm is None:
            return ""
        limit = f" (with 95 % certainty at most {mm(self.new_poses_limit_mm)} mm)" if self.new_poses_limit_mm else ""
        return f"{mm(self.new_poses_mm)} mm{limit}"


def fit_figures(
    fit: Fit, noise: Noise, lack: LackOfFit, new_poses: float, limit: float, errors: ErrorModel
) -> dict[str, Any]:
    """Return the fields of a `FitSummary` that a fit, its noise and its errors say; new_poses and its limit are in m."""
    turned = RADIAN in dict(noise.further)
    return {
        "noise_sources": noise.sources,
        "discrepancy_mm": 1e3 * noise.discrepancy[METRE],
        "rotation_discrepancy_mrad": 1e3 * noise.discrepancy[RADIAN] if turned else None,
        "discrepancies": {unit.label: unit.shown(size) for unit, size in noise.discrepancy.sizes},
        "new_poses_mm": None if np.isnan(new_poses) else 1e3 * new_poses,
        "new_poses_limit_mm": None if np.isnan(limit) else 1e3 * limit,
        "rest_mm": 1e3 * errors.rest,
        "loss": fit.loss,
        "reduced_chi2": lack.reduced_chi2 if noise.known else None,
        "lack_of_fit_p": lack.p if noise.known else None,
        "solver": Solver(status=fit.status, iterations=fit.iterations),
        "converged": fit.converged,
    }


@dataclass(frozen=True, kw_only=True)
class Extrapolation:
    """A joint whose held-out readings lie beyond what was fitted: accuracy there is a guess, good or bad."""

    joint: int = column("its number")
    rows: int = column("held-out rows beyond the fitted readings")

    @property
    def words(self) -> str:
        """The same in words."""
        return f"joint {self.joint}: {self.rows} held-out rows lie beyond the readings that were fitted"


@dataclass(frozen=True, kw_only=True)
class IdentifySummary(FitSummary):
    """How identify ended: noise, lack of fit, what the data determine, and the solver."""

    spread_mm: float = column("mean distance of the measured points from their middle", "mm")
    rank: int = column("number of directions that the data determine")
    parameters: int = column("number of parameters")
    rank_by_effect: dict[str, int] = column("directions that each effect adds, by its id")
    effective_parameters: float = column("parameters that the data determine rather than the prior")
    training_poses: int = column("poses that were fitted")
    heldout_poses: int = column("poses that were held out")
    equilibrium_error_um: float = column("how far a fourth turn of the equilibrium would move any pose", "um")
    starts: int = column("fits from different starting points")
    starts_agreeing: int = column("of which came to the same result")
    extrapolation: tuple[Extrapolation, ...] = column("joints held out beyond what was fitted: joint, rows", default=())
    noise_doubts: tuple[NoiseDoubt, ...] = column(
        "stated noises that repeats or the fit contradict: series, sizes, p", default=()
    )
    time_origin_s: float | None = column(
        "reading of the clock that times count from; null: no times", "s", default=None
    )
    conditions: tuple[str, ...] = column(
        "the optional conditions that the measurements state: approach, travel, wrench, …", default=()
    )
    notes: tuple[str, ...] = column(
        "what was assumed of the measurements, and which rows have no measured value", default=()
    )


MANY = 20  # parameters of one cause, beyond which sampling them would take days and say nothing new
ROBOT_FILE, REGISTERED = "robot file", "registered"  # where a place is from
NOT_TURNED = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class ModelEffect:
    """An effect of the model, in its order."""

    effect: str = column("its id")
    part: str = column("the part of the robot that it is a cause of; empty: all")
    variant: str = column("the figures that make its variant, as JSON")


@dataclass(frozen=True, kw_only=True)
class ModelObservation:
    """A series of measurements as the model observes it."""

    kind: str = column("id of the observation")
    series: str = column("name of the series; empty: the only one")
    observation: str = column("all that makes it, as JSON")


@dataclass(frozen=True, kw_only=True)
class DeviceNoise:
    """The noise of a series of measurements, as far as one is stated for all its values."""

    series: str = column("its name; empty: the only one")
    kind: str = column("id of its observation")
    source: Source = column("where the noise is known from")
    sigma_mm: float = column(
        "of a single row, per axis; of noise that grows with range, that at no distance; empty: `unit` is another", "mm",
        default=float("nan"),
    )  # fmt: skip
    growth_mm_per_m: float = column("by how much it grows with range", "mm/m", default=0.0)
    typical_mm: float = column(
        "rms over the rows, at the ranges where they were measured, per axis", "mm", default=float("nan")
    )
    unit: str = column("the unit that sigma and typical are in: mm, mrad, px, …", default=METRE.label)
    sigma: float = column("as sigma_mm, in `unit`")
    typical: float = column("as typical_mm, in `unit`")


@dataclass(frozen=True, kw_only=True)
class Placed:
    """Where base, markers, tool and what was observed are that the parameters refer to."""

    what: str = column("base, a marker's name, tool, or what a series observes")
    x_m: float = column("its place: a marker's in the flange's frame, else in the measuring frame", "m")
    y_m: float = column("the same along y", "m")
    z_m: float = column("the same along z", "m")
    rx_deg: float = column("its turn about x, then y, then z", "deg")
    ry_deg: float = column("the same about y", "deg")
    rz_deg: float = column("the same about z", "deg")
    kind: str = column("base, marker, tool or observation")
    source: str = column("who says so: the robot file, or registered by the training data")
    rx_rad: float = column("rx_deg to the last bit", "rad")
    ry_rad: float = column("ry_deg to the last bit", "rad")
    rz_rad: float = column("rz_deg to the last bit", "rad")


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


def identified(robot: Robot, results: Results, given: tuple[str, ...]) -> CalibratedModel:
    """Rebuild the model that identify fitted, for rows with these optional conditions."""
    return _read("identify", robot, results, given)


def calibrated(robot: Robot, results: Results, given: tuple[str, ...]) -> CalibratedModel:
    """Rebuild the best model there is: the one that diagnose extended, else identify's; with the residual field if there is one."""
    field = read_field(results, robot) if FIELD in results else None
    if "diagnose/effects.csv" not in results:
        return replace(identified(robot, results, given), field=field)
    model = _read("diagnose", robot, results, given)
    alternatives = _alternatives(results.rows("diagnose/alternatives.csv", AlternativeParameter), model.model)
    return replace(model, alternatives=alternatives, field=field)


def _alternatives(rows: Sequence[AlternativeParameter], model: Model) -> tuple[Alternative, ...]:
    alternatives = []
    for _, group in groupby(rows, key=lambda row: row.alternative):
        rows_of = list(group)
        first = rows_of[0]
        causes = [effect for effect in model.effects if isinstance(effect, Cause)]
        gone = causes[first.instead_of - 1] if first.instead_of else None
        come = [effect for effect in read_effects([first], model.robot) if isinstance(effect, Cause)]
        effects = (*(effect for effect in model.effects if effect != gone), *come)
        estimate = np.array([row.estimate for row in rows_of])
        other = replace(model, effects=effects)
        alternatives.append(Alternative(other, estimate, first.probability, gone, next(iter(come), None)))
    return tuple(alternatives)


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


def effect_table(effects: Sequence[Effect]) -> pd.DataFrame:
    """Return the table of `ModelEffect`s."""
    rows = []
    for effect in effects:
        whole, part = (effect.effect, effect.part) if isinstance(effect, Cause) else (effect, "")
        rows.append(ModelEffect(effect=whole.id, part=part, variant=whole.figures_text))
    return to_frame(rows, ModelEffect)


def read_effects(rows: Sequence[ModelEffect | AlternativeParameter], robot: Robot) -> tuple[Effect, ...]:
    """Rebuild the effects that rows name; a row may name none."""
    effects: list[Effect] = []
    for row in (row for row in rows if row.effect):
        whole = _kind(row.effect).of_figures(robot, row.variant)
        effects.append(Cause(robot, whole, row.part) if row.part else whole)
    return tuple(effects)


def observation_table(observed: Sequence[Observation]) -> pd.DataFrame:
    """Return the table of `ModelObservation`s."""
    rows = [
        ModelObservation(
            kind=observation.id, series=observation.series.name, observation=json.dumps(asdict(observation))
        )
        for observation in observed
    ]
    return to_frame(rows, ModelObservation)


def read_observations(rows: Sequence[ModelObservation]) -> tuple[Observation, ...]:
    """Rebuild the observations that `observation_table` wrote."""
    return tuple(adapter(observation_kinds()[row.kind]).validate_json(row.observation) for row in rows)


def model_tables(stage: str, calibrated: CalibratedModel) -> dict[str, pd.DataFrame]:
    """Return the tables that a stage keeps its model in, by their paths: parameters, observations and rivals apart."""
    model = calibrated.model
    tables = {
        "covariance": covariance_table(model.parameters, calibrated.covariance),
        "errors": error_table(calibrated.errors, model),
        "effects": effect_table(model.effects),
        "noise": noise_table(calibrated.device, model.observations),
        "needed_conditions": to_frame(calibrated.needed, NeededCondition),
    }
    return {f"{stage}/{name}.csv": table for name, table in tables.items()}


def noise_table(devices: Sequence[SeriesNoise], observed: Sequence[Observation]) -> pd.DataFrame:
    """Return the table of `DeviceNoise`."""
    rows = []
    for device, observation in zip(devices, observed, strict=True):
        unit = observation.units[0]
        sigma, typical = unit.shown(device.sigma), unit.shown(device.at_rows)
        lengths = {"sigma_mm": sigma, "typical_mm": typical} if unit == METRE else {}
        rows.append(
            DeviceNoise(
                series=observation.series.name, kind=observation.id, source=device.source, unit=unit.label, sigma=sigma,
                typical=typical, growth_mm_per_m=1e3 * device.growth, **lengths,
            )
        )  # fmt: skip
    return to_frame(rows, DeviceNoise)


def series_noise(noise: Noise, growth: tuple[float, float] | None = None) -> tuple[SeriesNoise, ...]:
    """Return the noise of each series; growth is its floor [m] and slope [m/m]."""
    devices = []
    for k, source in enumerate(noise.sources):
        typical = float(np.sqrt(np.mean(noise.sigma[noise.of_series(k)] ** 2)))
        sigma, slope = growth or (typical, 0.0)
        devices.append(SeriesNoise(sigma, source, slope, typical))
    return tuple(devices)


def _read_noise(rows: Sequence[DeviceNoise], observed: Sequence[Observation]) -> tuple[SeriesNoise, ...]:
    scales = [observation.units[0].scale for observation in observed]
    return tuple(
        SeriesNoise(row.sigma / scale, row.source, row.growth_mm_per_m / 1e3, row.typical / scale)
        for row, scale in zip(rows, scales, strict=True)
    )


def placement_table(robot: Robot, observed: Sequence[Observation]) -> pd.DataFrame:
    """Return the table of what is `Placed`: as the robot file says, or registered by the training data."""
    source = ROBOT_FILE if robot.base.known else REGISTERED
    placed = [("base", robot.base.origin, robot.base.rotation, "base", source)]
    placed += [
        (name, marker.point, NOT_TURNED, "marker", source if marker.known else REGISTERED)
        for name, marker in robot.markers.items()
    ]
    if robot.tool_rotation is not None:
        placed.append(("tool", (0.0, 0.0, 0.0), robot.tool_rotation, "tool", source))
    seen = [placement for observation in observed for placement in observation.placements]
    placed += [(placement.what, placement.origin, placement.rotation, "observation", REGISTERED) for placement in seen]
    rows = []
    for what, (x, y, z), turn, kind, origin_of in placed:
        rx, ry, rz = (float(angle) for angle in np.rad2deg(turn))
        exact = dict(zip(("rx_rad", "ry_rad", "rz_rad"), turn, strict=True))
        rows.append(
            Placed(
                what=what, x_m=x, y_m=y, z_m=z, rx_deg=rx, ry_deg=ry, rz_deg=rz, kind=kind, source=origin_of, **exact
            )
        )
    return to_frame(rows, Placed)


def placed(robot: Robot, results: Results) -> Robot:
    """Return the robot with base and markers where identify's errors refer to."""
    observed = read_observations(results.rows("identify/observations.csv", ModelObservation))
    if not any(observation.from_outside for observation in observed):
        return replace(robot, base=Base(fixed=True))
    rows = results.rows("identify/placement.csv", Placed)
    if all(row.source == ROBOT_FILE for row in rows):
        return robot
    at = {(row.kind, row.what): vector((row.x_m, row.y_m, row.z_m)) for row in rows}  # a marker may be called 'tool'
    turn = {row.kind: vector((row.rx_rad, row.ry_rad, row.rz_rad)) for row in rows}
    base = robot.base if robot.base.known else Base(origin=at["base", "base"], rotation=turn["base"], known=False)
    markers = {name: replace(marker, point=at["marker", name]) for name, marker in robot.markers.items()}
    tool = robot.tool_rotation and turn["tool"]
    return replace(robot, base=base, markers=markers, tool_rotation=tool)


def _read(stage: str, robot: Robot, results: Results, given: tuple[str, ...]) -> CalibratedModel:
    robot = placed(robot, results)
    observed = read_observations(results.rows("identify/observations.csv", ModelObservation))
    effects = read_effects(results.rows(f"{stage}/effects.csv", ModelEffect), robot)
    model = Model(robot, effects, given, observed)
    parameters = [row for row in results.rows(f"{stage}/parameters.csv", FittedParameter) if not row.fixed]
    covariance = results.tables.get(f"{stage}/covariance.csv", pd.DataFrame())
    names = [parameter.name for parameter in model.parameters]
    for name, stated in (
        ("parameters", [parameter.parameter for parameter in parameters]),
        ("covariance", list(covariance)[1:]),
    ):
        if names != stated:
            raise refuse(f"{stage}/{name}.csv does not fit the study's robot and effects; run {stage} again")
    needed = results.rows(f"{stage}/needed_conditions.csv", NeededCondition)
    time_origin = results.document("identify/summary.json", IdentifySummary).time_origin_s
    return CalibratedModel(
        model,
        np.array([parameter.estimate for parameter in parameters]),
        covariance.iloc[:, 1:].to_numpy(dtype=float),
        np.array([parameter.at_bound for parameter in parameters], dtype=bool),
        **read_error_model(stage, results, model.observations),
        errors=read_errors(results.tables[f"{stage}/errors.csv"], model),
        needed=tuple(needed),
        time_origin=time_origin,
    )


def read_error_model(stage: str, results: Results, observed: Sequence[Observation]) -> dict[str, Any]:
    """Return the sizes of the errors as a stage's tables state them, by the fields of `CalibratedModel`.

    Of a figure in mm only so many bits come back as are the same in m: whoever keeps a model in tables goes on with these.
    """
    summary = results.document(f"{stage}/summary.json", FitSummary)
    return {
        "device": _read_noise(results.rows(f"{stage}/noise.csv", DeviceNoise), observed),
        "discrepancy": summary.discrepancy_of(observed),
        "loss": summary.loss,
        "intraclass": summary.intraclass,
    }


def _kind(effect: str) -> type[Effect]:
    kind = effect_class(effect)
    if kind is None:
        raise refuse(
            f"the run has effect '{effect}', which is unknown here: install the package that it came from, or define or import "
            "its class before you load it"
        )
    return kind


PART_ROWS = 100_000  # whose Jacobian is there at once: enough for machine code to pay
# mean length of so many unit normals
MEAN_OF_NOISE = np.sqrt(np.array([0, 2, np.pi / 2, 8]) / np.array([1, np.pi, 1, np.pi]))
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


PROMISED = 0.95  # share of errors that are promised to be below their limit


def tested_rows(calibrated: CalibratedModel, data: Measurements, error: np.ndarray) -> pd.DataFrame:
    """Return pose, error and promised limit of the rows that no fit has seen, of very many such as tell as much.

    Args:
        calibrated: the calibrated model, without a residual field.
        data: rows that have the conditions that the model was stated for.
        error: size of what the model leaves of each, (n_rows,) in the unit by which it is judged; nan where there is none.
    """
    rows = data.held_out & np.isfinite(error)
    rows[rows] = representative(data.only(rows))
    held, unit = data.only(rows), judged_unit(_leading(calibrated.model))
    limit = promised_limits(calibrated, held, unit) if rows.any() else np.zeros(0)
    return pd.DataFrame({"pose": held.table["pose"].to_numpy(), "error": error[rows], "limit": limit})


def promised_limits(calibrated: CalibratedModel, data: Measurements, unit: MeasurementUnit) -> np.ndarray:
    """Return what 95 % of the errors of rows are promised to be below, shape (n_rows,) [unit].

    The squares' sum of normal errors along axes is taken for a gamma variable of its mean and variance (Satterthwaite 1946).
    """
    variance = promised_variance(calibrated, data, unit)
    total = variance.sum(axis=1)
    freedom = total**2 / (variance**2).sum(axis=1)
    return np.asarray(unit.shown(np.sqrt(total * scipy.special.chdtri(freedom, 1 - PROMISED) / freedom)))


MISSED = 2  # times the limit of 95 % of errors: normal errors are beyond it once in ten thousand rows at most
WORST = 50  # poses, those of the largest errors, that are held against it


@dataclass(frozen=True, kw_only=True)
class MissedPose:
    """A pose that is off by far more than the calibrated model promises."""

    pose: str = column("its name")
    line: int = column("the line of the measurement file with its largest error")
    split: Literal["train", "holdout"] = column("whether it was fitted or held out")
    error: float = column("its largest error, in the unit by which the model is judged")
    limit: float = column("what 95 % of such errors are promised to be below, in that unit")


def missed_poses(
    calibrated: CalibratedModel, data: Measurements, residuals: pd.DataFrame, error: np.ndarray
) -> tuple[MissedPose, ...]:
    """Return the poses, fitted or held out, that are off by many times what is promised, the worst first.

    Args:
        calibrated: the calibrated model, without a residual field.
        data: rows that have the conditions that the model was stated for.
        residuals: what the model leaves of them (see `Residual`).
        error: size of that, (n_rows,) in the unit by which the model is judged; nan where there is none.
    """
    there = np.flatnonzero(np.isfinite(error))
    by_pose = pd.Series(error[there], index=there).groupby(residuals["pose"].to_numpy()[there])
    largest = by_pose.idxmax().to_numpy(dtype=int)
    worst = np.sort(largest[np.argsort(-error[largest], kind="stable")][:WORST])
    rows, unit = data.only(np.isin(np.arange(len(data)), worst)), judged_unit(_leading(calibrated.model))
    limits, table = promised_limits(calibrated, rows, unit), residuals.iloc[worst]
    missed = [
        MissedPose(pose=str(pose), line=int(line), split=split, error=float(size), limit=float(limit))
        for pose, line, split, size, limit in zip(
            table["pose"], table["line"], table["split"], error[worst], limits, strict=True
        )
        if size > MISSED * limit
    ]
    return tuple(sorted(missed, key=lambda pose: -pose.error))


def _leading(model: Model) -> list[MeasurementUnit]:
    return [observation.units[0] for observation in model.observations]


def variance_in_unit(
    calibrated: CalibratedModel, data: Measurements, unit: MeasurementUnit, values: np.ndarray
) -> np.ndarray:
    """Return the same of rows with so many values in the unit (n_rows,), without the device's noise where that is known."""
    slope = error_jacobian(calibrated.model, calibrated.estimate, data)
    of_parameters = np.einsum("nai,ij,naj->n", slope, calibrated.covariance, slope)
    left = calibrated.discrepancy[unit] if calibrated.noise_known else calibrated.noise(data).sigma
    return np.asarray(of_parameters + values * left**2)


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """How sure a calibrated model, without a residual field, is of the rows by which it is judged: held out, else fitted."""

    points: int = column("measured points that were used")
    markers: tuple[str, ...] = column("their markers")
    payloads: tuple[str, ...] = column("their payloads")
    split: Literal["train", "holdout"] = column("the rows by which it is judged, which have values in `unit`")
    unit: str = column("the unit by which it is judged: mm, mrad, px, …")
    left: float = column("mean error, in `unit`")
    noise: str = column("the noise of the rows, in words")
    noise_floor: float | None = column(
        "mean error that noise alone would give, in `unit`; null: only the fit tells the noise"
    )
    model_sd_mm: float = column("how sure its parameters make its positions: root mean square", "mm")
    prediction_sd_mm: float = column("the same with the choice of the model and its own error", "mm")
    rivals: bool = column("whether other models explain the data about as well")
    tested: int = column(
        "errors of rows that no fit has seen, held against their limits: what 95 % are to be below", default=0
    )
    within: int = column("how many of them are below it", default=0)
    within_chance: float = column("chance of so few where the limits are right; each pose counts once", default=1.0)
    reach_m: tuple[float, ...] = column(
        "the least and the largest horizontal distance from the first axis of the rows by which it is judged",
        "m",
        default=(),
    )
    heights_m: tuple[float, ...] = column(
        "the least and the largest height of them, z in the measuring frame", "m", default=()
    )
    no_gain: float = column(
        "share of the measured rows at which the tool is promised no closer than it was moved from the maker's figures",
        default=0.0,
    )
    missed: tuple[MissedPose, ...] = column(
        "poses that are off by far more than is promised: pose, line, split, error, limit", default=()
    )

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, residuals: pd.DataFrame) -> Certainty:
        """Return that of a model, its rows as they were fitted, and what it leaves of them (see `Residual`)."""
        calibrated, used = replace(calibrated, field=None), (data.train | data.held_out)
        data, residuals = data.only(used), residuals[used]
        units = [observation.units for observation in calibrated.model.observations]
        unit = judged_unit([kinds[0] for kinds in units])
        distance = errors_in(residuals, unit.label)
        there = np.isfinite(distance)
        held = bool((data.held_out & there).any())
        judged = (data.held_out if held else data.train) & there
        some = data.conditions[:, np.flatnonzero(judged)[representative(data.only(judged))]]
        variances = (of_rows(calibrated, some) for of_rows in (parameter_variance, position_variance))
        model_sd, prediction_sd = (1e3 * float(np.sqrt(variance.sum(axis=1).mean())) for variance in variances)
        noise = calibrated.noise(data)
        mean = MEAN_OF_NOISE[np.array([kinds.count(kinds[0]) for kinds in units])[data.series_number]]
        floor = float((mean * unit.scale * noise.sigma)[judged].mean())
        place = calibrated.model.point(calibrated.estimate, some)
        reach = np.linalg.norm(place[:, :2] - calibrated.model.robot.base.origin[:2], axis=1)
        tested = tested_rows(calibrated, data, distance)
        below = tested["error"] <= tested["limit"]
        beyond = float((~below).groupby(tested["pose"]).mean().sum())  # poses: their rows err alike
        poses = tested["pose"].nunique()
        named = ([str(name) for name in data.table[column].unique()] for column in ("marker", "payload"))
        markers, payloads = (tuple(name for name in names if name) for names in named)
        return Certainty(
            points=len(data), markers=markers, payloads=payloads, split="holdout" if held else "train", unit=unit.label,
            left=float(distance[judged].mean()), noise=noise.words, noise_floor=floor if calibrated.noise_known else None,
            model_sd_mm=model_sd, prediction_sd_mm=prediction_sd, rivals=bool(calibrated.alternatives),
            reach_m=(float(reach.min()), float(reach.max())),
            heights_m=(float(place[:, 2].min()), float(place[:, 2].max())), tested=len(tested), within=int(below.sum()),
            within_chance=float(scipy.special.betainc(beyond, poses - beyond + 1, 1 - PROMISED)) if beyond else 1.0,
            no_gain=_no_gain(calibrated, data), missed=missed_poses(calibrated, data, residuals, distance),
        )  # fmt: skip


def _no_gain(calibrated: CalibratedModel, data: Measurements) -> float:
    conditions = data.conditions[:, representative(data)]
    return float((promised_distance(calibrated, conditions) >= distance_moved(calibrated, conditions)).mean())


def promised_distance(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return the distances that positions are promised to, root mean square, shape (n_rows,) [m]."""
    return np.asarray(np.sqrt(position_variance(calibrated, conditions).sum(axis=1)))


def distance_moved(calibrated: CalibratedModel, conditions: np.ndarray) -> np.ndarray:
    """Return how far positions are expected from where the maker's figures put them, shape (n_rows,) [m]."""
    moved = calibrated.model.point(calibrated.model.nominal, conditions) - expected_point(calibrated, conditions)
    return np.asarray(np.linalg.norm(moved, axis=1))


def errors_in(residuals: pd.DataFrame, label: str) -> np.ndarray:
    """Return the size of each row's error, shape (n_rows,), in the unit of a label; nan where its values are in another."""
    if label == METRE.label:
        return residuals["error_mm"].to_numpy(dtype=float)
    return residuals["error"].where(residuals["unit"] == label).to_numpy(dtype=float)
