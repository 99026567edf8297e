"""Calibrations of drawn robots: parameters from their priors, measured, identified and sampled as a user's are.

The model's own prior and graph make the data: whether a posterior is what it promises to be is asked of it where the model is
right by definition. Data of other physics are those of tests/hidden.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import calflow as cf
from calflow.design.candidates import candidates, packed_conditions
from calflow.estimation.accuracy import errors
from calflow.estimation.progress import draws
from calflow.model import Model, build
from calflow.robot.parts import Marker
from calflow.robot.robot import Robot
from calflow.sampling.chain import ChainLength
from calflow.sampling.posterior import Posterior
from calflow.sampling.sample import sample
from robots import industrial
from sampling.ranks import rank

EFFECTS = ("geometry", "joint-compliance")
SIGMA = 5e-5  # m, as it is stated
DRAWS = 99  # that a truth is ranked among
STEPS = 80  # of each of 280 walkers, who forget in 10
AXES = "xyz"
APART = ((0.05, -0.03, 0.12), (0.0, -0.33, 0.17), (0.25, -0.23, 0.02))  # m: markers on the tool


@dataclass(frozen=True)
class Design:
    """How a robot is measured: poses to fit and further ones, and markers.

    A pose shifts all its markers alike, by shared [m] along each axis, and its joints stand beside their readings by repeating
    [rad], both standard deviations.
    stated says whether the file states the noise; level is the sd of the log of the true noise over that.
    """

    poses: int = 40
    further: int = 10
    markers: int = 1
    shared: float = 0.0
    repeating: float = 0.0
    stated: bool = True
    level: float = 1.0
    joints: int = 6

    @property
    def robot(self) -> Robot:
        """The nominal robot, or its first joints alone."""
        whole, names = industrial(), "EFG"[: self.markers]
        markers = dict(zip(names, map(Marker, APART), strict=False))
        return replace(whole, joints=whole.joints[: self.joints], markers=markers)


SMALL = Design(joints=3, poses=30, level=0.0)


@dataclass(frozen=True, eq=False)
class Case:
    """A drawn robot: true parameters, log of the true noise over the stated one, and its measurements."""

    model: Model
    truth: np.ndarray
    log_noise: float
    data: cf.Measurements

    @staticmethod
    def drawn(design: Design, rng: np.random.Generator) -> Case:
        """Draw a robot from the priors, and measure it."""
        robot = design.robot
        model = build(robot, EFFECTS)
        truth = from_prior(model, rng)
        log_noise = design.level * rng.standard_normal()
        readings, _ = candidates(model, design.poses + design.further, "load", "E", None, rng)
        repeated = readings + design.repeating * rng.standard_normal(readings.shape)
        position = np.stack([model.position(truth, packed(model, repeated, name)) for name in robot.markers], axis=1)
        position = position + design.shared * rng.standard_normal((len(readings), 1, 3))
        position = position + SIGMA * np.exp(log_noise) * rng.standard_normal(position.shape)
        n, each = len(readings), design.markers
        more: dict[str, Any] = {
            "pose": np.repeat(np.arange(n), each),
            "marker": list(robot.markers) * n,
            "payload": "load",
            "split": np.repeat(["train"] * design.poses + ["holdout"] * design.further, each),
        }
        if design.stated:
            more["sigma"] = SIGMA
        data = cf.Measurements.from_arrays(robot, np.repeat(readings, each, axis=0), position.reshape(-1, 3), **more)
        return Case(build(robot, EFFECTS, data.given), truth, log_noise, data)

    def fitted(self) -> cf.Calibration:
        """Identify it."""
        return cf.identify(self.model.robot, self.data, EFFECTS, starts=1)


def packed(model: Model, readings: np.ndarray, marker: str) -> np.ndarray:
    """Conditions of joint readings (n, n_joints) under the load."""
    return packed_conditions(model, readings, "load", marker)


def from_prior(model: Model, rng: np.random.Generator) -> np.ndarray:
    """Draw parameters from their priors, which are cut at the bounds."""
    lower, upper = model.bounds.T
    found = np.full(len(model.nominal), np.nan)
    while (wrong := ~((found >= lower) & (found <= upper))).any():
        drawn = model.prior_mean + model.prior_sd * rng.standard_normal(len(found))
        found[wrong] = drawn[wrong]
    return found


@dataclass(frozen=True, eq=False)
class Told:
    """What a calibration says against the truth: ranks of the truth among draws, and errors over their standard deviations.

    ranks are by quantity: parameters, noise, where the marker really is at further poses. fitted (n,) are errors of the fit's
    parameters off their bounds over the fit's sd, predicted (n_further, 3) those of measurements at further poses; at_bound
    is how many parameters the fit left at their bounds.
    """

    ranks: dict[str, int]
    fitted: np.ndarray
    predicted: np.ndarray
    at_bound: int


def sampled(case: Case, rng: np.random.Generator, steps: int = STEPS) -> tuple[cf.Calibration, Posterior]:
    """Calibrate a case, and sample it."""
    fit, length = case.fitted(), ChainLength(max_steps=steps, block=steps)
    seed = int(rng.integers(2**31))
    with TemporaryDirectory() as folder:
        return fit, sample(fit, fit.data, Path(folder, "chain.h5"), length, rng=draws(seed))


def told(case: Case, design: Design, rng: np.random.Generator) -> Told:
    """Calibrate a case, sample it, and hold what is said against the truth."""
    return compared(case, design, *sampled(case, rng), rng)


def compared(case: Case, design: Design, known: cf.Calibration, drawn: Posterior, rng: np.random.Generator) -> Told:
    """Hold what a calibration and its sample say against the truth."""
    chosen = drawn.points.reshape(-1, len(case.truth) + 1)
    chosen = chosen[rng.choice(len(chosen), DRAWS, replace=False)]
    values, truth, names = [chosen[:, :-1]], [case.truth], [p.name for p in case.model.parameters]
    if not design.shared and not design.repeating:  # else what is left is no single noise
        values.append(chosen[:, -1:] + np.log(known.noise(known.data).total[0] / SIGMA))
        truth.append(np.array([case.log_noise]))
        names.append("noise")
    further = case.data.only(case.data.held_out)
    first = further.only(further.table["marker"].to_numpy() == "E")
    for k in range(min(2, len(first))):
        conditions = first.conditions[:, k : k + 1]
        values.append(np.array([case.model.point(one, conditions)[0] for one in chosen[:, :-1]]))
        truth.append(case.model.point(case.truth, conditions)[0])
        names += [f"further pose {k + 1} {axis}" for axis in AXES]
    ranks = rank(np.hstack(values), np.concatenate(truth))
    sd = np.sqrt(np.diag(known.covariance))
    free = ~known.at_bound
    variance = known.position_variance(further.conditions)
    if known.noise_known:
        variance = variance + known.noise(further).sigma[:, None] ** 2
    return Told(
        dict(zip(names, map(int, ranks), strict=True)),
        ((known.estimate - case.truth)[free] / sd[free]),
        errors(known.model, known.estimate, further) / np.sqrt(variance),
        int(known.at_bound.sum()),
    )
