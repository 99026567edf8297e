"""Distance: a length between marker and anchor, of a wire or a bar."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from calflow.files.problems import InputError
from calflow.files.toml import Origin, validate_table
from calflow.measurements.series import Series
from calflow.observations.distance import Distance, DistanceSettings
from observations.graph import error, no_links, through_json

ANCHOR = np.array([1.5, -0.7, 0.3])


def table(length: np.ndarray) -> pd.DataFrame:
    """What the wire reports."""
    return pd.DataFrame({"length": length})


def test_all_of_a_wire_may_be_unknown():
    """Fails if the length is not (1 + scale) |point - anchor| + offset."""
    rng = np.random.default_rng(1)
    points, length = rng.normal(size=(6, 3)), rng.uniform(1, 2, 6)
    one = Distance.at(Series(), ANCHOR)
    p = np.array([0.1, -0.2, 0.3, 0.01, 2e-3])
    expected = 1.002 * np.linalg.norm(points - ANCHOR - p[:3], axis=1) + 0.01 - length
    np.testing.assert_allclose(error(one, p, points, table(length))[:, 0], expected, atol=1e-14)
    assert [q.name for q in one.declared] == [f"distance.{s}" for s in ("x", "y", "z", "offset", "scale")]


def test_what_is_stated_is_not_fitted():
    """Fails if a stated anchor, offset or scale is a parameter, or is not used."""
    rng = np.random.default_rng(2)
    points, length = rng.normal(size=(6, 3)), rng.uniform(1, 2, 6)
    rows = table(length)
    one = Distance.of(Series.of("bar", "distance", {"anchor": tuple(ANCHOR), "offset": 0.05, "scale": -1e-3}), rows)
    one = one.registered(points, no_links, rows)
    expected = 0.999 * np.linalg.norm(points - ANCHOR, axis=1) + 0.05 - length
    assert one.declared == ()
    np.testing.assert_allclose(error(one, np.zeros(0), points, rows)[:, 0], expected, atol=1e-14)
    np.testing.assert_allclose(one.expected(points, np.zeros((6, 3, 3)))[0] - length, expected, atol=1e-14)


def test_an_anchor_stated_roughly_is_fitted():
    """Fails if a rough place counts as known."""
    settings = {"anchor": tuple(ANCHOR), "anchor_known": False, "offset": 0.0, "scale": 0.0}
    one = Distance.of(Series.of("wire", "distance", settings), table(np.ones(1)))
    assert [q.symbol for q in one.declared] == ["x", "y", "z"]
    assert one.anchor == tuple(ANCHOR)


def test_the_anchor_is_found_by_trilateration():
    """Fails if lengths with a zero of 15 mm and a nominal robot's error do not find the anchor, or count the zero as an error."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, size=(60, 3))
    rows = table(np.linalg.norm(points + 2e-3 * rng.normal(size=(60, 3)) - ANCHOR, axis=1) + 0.015)
    one = Distance.of(Series(), rows).registered(points, no_links, rows)
    np.testing.assert_allclose(one.anchor, ANCHOR, atol=0.02)
    assert abs(error(one, np.zeros(5), points, rows)).mean() < 2e-3
    assert through_json(one) == one
    assert Distance.of(Series(), rows).placed(one.placements).anchor == one.anchor


def test_an_unknown_zero_of_a_known_anchor_is_found():
    """Fails if a wire's zero counts as an error of the nominal robot, or moves an anchor whose place is stated."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-1, 1, size=(60, 3))
    rows = table(np.linalg.norm(points - ANCHOR, axis=1) + 0.015)
    bare = Distance.of(Series.of("wire", "distance", {"anchor": tuple(ANCHOR)}), rows)
    one = bare.registered(points, no_links, rows)
    assert one.anchor == tuple(ANCHOR)
    assert error(one, np.zeros(2), points, rows)[:, 0] == pytest.approx(0.0, abs=1e-4)
    np.testing.assert_allclose(one.expected(points, np.zeros((60, 3, 3)))[0], rows["length"], atol=1e-4)


def test_a_setting_that_a_wire_does_not_have_is_refused(tmp_path):
    """Fails if a wrong word goes through, or the nearest right one is not named."""
    path = tmp_path / "study.toml"
    path.write_text("[measurements.settings]\nancor_mm = [1, 2, 3]\n")
    with pytest.raises(InputError) as refused:
        validate_table({"ancor_mm": [1, 2, 3]}, DistanceSettings, Origin.of(path, "measurements", "settings"))
    assert "anchor" in str(refused.value)
    assert "2" in str(refused.value)
