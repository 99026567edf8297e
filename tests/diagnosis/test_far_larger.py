"""Causes far larger than a catalogue expects: data that clearly say so are believed, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

import calflow as cf
from calflow.estimation.prior_scale import on_likeliest_scale
from calflow.linear import Block, diagnose_linear
from hidden.case import Case, write_case
from hidden.causes import Hidden

USUAL = 3e-3
ON_ARM: dict[str, tuple[float, Case]] = {  # cause, size as findings state it
    "gear-transmission-error": (3e-3, Case(hidden=(Hidden("gear-transmission-error", 3, 3e-3),), sigma=1e-3, poses=60)),
    "joint-eccentricity": (15e-3, Case(hidden=(Hidden("joint-eccentricity", 4, 15e-3),), sigma=1e-3, poses=40)),
    "tool-deflection": (
        float(np.hypot(3e-5, 1.5e-5)),
        Case(hidden=(Hidden("tool-adapter", 0, 3e-5),), sigma=3e-4, poses=60),
    ),
}


def told(found: float, sd: float) -> tuple[float, float, float]:
    """Scale, estimate and sd of one amplitude, which the data alone find with an sd."""
    variance = 1 / (sd**-2 + USUAL**-2)
    estimate = variance * found / sd**2
    scale, mean, covariance = on_likeliest_scale(
        np.array([estimate]), np.array([[variance]]), (np.zeros(1), np.array([USUAL]))
    )
    return scale, float(mean[0]), float(covariance[0, 0] ** 0.5)


def test_data_that_clearly_say_26_mrad_are_believed():
    """Fails if a prior as wide as the data's error halves what lies six of both away, or if what is usual is fitted otherwise."""
    scale, estimate, sd = told(26e-3, 3.1e-3)
    assert scale > 1
    assert estimate == pytest.approx(26e-3, abs=2e-3)
    assert sd == pytest.approx(3.1e-3, rel=0.1)
    usual = np.linspace(-1.5, 1.5, 7) * USUAL
    assert {told(size, error * USUAL)[0] for size in usual for error in (0.01, 0.1, 1.0)} == {1.0}


def test_of_two_scales_that_are_nearly_as_likely_the_present_one_stays():
    """Fails if a fit goes to and fro between two scales, each a little likelier by the other's estimate."""
    error, changes = 0.3 * USUAL, []
    for size in np.linspace(1.0, 4.0, 31) * USUAL:
        first = told(size, error)[0]
        prior = np.array([first * USUAL])
        variance = 1 / (error**-2 + prior**-2)
        mean = np.array([size * error**-2]) * variance
        changes.append(on_likeliest_scale(mean, np.diag(variance), (np.zeros(1), prior), first)[0] / first)
    assert set(changes) == {1.0}
    assert told(2.2 * USUAL, error)[0] == 1.0  # as likely on a scale of two
    assert told(3.0 * USUAL, error)[0] == 2.0


def test_intervals_hold_sizes_far_beyond_the_usual():
    """Fails if a block many times its usual size is missed, or its amplitudes lie outside their intervals, as shrunken ones do."""
    assert_held(20.0, 20.0)


def assert_held(over_usual: float, over_error: float) -> None:
    """Amplitudes so many times their usual size, and their error, are in their intervals; benchmarks/slow has smaller ones."""
    rng, inside, number = np.random.default_rng(7), 0, 20
    for _ in range(number):
        course, rows, others = rng.normal(size=(60, 6)), rng.normal(size=(60, 2)), rng.normal(size=(60, 8))
        sd = np.sqrt(np.diag(np.linalg.inv(rows.T @ (rows - course @ np.linalg.lstsq(course, rows)[0])))).mean()
        size = over_error * sd * np.array([1.0, -1.0])
        usual = over_error * sd / over_usual
        residual = -(rows @ size) - course @ rng.normal(size=6) + rng.normal(size=60)
        candidates = [Block("large", rows, usual), *(Block(f"other {k}", others[:, [k]], usual) for k in range(8))]
        findings = diagnose_linear(residual, course, candidates, noise=1.0, rng=rng).findings
        (large,) = (each for each in findings if each.name == "large")
        inside += int((np.abs(large.estimate - size) < 1.96 * large.sd).sum())
    assert inside >= binom.isf(0.995, 2 * number, 0.95)


def test_an_arm_s_cause_many_times_its_usual_size_comes_back(tmp_path: Path):
    """Fails if a gear ten or twenty times off what is usual is missed, or told as far less."""
    assert_comes_back(tmp_path, "gear-transmission-error")


def assert_comes_back(tmp_path: Path, cause: str) -> None:
    """A cause far larger than usual is found, and as large as it is; benchmarks/slow has an encoder and an adapter."""
    size, case = ON_ARM[cause]
    write_case(tmp_path, case, np.random.default_rng(0))
    study = cf.load_study(tmp_path / "study.toml")
    first = cf.identify(study.robot, study.measurements(), study.file.effects, starts=1, seed=1)
    found = first.diagnose(catalogue=(cause,))
    (finding,) = (each for each in found.findings if each.cause == cause)
    assert finding.low < size < finding.high
    assert finding.estimate == pytest.approx(size, rel=0.25)
