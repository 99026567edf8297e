"""Vias: each joint comes from both sides, straight, and from where the robot can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import qmc

from calflow.design.measuring_order import VIA_TURNS, reached, vias
from calflow.design.planned import SelectionRequest
from calflow.design.selection import planned_poses
from calflow.model import build
from robots import hh800, industrial

POSES = 40
ASKED = SelectionRequest(marker="E")


def drawn(robot, number=POSES):
    """Readings of a robot within its limits."""
    return qmc.scale(qmc.Sobol(robot.n_joints, rng=np.random.default_rng(4)).random(64)[:number], *robot.limits.T)


def test_each_joint_comes_from_both_sides_in_equal_numbers():
    """Fails if a joint comes from one side more often than limits ask for, or the side hangs together with where it goes."""
    robot = industrial()
    readings = drawn(robot)
    came, travel = reached(readings, vias(build(robot, ("geometry",)), ASKED, readings, np.random.default_rng(5)))
    assert set(np.unique(came)) == {-1.0, 1.0}
    up = (came > 0).sum(axis=0)
    assert ((up >= 0.35 * POSES) & (up <= 0.65 * POSES)).all()
    together = [abs(np.corrcoef(came[:, i], readings[:, i])[0, 1]) for i in range(robot.n_joints)]
    assert np.mean(together) < 0.25
    assert (travel >= VIA_TURNS[0] - 1e-9).all()


def test_vias_are_poses_that_the_robot_can_take():
    """Fails if a via lies beyond a joint's limits, its sign or coupling forgotten, or farther from its pose than it should be."""
    for robot in (industrial(), hh800()):
        model, readings = build(robot, ("geometry",)), drawn(robot)
        marker = next(iter(robot.markers))
        good = robot.within_limits(readings @ robot.reading_matrix.T)
        found = vias(model, SelectionRequest(marker=marker), readings[good], np.random.default_rng(6))
        assert robot.within_limits(found @ robot.reading_matrix.T, 1e-9).all()
        way = np.abs(readings[good] - found)
        assert (way <= VIA_TURNS[1] + 1e-9).all()
        assert (way.max(axis=1) > 0).mean() > 0.9


def test_the_sides_in_the_table_are_those_of_the_vias():
    """Fails if approach or travel in poses.csv is that of the order, where each pose is reached from a via."""
    robot = industrial()
    robot = replace(robot, joints=tuple(robot.joints))
    model, readings = build(robot, ("geometry",)), drawn(robot, 8)
    via = readings - np.deg2rad(5.0) * np.where(np.arange(6) % 2, 1.0, -1.0)
    table = planned_poses(model, ASKED, readings, via)
    for i in range(6):
        assert (table[f"approach{i + 1}"] == (1 if i % 2 else -1)).all()
        assert np.allclose(table[f"via{i + 1}_deg"], np.rad2deg(via[:, i]), atol=1e-4)
        assert (table[f"travel{i + 1}_deg"] >= 5 - 1e-4).all()
    assert not [name for name in planned_poses(model, ASKED, readings) if name.startswith(("via", "travel"))]
