"""A background is found where there is one, at its size, and none where there is only noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.background import BackgroundBasis, Sizes, background, beside_background
from calflow.diagnosis.extension import unnamed
from calflow.diagnosis.trial import Linearisation
from calflow.diagnosis.verdict import TEMPERED, WITHIN
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.measurements.measurements import Measurements
from calflow.model import build
from diagnosis.found import cause, hidden, start
from diagnosis.test_unexplained import fitted
from estimation.data import SIGMA, measured
from robots import industrial


def wander(size, seed=5):
    """A shift that walks randomly from row to row, of a size per axis."""

    def shift(table):
        steps = np.random.default_rng(seed).standard_normal((len(table), 3)).cumsum(axis=0)
        steps -= steps.mean(axis=0)
        return size * steps / steps.std()

    return shift


def test_noise_has_no_background():
    """Fails if independent noise is taken for errors that rows share."""
    for seed in (1, 2, 3):
        known = fitted(seed=seed)
        left = background(known, BackgroundBasis.of(known))
        assert left is None or left.gain < 8


def test_what_wanders_is_found():
    """Fails if a slow walk of the device is missed, or put down to something else."""
    known = fitted(wander(SIGMA))
    left = background(known, BackgroundBasis.of(known))
    assert ("time",) in left.inputs
    assert left.gain > 20


def test_the_likelihood_is_that_of_the_whole_covariance():
    """Fails if what the modes leave out, or the model's own parameters, enter otherwise than in the textbook."""
    known = fitted(wander(SIGMA), poses=60)
    basis = BackgroundBasis.of(known)
    regressors = known.regressors(())
    sizes = Sizes.of(regressors, basis, known.problem)
    variance = np.zeros(len(basis.parts))
    variance[[0, -1]] = 0.02, 0.1
    n, freedom = len(regressors.residual), 90.0
    whole = np.eye(n) + sum(
        v * (basis.modes @ part) @ (basis.modes @ part).T for v, part in zip(variance, basis.parts, strict=True)
    )
    jacobian, residual = regressors.jacobian, regressors.residual
    inverse = np.linalg.inv(whole)
    normal = jacobian.T @ inverse @ jacobian + np.diag(regressors.precision)
    gradient = jacobian.T @ inverse @ residual + regressors.pull
    chi2 = residual @ inverse @ residual + regressors.prior_rss - gradient @ np.linalg.solve(normal, gradient)
    narrowed = np.linalg.slogdet(normal / np.sqrt(np.outer(regressors.precision, regressors.precision)))[1]
    expected = freedom * np.log(chi2) + np.linalg.slogdet(whole)[1] + narrowed
    assert sizes.evidence(variance, freedom) == pytest.approx(expected, abs=1e-4 * n)


def with_markers(poses, seed):
    """Poses of a robot with three markers, and the draws to go on with."""
    points = {"A": [0.05, -0.03, 0.12], "B": [-0.1, 0.2, 0.1], "C": [0.2, 0.1, -0.1]}
    robot, rng = (
        industrial(markers={name: {"point_m": point} for name, point in points.items()}),
        np.random.default_rng(seed),
    )
    model = build(robot, ("geometry",))
    table = measured(model, model.nominal, poses, rng, repeats=3).table
    return Measurements(robot, table.assign(marker=np.repeat([*points], poses), repeat=1)), rng


@pytest.mark.parametrize("smooth", [True, False])
def test_what_is_smooth_from_pose_to_pose_is_no_error_of_the_pose(smooth):
    """Fails if rows of a pose are said to share for themselves what poses near it share, or not to share what is its own."""
    data, rng = with_markers(poses=60, seed=3)
    model = build(data.robot, ("geometry",))
    own = rng.standard_normal((60, 3))[data.table["pose"]]
    near = np.sin(data.joints[:, :3] + [0.3, 1.2, 2.0]) * np.cos(data.joints[:, [1]] + 0.7)
    seen = model.position(model.nominal, data.conditions) + SIGMA * rng.standard_normal((180, 3))
    data.table[["x", "y", "z"]] = seen + 10 * SIGMA * (near if smooth else own)
    known = start(data)
    alone, beside = (one.intraclass for one in (known, beside_background(known, BackgroundBasis.of(known))))
    assert alone > 0.9
    assert 1 - beside > 4 * (1 - alone) if smooth else beside == alone


def test_intervals_are_wider_where_errors_are_shared():
    """Fails if the estimates' covariance forgets the smooth errors, narrows by them, or is unlike what the truth is off by."""
    for seed in (5, 6, 7):
        known = fitted(wander(2 * SIGMA, seed))
        assert "time" in known.errors.inputs
        sd, white = (np.sqrt(np.diag(covariance)) for covariance in (known.covariance, known.fit.covariance))
        told = sd < known.model.prior_sd / 2
        ratio = (sd / white)[told] * known.scale / SIGMA
        assert ratio.min() > 0.99
        assert ratio.max() > 1.3
        off = ((known.fit.estimate - known.model.nominal) / sd)[told]
        assert 0.8 < np.sqrt(np.mean(off**2)) < 1.5


def test_a_cause_stands_against_what_nobody_can_name_and_a_step_does_not():
    """Fails if a true cause gives way to a background, or a step is certain where the device wanders."""
    eccentric = cause("joint-eccentricity", "joint1", order=2)
    known = start(hidden([(eccentric, (1.5e-4, -1e-4))])).with_causes([eccentric])
    assert TEMPERED * unnamed(known, BackgroundBasis.of(known), {eccentric.place: 10})[eccentric] > WITHIN
    walked = fitted(wander(1.5 * SIGMA))
    moments = np.arange(8, 92, 12)
    robot = walked.data.robot
    effect = type(cause("frame-step", "device", moment=1.0).effect)
    steps = [Cause(robot, effect(robot, moment=float(moment)), "device") for moment in moments]
    best = min((walked.with_causes([step]) for step in steps), key=lambda one: one.fit.objective)
    (step,) = best.causes
    assert TEMPERED * unnamed(best, BackgroundBasis.of(walked), {step.place: len(moments)})[step] < WITHIN


def test_an_error_of_a_joint_that_is_another_at_each_pose_is_no_regular_one():
    """Fails if of a few poses the order that fits best of hundreds is taken for what the joint does, which is nothing regular.

    Breaks if residuals are counted, not degrees of freedom, or if nothing unnamed moves what the cause moves.
    """
    data, rng = with_markers(poses=16, seed=6)
    robot = data.robot
    turned = data.table.assign(q5=data.table["q5"] + 5e-4 * rng.standard_normal(16)[data.table["pose"]])
    model = build(robot, ("geometry",))
    seen = model.position(model.nominal, replace(data, table=turned).conditions)
    data.table[["x", "y", "z"]] = seen + SIGMA * rng.standard_normal(seen.shape)
    known = start(data)
    kind = catalogue()["periodic-joint-error"]
    waves = tuple(Cause(robot, kind(robot, order=float(order)), "joint5") for order in np.geomspace(3, 30, 60))
    score = Linearisation.at(known, waves).beside.scores[0]
    assert score.p < 1e-6
    best = known.with_causes([score.cause])
    assert unnamed(best, BackgroundBasis.of(known), {score.cause.place: len(waves)})[score.cause] < 0
