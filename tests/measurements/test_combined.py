"""Several series of one robot: how a study states them, and the rows of all as one table."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements, combined
from calflow.measurements.series import Series, Station
from calflow.observations import observations
from calflow.study import load_study
from robots import ur10

ONE = '[measurements]\nfile = "measurements.csv"\n'
WIRE = '\n[[measurements]]\nname = "wire"\nkind = "distance"\nfile = "wire.csv"\n'
SERIES = '[[measurements]]\nfile = "measurements.csv"\n'


def wired(small) -> None:
    """Add a wire's file: the same poses, how far the tool is from (3, 0, 1) m."""
    rows = small.rows
    apart = rows[["x_mm", "y_mm", "z_mm"]].astype(float) - [3000, 0, 1000]
    rows = rows.drop(columns=["x_mm", "y_mm", "z_mm", "sigma_mm"], errors="ignore")
    small.measure(rows.assign(length_mm=np.linalg.norm(apart, axis=1)), "wire.csv")


def two(q: np.ndarray, other: np.ndarray, names: list[str], **more) -> Measurements:
    """Two stations' rows at joint angles q and other, their poses named alike."""
    robot = ur10()
    first, second = (
        Measurements.from_arrays(robot, readings, np.ones((len(q), 3)), pose=names, **extra)
        for readings, extra in ((q, more), (other, {}))
    )
    return combined([first, Measurements(robot, second.table, second.notes, (Series(station=Station("B")),))])


def test_one_table_and_a_list_of_one_are_the_same(small):
    """Fails if the two ways to write one series give other rows."""
    plain = load_study(small.path).measurements()
    small.edit("study.toml", ("[measurements]", "[[measurements]]"))
    assert load_study(small.path).measurements() == plain


def test_a_wire_beside_a_tracker(small):
    """Fails if rows of the second series are lost, held against the first's columns, or split from their pose."""
    wired(small)
    small.edit("study.toml", (ONE, SERIES + WIRE))
    data = load_study(small.path).measurements()
    table = data.table
    assert [one.kind for one in data.series] == ["position", "distance"]
    assert data.of_series(1).sum() == data.of_series(0).sum() == len(data) // 2
    assert table.loc[data.of_series(1), "x"].isna().all()
    assert table.loc[data.of_series(0), "length"].isna().all()
    assert (table.groupby("pose")["split"].nunique() == 1).all()


def test_one_series_alone_may_be_a_wire(small):
    """Fails if positions must be there."""
    wired(small)
    small.edit("study.toml", (ONE, WIRE))
    data = load_study(small.path).measurements()
    assert "x" not in data.table
    assert data.table["length"].between(0.1, 10).all()


def test_an_unknown_kind_is_refused_with_its_line(small):
    """Fails if a mistyped kind is no problem, or its place or the nearest right one are not told."""
    small.edit("study.toml", (ONE, SERIES + WIRE.replace('"distance"', '"distanse"')))
    wired(small)
    (said,) = small.refused()
    assert said.startswith("study.toml:12: ")
    assert "did you mean 'distance'" in said


def test_an_unknown_setting_is_refused_with_its_line(small):
    """Fails if a mistyped setting of a kind is no problem, or its place or the nearest right one are not told."""
    small.edit("study.toml", (ONE, SERIES + WIRE + "\n[measurements.settings]\nofset_mm = 3\n"))
    wired(small)
    (said,) = small.refused()
    assert said.startswith("study.toml:16: ")
    assert "measurements[2].settings" in said or "settings.ofset" in said
    assert "offset" in said


def test_a_missing_column_is_told_with_its_file(small):
    """Fails if a wire without lengths is read, or what is missing is not named."""
    wired(small)
    small.measure(pd.read_csv(small / "wire.csv").rename(columns={"length_mm": "lenght_mm"}), "wire.csv")
    small.edit("study.toml", (ONE, SERIES + WIRE))
    said = small.refused()
    assert all(line.startswith("wire.csv:1: ") for line in said)
    assert any("length" in line and "missing" in line for line in said)
    assert any("lenght_mm" in line and "length" in line for line in said)


def test_all_series_are_read_before_anything_is_refused(small):
    """Fails if the second file's problems are told only once the first's are mended."""
    wired(small)
    small.measure(pd.read_csv(small / "wire.csv").drop(columns="length_mm"), "wire.csv")
    small.measure(small.rows.drop(columns="x_mm"))
    small.edit("study.toml", (ONE, SERIES + WIRE))
    said = small.refused()
    assert any(line.startswith("measurements.csv") for line in said)
    assert any(line.startswith("wire.csv") for line in said)


