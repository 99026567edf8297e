"""Link bending: a link bends as its section and its line say, whatever axes it is written in, and is found as one cause."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.effects.beam import Beam, Softness, beams
from calflow.effects.link_bending import LinkBending
from calflow.model import Model, build, over_rows
from calflow.robot.mechanism import State
from hidden.causes import Hidden
from hidden.test_hidden import case, found, only

ALIKE = only(
    "link-bending", "link-torsion", "bearing-compliance", "axis-wobble", "joint-eccentricity", "gear-ratio-error"
)
FORCE, MOMENT = np.array([120.0, -300.0, 500.0]), np.array([80.0, 150.0, -60.0])


WEIGHT = np.array([300.0, -900.0, -2500.0])


def summed(span: np.ndarray, near: np.ndarray, far: np.ndarray, aside: np.ndarray, parts: int = 2000) -> np.ndarray:
    """A beam's end (6,) from many short pieces, each turned by the moment that it carries, from one softness to the other.

    Every piece weighs as much as the next, and its centre is aside of the line.
    """
    shift, turn = np.zeros(3), np.zeros(3)
    for k in range(parts):
        rest = 1 - (k + 0.5) / parts
        lever = rest * span
        own = np.cross(lever / 2 + aside, rest * WEIGHT)
        soft = rest * near + (1 - rest) * far
        curved = np.linalg.norm(span) / parts * soft @ (MOMENT + np.cross(lever, FORCE) + own)
        turn, shift = turn + curved, shift + np.cross(curved, lever)
    return np.concatenate([shift, turn])


@pytest.mark.parametrize(("tapers", "close"), [(0.0, 1e-5), (5.0, 0.03)])
def test_an_oblique_beam_is_the_sum_of_its_pieces(tapers: float, close: float) -> None:
    """Breaks if end loads and own weight do not add up along the beam, or its section has axes of its own choice only."""
    span, aside = np.array([0.9, -0.2, 0.4]), np.array([0.02, 0.09, 0.0])
    root = np.random.default_rng(3).normal(size=(3, 3)) * 1e-4
    near, far = root @ root.T, (1 + tapers) * root @ root.T
    axes = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    bearing, link = np.zeros((6, 2)), np.zeros((6, 3))
    bearing[:3, 1], link[:, 2] = axes.T @ (FORCE + WEIGHT), np.concatenate([FORCE, MOMENT])
    loads = replace(State.symbols(robots.industrial()), bearing=ca.SX(ca.DM(bearing)), link=ca.SX(ca.DM(link)))
    beam = Beam(1, *(ca.DM(part) for part in (span, np.zeros(3), span / 2 + aside, axes)))
    found = np.array(ca.DM(beam.twist(Softness(*(ca.SX(ca.DM(soft)) for soft in (near, far))), loads)))
    assert_allclose(found.ravel(), summed(span, near, far, aside), rtol=close)


@pytest.mark.parametrize(("at", "bends"), [(-0.5, 0.0), (0.0, 0.0), (1.0, 1.0), (1.6, 1.0)])
def test_a_weight_beyond_an_end_of_the_beam_is_a_load_there_or_none(at: float, bends: float) -> None:
    """Breaks if a counterweight behind the joint bends the link before it, or what lies beyond the far end has another lever."""
    span = np.array([0.0, 0.0, 0.8])
    soft = Softness(*(2 * [ca.SX(ca.DM(np.diag([1e-7, 1e-7, 2e-7])))]))
    bearing, link = np.zeros((6, 2)), np.zeros((6, 3))
    bearing[:3, 1] = WEIGHT
    loads = replace(State.symbols(robots.industrial()), bearing=ca.SX(ca.DM(bearing)), link=ca.SX(ca.DM(link)))
    centre = at * span + [0.1, 0.0, 0.0]
    beam = Beam(1, *(ca.DM(part) for part in (span, np.zeros(3), centre, np.eye(3))))
    carried = beam.bent(soft, ca.SX(ca.DM(WEIGHT)), ca.SX(ca.DM(np.cross(centre - span, WEIGHT))))
    assert_allclose(np.array(ca.DM(beam.twist(soft, loads))), bends * np.array(ca.DM(carried)), rtol=1e-12)


def test_an_oblique_link_that_is_round_bends_as_a_straight_one() -> None:
    """Breaks if the two forms differ where they describe the same link."""
    robot = robots.industrial()
    straight, oblique = LinkBending(robot), LinkBending(robot, section="oblique")
    (first, *_) = [parameter.part for parameter in straight.parameters()]
    model = build(robot, ())
    conditions = robots.rows(model, robots.poses(robot, 20), "load")
    size = 1e-7

    def points(effect: LinkBending, values: dict[str, float]) -> np.ndarray:
        whole = Model(robot, (effect,))
        p, c = ca.SX.sym("p", len(whole.parameters)), ca.SX.sym("c", whole.n_conditions)
        at = ca.Function("at", [p, c], [ca.densify(whole.expression(p, c).position)])
        return over_rows(
            at, np.array([values.get(q.symbol, 0.0) * (q.part == first) for q in effect.declared]), conditions
        )[0]

    span = beams(robot)[0]
    u = np.array(span.span).ravel() / span.length
    matrix = size * (np.eye(3) - np.outer(u, u))
    round_one = {f"c{'xyz'[a]}{'xyz'[b]}": matrix[a, b] for a in range(3) for b in range(a, 3)}
    plain = points(straight, {})
    bends = points(straight, {"1/EI": size})
    assert np.abs(bends - plain).max() > 1e-6
    assert_allclose(points(oblique, round_one), bends, rtol=0, atol=1e-12)
    twisted = matrix + 2 * size * np.outer(u, u)
    entries = {f"c{'xyz'[a]}{'xyz'[b]}": twisted[a, b] for a in range(3) for b in range(a, 3)}
    twists = points(LinkBending(robot, section="twisting"), {"1/EI": size, "1/GJ": 2 * size})
    assert np.abs(twists - bends).max() > 1e-6
    assert_allclose(points(oblique, entries), twists, rtol=0, atol=1e-12)


BENT = {  # one of each sort is found here, all of them by benchmarks/hidden_cases.py
    "little, to the elbow": case("hh800", Hidden("link-bending", 4, 5e-8)),
    "much, to the elbow": case("hh800", Hidden("link-bending", 4, 1.5e-7)),
    "little, to the wrist": case("hh800", Hidden("link-bending", 3, 5e-8, "to the wrist")),
    "much, to the wrist": case("hh800", Hidden("link-bending", 3, 1.5e-7, "to the wrist")),
    "own weight, loop": case("hh800", Hidden("link-bending", 2, 3e-7)),
    "own weight": case("serial", Hidden("link-bending", 2, 3e-7)),
    "tapering, loop": case("hh800", Hidden("tapered-beam", 2, 1e-7, 4.0)),
    "tapering": case("serial", Hidden("tapered-beam", 2, 1e-7, 4.0)),
}


def test_a_link_that_bends_as_far_as_the_wrist_is_one_cause(tmp_path):
    """Fails if a forearm that ends at the wrist is a bearing that tilts, in part another's, or one that ends at the elbow."""
    bent = BENT["little, to the wrist"]
    seen = found(tmp_path, replace(bent, settings=ALIKE), 33)
    assert len(seen.causes) == 1, seen.causes
    assert seen.causes.iloc[0]["cannot_tell_from"] == "", seen.causes
    assert seen.has("link-bending", bent.hidden[0].joint)
    assert seen.unexplained.empty, seen.unexplained
