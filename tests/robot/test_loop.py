"""The four-bar loop against plain geometry."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import root

import robots
from calflow.model import build
from calflow.robot.frames import CONVENTIONS
from calflow.robot.mechanism import (
    Deflection,
    Row,
    assembly_side,
    close,
    nominal_dimensions,
    nominal_loads,
    pose,
    state,
)
from calflow.robot.robot import Robot

LENGTH = st.floats(0.2, 3.0)
ANGLE = st.floats(-np.pi, np.pi)


def closure_graph(side: int) -> ca.Function:
    """Graph of (link, bars (3,), link angle, crank angle) -> rocker angle, rod angle, cosine."""
    link, bars, link_angle, crank_angle = (
        ca.SX.sym(name, size) for name, size in zip("lbas", (1, 3, 1, 1), strict=True)
    )
    pin = link * ca.vertcat(ca.cos(link_angle), ca.sin(link_angle))
    found = close(side, pin, bars, crank_angle)
    outputs = [found.rocker_angle, found.rod_angle, found.cosine]
    return ca.Function("closure", [link, bars, link_angle, crank_angle], outputs)


def askew(robot: Robot) -> Robot:
    """The robot with its arm's two axes not quite parallel and its arm beside the loop's plane."""
    joints = list(robot.joints)
    for i, (alpha, beta, d) in {1: (0.03, -0.02, 0.15), 2: (-0.02, 0.03, -0.1)}.items():
        figures = joints[i].frame.figures
        figures |= {"alpha": figures["alpha"] + alpha, "beta": beta, "d": d}
        joints[i] = replace(joints[i], frame=CONVENTIONS[robot.kinematics](**figures))
    return replace(robot, joints=tuple(joints))


GENERAL = {name: robots.hh800_with_bars(0.75, 1.7, 0.9, name) for name in ("open", "crossed")}
PLANE = {"hh800": robots.hh800(), **GENERAL, "dh": robots.palletiser()}
LOOPS = PLANE | {f"{name} askew": askew(PLANE[name]) for name in ("open", "dh")}
GRAPH = {side: closure_graph(side) for side in (1, -1)}
ASSEMBLIES = ("open", "crossed")


def solve(assembly: str, link: float, bars: tuple[float, ...], link_angle: float, crank_angle: float) -> list[float]:
    """Rocker angle, rod angle and cosine that the graph finds."""
    side = int(np.sign(np.sin(crank_angle - link_angle))) * (1 if assembly == "open" else -1)
    return [float(value) for value in GRAPH[side or 1](link, bars, link_angle, crank_angle)]


def turn(angle: float) -> complex:
    """A unit vector of the plane."""
    return np.exp(1j * angle)


@pytest.mark.parametrize("assembly", ASSEMBLIES)
def test_general_loop_equals_a_root_finder(assembly: str) -> None:
    """Breaks if a bar's length enters wrongly, or the other of the two closures is taken."""
    link, (crank, rod, rocker) = 1.5, (0.7, 1.65, 0.9)
    for link_angle in np.linspace(0.3, 3.0, 8):
        for between in (0.4, 0.9, 1.6, -0.6, -1.3):
            q, s = crank * turn(link_angle + between), link * turn(link_angle)

            def gap(x: np.ndarray, q: complex = q, s: complex = s) -> list[float]:
                open_by = q + rod * turn(x[0]) - s - rocker * turn(x[1])
                return [open_by.real, open_by.imag]

            guess = robots.closed_loop(link, crank, rod, rocker, link_angle, link_angle + between, assembly)[::-1]
            rod_angle, rocker_angle = root(gap, np.add(guess, 0.05), tol=1e-14).x
            r = s + rocker * turn(rocker_angle)
            sides = [np.sign(np.imag(point * np.conj(s - q))) for point in (0 - q, r - q)]
            assert sides[0] * sides[1] == (-1 if assembly == "open" else 1)  # the assembly as its definition has it
            found = solve(assembly, link, (crank, rod, rocker), link_angle, link_angle + between)
            assert abs(turn(found[0]) - turn(rocker_angle)) < 1e-9
            assert abs(turn(found[1]) - turn(rod_angle)) < 1e-9


