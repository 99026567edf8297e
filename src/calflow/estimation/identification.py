"""Identification: a sequence of fits that adds one effect after the other to the nominal robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import scipy
from threadpoolctl import threadpool_limits

from calflow.effects import Effect, effect_ids
from calflow.effects.geometry import Geometry
from calflow.estimation.accuracy import Accuracy, accuracy, leading_errors, spread_mm
from calflow.estimation.calibrated_model import CalibratedModel, series_noise
from calflow.estimation.error_model import ErrorModel, SmoothVariances, beside_smooth_errors
from calflow.estimation.extrapolation import beyond_measured, extrapolation
from calflow.estimation.fit import START_ROWS, Fit, draw_starts, fit, fit_sharing, fit_to_all
from calflow.estimation.identifiability import rank_by_effect
from calflow.estimation.lack_of_fit import LackOfFit, NoiseDoubt, doubts_of_repeats, doubts_of_residuals
from calflow.estimation.least_squares import LeastSquares, Loss
from calflow.estimation.leverage import LeftOut, excess, left_out
from calflow.estimation.model_tables import IdentifySummary, fit_figures
from calflow.estimation.needed_conditions import needed_conditions
from calflow.estimation.noise import Noise, NoiseSource, averaged, measured_noise, representative
from calflow.estimation.progress import SAME, Advance, Draws, Say, nobody
from calflow.estimation.registration import registered_model
from calflow.files.problems import refuse
from calflow.files.units import METRE
from calflow.files.words import plural
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build, stated
from calflow.observations.base import USUAL_SIZE_SD

SIZE_ALARM = 1e-3  # probability that a board's stated size is doubted for lengths in proportion by chance
EQUILIBRIUM_ROWS = 2000  # rows at which the static equilibrium is checked


@dataclass(frozen=True, eq=False)
class FittedEffects:
    """A model identified from its training rows.

    data: all rows, with the registered robot to which the errors refer; noise: that of single rows, with the model's discrepancy;
    steps: accuracy of the nominal and of each extended model; lack: lack of fit; starts, agreeing: number of starts, and of those
    that reached the optimum; left_out: leave-one-pose-out errors of the training poses; errors: error model; doubts:
    contradictions of the stated noise.
    """

    data: Measurements
    fit: Fit
    noise: Noise
    steps: tuple[Accuracy, ...]
    lack: LackOfFit
    starts: int
    agreeing: int
    left_out: LeftOut
    errors: ErrorModel
    doubts: tuple[NoiseDoubt, ...] = ()

    @property
    def model(self) -> Model:
        return self.fit.model

    @cached_property
    def known(self) -> CalibratedModel:
        """The calibrated model, from which later stages start."""
        used, fitted = self.data.only(self.data.train | self.data.held_out), self.data.joints[self.data.train]
        return CalibratedModel(
            self.model, self.fit.estimate, self.fit.covariance, self.fit.at_bound, series_noise(self.noise, self.data),
            self.noise.discrepancy, self.fit.loss, self.errors, intraclass=self.noise.intraclass,
            needed=needed_conditions(self.model, self.fit.estimate, self.data), time_origin=self.data.time_origin,
            payloads=used.payloads, joint_range=np.array([fitted.min(axis=0), fitted.max(axis=0)]),
        )  # fmt: skip

    @cached_property
    def summary(self) -> IdentifySummary:
        fit, noise, data, out = self.fit, self.noise, self.data, self.left_out
        ranks = rank_by_effect(fit)
        used = data.only(data.train | data.held_out)
        points = fit.model.point(fit.estimate, used.conditions)
        return IdentifySummary(
            sigma_mm=1e3 * noise.typical(METRE) if METRE in noise.leading else None,
            **fit_figures(fit, self.known, self.lack, out.at_new_poses, out.upper_limit(noise.known)),
            spread_mm=spread_mm(points),
            rank=sum(ranks.values()),
            parameters=len(fit.model.parameters),
            rank_by_effect=ranks,
            effective_parameters=fit.effective_parameters,
            training_poses=data.table.loc[data.train, "pose"].nunique(),
            heldout_poses=data.table.loc[data.held_out, "pose"].nunique(),
            equilibrium_error_um=1e6 * fit.model.equilibrium_error(fit.estimate, used.conditions[:, :EQUILIBRIUM_ROWS]),
            starts=self.starts,
            starts_agreeing=self.agreeing,
            extrapolation=extrapolation(data),
            noise_doubts=self.doubts,
            time_origin_s=data.time_origin,
            conditions=data.given,
            notes=data.notes,
        )


@threadpool_limits.wrap(limits=1, user_api="blas")  # an arm's matrices are too small for threads to pay
def fit_effects(
    data: Measurements,
    effects: Sequence[str | Effect],
    *,
    starts: int = 3,
    loss: Loss = "linear",
    noise: NoiseSource = "auto",
    rng: Draws = SAME,
    say: Say = nobody,
    advance: Advance = nobody,
    source: Path | None = None,
) -> FittedEffects:
    """Fit the errors of the data's nominal robot, one effect after the other.

    Args:
        data: split rows, gross mistakes corrected (see `faults.examined`).
        effects: ids or objects, in the order in which they are added.
        starts: number of starting points of each fit.
        loss: function of a row's squared residual.
        noise: source of the noise.
        rng: draws the starts.
        say: receives a line for each fit.
        advance: receives the share of work done.
        source: the file of the data, for messages.

    Raises:
        InputError: the data are too few, or lack the requested source of noise.
    """
    nominal, data = registered_model(data)
    train, robot, observed = data.only(data.train), data.robot, nominal.observations
    error = leading_errors(nominal, nominal.nominal, data)
    device = measured_noise(data, noise, nominal)
    doubts = doubts_of_repeats(data, error, tuple(source == "file" for source in device.sources))
    for doubt in doubts:
        say(doubt.words)
    rows = accuracy("nominal", error, data)
    means, noise_of_means = averaged(train, device.only(data.train))
    some = representative(means)
    part, noise_of_part = means.only(some), noise_of_means.only(some)
    for k in range(1, len(effects) + 1):
        model = stated(robot, effects[:k], train, observed)
        if wrong := too_few_equations(model, train):
            raise refuse(wrong, source)
        name = " + ".join(effect_ids(effects[:k]))
        say(f"{name}: {plural(len(model.parameters), 'parameter')}, {plural(len(train), 'row')}")
        if k == len(effects):
            few = representative(part, START_ROWS)
            at_few = partial(LeastSquares.of, data=part.only(few), noise=noise_of_part.only(few))
            model = without_mistaken(without_wrong_size(model, at_few, say), at_few, say)
        points = draw_starts(model, starts, rng("starts"))
        result, reweighted, lack, agree = fit_sharing(model, part, noise_of_part, points, loss)
        if k == len(effects):
            if not some.all():
                result, reweighted = fit_to_all(result, noise_of_part, reweighted, means, noise_of_means)
            of_part = replace(result, problem=result.problem.only(some))
            poses = np.unique(part.table["pose"], return_inverse=True)[1]
            out = left_out(of_part, poses)
            sizes = SmoothVariances.of(result, means, device.known)
            result, smooth = beside_smooth_errors(sizes, sizes.variance, excess(of_part, poses, out))
            errors = beyond_measured(smooth, sizes, sizes.variance)
            if sizes.inputs:
                say(f"the residuals are smooth in {', '.join(sizes.inputs)}: uncertainties allow for it")
        error = leading_errors(model, result.estimate, data)
        rows += accuracy(name, error, data, k, model.effects[-1])
        advance(k / len(effects))

    left = replace(device, discrepancy=reweighted.discrepancy, intraclass=reweighted.intraclass)
    left = replace(left, sigma=_of_single_rows(left, reweighted))
    if not doubts:
        doubts = doubts_of_residuals(device.only(data.train), lack, tuple(series.name for series in data.series))
        for doubt in doubts:
            say(doubt.words)
    return FittedEffects(data, result, left, tuple(rows), lack, starts, agree, out, errors, doubts)


def too_few_equations(model: Model, train: Measurements) -> str:
    """Return the message that a model has more parameters without a stated prior than equations; empty where it has not."""
    expected = {key for key, expectation in model.robot.expectations.items() if expectation.mean is not None}
    unknown = sum(expected.isdisjoint((parameter.identity, parameter.name)) for parameter in model.parameters)
    first = np.unique(train.repeated, return_index=True)[1]
    equations = sum(len(model.observations[k].units) for k in train.series_number[first])
    if equations >= unknown:
        return ""
    poses = train.table["pose"].nunique()
    wanted = -(-unknown * poses // equations)
    return (f"{plural(equations, 'equation')} ({plural(poses, 'training pose')}) for {plural(unknown, 'parameter')}: measure "
            f"at least {wanted} training poses, better twice as many")  # fmt: skip


def without_wrong_size(model: Model, at_rows: Callable[[Model], LeastSquares], say: Say = nobody) -> Model:
    """Return the model in which the size of boards and plates counts as unknown, if the robot's lengths contradict it.

    What is smaller than stated makes all lengths too long by the same share. Lengths of a robot do not err so: their errors, in
    standard deviations, must fall by more than those of lengths that err independently would (F test), and by more than the
    wider prior of the size costs.
    """
    observed = tuple(one.of_unknown_size() for one in model.observations)
    if observed == model.observations:
        return model
    other = build(model.robot, model.effects, model.given, observed)
    stated = {parameter.name: parameter.prior_sd for parameter in model.parameters}
    costs = 2 * sum(np.log(p.prior_sd / stated.get(p.name, USUAL_SIZE_SD)) for p in other.parameters)
    before, error, weight = _lengths(fit(at_rows(model))[0])
    if (error**2).sum() < costs:
        return model
    after, error_after, _ = _lengths(fit(at_rows(other))[0])
    left, freedom = (error_after**2).sum(), weight.sum() - 1
    falls = (error**2).sum() - left
    if (
        2 * (before.objective - after.objective) < costs
        or scipy.stats.f.sf(falls / left * freedom, 1, freedom) > SIZE_ALARM
    ):
        return model
    say("all lengths are off by the same share: the stated size of what was measured counts as unknown")
    return other


def _lengths(result: Fit) -> tuple[Fit, np.ndarray, np.ndarray]:
    """Return a fit, its errors of the robot's lengths in standard deviations, and the share of each that the data determine."""
    model = result.model
    own = [k for k, p in enumerate(model.parameters) if p.effect == Geometry.id and p.joint and p.unit == "m"]
    error = (result.estimate - model.prior_mean) / model.prior_sd
    share = 1 - np.diag(result.covariance) / model.prior_sd**2
    return result, error[own], share[own]


