"""The tables and summaries of a run folder that hold a calibrated model and its fit, and the model read back from them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from calflow.effects import Effect, effect_class
from calflow.effects.cause import Cause
from calflow.estimation.calibrated_model import Alternative, CalibratedModel, SeriesNoise
from calflow.estimation.certainty import Certainty
from calflow.estimation.error_model import error_table, read_errors
from calflow.estimation.fit import Fit
from calflow.estimation.lack_of_fit import SIGNIFICANT, LackOfFit, NoiseDoubt
from calflow.estimation.least_squares import Loss
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.noise import PerUnit, Source
from calflow.estimation.parameters import FittedParameter, covariance_table
from calflow.estimation.registration import about_places
from calflow.estimation.residual_field import read_field
from calflow.estimation.smooth_functions import SmoothFunction
from calflow.files.deferred import pd
from calflow.files.plugins import subclasses
from calflow.files.problems import refuse
from calflow.files.tables import Results, column, to_frame
from calflow.files.toml import adapter
from calflow.files.units import METRE
from calflow.files.words import mm, plural
from calflow.model import Model
from calflow.observations import Observation, observation_kinds
from calflow.robot.frames import Vector, vector
from calflow.robot.parts import Base
from calflow.robot.robot import Robot

ROBOT_FILE, REGISTERED = "robot file", "registered"  # the origin of a place
NOT_TURNED = (0.0, 0.0, 0.0)
FUNCTIONS = {kind.__name__: kind for kind in subclasses(SmoothFunction)}  # by the names in an error table


@dataclass(frozen=True, kw_only=True)
class ModelEffect:
    """An effect of the model, in its order."""

    effect: str = column("its id")
    part: str = column("the part of the robot that it is a cause of; empty: all")
    variant: str = column("the figures of its variant, as JSON")
    prior_scale: float = column("its priors' standard deviations, over those of a cause of usual size", default=1.0)


@dataclass(frozen=True, kw_only=True)
class AlternativeModel:
    """Another model that explains the data about as well: one cause is replaced, added or left out."""

    probability: float = column("its posterior probability")
    instead_of: int = column("number of the cause in effects.csv that it lacks, from 1 in their order; 0: none")
    rival: ModelEffect | None = column("the cause that replaces it, or is added; null: none")
    estimates: dict[str, float] = column("the fitted values by parameter, in SI units")


@dataclass(frozen=True, kw_only=True)
class ModelObservation:
    """The observation of a series of measurements."""

    kind: str = column("id of the observation")
    observation: str = column("all its fields, as JSON, the name of the series among them")


@dataclass(frozen=True, kw_only=True)
class Placed:
    """The place of base, markers, tool and observed objects to which the parameters refer."""

    what: str = column("base, a marker's name, tool, or the object that a series observes")
    x_m: float = column("its place: a marker's in the flange's frame, else in the measuring frame", "m")
    y_m: float = column("the same along y", "m")
    z_m: float = column("the same along z", "m")
    rx_deg: float = column("its rotation about x, then y, then z", "deg")
    ry_deg: float = column("the same about y", "deg")
    rz_deg: float = column("the same about z", "deg")
    kind: str = column("base, marker, tool or observation")
    source: str = column("its source: the robot file, or registered by the training data")
    rx_rad: float = column("rx_deg to the last bit", "rad")
    ry_rad: float = column("ry_deg to the last bit", "rad")
    rz_rad: float = column("rz_deg to the last bit", "rad")


@dataclass(frozen=True, kw_only=True)
class Solver:
    """The solver's exit."""

    name: str = column("its name", default="IPOPT")
    status: str = column("its return status")
    iterations: int = column("number of iterations")

    @property
    def words(self) -> str:
        return f"{self.name}: {self.status}, {plural(self.iterations, 'iteration')}"


