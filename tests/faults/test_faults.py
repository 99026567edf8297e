"""Data faults are found with exactly the right rows, put right or left out, and nothing is found where nothing is wrong."""

from __future__ import annotations

import io
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calflow.faults import Correction, Fault, as_table, corrected, examined
from calflow.faults.base import correct, lines_in_words
from calflow.faults.outlier import limit_of
from calflow.faults.reference import Reference
from calflow.faults.rough import NORMAL_LENGTH
from calflow.faults.segments import states
from calflow.faults.setup import Setup
from calflow.files.problems import InputError
from calflow.files.tables import EXACT, csv_text
from calflow.measurements.measurements import Measurements
from calflow.study import load_study
from conftest import in_process
from hidden.case import Case, write_case
from hidden.causes import Hidden

ROBOTS = ("serial", "hh800")
STUDIES = Path(__file__).parents[2] / "studies"
ROWS = [  # cause, joint, variant, seeds
    ("outlier", 0, "", (1, 2)),
    ("marker-swap", 0, "", (1,)),
    ("encoder-turn", 5, "", (1,)),
    ("encoder-turn", 1, "gear", (1,)),
    ("encoder-turn", 6, "gear", (1,)),
    ("unit-mistake", 0, "", (1,)),
    ("unit-mistake", 4, "", (1,)),
    ("row-misalignment", 0, "", (1,)),
]


def measured(folder: Path, case: Case, seed: int) -> tuple[Measurements, list[int]]:
    """A case's measurements as a study reads them, and the lines that the sealed answer calls wrong."""
    write_case(folder, replace(case, workflow="paper-table"), np.random.default_rng([11, seed]))
    sealed = json.loads((folder / "answer.json").read_text(encoding="utf-8"))["faulty_lines"]
    return load_study(folder).measurements(), sealed


def lines_of(found: tuple[Fault, ...]) -> list[int]:
    """The lines of all faults."""
    return sorted(line for fault in found for line in fault.lines)


def through_csv(table: pd.DataFrame) -> pd.DataFrame:
    """A table as a later stage reads it."""
    return pd.read_csv(io.StringIO(csv_text(table)), **EXACT)


def with_rows(data: Measurements, conditions: np.ndarray, aside: np.ndarray) -> Measurements:
    """The data with the positions of some rows moved aside [m]."""
    table = data.table.copy()
    table.loc[conditions, ["x", "y", "z"]] += aside
    return Measurements(data.robot, table, data.notes)


# --- What is hidden is found ---------------------------------------------------------------------------


@pytest.mark.parametrize(  # on the robots in turn; benchmarks/mistakes.py has each on four
    ("cause", "joint", "variant", "seed", "robot"),
    [(*row, ROBOTS[k % 2]) for k, row in enumerate((*f[:3], s) for f in ROWS for s in f[3])],
)
def test_faulty_rows_are_found_and_no_others(tmp_path, robot, cause, joint, variant, seed):
    """Fails if a fault is missed, wrongly named or placed, if a good row is touched, or a later stage sees other rows."""
    case = Case(
        robot=robot, poses=80, markers=1 + (cause == "marker-swap"), hidden=(Hidden(cause, joint, extra=variant),)
    )
    data, sealed = measured(tmp_path, case, seed)
    after, found = examined(data)
    assert {(fault.cause, fault.joint) for fault in found} == {(cause, joint)}
    assert lines_of(found) == sealed
    left_out = [line for fault in found if fault.action == "left out" for line in fault.lines]
    assert after.table.loc[~after.train & ~after.held_out, "line"].tolist() == sorted(left_out)
    pd.testing.assert_frame_equal(
        corrected(data, through_csv(as_table(found, data))).table, after.table, check_exact=True
    )
    if any(fault.action == "corrected" for fault in found):
        assert not (Reference.of(after, Setup.of(after)).gross & (after.train | after.held_out)).any()


def test_a_joint_that_counts_the_other_way_is_found(tmp_path):
    """Fails if geometry and compliance are taken for a wrong sign, or the wrong joint is turned."""
    robot, joint = "hh800", 3  # benchmarks/mistakes.py has others
    data, _ = measured(tmp_path, Case(robot=robot, poses=60, hidden=(Hidden("joint-sign", joint),)), 1)
    after, found = examined(data)
    assert [(fault.cause, fault.joint, fault.lines) for fault in found] == [("joint-sign", joint, ())]
    np.testing.assert_array_equal(after.joints[:, joint - 1], -data.joints[:, joint - 1])
    table = through_csv(as_table(found, data))
    assert table["line"].isna().tolist() == [True]
    pd.testing.assert_frame_equal(corrected(data, table).table, after.table)


