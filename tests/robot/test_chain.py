"""Kinematics and gravity torques against pinocchio and plain numpy."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.model import Model, build
from calflow.robot.mechanism import Deflection, Row, gravity_torque, marker_point, nominal_dimensions, pose
from calflow.robot.parts import Coupling
from calflow.robot.robot import Robot

SERIAL = {"ur10": robots.ur10(), "industrial": robots.industrial()}


def kinematics(robot: Robot) -> ca.Function:
    """Graph of q -> flange (4, 4), marker (3,), the marker's Jacobian (3, n)."""
    q, dims = ca.SX.sym("q", robot.n_joints), nominal_dimensions(robot)
    still = Deflection.zero(robot.n_joints)
    at = pose(robot, dims, q, still)
    point = marker_point(robot, dims, q, still, ca.SX.ones(1))
    return ca.Function("kinematics", [q], [at.flange, point, ca.jacobian(point, q)])


@pytest.mark.parametrize("name", SERIAL)
def test_frames_and_jacobian_equal_pinocchio(name: str) -> None:
    """Breaks if a DH convention's order of motions, a sign or an offset is wrong."""
    robot = SERIAL[name]
    model, graph = robots.pinocchio_model(robot, "load"), kinematics(robot)
    data = model.createData()
    for q in robots.poses(robot, 25):
        pin.framesForwardKinematics(model, data, q)
        flange, point, jacobian = (np.array(value) for value in graph(q))
        assert_allclose(flange, data.oMf[model.getFrameId("flange")].homogeneous, atol=1e-9)
        assert_allclose(point.ravel(), data.oMf[model.getFrameId("E")].translation, atol=1e-9)
        wanted = pin.computeFrameJacobian(model, data, q, model.getFrameId("E"), pin.LOCAL_WORLD_ALIGNED)[:3]
        assert_allclose(jacobian, wanted, atol=1e-9)


@pytest.mark.parametrize("name", SERIAL)
@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.80665), (3.0, -2.0, -9.0)])
def test_gravity_torques_equal_pinocchio(name: str, gravity: tuple[float, float, float]) -> None:
    """Breaks if a mass hangs in the wrong frame, a payload is left out, or gravity's direction is ignored."""
    robot = replace(SERIAL[name], gravity=gravity)
    model, torque = robots.pinocchio_model(robot, "load"), gravity_torque(robot)
    data = model.createData()
    for q in robots.poses(robot, 25):
        wanted = pin.computeGeneralizedGravity(model, data, q)
        assert_allclose(np.array(torque(q, [1.0])).ravel(), wanted, atol=1e-9 * np.abs(wanted).max())


def test_numpy_mechanics_equal_pinocchio() -> None:
    """Breaks if the numpy mechanics, which the other tests lean on, go wrong together with the graph."""
    for robot in SERIAL.values():
        model = robots.pinocchio_model(robot, "load")
        data = model.createData()
        for q in robots.poses(robot, 5, seed=2):
            pin.framesForwardKinematics(model, data, q)
            assert_allclose(robots.marker_position(robot, q), data.oMf[model.getFrameId("E")].translation, atol=1e-12)
            wanted = pin.computeGeneralizedGravity(model, data, q)
            assert_allclose(robots.holding_torque(robot, q, "load"), wanted, atol=1e-7 * np.abs(wanted).max())


def test_signs_and_couplings_turn_readings_into_angles() -> None:
    """Breaks if a sign or FANUC's J2/J3 coupling is dropped, transposed, or applied to the signed angle."""
    plain = robots.industrial()
    joints = tuple(replace(j, sign=s) for j, s in zip(plain.joints, (1, -1, -1, 1, -1, 1), strict=True))
    coupling = Coupling(joint=3, source=2, factor=1.0)
    robot = replace(plain, joints=joints, couplings=(coupling,))
    readings = np.random.default_rng(3).uniform(-1, 1, (10, 6))
    q = readings * [1, -1, -1, 1, -1, 1]
    q[:, 2] += readings[:, 1]
    model = build(robot, [])
    assert_allclose(
        model.position(model.nominal, robots.rows(model, readings)), robots.marker_position(plain, q), atol=1e-12
    )
    symbols = ca.SX.sym("c", model.n_conditions)
    angles = ca.Function("q", [symbols], [Row.unpack(robot, symbols).q])
    assert_allclose(np.array(angles(robots.rows(model, readings))).T, q, atol=1e-15)


@pytest.mark.parametrize("convention", ["dh", "modified-dh"])
def test_prismatic_joint_slides_along_z(convention: str) -> None:
    """Breaks if a prismatic joint turns, slides elsewhere, loses its offset, or its drive holds no force."""
    robot = robots.robot(
        convention,
        [
            {"a_m": 0.4, "theta_deg": 20, "mass_kg": 8.0, "com_m": [0.1, 0.05, 0]},
            {"a_m": 0.3, "alpha_deg": 180, "mass_kg": 5.0},
            {
                "kind": "prismatic",
                "alpha_deg": 10,
                "d_m": 0.1,
                "theta_deg": 30,
                "limits_mm": [0, 250],
                "mass_kg": 2.0,
                "com_m": [0, 0.02, 0.1],
            },
        ],
        payloads={"load": {"mass_kg": 3.0, "com_m": [0.01, 0, 0.05]}},
    )
    q = robots.poses(robot, 10)
    assert q[:, 2].min() >= 0
    assert q[:, 2].max() <= 0.25
    model = Model(robot, ())
    assert_allclose(model.position(model.nominal, robots.rows(model, q)), robots.marker_position(robot, q), atol=1e-12)
    wanted = robots.holding_torque(robot, q, "load")
    assert np.abs(wanted[:, 2]).min() > 40  # the weight of 5 kg, against the slide
    torque = gravity_torque(robot).map(len(q))(q.T, np.ones((1, len(q))))
    assert_allclose(np.array(torque).T, wanted, atol=1e-6)


def test_two_rotations_between_parallel_axes() -> None:
    """Breaks if beta is applied before the link's length in modified DH, or before alpha in DH."""
    for convention in ("dh", "modified-dh"):
        joint = {"alpha_deg": 20, "a_m": 0.5, "beta_deg": 15, "d_m": 0.2}
        robot = robots.robot(convention, [joint, joint])
        turns = robots.turned(0, np.deg2rad(20)), robots.turned(1, np.deg2rad(15))
        length, offset = robots.shifted(0.5, 0, 0), robots.shifted(0, 0, 0.2)
        link = (
            turns[0] @ length @ turns[1] @ offset
            if convention == "modified-dh"
            else offset @ length @ turns[0] @ turns[1]
        )
        flange = np.array(kinematics(robot)(np.zeros(2))[0])
        assert_allclose(flange, link @ link, atol=1e-14)