@settings(deadline=None, max_examples=300)
@example("open", 1.0, (1.0, 0.842, 0.842), 0.0, 2.0)  # stretched all but straight
@example("crossed", 1.5, (0.5, 1.898, 0.9), 0.5, 0.52)  # folded all but flat
@given(st.sampled_from(ASSEMBLIES), LENGTH, st.tuples(LENGTH, LENGTH, LENGTH), ANGLE, ANGLE)
def test_loop_closes(
    assembly: str, link: float, bars: tuple[float, float, float], link_angle: float, crank_angle: float
) -> None:
    """Breaks if for any lengths the rod's end misses the rocker's end, or its angle points elsewhere."""
    crank, rod, rocker = bars
    q, s = crank * turn(crank_angle), link * turn(link_angle)
    assume(abs(np.sin(crank_angle - link_angle)) > 1e-6)
    assume(abs(rod - rocker) + 1e-3 < abs(s - q) < rod + rocker - 1e-3)
    rocker_angle, rod_angle, cosine = solve(assembly, link, bars, link_angle, crank_angle)
    assert abs(cosine) < 1
    r = s + rocker * turn(rocker_angle)
    assert abs(abs(r - q) - rod) < 1e-12
    assert abs(q + rod * turn(rod_angle) - r) < 1e-12


@settings(deadline=None, max_examples=300)
@given(LENGTH, st.tuples(LENGTH, LENGTH, LENGTH), ANGLE, ANGLE)
def test_cosine_tells_where_the_loop_cannot_close(
    link: float, bars: tuple[float, float, float], link_angle: float, crank_angle: float
) -> None:
    """Breaks if the cosine is within 1 where circles about Q and S do not meet, or beyond where they do."""
    crank, rod, rocker = bars
    distance = abs(crank * turn(crank_angle) - link * turn(link_angle))
    reach, hole = rod + rocker - distance, distance - abs(rod - rocker)
    assume(distance > 1e-6)
    assume(min(abs(reach), abs(hole)) > 1e-6)
    rocker_angle, rod_angle, cosine = solve("open", link, bars, link_angle, crank_angle)
    assert (abs(cosine) < 1) == (reach > 0 and hole > 0)
    assert np.isfinite([rocker_angle, rod_angle, cosine]).all()


def test_parallelogram_keeps_the_rocker_parallel_to_the_crank() -> None:
    """Breaks if the HH800's upper arm does not stand at q3 - q2 - 90 degrees (equation 2 of the paper)."""
    robot = robots.hh800()
    q = robots.poses(robot, 50)
    serial = q.copy()
    serial[:, 2] = q[:, 2] - q[:, 1] - np.pi / 2
    model = build(robot, [])
    wanted = robots.marker_position(replace(robot, loop=None), serial)
    assert_allclose(model.position(model.nominal, robots.rows(model, q)), wanted, atol=1e-12)


@pytest.mark.parametrize("robot", LOOPS.values(), ids=LOOPS)
def test_chain_follows_a_general_loop(robot: Robot) -> None:
    """Breaks if the chain takes another angle than the closed loop's, or another link for PS in one convention."""
    model = build(robot, [])
    q = robots.poses(robot, 50)
    wanted = robots.marker_position(robot, q)
    assert np.isfinite(wanted).all()
    assert_allclose(model.position(model.nominal, robots.rows(model, q)), wanted, atol=1e-12)


def arm_gives_way(robot: Robot, bearing: np.ndarray, end: np.ndarray) -> dict[str, np.ndarray]:
    """Motions as in `Deflection` that move only the arm PS: twists of its bearing and of its far end."""
    j, n = robot.loop.joint - 1, robot.n_joints
    motions = {"bearing": np.zeros((6, n)), "link": np.zeros((6, n + 1))}
    motions["bearing"][:, j - 1], motions["link"][:, j] = bearing, end
    return motions


