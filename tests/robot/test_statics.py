"""Loads on joints, bearings and links against energies and moments summed up in numpy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.model import build
from calflow.robot import mechanism
from calflow.robot.mechanism import (
    Deflection,
    Row,
    gravity_torque,
    nominal_dimensions,
    nominal_loads,
    rated_torques,
    state,
)
from calflow.robot.parts import Base, Marker, Payload
from calflow.robot.robot import Robot

LOOPS = {
    "hh800": robots.hh800(),
    "general open": robots.hh800_with_bars(0.75, 1.7, 0.9),
    "general crossed": robots.hh800_with_bars(0.75, 1.7, 0.9, "crossed"),
    "dh": robots.palletiser(),
}
SERIAL = {"ur10": robots.ur10(), "industrial": robots.industrial()}
WRENCH = np.array([120.0, -250.0, 90.0, 40.0, 25.0, -60.0])


def loads_at(
    robot: Robot, q: np.ndarray, payload: float = 0.0, deflection: Deflection | None = None, **given: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Torque (n,), bearing (6, n) and link (6, n + 1) wrenches at one pose; given are optional conditions."""
    sizes = Row.sizes(robot, tuple(given))
    c = ca.SX.sym("c", sum(sizes.values()))
    row = Row.unpack(robot, c, tuple(given))
    deflection = deflection or Deflection.zero(robot.n_joints)
    found = state(robot, nominal_dimensions(robot), nominal_loads(robot), row, deflection)
    function = ca.Function("state", [c], [ca.densify(x) for x in (found.torque, found.bearing, found.link)])
    ordered = [given[name] for name in sizes if name in given]
    torque, bearing, link = function(np.concatenate([q, [payload] * len(robot.payloads), [1.0], *ordered]))
    return np.array(torque).ravel(), np.array(bearing), np.array(link)


def wrench_in(frame: np.ndarray, forces: list[tuple[np.ndarray, np.ndarray]], moment: np.ndarray) -> np.ndarray:
    """Sum of forces at places and a moment, about a frame's origin and in its axes."""
    total = sum((force for force, _ in forces), np.zeros(3))
    about = sum((np.cross(place - frame[:3, 3], force) for force, place in forces), moment)
    return np.concatenate([frame[:3, :3].T @ total, frame[:3, :3].T @ about])


@pytest.mark.parametrize("loaded", [True, False], ids=["payload", "free"])
@pytest.mark.parametrize("name", LOOPS)
def test_loop_robot_torques_are_the_energy_gradient(name: str, loaded: bool) -> None:
    """Breaks if crank, rod, a link or the payload works on the wrong motor, or the loop transmits wrongly."""
    robot = LOOPS[name]
    q = robots.poses(robot, 40)
    wanted = robots.holding_torque(robot, q, next(iter(robot.payloads)) if loaded else "")
    found = np.array(gravity_torque(robot).map(len(q))(q.T, np.full((1, len(q)), float(loaded)))).T
    assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("name", LOOPS | SERIAL)