@dataclass(frozen=True, kw_only=True)
class FitSummary:
    """The noise of a fit, and the discrepancy of the model beyond it."""

    noise_sources: tuple[Source, ...] = column("source of each series' noise: repeats, file, estimated")
    sigma_mm: float | None = column(
        "the noise of a row, per axis; of noise that grows with range, its value at zero range; null: no lengths were measured",
        "mm",
    )
    discrepancies: dict[str, float] = column(
        "standard deviation of the model's error beyond the noise, by unit: mm, mrad, px, …"
    )
    new_poses_mm: float | None = column(
        "root mean square error expected at new poses like those measured, without the device's noise, by leave-one-pose-out "
        "cross-validation of the training poses; null: no lengths were measured",
        "mm",
        default=None,
    )
    new_poses_limit_mm: float | None = column(
        "its upper 95 % confidence limit, by an F distribution of its square; null: no lengths were measured",
        "mm",
        default=None,
    )
    rest_mm: float = column(
        "standard deviation of position errors, per axis, beyond the parameters' errors, smooth errors (see errors.csv) and the "
        "device's noise, which is included if estimated from the fit; without smooth errors by leave-one-pose-out errors",
        "mm",
    )
    alternatives: tuple[AlternativeModel, ...] = column(
        "other models that explain the data about as well: probability, the cause that each lacks, its rival, estimates",
        default=(),
    )
    noise: tuple[SeriesNoise, ...] = column(
        "noise of each series, in SI units or px: sigma of a row per axis (at zero range), typical over the rows, growth with "
        "range, and factors of what label names"
    )
    intraclass: float = column(
        "correlation of the errors of markers at one standstill, axis by axis; 0: independent", default=0.0
    )
    loss: Loss = column("of the fit")
    reduced_chi2: float | None = column("chi² per degree of freedom; null: the noise was estimated from the fit")
    lack_of_fit_p: float | None = column("p-value of the lack of fit; null: the noise was estimated from the fit")
    solver: Solver = column("name, status, iterations")
    converged: bool = column("whether the solver reached its optimum")
    noise_doubts: tuple[NoiseDoubt, ...] = column(
        "stated noises that repeats or the fit contradict: series, session, marker, sizes, p", default=()
    )

    @property
    def noise_known(self) -> bool:
        return any(source != "estimated" for source in self.noise_sources)

    def discrepancy(self, observed: Sequence[Observation]) -> PerUnit:
        """Return the model's discrepancy in SI units, given its observations."""
        units = {unit.label: unit for observation in observed for unit in observation.units}
        return PerUnit(tuple((units[label], size / units[label].scale) for label, size in self.discrepancies.items()))

    @property
    def discrepancy_mm(self) -> float:
        """Standard deviation of the model's error of lengths beyond the noise, per axis; 0 without lengths."""
        return self.discrepancies.get(METRE.label, 0.0)

    @property
    def lack_of_fit(self) -> float:
        """Residuals over the noise, root mean square; nan where the noise was estimated from the fit itself."""
        if not self.noise_known or self.reduced_chi2 is None:
            return float("nan")
        return float(np.sqrt(self.reduced_chi2))

    @property
    def lacks_fit(self) -> bool:
        return self.lack_of_fit_p is not None and self.lack_of_fit_p < SIGNIFICANT and self.lack_of_fit > 1

    @property
    def times_noise(self) -> float:
        """Error expected at new poses over the device's noise; 0 where either is unknown."""
        if self.new_poses_mm is None or not self.sigma_mm:
            return 0.0
        return self.new_poses_mm / (float(np.sqrt(3)) * self.sigma_mm)

    @property
    def at_new_poses(self) -> str:
        """The error expected at new poses, in words; empty where no lengths were measured."""
        if self.new_poses_mm is None:
            return ""
        limit = f" (with 95 % certainty at most {mm(self.new_poses_limit_mm)} mm)" if self.new_poses_limit_mm else ""
        besides = "" if self.noise_known else ", in addition to what the fit leaves"
        return f"{mm(self.new_poses_mm)} mm{limit}{besides}"


