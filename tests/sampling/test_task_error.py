"""How far off the tool may be where the robot works: probabilities that hold, alone and together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi

from calflow.sampling.task_points import PointErrors, TaskTolerances, point_errors, task_summary, task_table

TEN = TaskTolerances(tolerance=10.0)


def spread(parameters: float, own: float, points: int, rng: np.random.Generator) -> PointErrors:
    """Errors of place and turn, of which a part is the same at all points, and another is each point's own."""
    n = 20_000
    drawn = parameters * rng.standard_normal((2, n, 1, 3)) * np.ones((1, points, 1))
    alike = own * rng.standard_normal((2, n, 1, 3)) * np.ones((1, points, 1))
    return PointErrors(drawn, own * rng.standard_normal((2, n, points, 3)), alike)


def test_probabilities_are_those_of_normal_errors():
    """Fails if a radius, a point's probability or that of all points is not what normal errors have."""
    found = spread(3.0, 4.0, 6, np.random.default_rng(1))
    assert found.radius == pytest.approx(np.full((2, 6), 5 * chi.ppf(0.95, 3)), rel=0.02)
    assert found.expected == pytest.approx(np.full((2, 6), 5 * chi.mean(3)), rel=0.02)
    assert found.within(TEN).mean(axis=0) == pytest.approx(np.full(6, chi.cdf(2.0, 3)), abs=0.01)
    independent = spread(0.0, 5.0, 6, np.random.default_rng(2))
    assert independent.within(TEN).all(axis=1).mean() == pytest.approx(chi.cdf(2.0, 3) ** 6, abs=0.015)
    assert independent.within(TEN, alike=True).all(axis=1).mean() == pytest.approx(chi.cdf(2.0, 3), abs=0.01)


def test_a_point_meets_both_tolerances_or_none():
    """Fails if a point counts as within where only its place, or only its orientation, is."""
    rng = np.random.default_rng(3)
    found = spread(0.0, 1.0, 2, rng)
    expected = chi.cdf(1.5, 3) * chi.cdf(2.0, 3)
    assert found.within(TaskTolerances(tolerance=1.5, turn_tolerance=2.0)).mean() == pytest.approx(expected, abs=0.01)
    assert found.within(TaskTolerances()).all()


@pytest.fixture(scope="module")
def calibrations(small_robots):
    """The small robots, with what is said of ten further poses of each."""
    found = []
    for k, (case, known, drawn, _) in enumerate(small_robots):
        task = known.data.only(known.data.held_out)
        found.append((case, drawn, known, task, point_errors(drawn, known, task.conditions, np.random.default_rng(k))))
    return found


def test_true_errors_are_as_large_as_was_said(calibrations):
    """Fails if what is told is 20 % too small: in ten poses of five robots errors, by axis, have then an rms of 1.25."""
    z, below = [], []
    for case, _, known, task, found in calibrations:
        error = case.model.point(case.truth, task.conditions) - known.model.point(known.estimate, task.conditions)
        z.append(error / found.sd[0])
        below.append(np.linalg.norm(error, axis=1) < found.radius[0])
    assert 0.68 < np.sqrt(np.mean(np.square(z))) < 1.2
    assert np.mean(below) > 0.88


def test_draws_and_the_fits_covariance_agree(calibrations):
    """Fails if what the model lacks is left out of either, or orientations are not the draws': errors here are nearly normal."""
    for _, _, known, task, found in calibrations[:4]:
        expected = np.sqrt(known.position_variance(task.conditions))
        np.testing.assert_allclose(found.sd[0], expected, rtol=0.25)
        np.testing.assert_allclose(
            np.median(found.sd[1] / np.sqrt(known.rotation_variances(task.conditions)[0])), 1.0, atol=0.15
        )


def test_what_was_not_measured_is_said(calibrations):
    """Fails if a joint beyond its measured range is not named, or a task within it is."""
    _, sampled, known, task, found = calibrations[0]
    measured = sampled.data.only(sampled.data.train)
    near = measured.only(measured.joints[:, 0] > np.median(measured.joints[:, 0]))
    asked = TaskTolerances(tolerance=1e-4)
    narrow = replace(known, joint_range=np.array([near.joints.min(axis=0), near.joints.max(axis=0)]))
    whole, part = (task_table(model, task, measured, found, asked) for model in (known, narrow))
    far = task.joints[:, 0] < near.joints[:, 0].min() - 0.1 * np.ptp(near.joints[:, 0])
    assert far.any()
    assert all(("joint 1" in said) == is_far for said, is_far in zip(part["beyond"], far, strict=True))
    assert (whole["beyond"] != "").sum() < far.sum()
    told = task_summary(known, part, found, asked, ())
    assert told.beyond_measured == (part["beyond"] != "").sum()
    assert told.all_within <= told.least_within + 1e-9
    assert told.all_within <= told.all_within_alike + 0.05