def test_a_pose_of_two_stations_is_one_pose():
    """Fails if what one station sees of a pose is fitted and what the other sees is held out."""
    q = np.random.default_rng(1).uniform(-1, 1, (20, 6))
    data = two(q, q, [f"p{i}" for i in range(20)]).split(0.3, 1)
    assert data.table["pose"].nunique() == 20
    assert (data.table.groupby("pose")["split"].nunique() == 1).all()


def test_a_name_used_for_two_poses_stands_for_two():
    """Fails if two files that both count their poses from 1 share poses."""
    rng = np.random.default_rng(2)
    data = two(rng.uniform(-1, 1, (5, 6)), rng.uniform(-1, 1, (5, 6)), [f"p{i}" for i in range(5)])
    assert data.table["pose"].nunique() == 10


def test_a_pose_in_another_order_is_still_the_same():
    """Fails if two files without names, in which the same poses come in another order, hold a pose twice."""
    q = np.random.default_rng(3).uniform(-1, 1, (6, 6))
    data = two(q, q[::-1], [f"p{i}" for i in range(6)])
    assert data.table["pose"].nunique() == 6
    assert (data.table.groupby("pose")["q1"].nunique() == 1).all()


def test_a_condition_that_one_series_lacks_is_left_out_and_said():
    """Fails if temperatures of one series stand beside none of the other, or nobody is told."""
    q = np.random.default_rng(4).uniform(-1, 1, (5, 6))
    data = two(q, q, [f"p{i}" for i in range(5)], temperature=300.0)
    assert "temperature" not in data.given
    assert any("temperature" in note and "left out" in note for note in data.notes)


def test_rows_without_a_split_beside_others_with_one_are_fitted_and_that_is_said():
    """Fails if a series without a split is held out in part, or nobody is told that all of it is fitted."""
    q = np.random.default_rng(5).uniform(-1, 1, (2, 4, 6))
    data = two(*q, [f"p{i}" for i in range(4)], split=["train", "train", "holdout", "holdout"])
    assert data.only(data.of_series(1)).train.all()
    assert data.held_out.sum() == 2
    assert any("'split'" in note and "fitted" in note for note in data.notes)


def test_series_of_other_markers_are_refused_by_name(small):
    """Fails if a second series' marker that the robot does not have goes through."""
    wired(small)
    small.measure(pd.read_csv(small / "wire.csv").assign(marker="toool"), "wire.csv")
    small.edit("study.toml", (ONE, SERIES + WIRE))
    assert any("toool" in line for line in small.refused())


@pytest.mark.parametrize("wrong", ["floor_mm = -0.1", "angle_arcmin = 1"])
def test_an_impossible_beam_noise_is_refused(small, wrong):
    """Fails if a negative floor or an unknown unit goes through."""
    noise = f"\n[measurements.noise]\nfloor_mm = 0.015\nangle_arcsec = 1\n{wrong}\n"
    small.edit("study.toml", (ONE, ONE + (noise if "angle" in wrong else noise.replace("floor_mm = 0.015\n", ""))))
    with pytest.raises(InputError):
        load_study(small.path)


def test_two_series_that_share_a_name_are_refused(small):
    """Fails if the anchors of two wires become one parameter's two values, or nobody is told what to do."""
    wired(small)
    small.edit("study.toml", (ONE, SERIES + WIRE + WIRE))
    (said,) = small.refused()
    assert said.startswith("study.toml:")
    assert "wire.x" in said
    small.edit("study.toml", ('name = "wire"', 'name = "other"'))
    assert small.calflow("check").code == 0


def test_points_beside_full_poses():
    """Fails if a tracker's points are taken for poses of unknown orientation, since another series reports orientations."""
    rng = np.random.default_rng(3)
    robot, q = ur10(), rng.uniform(-1, 1, (5, 6))
    points = Measurements.from_arrays(robot, q, rng.uniform(size=(5, 3)))
    full = Measurements.from_arrays(
        robot, q, rng.uniform(size=(5, 3)), rotation=np.tile(np.eye(3), (5, 1, 1)), sigma_rotation=1e-3
    )
    for parts in ([points, full], [full, points]):
        kinds = {type(seen).id: seen.units for seen in observations(combined(parts))}
        assert {kind: len(units) for kind, units in kinds.items()} == {"position": 3, "pose": 6}
