"""Poses that the cell allows, against pinocchio's kinematics and coal's distances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import calflow as cf
from calflow.design.candidates import candidates, packed_conditions
from calflow.design.cell import RULES, Cell, CellStation, configuration
from calflow.design.planned import SelectionRequest
from calflow.design.skeleton import Skeleton, box_distances, segment_distances
from calflow.files.problems import InputError
from calflow.model import build
from collisions import BIG, CASES, Outside
from robots import frames as numpy_frames
from robots import hh800, holding_torque, industrial, ur10

NUMBER = 400


@pytest.mark.parametrize("name", CASES)
def test_what_the_cell_allows_is_what_others_find(name):
    """Fails if an allowed pose collides or is out of sight by pinocchio and coal, or one is refused without cause."""
    make, cell = CASES[name]
    robot = make()
    model, outside = build(robot, ()), Outside(robot, cell)
    readings, conditions = candidates(model, NUMBER, "load", "E", None, np.random.default_rng(5))
    refusals = cell.refusals(model, conditions, "E")
    rooms = [outside.room(q) for q in readings]
    least = np.array([min(room.values()) for room in rooms])
    sure = np.abs(least) > 1e-5  # coal's own tolerance is about 1e-6
    assert sure.sum() > 0.99 * NUMBER
    assert np.array_equal(refusals[sure] == 0, least[sure] > 0)
    assert 0 < (refusals == 0).sum() < NUMBER
    names = ["range", "elevation", "acceptance", "links", "around", "sight"]
    first = np.array([next((k for k, one in enumerate(names, 3) if room[one] <= 0), 0) for room in rooms])
    certain = np.array([min(map(abs, room.values())) for room in rooms]) > 1e-5
    assert np.array_equal(first[certain], refusals[certain])
    assert len(np.unique(refusals)) >= 6


@pytest.mark.parametrize("name", ["industrial", "ur10"])
def test_all_candidates_keep_to_the_cell(name):
    """Fails if one of 400 candidates is in a collision or out of sight, or nobody is told what was refused by what."""
    make, cell = CASES[name]
    robot, said = make(), []
    outside = Outside(robot, cell)
    readings, _ = candidates(
        build(robot, ()), NUMBER, "load", "E", None, np.random.default_rng(6), None, cell, said.append
    )
    assert len(readings) == NUMBER
    assert min(min(outside.room(q).values()) for q in readings) > -1e-6
    (words,) = said
    assert "line of sight" in words
    assert "links that touch each other" in words


def test_a_cell_that_allows_nothing_says_what_refused():
    """Fails if a search for poses that there are not goes on for ever, or does not say which rule leaves none."""
    cell = Cell(stations=(CellStation((30.0, 0.0, 0.0), range_max=1.0),))
    with pytest.raises(InputError, match=r"only 0 are left.*the cell allows 0 of \d+ poses; refused by range \d+$"):
        candidates(build(ur10(), ()), 10, "load", "E", None, np.random.default_rng(1), None, cell)


def test_distances_are_the_least_along_the_segments():
    """Fails if a formula is wrong where segments are parallel, points, inside the box or beyond its corner."""
    rng = np.random.default_rng(1)
    a, b, c, d = rng.normal(size=(4, 300, 3))
    b[:30] = a[:30]
    d[:30:2] = c[:30:2]
    d[30:90] = c[30:90] + (b - a)[30:90] * rng.choice([-0.7, 1.3], (60, 1))
    b[90:120, 1:] = a[90:120, 1:]
    low, high = np.array([-0.6, -0.2, -0.4]), np.array([0.5, 0.3, 1.0])

    def least(distance):
        grid = np.linspace(0, 1, 201)
        k = int(np.argmin([distance(t) for t in grid]))
        bounds = grid[max(0, k - 1)], grid[min(200, k + 1)]
        return min(minimize_scalar(distance, bounds=bounds, options={"xatol": 1e-12}, method="bounded").fun,
                   distance(0.0), distance(1.0))  # fmt: skip

    def to_segment(point, start, end):
        way = end - start
        share = np.clip((point - start) @ way / max(way @ way, 1e-30), 0, 1)
        return np.linalg.norm(point - start - share * way)

    lines = segment_distances(a, b, c, d)
    boxes = box_distances(a, b, low, high)
    for start, end, other, far, line, from_it in zip(a, b, c, d, lines, boxes, strict=True):

        def to_line(t, start=start, way=end - start, other=other, far=far):
            return to_segment(start + t * way, other, far)

        def to_box(t, start=start, way=end - start):
            point = start + t * way
            return np.linalg.norm(point - np.clip(point, low, high))

        assert line == pytest.approx(least(to_line), abs=1e-7)
        assert from_it == pytest.approx(least(to_box), abs=1e-7)
    assert (boxes == 0).sum() > 10


def test_nobody_sees_through_a_box():
    """Fails if a line that enters a box counts as beside it by rounding, which it does at one of a thousand poses or so."""
    near = np.deg2rad(
        [-51.2893, -14.0078, 72.2158, 160.5107, 0.1038, 12.2689]
    )  # the first station is behind the first box
    model = build(industrial(), ())
    readings = near + np.random.default_rng(4).uniform(-1e-3, 1e-3, (20_000, 6))
    assert BIG.refusals(model, packed_conditions(model, readings, "load", "E"), "E").all()


def test_the_skeleton_is_the_robots():
    """Fails if a joint, a pin of the loop or the reflector is elsewhere than the mechanics in numpy have it."""
    robot = hh800()
    readings, _ = candidates(build(robot, ()), 50, "rated", "E", None, np.random.default_rng(3))
    at, there = Skeleton.of(robot, readings, "E"), numpy_frames(robot, readings)
    for k, joint in enumerate(there.joints):
        np.testing.assert_allclose(at.nodes[:, k + 1], joint[:, :3, 3], atol=1e-9)
        np.testing.assert_allclose(at.axes[:, k], joint[:, :3, 2], atol=1e-9)
    flange = there.ends[-1]
    np.testing.assert_allclose(at.flange, flange[:, :3, :3], atol=1e-9)
    np.testing.assert_allclose(at.marker, flange[:, :3, 3] + flange[:, :3, :3] @ robot.markers["E"].point, atol=1e-9)
    rod = there.bars[1]
    far = rod[:, :3, 3] + robot.loop.rod.length * rod[:, :3, 0]
    np.testing.assert_allclose(at.bars, np.stack([there.bars[0][:, :3, 3], rod[:, :3, 3], far], axis=1), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(at.bars[:, 2] - at.nodes[:, 3], axis=1), robot.loop.rocker)


def test_arms_of_a_tree_keep_clear_of_each_other():
    """Fails if only the links of one chain are kept apart, or arms that begin on the same link count as touching there."""
    arm = {"limits": (-np.pi, np.pi)}
    joints = [
        cf.Joint(cf.modified_dh(), link="left", **arm),
        cf.Joint(cf.modified_dh(a=0.5), link="left hand", **arm),
        cf.Joint(cf.at_origin(cf.modified_dh(), (0, 0.6, 0)), parent="base", **arm),
        cf.Joint(cf.modified_dh(a=0.5), link="right hand", **arm),
    ]
    markers = {"left": cf.Marker((0.6, 0, 0), on="left hand"), "right": cf.Marker((0.4, 0, 0))}
    model = build(cf.Robot(joints=joints, markers=markers), ())
    side_by_side, crossed, reaching = [0, 0, 0, 0], [60, 0, -60, 0], [0, 90, 0, 0]
    readings = np.deg2rad([side_by_side, crossed, reaching])
    for marker, radius, touching in (
        ("left", None, [crossed]),
        ("left", 0.02, [crossed, reaching]),
        ("right", 0.02, [crossed]),
    ):
        cell = Cell(link_radii=(0.03,) * 4, tool_radius=radius)
        refused = cell.refusals(model, packed_conditions(model, readings, "", marker), marker) > 0
        assert refused.tolist() == [one in touching for one in (side_by_side, crossed, reaching)]


def test_elbow_and_wrist_are_kept():
    """Fails if joint 5 passes zero among poses of one wrist, or the UR10's joint 3 among those of one elbow."""
    robot = ur10()
    like = tuple(np.deg2rad([0, -90, 80, 0, 60, 0]))
    readings, _ = candidates(
        build(robot, ()), 200, "load", "E", None, np.random.default_rng(2), None, Cell(configuration=like)
    )
    assert (np.sin(readings[:, 2]) > 0).all()
    assert (np.sin(readings[:, 4]) > 0).all()
    arm = industrial()
    for q in np.deg2rad([[10, 20, 30, 40, 50, 60], [10, 20, 30, 40, -50, 60]]):
        assert (
            configuration(arm, Skeleton.of(arm, q[None], "E"))[0, 1]
            == np.sign(q[4]) * configuration(arm, Skeleton.of(arm, np.deg2rad([[0, 0, 0, 0, 90, 0]]), "E"))[0, 1]
        )