def test_several_signs_and_a_base_that_nobody_knows(tmp_path):
    """Fails if one wrong sign hides another, or the search needs a base that is stated."""
    data, _ = measured(tmp_path, Case(poses=60), 2)
    robot = replace(data.robot, base=replace(data.robot.base, known=False))
    turned = correct(
        data.on(robot), Fault("", 0, (), "", "corrected", (Correction(0, "q3", -1.0), Correction(0, "q5", -1.0)))
    )
    after, (fault,) = examined(turned)
    assert (fault.cause, fault.action) == ("joint-sign", "corrected")
    assert "joints 3 and 5: all readings have the wrong sign" in fault.statement
    np.testing.assert_array_equal(after.joints, data.joints)


def test_faults_of_two_kinds_are_told_apart(tmp_path):
    """Fails if one fault hides another, or its rows are taken for outliers."""
    data, sealed = measured(tmp_path, Case(noise="outliers", hidden=(Hidden("encoder-turn", 2, extra="gear"),)), 3)
    found = examined(data)[1]
    assert {fault.cause for fault in found} == {"encoder-turn", "outlier"}
    assert lines_of(found) == sealed


def test_rows_are_put_right_behind_a_mistake_of_the_whole_table(tmp_path):
    """Fails if a wrong sign hides what corrects single rows, which are then left out as outliers to be measured again."""
    column = "q4"
    data, _ = measured(tmp_path, Case(poses=70), 3)
    table = data.table.copy()
    place = ["x", "y", "z"]
    table.loc[3, place] *= 1000
    table.loc[[10, 30], place] = table.loc[[30, 10], place].to_numpy()
    after, found = examined(replace(data, table=table.assign(**{column: -table[column]})))
    assert [fault.action for fault in found] == ["corrected"] * 3
    assert {fault.cause for fault in found[1:]} == {"unit-mistake", "rows-exchanged"}
    np.testing.assert_allclose(after.position, data.position, rtol=1e-12)
    np.testing.assert_array_equal(after.joints, data.joints)


@pytest.mark.parametrize("near", [True, False])
def test_a_joint_that_errs_at_one_angle_is_no_slip_of_the_pen(tmp_path, near):
    """Fails if a chipped tooth's poses are left out, so that the robot is said to be accurate there; or slips are let stand."""
    data, _ = measured(tmp_path, Case(poses=70), 3)
    table = data.table.copy()
    away = (table["q2"] - table["q2"].median()).abs().to_numpy().argsort(kind="stable")
    chipped = away[:3] if near else away[[0, -1, -2]]
    table.loc[chipped, "q2"] += 5e-3
    after, found = examined(replace(data, table=table))
    assert [fault.cause for fault in found] == ([] if near else ["outlier"])
    assert (after.train | after.held_out).all() == near


def test_rows_pasted_from_a_table_in_radians_are_put_right(tmp_path):
    """Fails if a whole pose in another unit is no mistake, and successive ones pass for a step that a cause explains."""
    data, _ = measured(tmp_path, Case(poses=70), 3)
    angles, pasted = [f"q{i + 1}" for i in range(6)], np.arange(20, 25)
    table = data.table.copy()
    table.loc[pasted, angles] *= np.pi / 180
    after, (found,) = examined(replace(data, table=table))
    assert (found.cause, found.joint, found.action) == ("unit-mistake", 0, "corrected")
    assert list(found.lines) == data.table["line"].iloc[pasted].tolist()
    np.testing.assert_allclose(after.joints, data.joints, rtol=1e-9)


def test_without_masses_too(tmp_path):
    """Fails if deflection that the robot file's masses would explain is let stand, so that outliers drown in it."""
    case = Case(
        robot="hh800", noise="outliers", masses=False, effects=("geometry",), hidden=(Hidden("joint-compliance", 0, 1),)
    )
    data, sealed = measured(tmp_path, case, 4)
    assert lines_of(examined(data)[1]) == sealed


