"""The difference of two calibrations: chance is told from difference whatever the priors are, and a place from another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import kstest

from calflow.effects.joint_error_map import JointErrorMap
from calflow.estimation.difference import Difference
from calflow.model import build
from calflow.runs.between_runs import _curves
from estimation.data import calibration
from robots import ASKEW, ur10

ONE_IN = 4  # figures of which no measurement tells


def calibrations(rng, shift=None):
    """Two calibrations of one robot from independent linear measurements of most figures; a shift is of the second's truth."""
    model = build(replace(ur10(), base=replace(ASKEW, known=False)), ("geometry",))
    n, sd = len(model.parameters), model.prior_sd
    truth = sd * rng.standard_normal(n)
    found = []
    for moved in (0.0, 0.0 if shift is None else shift):
        slope = rng.standard_normal((3 * n, n)) / 1e-5
        slope[:, ::ONE_IN] = 0.0
        seen = slope @ (truth + moved) + rng.standard_normal(3 * n)
        covariance = np.linalg.inv(slope.T @ slope + np.diag(sd**-2.0))
        estimate = covariance @ slope.T @ seen
        found.append(calibration(model, estimate, covariance, sigma=1e-5))
    return found


def test_chance_is_uniform_and_counts_what_measurements_tell():
    """Fails if directions known far better than by their prior are left out of the test, or those of which only it knows count."""
    every = [Difference.of(*calibrations(np.random.default_rng(seed))) for seed in range(150)]
    n = len(every[0].value)
    told = n - len(range(0, n, ONE_IN))
    assert {one.joint[1] for one in every} == {told}
    assert kstest([one.joint[2] for one in every], "uniform").pvalue > 0.001


def test_no_parameter_alone_differs_by_more_than_all_together():
    """Fails if a base that stands 27 standard deviations elsewhere is told to agree, since its prior is wide."""
    found = Difference.of(
        *calibrations(np.random.default_rng(3), shift=2e-4 * np.eye(len(build(ur10(), ("geometry",)).parameters))[1])
    )
    squared, _, chance = found.joint
    assert squared >= ((found.value / np.where(found.sd > 0, found.sd, np.inf)) ** 2).max() > 25
    assert chance < 1e-6


def test_a_base_is_compared_where_both_count_from_the_same_place():
    """Fails if calibrations that placed the base apart count what each corrected of its own place as a difference of the robot."""
    first, second = calibrations(np.random.default_rng(4))
    robot = replace(second.model.robot, base=replace(ASKEW, origin=(0.5, -1.2, 0.301), known=False))
    apart = replace(second, model=replace(second.model, robot=robot))
    compared = {first.model.parameters[k].part for k in Difference.of(first, second).first}
    assert {first.model.parameters[k].part for k in Difference.of(first, apart).first} == compared - {"base"}
    assert "base" in compared


def test_figures_of_a_joint_are_compared_where_both_models_have_the_same_causes_there():
    """Fails if a zero that takes up the mean of a curve in one calibration, and not in the other, is told to have moved."""
    plain, _ = calibrations(np.random.default_rng(4))
    model = build(plain.model.robot, ("geometry", "joint-backlash"))
    sd = model.prior_sd
    curved = calibration(model, np.zeros(len(sd)), np.diag(sd**2), sigma=1e-5)
    assert {plain.model.parameters[k].joint for k in Difference.of(plain, curved).first} == {0}
    assert {model.parameters[k].joint for k in Difference.of(curved, curved).first} == set(range(7))


def test_a_curve_of_few_figures_is_one_too():
    """Fails if figures of a short travel's curve, or of a slide's, are each told to differ."""
    robot = replace(ur10(), base=replace(ASKEW, known=False))
    curve = JointErrorMap(robot, (0.0, 0.1) + 4 * (0.0,), (0.0, 1.1) + 4 * (0.0,), 0.5)
    model = build(robot, ("geometry", curve, "periodic-joint-error"))
    n, sd = len(model.columns(model.effects[1])), model.prior_sd
    assert 1 < n < 20
    one = calibration(model, np.zeros(len(sd)), np.diag(sd**2), sigma=1e-5)
    named = _curves(one, Difference.of(one, one))
    assert (set(named), len([name for name in named if name])) == ({"", "angle error curve of joint 2"}, n)


def test_a_curve_is_one_test():
    """Fails if each of a curve's figures counts as a test, of which the others then pay, or as many find chance differences."""
    every = [Difference.of(*calibrations(np.random.default_rng(seed))) for seed in range(150)]
    n = len(every[0].value)
    wholes = ["a", *[""] * 3, *["b"] * (n - 5), "a"]
    found = [one.tested(wholes, 0.01) for one in every]
    assert all(len(set(p[4:-1])) == 1 and p[0] == p[-1] for p, _ in found)
    for k in (1, 4):  # one figure alone, and the whole
        assert kstest([p[k] for p, _ in found], "uniform").pvalue > 0.001
    limit = 0.01 / 5  # of as many tests
    assert all(beyond.any() == (p.min() <= limit) for p, beyond in found)
    moved = Difference.of(*calibrations(np.random.default_rng(0), shift=1e-4))
    assert moved.tested(wholes, 0.01)[1][4:-1].all()
