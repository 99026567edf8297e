"""Origins: which of a frame's six errors are parameters."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import robots
from calflow.effects.geometry import Geometry
from calflow.estimation.identifiability import redundant
from calflow.robot.frames import LISTED, Axis, FrameOrigin, about, joint_frame, origins_left_out, placement, rpy_of
from calflow.robot.mechanism import Deflection, nominal_dimensions, pose, symbols_like
from calflow.robot.robot import Robot
from robot.formats import urdfs


def slopes(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """How the flange (12 figures of 60 poses) moves by the base's errors and all steps, and by the base's and the free ones."""
    dims, q = symbols_like(nominal_dimensions(robot)), ca.SX.sym("q", robot.n_joints)
    flange = placement(dims.base) @ pose(robot, dims, q, Deflection.zero(robot.n_joints)).flange
    figures = ca.vertcat(dims.base, dims.steps)
    moved = ca.jacobian(ca.vec(flange[:3, :]), figures)
    function = ca.Function("slopes", [*vars(dims).values(), q], [ca.densify(moved)])
    nominal = vars(nominal_dimensions(robot)).values()
    poses = np.random.default_rng(4).uniform(-2, 2, (60, robot.n_joints))
    every = np.vstack([np.array(function(*(ca.DM(ca.evalf(one)) for one in nominal), one)) for one in poses])
    origins = [6 + k for k, step in enumerate(robot.steps) if step.symbol in LISTED]
    free = [6 + error.index for error in Geometry(robot).errors if error.field == "steps"]
    return every[:, [*range(6), *origins]], every[:, [*range(6), *free]]


@pytest.mark.parametrize("seed", range(10))
def test_parameters_span_all_errors_of_origins_and_none_is_there_twice(seed: int, tmp_path: Path) -> None:
    """Fails if an error of an origin is nobody's parameter, or two parameters do the same whatever the pose."""
    path = tmp_path / "tree.urdf"
    path.write_text(urdfs.tree(seed))
    every, free = slopes(Robot.from_urdf(path, tip="tip"))
    sizes = np.linalg.svd(free, compute_uv=False)
    assert sizes[-1] > 1e-4 * sizes[0]
    assert np.linalg.matrix_rank(every, tol=1e-7 * sizes[0]) == free.shape[1]


@pytest.mark.parametrize(("xyz", "axis", "expected"), [
    ((0, 0.2, 0), (0, 1, 0), ("z", "rz")),  # at a right angle: what a turn or a shift of the joint before does
    ((0, -0.17, 0.6), (0, 0, 1), ("x", "z")),  # parallel: the shift across the way between them, and along them
    ((0.6, 0.1, 0.2), (0, 0, -1), ("y", "z")),
    ((0.01, 0, 0.2), (0, 0, 1), ("z", "theta")),  # nearly one line: both zeros do the same
])  # fmt: skip
def test_what_is_left_out(xyz: tuple[float, ...], axis: tuple[float, ...], expected: tuple[str, ...]) -> None:
    """Fails if a joint's zero gives way to a figure that people think of less, or the wrong figure is left out."""
    frame = joint_frame(FrameOrigin(xyz), Axis(axis), before=Axis((0, 0, 1)))
    assert origins_left_out(frame) == expected


def test_what_is_left_out_is_named(tmp_path: Path) -> None:
    """Fails if a reader is not told which figures of a URDF are no parameters, or is told so of a robot by DH."""
    path = tmp_path / "tree.urdf"
    path.write_text(urdfs.tree(1))
    robot = Robot.from_urdf(path, tip="tip")
    names = {parameter.name for parameter in Geometry(robot).parameters()}
    figures = {
        f"joint{i}.{s.symbol}" for i, f in enumerate(robot.frames, start=1) for s in f.steps if s.symbol in LISTED
    }
    assert set(redundant(robot)["figure"]) == figures - names
    assert redundant(robots.ur10()).empty


def test_the_first_joints_origin_is_the_bases_and_a_slide_has_a_direction_only() -> None:
    """Fails if a parameter stands for what base or a slide do already."""
    assert origins_left_out(joint_frame(FrameOrigin(), Axis((0, 0, 1)), before=None)) == (
        "x",
        "y",
        "z",
        "rx",
        "ry",
        "theta",
    )
    rail = Axis((1, 0, 0), slides=True)
    assert origins_left_out(joint_frame(FrameOrigin((0, 0, 0.4)), Axis((0, 0, 1)), before=rail)) == (
        "x",
        "y",
        "z",
        "rx",
    )


@pytest.mark.parametrize("off", [0.0, 1e-13, 3e-12, 1e-9, 1e-6, 0.3])
@pytest.mark.parametrize("side", [1, -1])
def test_an_origin_s_angles_are_exact_at_and_near_a_right_angle(off: float, side: int) -> None:
    """Fails if x and z, which turn about nearly the same line there, are each rounded apart from the other."""
    rng = np.random.default_rng(1)
    for roll, yaw in rng.uniform(-3, 3, (20, 2)):
        turn = about(2, yaw) @ about(1, side * (np.pi / 2 - off)) @ about(0, roll)
        turn = about(1, 0.7) @ (about(1, -0.7) @ turn)  # as it comes out of a chain: rounded
        assert np.abs(FrameOrigin(rpy=rpy_of(turn)).rotation - turn).max() < 1e-11