def test_rows_that_no_shift_puts_right_are_left_out(tmp_path):
    """Fails if a shuffled block stays in, or is called outliers."""
    data, _ = measured(tmp_path, Case(), 5)
    block = np.arange(60, 72)
    table = data.table.copy()
    table.loc[block, ["x", "y", "z"]] = table.loc[block[::-1], ["x", "y", "z"]].to_numpy()
    after, found = examined(Measurements(data.robot, table, data.notes))
    assert [(fault.cause, fault.action) for fault in found] == [("row-misalignment", "left out")]
    assert not (after.train | after.held_out)[block].any()


# --- What is not there is not found --------------------------------------------------------------------


@pytest.mark.parametrize(
    "case",
    [
        Case(noise="heavy"),
        Case(
            robot="hh800",
            noise="range",
            masses=False,
            effects=("geometry",),
            hidden=(Hidden("joint-compliance", 0, 1),),
        ),
        Case(
            noise="heavy", markers=3, poses=40, hidden=(Hidden("frame-step", 0, 4e-3), Hidden("payload-mass", 0, 0.3))
        ),
        Case(
            robot="hh800",
            hidden=(Hidden("nonlinear-joint-stiffness", 2, 3e-3, "break"), Hidden("joint-error-map", 1, 1e-3)),
        ),
    ],
    ids=["heavy tails", "compliance", "a bumped device", "a stiffening gear"],
)
def test_noise_and_missing_causes_are_no_faults(tmp_path, case):
    """Fails if heavy tails or what the model lacks are taken for mistakes in the data."""
    assert examined(measured(tmp_path, case, 6)[0])[1] == ()


@pytest.mark.skipif("CALFLOW_DATA" not in os.environ, reason="CALFLOW_DATA does not name the folder with measured data")
@pytest.mark.parametrize("study", ["ur10-tmac/study.toml", "ur10-tmac/series_b.toml", "fanuc-r2000/study.toml"])
def test_real_data_are_without_faults(study):
    """Fails if a real robot's own errors, or a base and markers that nobody wrote down, look like faults."""
    data = load_study(STUDIES / study).measurements()
    after, found = examined(data)
    assert found == ()
    assert after is data


@pytest.mark.parametrize("n", [40, 400])
def test_an_outlier_is_beyond_heavy_tails(n):
    """Fails if the limit's quantile or its constant is wrong: a few in a thousand data sets may alarm, not a few percent."""
    rng, alarms = np.random.default_rng(7), 0
    for _ in range(2000):
        miss = np.linalg.norm(rng.standard_t(3, (n, 3)), axis=1)
        scale = float(np.median(miss)) / NORMAL_LENGTH
        alarms += bool((miss > limit_of(miss, scale, 15 * scale)).any())
    assert alarms < 20
    miss = np.linalg.norm(rng.standard_normal((n, 3)), axis=1)
    assert limit_of(miss, 1.0, 15.0) < 65


def test_rows_that_are_off_together_are_no_outliers(tmp_path):
    """Fails if a device that was bumped near the end, or half of all rows, are left out as outliers."""
    data, _ = measured(tmp_path, Case(poses=75), 8)
    rng = np.random.default_rng(9)
    assert examined(with_rows(data, np.arange(69, 75), np.array([5e-3, 1e-3, 0])))[1] == ()
    assert examined(with_rows(data, np.arange(0, 75, 3), rng.normal(0, 5e-3, (25, 3))))[1] == ()
    assert len(examined(with_rows(data, np.arange(0, 75, 15), rng.normal(0, 5e-3, (5, 3))))[1]) == 1


def test_a_handful_of_rows_says_nothing(tmp_path):
    """Fails if a model is fitted to as many rows as it has parameters, and the others are believed wrong."""
    data, _ = measured(tmp_path, Case(poses=6, noise="outliers"), 10)
    assert examined(data)[1] == ()


# --- How it is put right -------------------------------------------------------------------------------


def test_values_of_the_device_go_with_their_position(tmp_path):
    """Fails if a row's stated noise or range stays behind where its position is exchanged or mended."""
    data, _ = measured(tmp_path, Case(poses=20, noise="range", columns=("sigma",)), 12)
    swapped = correct(data, Fault("", 0, (), "", "corrected", (Correction(3, source=4), Correction(4, source=3))))
    for name in ("x", "sigma", "range"):
        assert swapped.table[name][2:4].tolist() == data.table[name][[3, 2]].tolist()
    assert swapped.table["q1"].equals(data.table["q1"])
    longer = correct(data, Fault("", 0, (), "", "corrected", (Correction(5, "position", 1.1),)))
    np.testing.assert_allclose(longer.table["range"], np.linalg.norm(longer.position, axis=1))


