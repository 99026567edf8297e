"""Outliers among repeats: told by the others of their pose, and never for noise of another size or for what a joint does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.estimation.identification import fit_effects
from calflow.faults import examined
from calflow.faults.repeats import among_repeats
from calflow.study import load_study
from hidden.case import Case, draw, write_case
from hidden.causes import measured_points

SIZES = [(10, 4), (40, 3), (60, 2), (100, 5)]  # poses, repeats of each
CASE = Case(poses=40, repeats=3, payloads=("none",), columns=(), effects=("geometry",), sigma=2e-5)


def drawn(rng, poses, times, degrees=0):
    """Noise of unit variance, normal or of Student's t, and which pose each row is of."""
    shape = (poses * times, 3)
    noise = rng.standard_t(degrees, shape) / np.sqrt(degrees / (degrees - 2)) if degrees else rng.standard_normal(shape)
    return noise, np.repeat(np.arange(poses), times)


def odd(error, group, session=""):
    """The rows that are outliers among repeats."""
    return np.flatnonzero(among_repeats(error, group, np.broadcast_to(session, len(error)))[1]).tolist()


@pytest.mark.parametrize(("degrees", "share"), [(0, 0.01), (5, 0.04)])
@pytest.mark.parametrize(("poses", "times"), SIZES)
def test_noise_has_no_outliers(poses, times, degrees, share):
    """Fails if repeats are left out of more than one series in a hundred for nothing, or tails of the noise are cut off."""
    rng = np.random.default_rng(41)
    assert np.mean([odd(*drawn(rng, poses, times, degrees)) != [] for _ in range(200)]) <= share


@pytest.mark.parametrize(("poses", "times"), SIZES)
def test_a_gross_error_is_found(poses, times):
    """Fails if a row 25 standard deviations off stays in its pose's mean, or others than those of its pair go with it."""
    rng = np.random.default_rng(42)
    for _ in range(20):
        error, group = drawn(rng, poses, times)
        error[7] += 25 * np.array([0.6, 0.0, 0.8])
        assert odd(error, group) == ([6, 7] if times == 2 else [7])


def test_the_noise_is_as_without_gross_errors():
    """Fails if one row in twenty that is 25 sigma off makes the noise two or three times too large."""
    error, group = drawn(np.random.default_rng(42), 100, 3)
    wrong = np.arange(7, len(error), 20)
    error[wrong] += 25 * np.array([0.6, 0.0, 0.8])
    assert odd(error, group) == wrong.tolist()


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("times", [3.0, 5.0])
def test_a_day_of_larger_noise_has_no_gross_errors_for_that(times, told):
    """Fails if the repeats of a noisy day count as gross errors by the others', or errors of that day as its noise."""
    rng = np.random.default_rng(44)
    error, group = drawn(rng, 40, 3)
    day = np.where(group < 10, "windy", "calm")
    error[day == "windy"] *= times
    assert odd(error, group, day if told else "") == []
    error[7] += 60 * times * np.array([0.6, 0.0, 0.8])
    assert odd(error, group, day) == [7]


def test_a_pose_whose_repeats_all_scatter_has_no_gross_errors_for_that():
    """Fails if noise that grows with range, or a pose where the robot trembles, looks like slips of the pen."""
    rng, found = np.random.default_rng(45), 0
    for _ in range(50):
        error, group = drawn(rng, 40, 5)
        assert odd(error * np.exp(rng.uniform(-1, 1, 40))[group, None], group) == []
        error[group == 3] *= 10
        found += odd(error, group) != []
    assert found <= 2


def rows_of(folder, change, case=CASE):
    """Measurements of a robot, the file's positions [mm] moved by what change returns, (n_rows, 3) [m]."""
    write_case(folder, case, np.random.default_rng(3))
    table = pd.read_csv(folder / "measurements.csv")
    table[["x_mm", "y_mm", "z_mm"]] += 1e3 * change(draw(case, np.random.default_rng(3)))
    table.to_csv(folder / "measurements.csv", index=False)
    return load_study(folder).measurements()


def slips(_):
    """Two repeats 0.6 mm off."""
    moved = np.zeros((120, 3))
    moved[[10, 61]] = [[4e-4, 0.0, -4.5e-4], [0.0, 6e-4, 0.0]]
    return moved


def test_the_user_is_told_and_the_means_are_without_them(tmp_path):
    """Fails if lines or poses are wrong, or the errors pull the means that are fitted."""
    data, (fault,) = examined(rows_of(tmp_path, slips))
    assert (fault.cause, fault.action, fault.lines) == ("outlier", "left out", (12, 63))
    assert "lines 12, 63 (poses 4 and 21)" in fault.statement
    assert "times their scatter; left out; measure again" in fault.statement
    (tmp_path / "clean").mkdir()
    clean = examined(rows_of(tmp_path / "clean", lambda _: 0))[0]
    assert not (data.table["split"] == "")[clean.table["split"] == ""].any()
    with_errors, without = (fit_effects(rows, ("geometry",), starts=1).known for rows in (data, clean))
    apart = np.abs(with_errors.estimate - without.estimate) / np.sqrt(np.diag(without.covariance))
    assert apart.max() < 0.5


@pytest.mark.parametrize(
    ("times", "slipped", "lines", "both"), [(2, [10], (12, 13), True), (5, [10, 12], (12, 14), False)]
)
def test_both_of_two_are_said_to_differ_only_where_no_repeat_remains(tmp_path, times, slipped, lines, both):
    """Fails if two slips in a pose whose other three repeats agree are told as a pair that differs, or such a pair is not."""

    def moved(_):
        by = np.zeros((120, 3))
        by[slipped] = np.array([[4e-4, 0.0, 0.0], [0.0, 4e-4, 0.0]])[: len(slipped)]
        return by

    _, (fault,) = examined(rows_of(tmp_path, moved, replace(CASE, poses=120 // times, repeats=times)))
    assert (fault.cause, fault.lines) == ("outlier", lines)
    assert ("of two that differ both" in fault.statement) == both


def rests_elsewhere(world):
    """Joint 2 comes to rest 0.25 mrad off at the last repeat of every sixth pose."""
    q = world.rows.q.copy()
    q[2::18, 1] += 2.5e-4
    turned = measured_points(world.real, replace(world.rows, q=q), world.hidden)
    return turned - measured_points(world.real, world.rows, world.hidden)


def scatters_along_one_axis(_):
    """Noise along z a hundred times that along x and y, in every row."""
    return 2e-3 * np.random.default_rng(43).standard_normal((120, 3)) * [0, 0, 1]


@pytest.mark.parametrize("change", [rests_elsewhere, scatters_along_one_axis])
def test_what_many_repeats_do_is_no_gross_error(tmp_path, change):
    """Fails if what a joint does now and then is left out as gross errors, where nobody looks for it, or all repeats are."""
    assert examined(rows_of(tmp_path, change))[1] == ()