def fit_figures(
    fit: Fit, calibrated: CalibratedModel, lack: LackOfFit, new_poses: float, limit: float
) -> dict[str, Any]:
    """Return the fields of a `FitSummary` from a fit and its model; new_poses and its limit are in m."""
    return {
        "noise_sources": tuple(device.source for device in calibrated.device),
        "noise": calibrated.device,
        "discrepancies": {unit.label: unit.shown(size) for unit, size in calibrated.discrepancy.sizes},
        "alternatives": alternative_models(calibrated.alternatives, calibrated.model),
        "intraclass": calibrated.intraclass,
        "new_poses_mm": None if np.isnan(new_poses) else 1e3 * new_poses,
        "new_poses_limit_mm": None if np.isnan(limit) else 1e3 * limit,
        "rest_mm": 1e3 * calibrated.errors.rest[METRE],
        "loss": fit.loss,
        "reduced_chi2": lack.reduced_chi2 if calibrated.noise_known else None,
        "lack_of_fit_p": lack.p if calibrated.noise_known else None,
        "solver": Solver(status=fit.status, iterations=fit.iterations),
        "converged": fit.converged,
    }


@dataclass(frozen=True, kw_only=True)
class IdentifySummary(FitSummary):
    """The result of identify: noise, lack of fit, identifiability and solver."""

    spread_mm: float = column("mean distance of the measured points from their centroid", "mm")
    rank: int = column("number of directions that the data determine")
    parameters: int = column("number of parameters")
    rank_by_effect: dict[str, int] = column("directions that each effect adds, by its id")
    effective_parameters: float = column("effective number of parameters that the data determine rather than the prior")
    training_poses: int = column("poses that were fitted")
    heldout_poses: int = column("poses that were held out")
    equilibrium_error_um: float = column("largest change of a position by a fourth iteration of the equilibrium", "um")
    starts: int = column("number of fits from different starting points")
    starts_agreeing: int = column("number of them that reached the same optimum")
    extrapolation: tuple[int, ...] = column("numbers of the joints held out beyond the fitted range", default=())
    time_origin_s: float | None = column("clock reading from which times count; null: no times", "s", default=None)
    conditions: tuple[str, ...] = column(
        "the optional conditions that the measurements state: approach, travel, wrench, …", default=()
    )
    notes: tuple[str, ...] = column(
        "assumptions about the measurements, and the rows without a measured value", default=()
    )


def model_tables(stage: str, calibrated: CalibratedModel) -> dict[str, pd.DataFrame]:
    """Return the tables that hold a stage's model, by path, except parameters, observations and alternatives."""
    model = calibrated.model
    tables = {
        "covariance": covariance_table(model.parameters, calibrated.covariance),
        "errors": error_table(calibrated.errors, model),
        "effects": effect_table(model.effects),
        "needed_conditions": to_frame(calibrated.needed, NeededCondition),
    }
    return {f"{stage}/{name}.csv": table for name, table in tables.items()}


def alternative_models(alternatives: Sequence[Alternative], model: Model) -> tuple[AlternativeModel, ...]:
    """Return the alternatives to a model as its summary holds them."""
    return tuple(
        AlternativeModel(
            probability=other.probability, instead_of=model.causes.index(other.gone) + 1 if other.gone else 0,
            rival=_model_effect(other.rival) if other.rival else None,
            estimates=dict(zip((p.name for p in other.model.parameters), other.estimate.tolist(), strict=True)),
        )
        for other in alternatives
    )  # fmt: skip


def effect_table(effects: Sequence[Effect]) -> pd.DataFrame:
    """Return the table of `ModelEffect`s."""
    return to_frame(map(_model_effect, effects), ModelEffect)


def _model_effect(effect: Effect) -> ModelEffect:
    if isinstance(effect, Cause):
        return replace(_model_effect(effect.effect), part=effect.part, prior_scale=effect.scale)
    return ModelEffect(effect=effect.id, part="", variant=effect.figures_text)


def observation_table(observed: Sequence[Observation]) -> pd.DataFrame:
    """Return the table of `ModelObservation`s."""
    rows = (ModelObservation(kind=each.id, observation=json.dumps(asdict(each))) for each in observed)
    return to_frame(rows, ModelObservation)


