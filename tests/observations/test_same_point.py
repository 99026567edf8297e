"""Same point: the marker again and again in sockets whose places nobody knows."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pandas as pd
import pytest

from calflow.measurements.series import Series
from calflow.observations import Seen
from calflow.observations.same_point import SamePoint
from observations.graph import error, no_links, through_json, turned

NAMES = [("left", "0"), ("left", "1"), ("right", "0"), ("right", "1")]
AT = {name: np.array([k, 0.1 * k, -0.2 * k]) for k, name in enumerate(NAMES, start=1)}


def table(names: list[tuple[str, str]]) -> pd.DataFrame:
    """Rows in these sockets."""
    return pd.DataFrame(names, columns=["placement", "socket"])


def test_a_socket_is_where_its_rows_are():
    """Fails if a row is held against another socket, or a place has other than three parameters."""
    rng = np.random.default_rng(1)
    names = [NAMES[k] for k in rng.integers(4, size=10)] + NAMES
    points = rng.normal(size=(len(names), 3))
    one = SamePoint.of(Series(), table(names))
    p = rng.normal(size=12)
    own = np.array([p[3 * NAMES.index(name) :][:3] for name in names])
    np.testing.assert_allclose(error(one, p, points, table(names)), points - own, atol=1e-12)
    assert one.declared[3].name == "same-point-left-1.x"


def test_sockets_without_a_placement_are_one_each():
    """Fails if the column placement must be there."""
    rows = pd.DataFrame({"socket": ["a", "b", "a"]})
    one = SamePoint.of(Series(name="cups"), rows)
    assert [p.part for p in one.declared] == ["cups-a"] * 3 + ["cups-b"] * 3


@pytest.mark.parametrize("sd", [0.0, 1e-4])
def test_two_sockets_stand_their_known_distance_apart(sd):
    """Fails if the second socket of a pair is not the distance from the first, in any direction, or its error is not used."""
    rng = np.random.default_rng(2)
    rows = table(NAMES)
    points = np.array([AT[name] for name in NAMES])
    said = {"distance": 0.05} | ({"distance_sd": sd} if sd else {})
    one = SamePoint.of(Series.of("", "same-point", said), rows).registered(points, no_links, rows)
    p = 0.3 * rng.normal(size=len(one.declared))
    each = 6 if sd else 5
    assert len(p) == 2 * each
    places = points - error(one, p, points, rows)
    for pair in (0, 1):
        own = p[pair * each : (pair + 1) * each]
        apart = 0.05 + (own[5] if sd else 0.0)
        assert np.linalg.norm(places[2 * pair + 1] - places[2 * pair]) == pytest.approx(abs(apart))
        np.testing.assert_allclose(places[2 * pair], points[2 * pair] + own[:3])
    nominal = points - error(one, 0 * p, points, rows)
    way = points[1] - points[0]
    np.testing.assert_allclose(nominal[1] - nominal[0], 0.05 * way / np.linalg.norm(way))
    assert through_json(one) == one


def test_more_than_two_sockets_are_no_pair():
    """Fails if a distance is taken to hold among three sockets."""
    rows = table([("left", "0"), ("left", "1"), ("left", "2")])
    assert len(SamePoint.of(Series.of("", "same-point", {"distance": 0.05}), rows).declared) == 9


def test_a_new_socket_is_lacking_until_it_is_added():
    """Fails if an unknown socket goes unseen, or adding it renames or moves the ones that are known."""
    known, new = table(NAMES[:2]), table(NAMES)
    points = np.array([AT[name] for name in NAMES])
    said = Series.of("", "same-point", {"distance": 0.05})
    one = SamePoint.of(said, known).registered(points[:2], no_links, known)
    assert one.lacks(new)
    assert not one.lacks(known)
    wider = one.extended(new)
    assert wider.placements | one.placements == wider.placements
    assert [p.name for p in wider.declared[:5]] == [p.name for p in one.declared]
    assert not wider.lacks(new)
    assert one == SamePoint.of(said, known).placed(one.placements)


def test_planned_rows_go_to_the_sockets_in_turn():
    """Fails if further poses are all planned for one socket."""
    one = SamePoint.of(Series(), table(NAMES))
    np.testing.assert_array_equal(
        one.expected(np.zeros((6, 3)), np.zeros((6, 3, 3))).argmax(axis=0), [0, 1, 2, 3, 0, 1]
    )


def test_sockets_on_a_link_move_with_it():
    """Fails if such a socket stands still, or is registered in the measuring frame: its rows' own points are not at one place."""
    rng = np.random.default_rng(7)
    links = np.tile(np.eye(4), (5, 1, 1))
    links[:, :3, :3], links[:, :3, 3] = turned(rng, 5), rng.normal(size=(5, 3))
    own = np.array([0.1, -0.2, 0.3])
    points, rows = np.einsum("nij,j->ni", links[:, :3, :3], own) + links[:, :3, 3], pd.DataFrame({"socket": ["a"] * 5})
    cup = SamePoint.of(Series.of("", "same-point", {"on": "hand"}), rows)
    cup = cup.registered(points, lambda name: links, rows)
    np.testing.assert_allclose(cup.nominal[0][:3], own, atol=1e-12)
    for at, point in zip(links, points, strict=True):
        seen = Seen(
            ca.SX(ca.DM(point)),
            lambda: ca.SX.eye(3),
            lambda p: p,
            lambda name, at=at: ca.SX(ca.DM(at)),
            lambda: ca.SX(3, 1),
        )
        assert float(ca.norm_2(ca.evalf(cup.error(ca.SX(3, 1), seen, ca.SX(1))))) < 1e-12