def deflection(motions: dict[str, np.ndarray]) -> Deflection:
    """The same for the graph, zero entries left out."""
    bearing, link = (ca.SX(ca.sparsify(ca.DM(motions[part]))) for part in ("bearing", "link"))
    return Deflection(ca.SX(bearing.shape[1], 1), bearing, link)


def mechanism(robot: Robot, given: Deflection) -> ca.Function:
    """Graph of q -> frames of the driven joint, the crank, the rod and the flange."""
    q = ca.SX.sym("q", robot.n_joints)
    at = pose(robot, nominal_dimensions(robot), q, given)
    return ca.Function("mechanism", [q], [at.joints[robot.loop.joint - 1], *at.bars, at.flange])


@pytest.mark.parametrize("robot", PLANE.values(), ids=PLANE)
def test_loop_closes_where_its_arm_has_given_way(robot: Robot) -> None:
    """Breaks if an arm that bends or shifts in its plane stretches the rod, or takes the crank or the rocker with it."""
    in_plane = np.array([1, 1, 0, 0, 0, 1]) * np.random.default_rng(5).normal(0, 5e-3, (2, 6))
    bent, straight = mechanism(robot, deflection(arm_gives_way(robot, *in_plane))), mechanism(robot, Deflection.zero(6))
    from_x = -(robot.loop.offset + robot.frames[robot.loop.joint - 1].turn.value)
    rocker = robot.loop.rocker * np.array([np.cos(from_x), np.sin(from_x), 0])
    for q in robots.poses(robot, 10):
        joint, crank, rod, _ = (np.array(frame) for frame in bent(q))
        assert_allclose(robots.moved(rod, [robot.loop.rod.length, 0, 0]), robots.moved(joint, rocker), atol=1e-12)
        assert_allclose(crank, straight(q)[1], atol=1e-12)
        assert np.linalg.norm(joint[:3, 3] - np.array(straight(q)[0])[:3, 3]) > 1e-3


@pytest.mark.parametrize("robot", PLANE.values(), ids=PLANE)
def test_a_slope_at_the_pin_turns_nothing(robot: Robot) -> None:
    """Breaks if the upper arm turns with the lower arm's end, which only a serial robot's does."""
    slope = np.array([0, 0, 0, 0, 0, 0.02])
    bent = mechanism(robot, deflection(arm_gives_way(robot, np.zeros(6), slope)))
    straight = mechanism(robot, Deflection.zero(6))
    for q in robots.poses(robot, 10):
        assert_allclose(bent(q)[3], straight(q)[3], atol=1e-12)


@pytest.mark.parametrize("robot", LOOPS.values(), ids=LOOPS)
def test_arm_carries_what_the_rod_leaves_it(robot: Robot) -> None:
    """Breaks if the wrenches on the arm are not the slopes of the energy with the loop closed at the deflected pose."""
    j, payload = robot.loop.joint - 1, next(iter(robot.payloads))
    twists = np.random.default_rng(6).normal(0, 5e-3, 12)
    c = ca.SX.sym("c", sum(Row.sizes(robot).values()))
    given = deflection(arm_gives_way(robot, *np.split(twists, 2)))
    found = state(robot, nominal_dimensions(robot), nominal_loads(robot), Row.unpack(robot, c), given)
    wrenches = ca.Function("wrenches", [c], [ca.vertcat(found.bearing[:, j - 1], found.link[:, j])])

    for q in robots.poses(robot, 5):

        def energy(twists: np.ndarray, q: np.ndarray = q) -> float:
            return robots.energy(robot, q, payload, **arm_gives_way(robot, *np.split(twists, 2)))

        wanted = [(energy(twists - h) - energy(twists + h)) / 2e-5 for h in 1e-5 * np.eye(12)]
        assert_allclose(np.array(wrenches([*q, 1, 1])).ravel(), wanted, atol=1e-7 * np.abs(wanted).max())