def placement_table(robot: Robot, observed: Sequence[Observation]) -> pd.DataFrame:
    """Return the table of `Placed` objects: places from the robot file, or registered by the training data."""
    source = ROBOT_FILE if robot.base.known else REGISTERED
    rows = [_placed("base", robot.base.origin, robot.base.rotation, "base", source)]
    rows += [
        _placed(name, marker.point, NOT_TURNED, "marker", source if marker.known else REGISTERED)
        for name, marker in robot.markers.items()
    ]
    if robot.tool_rotation is not None:
        rows.append(_placed("tool", (0.0, 0.0, 0.0), robot.tool_rotation, "tool", source))
    rows += [
        _placed(what, at[:3], at[3:], "observation", REGISTERED)
        for observation in observed
        for what, at in observation.placements.items()
    ]
    return to_frame(rows, Placed)


def _placed(what: str, place: Vector, turn: Vector, kind: str, source: str) -> Placed:
    degrees = (float(angle) for angle in np.rad2deg(turn))
    figures = [f"{axis}_m" for axis in "xyz"] + [f"r{axis}_{unit}" for unit in ("deg", "rad") for axis in "xyz"]
    return Placed(what=what, kind=kind, source=source, **dict(zip(figures, (*place, *degrees, *turn), strict=True)))


def calibrated(robot: Robot, results: Results, given: tuple[str, ...]) -> CalibratedModel:
    """Return the model that diagnose extended, else identify's, with its residual field, for rows that give conditions."""
    stage = "diagnose" if "diagnose/effects.csv" in results else "identify"
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
    summary = results.document(f"{stage}/summary.json", FitSummary)
    time_origin = results.document("identify/summary.json", IdentifySummary).time_origin_s
    used = results.document("identify/certainty.json", Certainty)
    return CalibratedModel(
        model,
        np.array([parameter.estimate for parameter in parameters]),
        covariance.iloc[:, 1:].to_numpy(dtype=float),
        np.array([parameter.at_bound for parameter in parameters], dtype=bool),
        device=summary.noise,
        discrepancy=summary.discrepancy(observed),
        loss=summary.loss,
        intraclass=summary.intraclass,
        errors=read_errors(results.tables[f"{stage}/errors.csv"], model, FUNCTIONS),
        needed=tuple(needed),
        time_origin=time_origin,
        payloads=used.payloads,
        joint_range=np.array([used.joints_low, used.joints_high]) if used.joints_low else None,
        alternatives=tuple(_alternative(stated, model) for stated in summary.alternatives),
        field=read_field(results, robot),
    )


def read_effects(rows: Sequence[ModelEffect], robot: Robot) -> tuple[Effect, ...]:
    """Return the effects that rows name."""
    effects: list[Effect] = []
    for row in rows:
        whole = _kind(row.effect).of_figures(robot, row.variant)
        effects.append(Cause(robot, whole, row.part, row.prior_scale) if row.part else whole)
    return tuple(effects)


def read_observations(rows: Sequence[ModelObservation]) -> tuple[Observation, ...]:
    """Return the observations of an `observation_table`."""
    return tuple(adapter(observation_kinds()[row.kind]).validate_json(row.observation) for row in rows)


def _alternative(stated: AlternativeModel, model: Model) -> Alternative:
    gone = model.causes[stated.instead_of - 1] if stated.instead_of else None
    rivals = read_effects([stated.rival] if stated.rival else [], model.robot)
    come = [effect for effect in rivals if isinstance(effect, Cause)]
    other = replace(model, effects=(*(effect for effect in model.effects if effect != gone), *come))
    # Estimates are in the order of the findings, which is not the model's.
    estimate = np.array([stated.estimates[parameter.name] for parameter in other.parameters])
    return Alternative(other, estimate, stated.probability, gone, next(iter(come), None))


def placed(robot: Robot, results: Results) -> Robot:
    """Return the robot with base, markers and tool at the places to which identify's errors refer."""
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
    moved = replace(robot, base=base, markers=markers, tool_rotation=tool)
    return replace(moved, expected=about_places(robot, moved))


def _kind(effect: str) -> type[Effect]:
    kind = effect_class(effect)
    if kind is None:
        raise refuse(
            f"the run has effect '{effect}', which is unknown here: install the package that it came from, or define or import "
            "its class before you load it"
        )
    return kind
