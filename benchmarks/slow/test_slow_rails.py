"""Rails that are twisted far more than rails are, measured in part, or warm: told as what they are."""

from __future__ import annotations

from math import pi

import numpy as np

from calflow import Measurements, identify
from effects.test_axis_straightness import ON_A_RAIL, SIGMA, TRAVEL, drawn, measured, points
from effects.test_drive_stretch import lifted, told


def test_a_twisted_rail_is_as_twisted_as_it_is():
    """Fails if a curve beyond what rails usually have is pulled towards zero, and the arm's dimensions take up the rest."""
    rng = np.random.default_rng(7)

    def rolling(poses: int) -> Measurements:
        q = drawn(poses, rng)
        off = np.zeros((poses, 6))
        off[:, 5] = 1.5e-3 * np.sin(pi * q[:, 0] / TRAVEL)
        return measured(q, off, rng)

    told = identify(ON_A_RAIL, rolling(90), ("geometry",), starts=1).diagnose(catalogue=["axis-straightness"])
    assert [(found.cause, found.joint) for found in told.findings] == [("axis-straightness", 1)]
    error = told.validate(rolling(60), station="known").judged.rms_mm
    assert np.sqrt(error**2 - 3e6 * SIGMA**2) < 2.5e3 * SIGMA  # 0.24 mm with curves of the usual size alone


def test_beyond_the_measured_rail_the_promise_is_as_wide_as_its_curves():
    """Fails if the rail counts as straight where the carriage never was, so that the tool is off by more than was promised."""
    rng = np.random.default_rng(8)
    rate, phase = rng.normal(0, 3.0, (6, 60)), rng.uniform(0, 2 * pi, (6, 60))
    size = np.array([1.5e-4] * 3 + [5e-5] * 3)
    q, new = drawn(150, rng), drawn(60, rng)
    q[:, 0] = 0.2 * TRAVEL + 0.6 * q[:, 0]
    new[:, 0] = np.where(new[:, 0] < TRAVEL / 2, 0.3 * new[:, 0], TRAVEL - 0.3 * (TRAVEL - new[:, 0]))

    def off(at: np.ndarray) -> np.ndarray:
        return size * np.cos(at[:, :1, None] * rate + phase).sum(axis=2) / np.sqrt(30)

    told = identify(ON_A_RAIL, measured(q, off(q), rng), ("geometry",), starts=1).diagnose(
        catalogue=["axis-straightness"]
    )
    assert [found.cause for found in told.findings] == ["axis-straightness"]
    there = told.predict(new)
    error = there.position - points(new, off(new), 0.8003)
    assert (np.abs(error) < 1.96 * there.sd).mean() > 0.9
    assert 0.7 < np.sqrt((there.sd**2).sum() / (error**2).sum()) < 2.5


def test_a_rack_that_grows_is_told_from_a_device_that_wanders():
    """Fails if what a rack gains as it warms up is called drift, and the arm misses elsewhere on another day."""
    rng = np.random.default_rng(6)
    q, time = drawn(90, rng), np.cumsum(rng.uniform(30, 70, 90))
    warm = 294.15 + 6 * (1 - np.exp(-time / 1800))
    grown = np.zeros((90, 6))
    grown[:, 2] = 23e-6 * (warm - 294.15) * q[:, 0]
    seen = points(q, grown) + SIGMA * rng.standard_normal((90, 3))
    data = Measurements.from_arrays(ON_A_RAIL, q, seen, sigma=SIGMA, time=time, temperature=warm).split(seed=3)
    told = identify(ON_A_RAIL, data, ("geometry",), starts=1).diagnose(
        catalogue=["axis-straightness", "frame-drift", "frame-step", "gear-ratio-error", "thermal-growth"]
    )
    assert ("gear-ratio-error", 1) in {
        (found.cause, found.joint) for found in told.findings if "temperature" in found.detail
    }
    assert "frame-drift" not in {found.cause for found in told.findings}


def test_a_stiff_belt_is_not_found_soft():
    """Fails if a lift's belt that gives way to nothing is said to stretch."""
    assert not told(lifted(0.0, np.random.default_rng(8)))
