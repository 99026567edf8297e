"""Causes in other forms obey the same laws: limit cases, reciprocity of loads and motions, and slopes of energies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden import beams, causes, forms
from hidden.beams import bent, link_bending, link_torsion, round_tube
from hidden.case import Case, draw
from hidden.causes import Hidden
from hidden.simulator import Array, Motion, Robot, Rows, State, energy, frames, statics

SOFT = {
    "cantilever-bracket": Hidden("cantilever-bracket", 6, 3e-7, seed=3),
    "oblique-beam": Hidden("oblique-beam", 2, 5e-8, seed=4),
    "oblique-beam of the forearm": Hidden("oblique-beam", 4, 5e-8, seed=5),
    "tapered-beam": Hidden("tapered-beam", 2, 5e-8, 4.0),
    "offset-bearing": Hidden("offset-bearing", 2, 1e-7, 0.3, seed=6),
    "offset-bearing of the wrist": Hidden("offset-bearing", 4, 1e-7, 0.3, seed=7),
}


def loaded(poses: int = 20) -> tuple[Robot, Rows, State]:
    """The serial robot as built, its poses, and the loads in them."""
    world = draw(Case(poses=poses), np.random.default_rng(1))
    return world.real, world.rows, statics(world.real, world.rows, Motion.none(poses, world.real.n))


def work(robot: Robot, rows: Rows, motion: Motion) -> Array:
    """What gravity does [J] on a small motion from the straight robot (rows,)."""
    ways = [Motion(*(sign * part for part in vars(motion).values())) for sign in (1, -1)]
    return (energy(robot, rows, ways[1]) - energy(robot, rows, ways[0])) / 2


@pytest.mark.parametrize("name", SOFT)
def test_what_one_payload_does_on_the_other_s_motion_is_what_the_other_does_on_its_own(name: str) -> None:
    """Fails if a compliance is not symmetric, or turns and shifts about another place than where its loads are taken."""
    robot, rows, _ = loaded()
    robot = replace(
        robot, mass=np.where(np.arange(robot.n) == SOFT[name].joint - 1, 0.0, robot.mass)
    )  # its own work is inside it
    done = {}
    for load in (0, 2):
        carried = replace(rows, payload=np.full(len(rows), load))
        state = statics(robot, carried, Motion.none(len(rows), robot.n))
        done[load] = carried, causes.ON_MOTION[SOFT[name].cause](SOFT[name], robot, carried, state)
    (empty, first), (full, second) = done.values()
    np.testing.assert_allclose(work(robot, empty, second), work(robot, full, first), rtol=1e-3, atol=1e-9)
    assert (work(robot, full, second) > 0).all(), "a load does work on the motion that it makes"
    assert np.abs(work(robot, full, second)).mean() > 1e-4


def test_a_straight_round_beam_is_the_cantilever_and_the_twist_of_textbooks() -> None:
    """Fails if a chain of beams does not bend as one, or bends under what only twists it."""
    robot, rows, state = loaded()
    end = np.array([robot.a[2], 0.0, robot.d[1]])
    path = np.array([np.zeros(3), 0.3 * end, end])
    unit = end / np.linalg.norm(end)
    force, moment = state.tip_force[:, 1], state.tip_moment[:, 1]
    weightless = replace(robot, mass=0 * robot.mass)
    bends, twists = np.eye(3) - np.outer(unit, unit), np.outer(unit, unit)
    for section, textbook in ((bends, link_bending), (twists, link_torsion)):
        shift, turn = bent(path, [section, section], force, moment)
        known = textbook(Hidden("", 2, 1.0), weightless, rows, state).tip[:, 1]
        np.testing.assert_allclose(np.concatenate([shift, turn], axis=1), known, rtol=1e-9, atol=1e-9)


def test_a_crooked_beam_s_own_weight_at_its_end_is_that_of_the_next_link_there() -> None:
    """Fails if a piece of a link's weight bends the wrong part of it, or the end does not go with what is bent."""
    robot, rows, _ = loaded()
    h, own, following = SOFT["oblique-beam"], *(np.arange(robot.n) == link for link in (1, 2))
    at_end = np.array([robot.a[2], 0.0, 0.0])
    light = replace(robot, mass=np.where(following, 0.0, robot.mass))
    heavy = light.mass[1]
    ends = replace(light, com=np.where(own[:, None], at_end, light.com))
    joints = replace(
        light,
        mass=np.where(own, 0.0, light.mass) + heavy * following,
        com=np.where(following[:, None], [0, 0, -light.d[2]], light.com),
    )
    bent_by = (
        beams.oblique_beam(h, arm, rows, statics(arm, rows, Motion.none(len(rows), arm.n))) for arm in (ends, joints)
    )
    np.testing.assert_allclose(*(motion.tip[:, 1] for motion in bent_by), rtol=1e-9, atol=1e-12)


