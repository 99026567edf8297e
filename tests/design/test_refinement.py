"""Refined poses tell more than those that they come from, and are where poses may be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calflow.design.candidates import allowed, candidates, pack
from calflow.design.exchange import information
from calflow.design.optimality import Parameters
from calflow.design.planned import Planned
from calflow.design.refinement import refined
from calflow.design.task import Task
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations.pose import Pose
from calflow.observations.position import Position
from calflow.robot.robot import Robot

HH800 = Path(__file__).parents[2] / "studies" / "hh800" / "robot.toml"
REGION = np.array([[1.5, -1.6, 0.5], [3.6, 1.6, 3.0]])


@pytest.fixture(scope="module")
def model():
    """The HH800's geometry, with its loop, observed by positions."""
    return build(Robot.from_toml(HH800), ("geometry",), (), (Position.planned(Series()),))


@pytest.mark.parametrize("for_tool", [False, True])
def test_refined_poses_are_better_and_allowed(model, for_tool):
    """Fails if a move makes poses worse, or leaves joint limits, the region or what the loop reaches; or none is made."""
    planned = Planned(model.observations[0], 5e-5)
    readings, rows = candidates(model, 30, "rated", "E", REGION, np.random.default_rng(2))
    prior = np.eye(len(model.parameters))
    criterion = Task(rows).criterion(model) if for_tool else Parameters(len(prior))
    found = refined(model, planned, readings, "rated", "E", REGION, prior, criterion)

    def loss(poses):
        jacobian = model.position_jacobian(model.nominal, pack(model, poses, "rated", "E")) * model.prior_sd / 5e-5
        return criterion.loss(np.linalg.inv(information(jacobian, prior)))

    assert loss(found) < 0.9 * loss(readings)
    assert len(allowed(model, found, "rated", "E", REGION)[0]) == 30


def test_poses_whose_reports_matter_stay(model):
    """Fails if poses are moved where what they tell depends on what is reported there, which a move would change."""
    posed = replace(model, observations=(Pose.planned(Series()),))
    readings, _ = candidates(posed, 10, "rated", "E", REGION, np.random.default_rng(2))
    n = len(posed.parameters)
    planned = Planned(posed.observations[0], 5e-5, 1e-4)
    found = refined(posed, planned, readings, "rated", "E", REGION, np.eye(n), Parameters(n))
    assert (found == readings).all()