def test_a_robot_with_other_figures_takes_the_graphs_of_another(name: str) -> None:
    """Breaks if it takes a figure of the other one too, or if its graphs are built anew."""
    first = (LOOPS | SERIAL)[name]
    joints = [
        replace(joint, frame=joint.frame.restated({"d": 0.1, "theta": 0.2}), mass=50.0, com=(0.1, 0.2, 0.3))
        for joint in first.joints
    ]
    other = replace(
        first,
        joints=tuple(joints),
        gravity=(1.0, 2.0, -9.0),
        base=Base((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
        payloads={load: Payload(70.0, (0.3, 0.2, 0.1)) for load in first.payloads},
        markers={marker: Marker((0.2, 0.1, 0.3)) for marker in first.markers},
    )
    built = []
    for robot in (first, other):
        model, q = build(robot, ("geometry",)), robots.poses(robot, 20)
        wanted = robots.holding_torque(robot, q, next(iter(robot.payloads)))
        torque = np.array(gravity_torque(robot).map(len(q))(q.T, np.ones((1, len(q))))).T
        assert_allclose(torque, wanted, atol=1e-6 * np.abs(wanted).max())
        place = model.position(model.nominal, robots.rows(model, q))
        assert_allclose(place, robots.marker_position(robot, q), atol=1e-12)
        graphs = mechanism._graph, mechanism._marker_graph, mechanism._of_gravity
        built.append([graph.cache_info().misses for graph in graphs])
    assert built[0] == built[1]


@pytest.mark.parametrize("name", SERIAL)
@pytest.mark.parametrize("wrench", [None, WRENCH], ids=["gravity", "wrench"])
def test_wrenches_sum_up_all_that_hangs_outboard(name: str, wrench: np.ndarray | None) -> None:
    """Breaks if a bearing or link end carries the wrong masses, in the wrong frame, about the wrong point."""
    robot = SERIAL[name]
    given = {} if wrench is None else {"wrench": wrench}
    force, moment = (np.zeros(3), np.zeros(3)) if wrench is None else (wrench[:3], wrench[3:])
    for q in robots.poses(robot, 5):
        at = robots.frames(robot, q)
        marker = robots.moved(at.ends[-1], robot.markers["E"].point)
        carried = robots.masses(robot, at, "load")
        torque, bearing, link = loads_at(robot, q, 1.0, **given)
        scale = np.abs(bearing).max()
        for i in range(7):
            hung = [(mass * np.array(robot.gravity), place) for mass, place, carrier in carried if carrier >= i]
            hung.append((force, marker))
            wanted = wrench_in(at.ends[i], hung, moment)
            if i < 6:
                assert_allclose(bearing[:, i], wrench_in(at.joints[i], hung, moment), atol=1e-10 * scale)
                assert_allclose(torque[i], bearing[5, i], atol=1e-10 * scale)
            # what a link's end carries: all beyond it, not the link itself
            assert_allclose(link[:, i], wanted, atol=1e-10 * scale)


@pytest.mark.parametrize("name", SERIAL)
def test_applied_wrench_works_through_the_jacobian(name: str) -> None:
    """Breaks if the force acts elsewhere than at the marker, or force or moment are in another frame."""
    robot = replace(SERIAL[name], gravity=(0.0, 0.0, 0.0))
    model = robots.pinocchio_model(robot, "load")
    data = model.createData()
    for q in robots.poses(robot, 20):
        jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId("E"), pin.LOCAL_WORLD_ALIGNED)
        torque, _, _ = loads_at(robot, q, 1.0, wrench=WRENCH)
        assert_allclose(torque, jacobian.T @ WRENCH, atol=1e-9)


def test_loads_are_taken_at_the_deflected_pose() -> None:
    """Breaks if a deflection is ignored, or the loop does not follow the motors' deflection."""
    robot, step = LOOPS["general open"], np.array([0.01, 0.03, -0.02, 0.01, 0.02, -0.04])
    q = robots.poses(robot, 1)[0]
    still = Deflection.zero(6)
    at_step = loads_at(robot, q, 1.0, Deflection(ca.SX(ca.DM(step)), still.bearing, still.link))
    for found, wanted in zip(at_step, loads_at(robot, q + step, 1.0), strict=True):
        assert_allclose(found, wanted, rtol=1e-9, atol=1e-7)
    assert np.abs(at_step[0] - loads_at(robot, q, 1.0)[0]).max() > 100


def test_loop_works_through_the_applied_wrench() -> None:
    """Breaks if the closed loop does not pass a force at the marker on to both its motors."""
    robot = replace(LOOPS["general open"], gravity=(0.0, 0.0, 0.0))
    for q in robots.poses(robot, 5):
        steps = 1e-6 * np.eye(6)
        tips = [robots.marker_position(robot, np.array([q + h, q - h])) for h in steps]
        wanted = [(tip[0] - tip[1]) @ WRENCH[:3] / 2e-6 for tip in tips]
        torque, _, _ = loads_at(robot, q, wrench=WRENCH * [1, 1, 1, 0, 0, 0])
        assert_allclose(torque, wanted, atol=1e-6)


def test_measured_torques_replace_computed_ones() -> None:
    """Breaks if measured motor torques are added, keep their sign, or change what the bearings carry."""
    robot, measured = robots.ur10(), np.array([1.0, -50.0, 30.0, 2.0, 0.5, -0.1])
    q = robots.poses(robot, 1)[0]
    torque, bearing, link = loads_at(robot, q, 1.0, torque=measured)
    assert_allclose(torque, -measured)  # the loads push against what the motors hold
    computed = loads_at(robot, q, 1.0)
    assert_allclose(bearing, computed[1])
    assert_allclose(link, computed[2])
    assert np.abs(computed[0] + measured).max() > 1


def test_stated_rated_torques_win() -> None:
    """Breaks if a stated rated torque is overruled, or one not stated is not what gravity asks at most."""
    plain = robots.ur10()
    stated = {0: 330.0, 1: 1e-3}
    joints = tuple(replace(joint, rated_torque=stated.get(i)) for i, joint in enumerate(plain.joints))
    rated = rated_torques(replace(plain, joints=joints))
    assert_allclose(rated[:2], [330.0, 1e-3])
    largest = np.abs(robots.holding_torque(plain, robots.poses(plain, 4000), "load")).max(axis=0)
    assert (rated[2:3] <= 1.05 * largest[2:3]).all()
    assert (rated[2:3] >= 0.8 * largest[2:3]).all()
    without = rated_torques(plain)
    assert_allclose(rated[2:], without[2:])
    assert_allclose(without[0], 0.1 * without.max())  # a vertical axis, which gravity does not load
    assert (without[3:] >= 0.1 * without.max() - 1e-9).all()


def test_rated_torques_cover_the_joints_ranges() -> None:
    """Breaks if an unstated rated torque is taken over other poses than the robot's limits allow."""
    robot = robots.hh800()
    everywhere = np.random.default_rng(13).uniform(*robot.limits.T, (4000, 6))
    largest = np.abs(robots.holding_torque(robot, everywhere, "rated")).max(axis=0)
    assert_allclose(rated_torques(robot)[1:3], largest[1:3], rtol=0.07)


def test_rated_torques_take_the_heaviest_payload() -> None:
    """Breaks if the first or no payload counts instead of the heaviest."""
    light, heavy = {"mass_kg": 1.0}, {"mass_kg": 30.0, "com_m": [0, 0, 0.2]}
    rated = [
        rated_torques(robots.ur10(payloads=payloads))
        for payloads in ({}, {"light": light}, {"heavy": heavy}, {"heavy": heavy, "light": light})
    ]
    assert rated[0][1] < rated[1][1] < rated[2][1]
    assert_allclose(rated[3], rated[2])


@pytest.mark.parametrize(
    "robot", [*LOOPS.values(), robots.ur10(payloads={}), robots.hh800_with_bars(rod=2.9, rocker=0.5)]
)
def test_rated_torques_are_positive_numbers(robot: Robot) -> None:
    """Breaks if poses that the loop cannot reach, a loop that closes nowhere, or an unloaded joint leave NaN or zero."""
    rated = rated_torques(robot)
    assert rated.shape == (6,)
    assert np.isfinite(rated).all()
    assert (rated > 0).all()
