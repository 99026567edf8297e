"""Position: coordinates in the frame of a station, which may be another each session."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from calflow.measurements.series import Series, Station
from calflow.observations.position import Position
from observations.graph import error, frame, no_links, through_json


def table(points: np.ndarray, sessions: list[str] | None = None) -> pd.DataFrame:
    """What a device reports of points."""
    rows = pd.DataFrame(points, columns=["x", "y", "z"])
    return rows if sessions is None else rows.assign(session=sessions)


def composed(nominal: np.ndarray, small: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A frame that errs by `small` in its own axes."""
    turn, origin = frame(nominal)
    more, shift = frame(small)
    return turn @ more, origin + turn @ shift


def test_the_first_station_is_the_measuring_frame():
    """Fails if the plain case gains parameters, or its error is not predicted minus reported."""
    rng = np.random.default_rng(1)
    points, reported = rng.normal(size=(2, 5, 3))
    one = Position.of(Series(), table(reported))
    assert one.declared == ()
    np.testing.assert_allclose(error(one, np.zeros(0), points, table(reported)), points - reported, atol=1e-15)


def test_a_further_station_sees_points_in_its_own_frame():
    """Fails if the frame is inverted wrongly, its error acts in the wrong axes, or the device's own error acts before it."""
    rng = np.random.default_rng(2)
    points, reported = rng.normal(size=(2, 6, 3))
    one = Position.beside(Series(station=Station("B")), table(reported), first=False)
    nominal, small = rng.normal(size=6), 0.1 * rng.normal(size=6)
    one = one.placed(dict.fromkeys(one.placements, tuple(nominal)))
    turn, origin = composed(nominal, small)
    found = error(one, small, points, table(reported), device=1.01)
    np.testing.assert_allclose(found, 1.01 * (points - origin) @ turn - reported, atol=1e-12)
    assert [p.name for p in one.declared] == [f"station-B.{s}" for s in ("x", "y", "z", "rx", "ry", "rz")]
    assert one.declared[1].figure == pytest.approx(nominal[1])


def test_each_session_has_its_frame_and_the_first_none():
    """Fails if a row is read in another session's frame."""
    rng = np.random.default_rng(3)
    points, reported = rng.normal(size=(2, 6, 3))
    sessions = ["mon", "tue", "wed", "tue", "mon", "wed"]
    rows = table(reported, sessions)
    one = Position.beside(Series(station=Station("A", by_session=True)), rows, first=True)
    assert len(one.declared) == 12
    p = 0.2 * rng.normal(size=12)
    found = error(one, p, points, rows)
    for i, session in enumerate(sessions):
        turn, origin = {"mon": (np.eye(3), np.zeros(3)), "tue": frame(p[:6]), "wed": frame(p[6:])}[session]
        np.testing.assert_allclose(found[i], (points[i] - origin) @ turn - reported[i], atol=1e-12)


def test_a_station_is_registered_where_its_rows_put_it():
    """Fails if exact rows leave an error at the registered frame, or a session is placed by another's rows."""
    rng = np.random.default_rng(4)
    points = rng.normal(size=(20, 3))
    places = {"tue": rng.normal(size=6), "wed": rng.normal(size=6)}
    sessions = [("mon", "tue", "wed")[i % 3] for i in range(20)]
    reported = points.copy()
    for i, session in enumerate(sessions):
        if session in places:
            turn, origin = frame(places[session])
            reported[i] = turn.T @ (points[i] - origin)
    rows = table(reported, sessions)
    series = Series(station=Station("A", by_session=True))
    one = Position.of(series, rows).registered(points, no_links, rows)
    np.testing.assert_allclose(error(one, np.zeros(12), points, rows), 0, atol=1e-12)
    assert through_json(one) == one


def test_a_known_station_has_no_parameters():
    """Fails if a stated frame is fitted, moved by the rows, or not used."""
    rng = np.random.default_rng(5)
    points, reported = rng.normal(size=(2, 6, 3))
    station = Station("B", known=True, origin=(1.0, 2.0, 3.0), rotation=(0.1, -0.2, 0.3))
    one = Position.beside(Series(station=station), table(reported), first=False)
    one = one.registered(points, no_links, table(reported))
    turn, origin = frame(np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3]))
    assert one.declared == ()
    np.testing.assert_allclose(error(one, np.zeros(0), points, table(reported)), (points - origin) @ turn - reported)


def test_a_new_session_is_lacking_until_it_is_added():
    """Fails if an unknown session goes unseen, or adding it changes the frames that are known."""
    rng = np.random.default_rng(6)
    points, reported = rng.normal(size=(2, 8, 3))
    rows = table(reported, ["mon", "tue"] * 4)
    series = Series(station=Station("A", by_session=True))
    one = Position.of(series, rows).registered(points, no_links, rows)
    new = table(reported, ["mon", "wed"] * 4)
    assert not one.lacks(rows)
    assert one.lacks(new)
    wider = one.extended(new)
    assert not wider.lacks(new)
    assert not wider.lacks(rows)
    assert wider.placements | one.placements == wider.placements
    assert [p.name for p in wider.declared[:6]] == [p.name for p in one.declared]


def test_what_is_expected_leaves_no_error():
    """Fails if planned rows are not what the graph would report of them."""
    rng = np.random.default_rng(7)
    points = rng.normal(size=(5, 3))
    one = Position.of(Series(), table(points))
    expected = one.expected(points, np.zeros((5, 3, 3)))
    np.testing.assert_array_equal(expected, one.reported(table(points)))