def test_a_bracket_turns_by_one_and_a_half_of_its_shift_over_its_length() -> None:
    """Fails if a force on a cantilever's end does not turn it as it should."""
    path, force = np.array([[0, 0, 0], [0, 0, 0.4]]), np.array([[10.0, 0, 0]])
    shift, turn = bent(path, [round_tube(path[1])], force, 0 * force)
    np.testing.assert_allclose(shift, [[0.4**3 / 3 * 10, 0, 0]])
    np.testing.assert_allclose(turn, [[0, 1.5 / 0.4 * shift[0, 0], 0]])


def test_a_bearing_s_pivot_stays_where_it_is() -> None:
    """Fails if the tilt is about the joint's origin, or the joint's origin is shifted to the wrong side."""
    robot, rows, state = loaded()
    h, i = SOFT["offset-bearing"], 1
    motion = forms.offset_bearing(h, robot, rows, state)
    before, after = state.frames.joints[i], frames(robot, rows.q, motion).links[i]
    d = np.eye(4)
    d[2, 3] = -robot.d[i]
    after = after @ d
    pivot = 0.3 * forms.slanting(h.rng, np.array([0.0, 0.0, 1.0]), np.pi)
    apart = (before - after)[:, :3, :3] @ pivot + (before - after)[:, :3, 3]
    assert np.abs(apart).max() < 1e-8
    assert np.abs((before - after)[:, :3, 3]).max() > 1e-6


def test_a_spring_s_torque_is_its_energy_s_slope() -> None:
    """Fails if the torque has the wrong sign or lever, or the spring's rate is left out."""
    robot, rows, state = loaded()
    h, step = Hidden("spring-compensator", 2, 2e3, seed=8), 1e-6
    spring = forms.Spring.drawn(h)

    def stored(turn: float) -> Array:
        turned = replace(rows, q=rows.q + turn * np.eye(6)[1])
        _, line = spring.line(statics(robot, turned, Motion.none(len(rows), robot.n)))
        longer = np.linalg.norm(line, axis=1) - forms.COLUMN
        return h.size * (longer + spring.rate * longer**2 / (2 * forms.ARM))

    slope = (stored(step) - stored(-step)) / (2 * step)
    np.testing.assert_allclose(forms.spring_compensator(h, state), -slope, rtol=1e-5, atol=1e-3)
    assert np.ptp(slope) > 50


def test_one_link_warms_alone() -> None:
    """Fails if another link grows, or this one does not tend to its size."""
    robot, rows, _ = loaded()
    late = replace(rows, time=rows.time + 1e6)
    still = Motion.none(len(rows), robot.n)
    grown = frames(forms.warm_link(Hidden("warm-link", 2, 1e-3, seed=1), robot, late), rows.q, still)
    plain = frames(robot, rows.q, still)
    for i in range(5):
        lengths = [np.linalg.norm(x.joints[i + 1][:, :3, 3] - x.joints[i][:, :3, 3], axis=1) for x in (grown, plain)]
        np.testing.assert_allclose(lengths[0], lengths[1] * (1.001 if i == 1 else 1.0), rtol=1e-9)
    begin = replace(rows, time=0 * rows.time)
    np.testing.assert_allclose(forms.warm_link(Hidden("warm-link", 2, 1e-3, "cooling", 1), robot, begin).a[:, 2],
                               1.001 * robot.a[2])  # fmt: skip