def without_mistaken(model: Model, at_rows: Callable[[Model], LeastSquares], say: Say = nobody) -> Model:
    """Return the model in which no figure of a kind counts as stated that the rows contradict in one joint.

    A figure at the end of what a maker's robot is off bends all others, and what these cannot follow looks like a cause. It is
    judged by the device's noise, since beside a discrepancy the priors win. Not counting the figures must make the errors likelier
    by more than their wider priors cost.
    """
    result, _ = fit(at_rows(model))
    while (freed := _freed(result)) != model.effects:
        other = build(model.robot, freed, model.given, model.observations)
        wider, _ = fit(at_rows(other))
        gain = len(result.residual) * np.log((result.residual**2).sum() / (wider.residual**2).sum())
        if gain < 2 * np.log(other.prior_sd / model.prior_sd).sum():
            break
        say("the data contradict figures of the robot file; none of their kind counts as stated")
        model, result = other, wider
    return model


def _freed(result: Fit) -> tuple[Effect, ...]:
    pushed = [parameter for parameter, there in zip(result.model.parameters, result.at_bound, strict=True) if there]
    return tuple(
        effect.without_mistaken(pushed) if isinstance(effect, Geometry) else effect for effect in result.model.effects
    )


def _of_single_rows(noise: Noise, fitted: Noise) -> np.ndarray:
    """Return each single row's sigma, where estimated as the fit ended: the largest, since means of repeats have smaller ones."""
    sigma = noise.sigma.copy()
    for k, source in enumerate(noise.sources):
        if source == "estimated":
            sigma[noise.of_series(k)] = fitted.sigma[fitted.of_series(k)].max(initial=0.0)
    return sigma
