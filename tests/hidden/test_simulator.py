"""The simulator is right by measures of its own: another library, its energy, and the sizes of what it hides."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

from calflow.design.candidates import packed_conditions
from calflow.model import build
from calflow.robot import robot as stated
from hidden.case import Case, draw, effect_rms, write_case
from hidden.causes import PHYSICAL, Hidden, measured_points, response
from hidden.file_faults import ON_TABLE, XYZ
from hidden.simulator import Motion, Robot, Rows, energy, equilibrium, frames, moved, statics, tool_point

ROBOTS = ("serial", "hh800")
TIMES = ("approach", "travel", "time", "temperature")
USUAL = {
    "joint-compliance": (3, 5e-8, ""),
    "gravity-deflection": (0, 1.0, ""),
    "nonlinear-joint-stiffness": (2, 3e-4, ""),
    "nonlinear-joint-stiffness break": (2, 3e-4, "break"),
    "nonlinear-joint-stiffness sides": (5, 3e-4, "sides"),
    "joint-backlash": (2, 1e-4, ""),
    "torque-backlash": (3, 1e-4, ""),
    "joint-hysteresis": (1, 1e-4, ""),
    "friction-wind-up": (2, 2e-4, 0.3),
    "loaded-transmission-error": (2, 2e-4, 2),
    "loaded-transmission-error warm": (2, 2e-4, "warm"),
    "joint-eccentricity": (2, 1e-4, 2),
    "periodic-joint-error": (3, 1e-4, 7.3),
    "joint-error-map": (1, 2e-4, ""),
    "gear-transmission-error": (2, 8e-5, 2),
    "gear-ratio-error": (3, 1e-4, ""),
    "wrist-coupling": (0, 2e-4, "65"),
    "bearing-compliance": (2, 1e-7, 0.5),
    "bearing-play": (4, 2e-4, ""),
    "axis-wobble": (2, 1e-4, ""),
    "link-bending": (2, 1e-7, ""),
    "link-torsion": (2, 1e-7, ""),
    "base-compliance": (0, 1e-8, ""),
    "base-play": (0, 2e-4, ""),
    "rod-play": (3, 2e-4, ""),
    "gravity-compensator": (2, 1e3, ""),
    "dress-pack": (4, 100.0, ""),
    "payload-mass": (0, 0.1, ""),
    "payload-com": (0, 0.05, ""),
    "payload-step": (0, 0.1, ""),
    "link-mass": (3, 0.1, ""),
    "tool-deflection": (0, 3e-7, "anisotropic"),
    "thermal-growth": (0, 12e-6, ""),
    "link-growth": (2, 2e-5, ""),
    "bar-growth": (2, 2e-5, ""),
    "housing-growth": (2, 3e-5, ""),
    "warm-zero": (2, 1e-5, ""),
    "session-frame": (0, 3e-4, ""),
    "stand-growth": (0, 3e-5, ""),
    "scale-growth": (0, 1e-5, ""),
    "wander": (0, 1.2e-4, ""),
    "tool-sag": (0, 1e-4, ""),
    "tool-bracket": (0, 3e-7, ""),
    "tool-adapter": (0, 1e-6, ""),
    "thermal-growth warm-up": (0, 1e-4, "warm-up"),
    "cantilever-bracket": (0, 3e-7, ""),
    "oblique-beam": (2, 5e-8, ""),
    "tapered-beam": (2, 1e-7, 4.0),
    "offset-bearing": (2, 1e-7, 0.2),
    "spring-compensator": (2, 1e3, ""),
    "warm-link": (2, 1e-4, ""),
    "frame-drift": (0, 2e-4, ""),
    "frame-step": (0, 1e-4, ""),
    "tracker-scale": (0, 2e-5, ""),
    "third-order": (2, 1e-4, ""),
    "cable-drag": (0, 2e-4, ""),
    "joint-step": (2, 2e-4, ""),
    "tool-slip": (0, 2e-4, ""),
    "random-field": (0, 1e-4, ""),
    "floor-vibration": (0, 5e-5, ""),
}


def hidden(name: str, size: float | None = None) -> Hidden:
    """A cause of its usual size, or another."""
    joint, usual, extra = USUAL[name]
    return Hidden(name.split()[0], joint, usual if size is None else size, extra)


def loaded(robot: str, poses: int = 30) -> tuple[Robot, Rows]:
    """A robot as built, at rows under all its payloads."""
    world = draw(Case(robot=robot, poses=poses), np.random.default_rng(1))
    return world.real, world.rows


def pinocchio_model(robot: Robot, payload: int) -> pin.Model:
    """The same serial robot in pinocchio, its base the world, with a frame `E`."""
    model, parent = pin.Model(), 0
    model.gravity.linear = np.array([0, 0, -9.80665])
    inertia = 0.1 * np.eye(3)
    for i in range(robot.n):
        sideways = pin.SE3(pin.rpy.rpyToMatrix(robot.alpha[i], 0, 0), np.array([robot.a[i], 0, 0]))
        lean = pin.SE3(pin.rpy.rpyToMatrix(0, robot.beta[i], 0), np.zeros(3))
        turn = pin.SE3(pin.rpy.rpyToMatrix(0, 0, robot.theta[i]), np.zeros(3))
        along = pin.SE3(np.eye(3), np.array([0, 0, robot.d[i]]))
        before = sideways * lean * turn * along  # a turn about z and a shift along it may change places
        parent = model.addJoint(parent, pin.JointModelRZ(), before, f"joint{i + 1}")
        model.appendBodyToJoint(parent, pin.Inertia(robot.mass[i], robot.com[i], inertia), pin.SE3.Identity())
    load = pin.Inertia(robot.payload_mass[payload], robot.payload_com[payload], inertia)
    model.appendBodyToJoint(parent, load, pin.SE3.Identity())
    model.addFrame(pin.Frame("E", parent, pin.SE3(np.eye(3), robot.markers[0]), pin.FrameType.OP_FRAME))
    return model


def test_kinematics_and_torques_are_those_of_pinocchio():
    """Fails if a frame, a centre of mass or a torque's sign is wrong."""
    robot, rows = loaded("serial")
    state = statics(robot, rows, Motion.none(len(rows), robot.n))
    tool = moved(state.frames.tips[-1], robot.markers[0])
    for i in range(len(rows)):
        model = pinocchio_model(robot, rows.payload[i])
        data = model.createData()
        pin.framesForwardKinematics(model, data, rows.q[i])
        np.testing.assert_allclose(tool[i], data.oMf[model.getFrameId("E")].translation, atol=1e-12)
        gravity = pin.computeGeneralizedGravity(model, data, rows.q[i])
        np.testing.assert_allclose(state.torque[i], -gravity, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_loads_are_the_energy_s_slopes(name):
    """Fails if a moment or a force misses a body, the loop's rod, or its own frame."""
    robot, rows = loaded(name)
    if name == "hh800":  # in a plane, as its loop is built: else the rod pulls a little sideways
        robot = replace(robot, alpha=np.round(robot.alpha, 2), beta=0 * robot.beta, d=np.round(robot.d, 2))
    still = Motion.none(len(rows), robot.n)
    still.joint[:] = np.random.default_rng(2).normal(0, 2e-3, still.joint.shape)
    state = statics(robot, rows, still)
    tip = np.concatenate([state.tip_force, state.tip_moment], axis=2)
    expected = Motion(state.torque, state.moment, tip, state.base_moment, still.tool)
    for part in ("joint", "bearing", "tip", "base"):
        for at in np.ndindex(getattr(still, part).shape[1:]):
            if part in ("bearing", "base") and at[-1] == 2:
                continue  # a turn about the joint's own axis is the joint's
            slope = _slope(robot, rows, still, part, at)
            np.testing.assert_allclose(
                getattr(expected, part)[(slice(None), *at)], slope, atol=2e-3, err_msg=f"{part} {at}"
            )


def _slope(robot: Robot, rows: Rows, motion: Motion, part: str, at: tuple[int, ...], step: float = 1e-4) -> np.ndarray:
    energies = []
    for way in (1, -1):
        values = getattr(motion, part).copy()
        values[(slice(None), *at)] += way * step
        energies.append(energy(robot, rows, replace(motion, **{part: values})))
    return -(energies[0] - energies[1]) / (2 * step)


def test_the_loop_closes_though_its_link_bends():
    """Fails if the rod is stretched, or the rocker is not where the rod's end is."""
    world = draw(Case(robot="hh800", poses=50), np.random.default_rng(3))
    robot, rows = world.stated, world.rows
    motion = Motion.none(len(rows), robot.n)
    plane = [0, 1, 5]
    motion.tip[:, 1, plane] = np.random.default_rng(4).normal(0, 1e-3, (len(rows), 3))
    found = frames(robot, rows.q, motion)
    crank, rod, rocker = robot.loop.bars
    angle = robot.loop.offset
    on_rocker = moved(found.joints[2], rocker * np.array([np.cos(angle), -np.sin(angle), 0]))
    on_rod = moved(found.bars[1], np.array([rod, 0, 0]))
    np.testing.assert_allclose(on_rocker, on_rod, atol=1e-12)
    ends = found.bars[1][:, :3, 3] - found.joints[1][:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(ends, axis=1), crank, atol=1e-12)
    straight = frames(robot, rows.q, Motion.none(len(rows), robot.n)).closure
    np.testing.assert_allclose(straight.rocker, straight.crank, atol=1e-12)  # nominally a parallelogram


@pytest.mark.parametrize("name", ROBOTS)
def test_equilibrium_is_a_fixed_point(name):
    """Fails if the loads are those of another pose than the one they lead to."""
    robot, rows = loaded(name)
    causes = tuple(
        hidden(cause) for cause in ("link-bending", "bearing-compliance", "torque-backlash", "tool-deflection")
    )
    motion, state = equilibrium(robot, rows, lambda state: response(robot, rows, state, causes))
    again = response(robot, rows, state, causes)
    first, second = (tool_point(robot, rows, m, frames(robot, rows.q, m).tips[-1]) for m in (motion, again))
    np.testing.assert_allclose(first, second, atol=1e-9)
    assert np.abs(motion.joint).max() > 1e-4


def test_every_physical_cause_is_tried():
    """Fails if a cause was added without its usual size."""
    assert {name.split()[0] for name in USUAL} == PHYSICAL


@pytest.mark.parametrize(
    ("robot", "name"),
    [(robot, name) for robot in ROBOTS for name in USUAL if robot == "hh800" or name not in ("bar-growth", "rod-play")],
)
def test_a_cause_moves_the_tool_by_its_size(robot, name):
    """Fails if a cause of size zero does something, or one of usual size hardly anything or far too much."""
    world = draw(Case(robot=robot, poses=40, hidden=(hidden(name),)), np.random.default_rng(5))
    plain = measured_points(world.real, world.rows, ())
    nothing = tuple(replace(h, size=0.0) for h in world.hidden)
    np.testing.assert_array_equal(measured_points(world.real, world.rows, nothing), plain)
    shift = np.linalg.norm(measured_points(world.real, world.rows, world.hidden) - plain, axis=1)
    assert 5e-6 < np.sqrt(np.mean(shift**2)) < (20e-3 if name == "gravity-deflection" else 3e-3)


@pytest.mark.parametrize("name", [*ON_TABLE, "encoder-turn gear", "unit-mistake joint"])
def test_faults_are_where_the_answer_says(tmp_path, name):
    """Fails if the sealed lines are not the ones that differ from what was simulated."""
    cause, _, variant = name.partition(" ")
    joint = int(cause in ("joint-sign", "encoder-turn") or variant == "joint")
    case = Case(poses=60, markers=2, hidden=(Hidden(cause, joint, extra=variant),))
    write_case(tmp_path, case, np.random.default_rng(6))
    world = draw(case, np.random.default_rng(6))
    table = pd.read_csv(tmp_path / "measurements.csv")
    point = 1e3 * measured_points(world.real, world.rows, ())[: len(table)]
    readings = np.rad2deg(world.rows.q)[: len(table)]
    off = np.abs(table[XYZ].to_numpy() - point).max(axis=1) > 0.5
    turned = np.abs(table[[f"q{i}_deg" for i in range(1, 7)]].to_numpy() - readings).max(axis=1) > 1e-3
    sealed = json.loads((tmp_path / "answer.json").read_text(encoding="utf-8"))["faulty_lines"]
    assert sealed == (np.flatnonzero(off | turned) + 2).tolist()
    assert sealed


def test_friction_winds_up_with_travel():
    """Fails if far travel does not wind a joint up to the side it came from, or short travel forgets the way before."""
    rows = draw(Case(poses=400), np.random.default_rng(7)).rows
    far, near = rows.travel > np.deg2rad(30), rows.travel < np.deg2rad(2)
    assert (rows.travel > 0).all()
    np.testing.assert_allclose(rows.wound[far], rows.approach[far], atol=0.01)
    assert (rows.wound * rows.approach)[near].mean() < 0


@pytest.mark.parametrize("noise", ["gauss", "heavy", "range", "outliers"])
def test_noise_is_as_large_as_stated(tmp_path, noise):
    """Fails if a kind of noise has another spread, or grossly wrong rows are not sealed."""
    case = Case(poses=2000, noise=noise, columns=("sigma",))
    write_case(tmp_path, case, np.random.default_rng(8))
    table = pd.read_csv(tmp_path / "measurements.csv")
    world = draw(case, np.random.default_rng(8))
    error = table[XYZ].to_numpy() - 1e3 * measured_points(world.real, world.rows, ())
    faulty = np.array(json.loads((tmp_path / "answer.json").read_text(encoding="utf-8"))["faulty_lines"], dtype=int) - 2
    assert len(faulty) == (40 if noise == "outliers" else 0)
    whitened = np.delete(error / table[["sigma_mm"]].to_numpy(), faulty, axis=0)
    assert whitened.std() == pytest.approx(1, rel=0.1 if noise == "heavy" else 0.03)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_written_case_can_be_drawn_again(tmp_path, name):
    """Fails if anything but the generator decides, or a study without masses gives them away."""
    causes = (hidden("joint-backlash"), hidden("gravity-deflection"))
    case = Case(
        robot=name, hidden=causes, poses=20, repeats=2, markers=3, masses=False, effects=("geometry",), columns=TIMES
    )
    for folder in ("first", "second"):
        write_case(tmp_path / folder, case, np.random.default_rng(9))
    for file in ("robot.toml", "study.toml", "measurements.csv", "answer.json"):
        assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "second" / file).read_bytes()
    assert len(pd.read_csv(tmp_path / "first" / "measurements.csv")) == 20 * 2 * 3
    robot = tomllib.loads((tmp_path / "first" / "robot.toml").read_text(encoding="utf-8"))
    assert "mass_kg" not in json.dumps([robot["joints"], robot.get("loop")])
    sealed = json.loads((tmp_path / "first" / "answer.json").read_text(encoding="utf-8"))["causes"]
    assert [cause["rms_mm"] for cause in sealed] == pytest.approx(effect_rms(case, np.random.default_rng(9)), abs=1e-6)
    assert len(sealed) == 7


@pytest.mark.parametrize("name", ROBOTS)
def test_calflow_reads_the_robot_as_it_was_simulated(tmp_path, name):
    """Fails if simulator and calflow differ in a convention: neither knows the other."""
    case = Case(robot=name, poses=30, markers=2, payloads=("full",))
    write_case(tmp_path, case, np.random.default_rng(10))
    model = build(stated.Robot.from_toml(tmp_path / "robot.toml"), ("geometry", "joint-compliance"))
    world = draw(case, np.random.default_rng(10))
    robot = replace(world.stated, compliance=world.real.compliance)
    springs = iter(robot.compliance)
    values = np.array([next(springs) if p.symbol == "s" else 0.0 for p in model.parameters])
    point = measured_points(robot, world.rows, ())
    for i, marker in enumerate("EF"):
        own = world.rows.marker == i
        theirs = model.position(values, packed_conditions(model, world.rows.q[own], "full", marker))
        np.testing.assert_allclose(point[own], theirs, atol=2e-8)
