"""Figures of an arm that no maker set: zeros degrees off, as of a printed arm or one whose encoders were mounted anew.

The arm is simulated by NumPy alone.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import calflow as cf
from calflow.effects.geometry import Geometry
from calflow.robot.parts import PLACED_SD
from robots import industrial

LENGTHS = (
    (0.12, 0.0, 90),
    (0.0, 0.22, 0),
    (0.0, 0.02, 90),
    (0.18, 0.0, -90),
    (0.0, 0.0, 90),
    (0.06, 0.0, 0),
)  # d, a, alpha
SIGMA = 3e-5  # m


def arm() -> cf.Robot:
    frames = [cf.dh(alpha=np.deg2rad(alpha), a=a, d=d) for d, a, alpha in LENGTHS]
    return cf.Robot(
        [cf.Joint(frame, limits=(-2.9, 2.9)) for frame in frames],
        base=cf.Base(known=False), markers={"tool": cf.Marker((0.05, 0.02, 0.08), known=False)},
    )  # fmt: skip


def measured(zeros: np.ndarray, n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Readings of poses (n, 6), and where a tracker sees the tool's point (n, 3), with errors of all lengths."""
    rng = np.random.default_rng(7)
    off, readings = rng.normal(0, 5e-4, (6, 2)), rng.uniform(-2.4, 2.4, (n, 6))
    points = []
    for q in readings:
        whole = np.eye(4)
        for (d, a, alpha), (by_d, by_a), angle in zip(LENGTHS, off, q + zeros, strict=True):
            (c, s), (ca, sa) = ((np.cos(turn), np.sin(turn)) for turn in (angle, np.deg2rad(alpha)))
            a, d = a + by_a, d + by_d
            whole = whole @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        points.append((whole @ [0.05, 0.02, 0.08, 1])[:3])
    return readings, np.array(points) + rng.normal(0, SIGMA, (n, 3))


def calibrated(robot: cf.Robot, zeros: np.ndarray, parameters: cf.Parameters | None = None) -> cf.Calibration:
    readings, points = measured(zeros)
    data = cf.Measurements.from_arrays(robot, readings, points, sigma=SIGMA).split(holdout=0.3, seed=1)
    return cf.identify(robot, data, ["geometry"], parameters=parameters, starts=1)


ASSEMBLED = np.deg2rad([0.0, -2.4, 2.6, -1.0, 1.8, 0.0])


@pytest.fixture(scope="module")
def assembled() -> cf.Calibration:
    return calibrated(arm(), ASSEMBLED)


def test_zeros_that_no_maker_set_are_found_and_hide_behind_no_cause(assembled: cf.Calibration, tmp_path: Path) -> None:
    """Fails if a zero is held at the end of what a maker's robot is off: the others bend, and a joint gets an error curve."""
    found = assembled
    for k in (2, 3, 4, 5):
        zero = found.parameters[f"joint{k}.theta"]
        assert not zero.at_bound
        assert abs(zero.value - ASSEMBLED[k - 1]) < 4 * zero.sd + 1e-4
    held_out = found.accuracy.table.set_index(["model", "split"])["rms_mm"]["geometry", "holdout"]
    assert held_out < 2.5 * 1e3 * SIGMA
    assert not found.diagnose(catalogue=["joint-eccentricity", "gear-ratio-error"]).findings
    kept = cf.Calibration.load(found.save(tmp_path / "kept"))
    assert kept.parameters["joint4.theta"].prior == found.parameters["joint4.theta"].prior == (0.0, 0.02)


def test_only_figures_of_a_kind_that_the_data_contradict_lose_their_prior(assembled: cf.Calibration) -> None:
    """Fails if one mistaken zero frees lengths, which few poses may not determine, or a usual robot loses any prior."""
    found = assembled.parameters
    assert found["joint3.a"].prior == (0.0, 0.002)
    assert found["joint5.theta"].prior == (0.0, 0.02)
    usual = calibrated(arm(), ASSEMBLED / 10).parameters
    assert usual["joint3.theta"].prior == (0.0, 0.002)


def test_a_bound_that_a_user_states_holds() -> None:
    """Fails if a statement of the user's is passed over."""
    robot = arm()
    readings, points = measured(ASSEMBLED)
    data = cf.Measurements.from_arrays(robot, readings, points, sigma=SIGMA).split(holdout=0.3, seed=1)
    own = cf.Parameters.of(robot, data, ["geometry"]).bound("joint3.theta", -0.03, 0.03)
    found = calibrated(robot, ASSEMBLED, own).parameters
    assert found["joint3.theta"].value == pytest.approx(0.03, abs=1e-4)
    assert found["joint3.theta"].bounds == (-0.03, 0.03)


def test_a_figure_that_only_moves_the_flange_with_its_marker_is_none_that_positions_contradict() -> None:
    """Fails if a load, felt through a spring that the model lacks, frees the last link's length: programs land millimetres off."""
    geometry = Geometry(industrial())
    by_name = {parameter.name: parameter for parameter in geometry.parameters()}
    assert geometry.without_mistaken([by_name["joint6.d"], by_name["joint6.theta"]]) == geometry
    freed = {p.name: p.prior_sd for p in geometry.without_mistaken([by_name["joint4.d"]]).parameters()}
    assert freed["joint4.d"] == PLACED_SD
    assert freed["joint6.d"] == by_name["joint6.d"].prior_sd