def test_loads_that_joints_cannot_hold_are_refused():
    """Fails if gravity's torque, from the energy in numpy, is beyond what is allowed, or the payload does not count."""
    robot = industrial()
    rated = 4000.0
    robot = replace(robot, joints=tuple(replace(joint, rated_torque=rated) for joint in robot.joints))
    model, cell = build(robot, ()), Cell(torque_share=0.5, self_collision=False)
    readings, conditions = candidates(model, 200, "load", "E", None, np.random.default_rng(2))
    worst = np.abs(holding_torque(robot, readings, "load")).max(axis=1)
    refusals = cell.refusals(model, conditions, "E")
    assert np.array_equal(refusals == 0, worst <= 0.5 * rated)
    assert set(np.unique(refusals)) == {0, list(RULES).index("payload") + 1}
    empty = cell.refusals(model, packed_conditions(model, readings, "", "E"), "E")
    assert (empty == 0).sum() > (refusals == 0).sum()


def test_stated_poses_keep_to_the_cell():
    """Fails if taught poses are taken that the cell refuses."""
    robot = industrial()
    model = build(robot, ())
    readings, conditions = candidates(model, 100, "load", "E", None, np.random.default_rng(2))
    kept = SelectionRequest(payload="load", marker="E", cell=BIG).allowed(model, readings)
    assert np.array_equal(kept, BIG.refusals(model, conditions, "E") == 0)


def test_sight_begins_where_it_is_said():
    """Fails if what holds the reflector stands in its light although the line is said to begin beyond it, or counts not at all."""
    robot = ur10(markers={"E": {"point_m": [0.0, 0.0, 0.01]}})
    model = build(robot, ())
    _, conditions = candidates(model, 100, "load", "E", None, np.random.default_rng(2))
    cell = Cell(stations=(CellStation((4.0, 0.0, 1.0)),), self_collision=False)
    assert not (cell.refusals(model, conditions, "E") == 0).any()
    assert (replace(cell, sight_from=0.15).refusals(model, conditions, "E") == 0).sum() > 20
