"""The stage identify: geometry and the other effects of the study as bounded decision variables of one fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd
from pydantic import Field
from scipy.stats import chi2

from calflow.estimation.accuracy import Accuracy, Residual, accuracy, errors, residuals
from calflow.estimation.calibrated import (
    DeviceNoise,
    ModelObservation,
    Placed,
    noise_table,
    observation_table,
    placement_table,
)
from calflow.estimation.fit import Fit, draw_starts
from calflow.estimation.fit_summary import Extrapolation, IdentifySummary, Solver
from calflow.estimation.identifiability import (
    Correlation,
    Counted,
    Identifiability,
    Statement,
    best_subset,
    correlations,
    identifiability,
)
from calflow.estimation.least_squares import LeastSquares, Loss
from calflow.estimation.noise import LackOfFit, Noise
from calflow.estimation.nuisance import completed
from calflow.estimation.parameters import Covariances, FittedParameter, covariance_table, parameter_table
from calflow.estimation.registration import registered
from calflow.estimation.repeats import conditions, measured_noise
from calflow.estimation.reweighting import fit_reweighted
from calflow.faults import FaultyRow, as_table, search
from calflow.files.documents import to_document
from calflow.files.problems import InputError, Problem, nearest
from calflow.files.results import Results
from calflow.files.tables import column, to_frame, typed
from calflow.files.toml import FileModel
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from calflow.observations import observations
from calflow.stages.stage import Context, Stage
from calflow.study import Study

FALSE_FLAGS = 0.01  # chance that any good row of a whole data set is flagged
BEYOND = 0.1  # share of a joint's travel by which a held-out reading may lie outside the fitted ones
EQUILIBRIUM_ROWS = 2000  # rows at which the equilibrium is checked


@dataclass(frozen=True, kw_only=True)
class JudgedResidual(Residual):
    """What the identified model leaves of a measured row, and whether that is too much."""

    whitened: float = column("root mean square of the error's parts in standard deviations of noise and discrepancy")
    flagged: bool = column("whether it is too large for noise and for the spread of the rest")


class IdentifySettings(FileModel):
    """Settings of identify."""

    starts: int = Field(default=3, ge=1)
    loss: Loss = "linear"
    noise: Literal["auto", "repeats", "file", "estimated"] = "auto"
    count: dict[str, int] = {}


def run(context: Context) -> Results:
    """Fit the nominal robot's errors, effect by effect, and say what the data determine."""
    study, settings = context.study, context.settings
    effects = study.file.effects
    if wrong := _wrong_count(study, settings):
        raise InputError(wrong)
    data = study.measurements()
    for note in data.notes:
        context.say(note)
    data, faults = search(data)
    for fault in faults:
        context.say(f"{fault.cause.replace('-', ' ')}: {fault.statement}")
    train = data.only(data.train)
    robot, observed = registered(study.robot, observations(train), train)
    data, train = data.on(robot), train.on(robot)
    nominal = build(robot, (), data.given, observed)
    noise = measured_noise(data, settings.noise, nominal)

    rows = accuracy("nominal", errors(nominal, nominal.nominal, data), data)
    for k in range(1, len(effects) + 1):
        model = build(robot, effects[:k], data.given, observed)
        if wrong := _too_few_equations(model, train, study):
            raise InputError(wrong)
        context.say(f"{' + '.join(effects[:k])}: {len(model.parameters)} parameters, {len(train)} rows")
        starts = draw_starts(model, settings.starts, context.rng("starts"))
        result, reweighted, lack, agree = fit_reweighted(model, train, noise.only(data.train), starts, settings.loss)
        error = errors(model, result.estimate, data)
        rows += accuracy(" + ".join(effects[:k]), error, data, k, model.effects[-1])
        context.advance(k / len(effects))

    found = identifiability(result)
    noise = replace(noise, discrepancy=reweighted.discrepancy, rotation_discrepancy=reweighted.rotation_discrepancy)
    noise = replace(noise, sigma=_of_single_rows(noise, reweighted))
    tables = {
        "identify/faults.csv": as_table(faults, data),
        "identify/parameters.csv": parameter_table(result),
        "identify/accuracy.csv": to_frame(rows, Accuracy),
        "identify/residuals.csv": _residuals(result, data, noise),
        "identify/identifiability.csv": found.statements,
        "identify/correlations.csv": correlations(result),
        "identify/covariance.csv": covariance_table(result),
        "identify/observations.csv": observation_table(observed),
        "identify/noise.csv": noise_table(noise, observed),
        "identify/placement.csv": placement_table(robot, observed),
    }
    if settings.count:
        tables["identify/count.csv"] = best_subset(result, settings.count)
    summary = _summary(result, found, noise, lack, agree, settings, data)
    return Results(tables, {"identify/summary.json": to_document(summary)})


def problems(study: Study, settings: IdentifySettings, data: Measurements | None) -> list[Problem]:
    """Find counts that cannot be, and measurements that are too few or do not tell the noise asked for."""
    found = _wrong_count(study, settings)
    if data is None:
        return found
    observed = observations(data)
    model = build(study.robot, study.file.effects, data.given, observed)
    try:
        measured_noise(data, settings.noise, build(study.robot, (), data.given, observed))
    except InputError as error:
        found += [study.setting_problem("identify", problem.message, "noise") for problem in error.problems]
    return found + _too_few_equations(model, data.only(data.train), study)


def _wrong_count(study: Study, settings: IdentifySettings) -> list[Problem]:
    effects = study.file.effects
    found = []
    for effect, count in settings.count.items():
        most = len(build(study.robot, (effect,)).parameters) if effect in effects else 0
        if effect not in effects:
            message = f"unknown effect '{effect}'{nearest(effect, effects)}; the study has {', '.join(effects)}"
        elif not 0 <= count <= most:
            message = f"expected a count from 0 to {most}, as many parameters as the effect has, found {count}"
        else:
            continue
        found.append(study.setting_problem("identify", message, "count", effect))
    return found


