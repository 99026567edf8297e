"""Measurements in memory for the stages' tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel, SeriesNoise
from calflow.estimation.error_model import ErrorModel, SmoothVariances, beside_smooth_errors
from calflow.estimation.extrapolation import beyond_measured
from calflow.estimation.fit import fit_reweighted
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise, PerUnit, Source
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from robots import industrial

SIGMA = 3e-5  # m
POSES = 90  # of a robot that errs smoothly


def measured(
    model: Model, truth: np.ndarray, poses: int, rng: np.random.Generator, repeats: int = 1, sigma: float = SIGMA
) -> Measurements:
    """Random poses of a model with true values, with noise, all to be fitted."""
    robot = model.robot
    payload = next(iter(robot.payloads), "")
    readings, conditions = candidates(model, poses, payload, next(iter(robot.markers)), None, rng)
    blocks = []
    for repeat in range(1, repeats + 1):
        position = model.position(truth, conditions) + sigma * rng.standard_normal((poses, 3))
        block = pd.DataFrame(readings, columns=[f"q{i + 1}" for i in range(robot.n_joints)])
        block[["x", "y", "z"]] = position
        blocks.append(block.assign(pose=np.arange(poses), repeat=repeat))
    table = pd.concat(blocks, ignore_index=True)
    table = table.assign(
        marker=next(iter(robot.markers)), payload=payload, split="train", line=np.arange(2, len(table) + 2)
    )
    return Measurements(robot, table)


def stated(data: Measurements, sigma: float = SIGMA) -> Noise:
    """The noise as a file would state it."""
    rotation = data.table["sigma_rotation"].to_numpy() if data.rotation is not None else None
    return Noise(np.full(len(data), sigma), ("file",), rotation=rotation)


def problem(model: Model, data: Measurements, sigma: float = SIGMA) -> LeastSquares:
    """The fit's problem for data with a stated noise."""
    return LeastSquares.of(model, data, stated(data, sigma))


def drawn_truth(model: Model, rng: np.random.Generator, width: float = 0.5) -> np.ndarray:
    """True values drawn from a part of the prior, off the bounds."""
    truth = model.nominal + width * model.prior_sd * rng.standard_normal(len(model.nominal))
    lower, upper = model.bounds.T
    return np.clip(np.where(lower == 0, np.abs(truth), truth), lower + 0.02 * model.prior_sd, upper)


def wavering(seed: int, size: float = 4e-4, poses: int = POSES) -> Measurements:
    """An industrial robot of which joint 2 errs by a smooth function of its own angle and joint 1's, and its poses, by time."""
    robot, rng = industrial(), np.random.default_rng(seed)
    model = build(robot, ("geometry",))
    data = measured(model, model.nominal, poses, rng)
    data.table["time"] = np.cumsum(rng.uniform(20, 40, poses))
    model = build(robot, ("geometry",), data.given)
    turned, phase = data.conditions.copy(), rng.uniform(0, 6, 2)
    turned[1] += size * np.sin(1.3 * turned[0] + phase[0]) * np.cos(turned[1] + phase[1])
    data.table[["x", "y", "z"]] += model.position(model.nominal, turned) - model.position(
        model.nominal, data.conditions
    )
    return replace(data, table=data.table)


def calibration(
    model: Model,
    estimate: np.ndarray,
    covariance: np.ndarray,
    sigma: float = SIGMA,
    source: Source = "file",
    at_bound: np.ndarray | None = None,
) -> CalibratedModel:
    """A calibration with this estimate and covariance, of one series; beside its noise, sigma [m], nothing errs."""
    n = len(estimate)
    return CalibratedModel(
        model, estimate, covariance, np.zeros(n, dtype=bool) if at_bound is None else at_bound,
        (SeriesNoise(sigma, source, sigma),), PerUnit(), "linear", ErrorModel.white(PerUnit(), n),
    )  # fmt: skip


def calibrated(data: Measurements) -> CalibratedModel:
    """The geometry fitted to rows of stated noise, as sure as it is beside what smooth errors it leaves."""
    model = build(data.robot, ("geometry",), data.given)
    result = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")[0]
    sizes = SmoothVariances.of(result, data, True)
    unsure, left = beside_smooth_errors(sizes, sizes.variance, PerUnit())
    errors = beyond_measured(left, sizes, sizes.variance)
    return replace(calibration(model, result.estimate, unsure.covariance, at_bound=result.at_bound), errors=errors)


def variance(
    errors: ErrorModel, model: Model, estimate: np.ndarray, covariance: np.ndarray, conditions: np.ndarray
) -> np.ndarray:
    """The variance (n_rows, 3) of positions by an error model."""
    shared = errors.shared(errors.slopes(model, estimate, conditions), covariance)
    return (shared**2).sum(axis=2) + errors.rest[METRE] ** 2
