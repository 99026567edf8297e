"""Measurements in memory for the stages' tests."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calflow.design.candidates import candidates
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise
from calflow.files.units import RADIAN
from calflow.measurements.measurements import Measurements
from calflow.model import Model

SIGMA = 3e-5  # m


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
    return Noise(np.full(len(data), sigma), ("file",), further=() if rotation is None else ((RADIAN, rotation),))


def problem(model: Model, data: Measurements, sigma: float = SIGMA) -> LeastSquares:
    """The fit's problem for data with a stated noise."""
    return LeastSquares.of(model, data, stated(data, sigma))


def drawn_truth(model: Model, rng: np.random.Generator, width: float = 0.5) -> np.ndarray:
    """True values drawn from a part of the prior, off the bounds."""
    truth = model.nominal + width * model.prior_sd * rng.standard_normal(len(model.nominal))
    lower, upper = model.bounds.T
    return np.clip(np.where(lower == 0, np.abs(truth), truth), lower + 0.02 * model.prior_sd, upper)