def test_approach_follows_from_the_mended_readings(tmp_path):
    """Fails if a reading that is put right leaves the ways behind it as they were read."""
    folder = tmp_path / "case"
    write_case(folder, Case(columns=(), hidden=(Hidden("encoder-turn", 5),)), np.random.default_rng(13))
    text = (folder / "study.toml").read_text(encoding="utf-8")
    (folder / "study.toml").write_text(text.replace("[split]", "in_order = true\n\n[split]"), encoding="utf-8")
    after, found = examined(load_study(folder).measurements())
    assert {fault.cause for fault in found} == {"encoder-turn"}
    step = np.diff(after.joints[:, 4])
    np.testing.assert_array_equal(after.table["approach5"][1:], np.sign(step))


def test_a_table_about_other_rows_is_refused(tmp_path):
    """Fails if the rows of another file are mended."""
    data, _ = measured(tmp_path, Case(noise="outliers"), 14)
    table = as_table(examined(data)[1], data)
    with pytest.raises(InputError, match="does not fit"):
        corrected(data.only(data.train), table)
    assert corrected(data, table.iloc[:0]) is data


def test_segments_are_the_cheapest():
    """Fails if a single odd row makes a segment, or an end of one is off."""
    costs = np.array([[0, 0, 9, 9, 9, 9, 0, 0, 9, 0.0], [9, 9, 0, 0, 0, 0, 9, 9, 0, 9.0]])
    assert states(costs, 10.0).tolist() == [0, 0, 1, 1, 1, 1, 0, 0, 0, 0]


def test_lines_are_told_in_words():
    """Fails if runs of lines are spelled out, or a long list is not cut."""
    assert lines_in_words([7]) == "line 7"
    assert lines_in_words([4, 2, 3, 3, 9]) == "lines 2 to 4, 9"
    assert lines_in_words(range(0, 40, 2), most=2) == "lines 0, 2, 18 more places"


# --- From end to end -----------------------------------------------------------------------------------


def test_a_run_says_what_is_wrong_and_reaches_the_noise(tmp_path):
    """Fails if outliers spoil the fit or the judgement, are dropped without a word, or their rows vanish from the tables."""
    case = Case(noise="outliers", hidden=(Hidden("unit-mistake"),), workflow="paper-table")
    write_case(tmp_path, case, np.random.default_rng(15))
    sealed = json.loads((tmp_path / "answer.json").read_text(encoding="utf-8"))["faulty_lines"]
    answer = in_process("run", tmp_path, "--out", tmp_path / "run")
    assert answer.code == 0, answer
    assert "outlier: the position in line" in answer.out
    assert "unit mistake: x, y, z are in m instead of mm in lines" in answer.out
    table = pd.read_csv(tmp_path / "run" / "identify" / "faults.csv")
    assert sorted(table["line"]) == sealed
    assert set(zip(table["cause"], table["action"], strict=True)) == {
        ("outlier", "left out"), ("unit-mistake", "corrected")
    }  # fmt: skip
    residuals = pd.read_csv(tmp_path / "run" / "identify" / "residuals.csv")
    assert len(residuals) == case.poses
    out = residuals["split"].isna()
    assert residuals.loc[out, "line"].tolist() == table.loc[table["action"] == "left out", "line"].tolist()
    assert not residuals.loc[out, "flagged"].any()
    accuracy = pd.read_csv(tmp_path / "run" / "identify" / "accuracy.csv")
    assert accuracy.groupby("model")["n"].sum().tolist() == [case.poses - out.sum()] * 3
    last = accuracy.iloc[-1]
    assert last["split"] == "holdout"
    assert last["mean_mm"] < 1.3 * 1e3 * case.sigma * np.sqrt(8 / np.pi)
    assert last["max_mm"] < 6e3 * case.sigma


def test_a_file_without_faults_has_an_empty_table(tmp_path):
    """Fails if the table is left out, so that a reader cannot tell "none" from "not looked for"."""
    write_case(tmp_path, Case(poses=40, workflow="paper-table"), np.random.default_rng(16))
    assert in_process("run", tmp_path, "--out", tmp_path / "run").code == 0
    table = pd.read_csv(tmp_path / "run" / "identify" / "faults.csv")
    assert list(table)[:6] == ["cause", "joint", "line", "pose", "action", "statement"]
    assert table.empty