def _too_few_equations(model: Model, train: Measurements, study: Study) -> list[Problem]:
    first = np.unique(conditions(train), return_index=True)[1]
    equations = sum(len(model.observations[k].units) for k in train.series_number[first])
    if equations >= len(model.parameters):
        return []
    poses = train.table["pose"].nunique()
    wanted = -(-len(model.parameters) * poses // equations)
    return [Problem(f"{equations} equations ({poses} training poses) for {len(model.parameters)} parameters: measure at least "
                    f"{wanted} training poses, better twice as many", study.measurement_path)]  # fmt: skip


def _of_single_rows(noise: Noise, fitted: Noise) -> np.ndarray:
    """Each row's sigma, an estimated one's as the fit left it: a mean of n repeats is that much better than a single row."""
    sigma = noise.sigma.copy()
    for k, source in enumerate(noise.sources):
        if source == "estimated":
            sigma[noise.of_series(k)] = fitted.sigma[fitted.of_series(k)].max(initial=0.0)
    return sigma


def _residuals(result: Fit, data: Measurements, noise: Noise) -> pd.DataFrame:
    """Each row's error; flagged where it is too large for the noise and the discrepancy of the rest, unless left out.

    A training row's residual is studentised by its leverage, so that a row that pulls the fit to itself still shows.
    """
    model, estimate = completed(result.model, result.estimate, data)
    known = [model.parameters.index(parameter) for parameter in result.model.parameters]
    squared, whitened, limit = np.empty(len(data)), np.empty(len(data)), np.empty(len(data))
    for rows, residual, whole in LeastSquares.of(model, data, noise).linearised(estimate):
        jacobian = whole[:, :, known]
        predicted = jacobian @ result.covariance @ jacobian.transpose(0, 2, 1)
        spread = np.eye(residual.shape[1]) + np.where(data.train[rows], -1.0, 1.0)[:, None, None] * predicted
        inverse = np.linalg.pinv(spread, hermitian=True)
        squared[rows] = np.einsum("ni,nij,nj->n", residual, inverse, residual)
        whitened[rows] = np.sqrt((residual**2).mean(axis=1))
        limit[rows] = chi2.isf(FALSE_FLAGS / len(data), residual.shape[1])
    flagged = (squared > limit) & (data.train | data.held_out)
    table = residuals(errors(result.model, result.estimate, data), data)
    return typed(table.assign(whitened=whitened, flagged=flagged), JudgedResidual)


def _summary(
    result: Fit, found: Identifiability, noise: Noise, lack: LackOfFit, agree: int, settings: IdentifySettings,
    data: Measurements,
) -> IdentifySummary:  # fmt: skip
    used = data.only(data.train | data.held_out)
    return IdentifySummary(
        noise_sources=noise.sources,
        sigma_mm=1e3 * float(np.sqrt(np.mean(noise.sigma**2))),
        discrepancy_mm=1e3 * noise.discrepancy,
        rotation_discrepancy_mrad=None if noise.rotation is None else 1e3 * noise.rotation_discrepancy,
        loss=settings.loss,
        reduced_chi2=lack.reduced_chi2 if noise.known else None,
        lack_of_fit_p=lack.p if noise.known else None,
        solver=Solver(status=result.status, iterations=result.iterations),
        spread_mm=1e3 * _spread(result.model, result.estimate, used),
        rank=found.rank,
        parameters=found.n_parameters,
        rank_by_effect=dict(found.rank_by_effect),
        effective_parameters=result.effective_parameters,
        training_poses=data.table.loc[data.train, "pose"].nunique(),
        heldout_poses=data.table.loc[data.held_out, "pose"].nunique(),
        converged=result.converged,
        equilibrium_error_um=1e6 * result.model.equilibrium_error(result.estimate, used.rows[:, :EQUILIBRIUM_ROWS]),
        starts=settings.starts,
        starts_agreeing=agree,
        extrapolation=extrapolation(data),
        time_origin_s=data.time_origin,
    )


def _spread(model: Model, estimate: np.ndarray, data: Measurements) -> float:
    """Mean distance of the points from their middle [m]."""
    points = model.point(estimate, data.rows)
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())


def extrapolation(data: Measurements) -> tuple[Extrapolation, ...]:
    """Return the joints whose held-out readings lie beyond what was fitted: their accuracy is a guess, good or bad."""
    train, heldout = data.joints[data.train], data.joints[data.held_out]
    if not len(heldout):
        return ()
    low, high = train.min(axis=0), train.max(axis=0)
    margin = BEYOND * np.maximum(high - low, np.ptp(data.joints[data.train | data.held_out], axis=0))
    beyond = (heldout < low - margin) | (heldout > high + margin)
    return tuple(
        Extrapolation(joint=int(i) + 1, rows=int(beyond[:, i].sum())) for i in np.flatnonzero(beyond.any(axis=0))
    )


STAGE = Stage(
    "identify",
    "identify geometry and compliance",
    IdentifySettings,
    run,
    tables={
        "identify/parameters.csv": FittedParameter,
        "identify/accuracy.csv": Accuracy,
        "identify/residuals.csv": JudgedResidual,
        "identify/faults.csv": FaultyRow,
        "identify/identifiability.csv": Statement,
        "identify/correlations.csv": Correlation,
        "identify/covariance.csv": Covariances,
        "identify/observations.csv": ModelObservation,
        "identify/noise.csv": DeviceNoise,
        "identify/placement.csv": Placed,
        "identify/count.csv": Counted,
    },
    documents={"identify/summary.json": IdentifySummary},
    problems=problems,
)