@pytest.mark.parametrize("robot", LOOPS.values(), ids=LOOPS)
def test_an_arm_that_stands_still_costs_nothing(robot: Robot) -> None:
    """Breaks if motions that are zero, left out or put in, leave operations in the graph."""
    q, still, dims = ca.SX.sym("q", 6), Deflection.zero(6), nominal_dimensions(robot)
    dims = replace(dims, steps=ca.SX.sym("steps", 30))
    moving = replace(still, bearing=ca.SX.sym("bearing", 6, 6), link=ca.SX.sym("link", 6, 7))
    left_out, with_motions = (pose(robot, dims, q, given).flange for given in (still, moving))
    put_in = ca.substitute(with_motions, ca.veccat(moving.bearing, moving.link), ca.DM.zeros(78))
    j = robot.loop.joint - 1
    figure = lambda joint, symbol: dims.steps[robot.step_index(joint, symbol)]  # noqa: E731
    turn, length = q[j - 1] + figure(j - 1, "theta"), figure(j if robot.kinematics == "modified-dh" else j - 1, "a")
    pin, angles = length * ca.vertcat(ca.cos(turn), ca.sin(turn)), ca.SX(q)
    angles[j] = close(assembly_side(robot), pin, dims.bars, q[j]).rocker_angle - turn + robot.loop.offset
    chain = replace(robot, loop=None)
    by_hand = pose(chain, replace(dims, bars=nominal_dimensions(chain).bars), angles, still).flange
    assert ca.n_nodes(left_out) == ca.n_nodes(put_in) == ca.n_nodes(by_hand)


@pytest.mark.parametrize(("rod", "rocker"), [(0.5, 0.4), (2.9, 0.5)], ids=["too short", "too long"])
def test_model_stays_finite_where_the_loop_cannot_close(rod: float, rocker: float) -> None:
    """Breaks if an unclosable pose gives NaN in positions or derivatives instead of a telling cosine."""
    robot = robots.hh800_with_bars(rod=rod, rocker=rocker)
    joints = tuple(replace(joint, rated_torque=1e4) for joint in robot.joints)
    robot = replace(robot, joints=joints)
    model = build(robot, ["geometry", "joint-compliance"])
    q = np.random.default_rng(4).uniform(*robot.limits.T, (300, 6))
    conditions = robots.rows(model, q, "rated")
    p = np.concatenate([np.zeros(31), np.full(6, 1e-7)])
    crank = robot.loop.crank.length
    distance = np.abs(1.6 * np.exp(1j * q[:, 1]) - crank * np.exp(1j * q[:, 2]))
    closable = (abs(rod - rocker) < distance) & (distance < rod + rocker)
    assert not closable.all()
    assert_allclose(np.abs(model.closure_cosine(np.zeros(37), conditions)) < 1, closable)
    assert np.isfinite(model.position(p, conditions)).all()
    assert np.isfinite(model.rotation(p, conditions)).all()
    assert np.isfinite(model.position_jacobian(p, conditions)).all()


@pytest.mark.parametrize("crank_angle", [-0.3, -1e-6, 0.0, 1e-6, 0.3])
def test_a_moving_loop_keeps_its_side(crank_angle: float) -> None:
    """Breaks if a general loop jumps to its other closure where P, Q and S are in line, or does not close there."""
    link, (crank, rod, rocker) = 1.5, (0.7, 1.65, 1.3)
    rocker_angle, _, cosine = (float(value) for value in GRAPH[1](link, (crank, rod, rocker), 0.0, crank_angle))
    assert abs(cosine) < 1
    assert abs(link + rocker * turn(rocker_angle) - crank * turn(crank_angle)) == pytest.approx(rod, abs=1e-12)
    assert 1.0 < rocker_angle < 1.8
