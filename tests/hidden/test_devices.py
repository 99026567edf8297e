"""Calibrations without a tracker's positions are worth what they promise; the long version is benchmarks/observations.py."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import calflow as cf
from calflow.robot.robot import Robot
from calflow.study import load_study
from hidden import trials

STUDIES = Path(__file__).parents[2] / "studies"


@pytest.fixture(scope="module")
def nominal():
    """The UR10 as its maker says."""
    return Robot.from_toml(STUDIES / "ur10-tmac" / "robot.toml")


@pytest.mark.parametrize("observe", [trials.by_wire, trials.by_sockets])
def test_the_tool_errs_by_what_is_promised(nominal, observe):
    """Fails if lengths of a wire, or touches of two sockets, do not place the tool as surely as the information matrix says."""
    errors = [trials.tool_error(nominal, observe, seed) for seed in range(3)]
    true, promised = (np.sqrt(np.mean([getattr(e, name) ** 2 for e in errors])) for name in ("true", "promised"))
    assert 0.3 * promised < true < 1.3 * promised


def test_an_anchor_called_known_is_so_beside_the_base(nominal):
    """Fails if a zero of joint 1, which turns the anchor about axis 1 as no other figure does, passes for a cause."""
    rng = np.random.default_rng(1)
    data = trials.by_wire(trials.Arm.drawn(nominal, rng), rng, {"anchor": tuple(trials.ANCHOR)})
    calibration = cf.identify(data.robot, data, effects=["geometry"]).diagnose()
    assert len(calibration.findings) == 0
    assert calibration.accuracy[-1].mean_mm < 1e3 * trials.NOISE


def test_two_stations_of_a_tracker(nominal):
    """Fails if stations of unknown place, or noise along and across the beam, bias parameters or their intervals."""
    stations = trials.Stations.of(nominal)
    z = np.abs(np.array([stations.z(seed) for seed in range(8)]))
    assert (z < 1.96).mean() > 0.9
    assert (z < 3).mean() > 0.98


@pytest.mark.skipif("CALFLOW_DATA" not in os.environ, reason="CALFLOW_DATA names no folder with measurements")
def test_a_real_panda_by_its_sockets():
    """Fails if a placement that was not fitted is not as consistent as what was published."""
    data = load_study(STUDIES / "mukca-panda" / "panda_4.toml").measurements()
    assert trials.left_out_in_turn(data, ("geometry", "gravity-deflection")).mean < 0.278e-3
