"""Refined poses tell more than those that they come from, and are where poses may be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calflow.design.candidates import candidates, packed_conditions
from calflow.design.cell import Cell, CellStation
from calflow.design.optimality import ParameterCriterion, information
from calflow.design.planned import Planned, SelectionRequest, Task
from calflow.design.refinement import refined_poses
from calflow.estimation.noise import PerUnit
from calflow.files.units import RADIAN
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


def request(planned, cell=None):
    """What is asked of the poses."""
    return SelectionRequest(payload="rated", marker="E", region=REGION, planned=planned, cell=cell)


@pytest.mark.parametrize("for_tool", [False, True])
def test_refined_poses_are_better_and_allowed(model, for_tool):
    """Fails if a move makes poses worse, or leaves joint limits, the region or what the loop reaches; or none is made."""
    planned = Planned(model.observations[0], 5e-5)
    readings, _ = candidates(model, 30, "rated", "E", REGION, np.random.default_rng(2))
    prior = np.eye(len(model.parameters))
    criterion = Task.of(readings, ["rated"], "E").criterion(model) if for_tool else ParameterCriterion(len(prior))
    found = refined_poses(model, request(planned), readings, prior, criterion)

    def loss(poses):
        jacobian = (
            model.position_jacobian(model.nominal, packed_conditions(model, poses, "rated", "E"))
            * model.prior_sd
            / 5e-5
        )
        return criterion.loss(np.linalg.inv(information(jacobian, prior)))

    assert loss(found) < 0.9 * loss(readings)
    assert request(planned).allowed(model, found).all()


def test_refined_poses_keep_to_the_cell(model):
    """Fails if a pose is moved to where the cell refuses it; or none would be without it, or none is moved."""
    cell = Cell(
        stations=(CellStation((7.0, 0.0, 1.0)),), reflector_axis=(1.0, 0.0, 1.0), acceptance=np.deg2rad(60), floor=0.2
    )
    planned = Planned(model.observations[0], 5e-5)
    readings, _ = candidates(model, 30, "rated", "E", REGION, np.random.default_rng(2), None, cell)
    prior = np.eye(len(model.parameters))
    free, kept = (
        refined_poses(model, request(planned, one), readings, prior, ParameterCriterion(len(prior)))
        for one in (None, cell)
    )
    assert not request(planned, cell).allowed(model, free).all()
    assert request(planned, cell).allowed(model, kept).all()
    assert (kept != readings).any()


def test_poses_whose_reports_matter_stay(model):
    """Fails if poses are moved where what they tell depends on what is reported there, which a move would change."""
    posed = replace(model, observations=(Pose.planned(Series()),))
    readings, _ = candidates(posed, 10, "rated", "E", REGION, np.random.default_rng(2))
    n = len(posed.parameters)
    planned = Planned(posed.observations[0], 5e-5, PerUnit(((RADIAN, 1e-4),)))
    found = refined_poses(posed, request(planned), readings, np.eye(n), ParameterCriterion(n))
    assert (found == readings).all()
