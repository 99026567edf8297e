"""Measurements that cannot be right are refused, with all that is wrong, before anything is done with them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calflow.files.problems import InputError
from calflow.study import load_study

Q, X = ["q1_deg", "q2_deg", "q3_deg"], ["x_mm", "y_mm", "z_mm"]


def put(column, row, value):
    """A change of one cell; row 0 is line 2."""

    def change(rows):
        rows.loc[row, column] = value
        return rows

    return change


def scaled(columns, factor):
    return lambda rows: rows.assign(**{name: rows[name].astype(float) * factor for name in columns})


def renamed(**names):
    return lambda rows: rows.rename(columns=names)


def with_columns(**columns):
    return lambda rows: rows.assign(**columns)


def both(*changes):
    def change(rows):
        for one in changes:
            rows = one(rows)
        return rows

    return change


def approached(last):
    return with_columns(approach1="1", approach2="-1", approach3=last)


HEADER = {
    "missing": (lambda rows: rows.drop(columns=["q2_deg", "y_mm"]),
                ["missing column: expected q2_rad or q2_deg", "missing column: expected y_m or y_mm or y_um"]),
    "misspelt": (renamed(payload="paylod", x_mm="X_mm"),
                 ["unknown column 'paylod', did you mean 'payload'?", "unknown column 'X_mm', did you mean 'x_mm'?",
                  "missing column: expected x_m"]),
    "internal name": (with_columns(line="1"), ["unknown column 'line'"]),
    "unit of a label": (renamed(pose="pose_mm"), ["unknown column 'pose_mm', did you mean 'pose'?"]),
    "no unit": (renamed(x_mm="x"), ["column 'x' needs a unit of length in its name: x_m, x_mm, x_um"]),
    "length for an angle": (renamed(q1_deg="q1_mm"), ["column 'q1_mm' needs a unit of angle in its name: q1_rad, q1_deg"]),
    "two units": (with_columns(x_m="1"), ["column 'x_m': 'x' is there twice, in different units"]),
    "twice": (lambda rows: pd.concat([rows, rows["x_mm"]], axis=1), ["column 'x_mm' is there twice: expected each name once"]),
    "some approaches": (with_columns(approach2="1"), ["missing column: expected approach1", "missing column: expected approach3"]),
    "some travel": (with_columns(travel1_deg="1"), ["missing column: expected travel2_rad or travel2_deg",
                                                    "missing column: expected travel3_rad or travel3_deg"]),
    "many unknown": (with_columns(**{f"c{i}": "1" for i in range(300)}), [*["unknown column 'c"] * 20, "and 280 more columns"]),
    "some torques": (with_columns(tau1_Nm="1", tau2_Nm="1"), ["missing column: expected tau3_Nm or tau3_kNm"]),
    "some forces": (with_columns(fx_N="1", fy_N="1", fz_N="1", mx_Nm="1", my_Nm="1"), ["missing column: expected mz_Nm"]),
    "a fourth joint": (with_columns(q4_deg="1"), ["unknown column 'q4_deg': the robot file has 3 joints"]),
    "names of another": (renamed(x_mm="#7"), ["unknown column '#7'", "missing column: expected x_m",
                                               "if columns have names of their own, say q1_deg = "]),
    "a title first": (lambda rows: pd.DataFrame([rows.columns.tolist()], columns=["A tracker's", *[""] * (len(rows.columns) - 1)]),
                      ["expected the header line, found 'A tracker's': leave out what precedes it, or say header_line = 2"]),
    "another separator": (lambda rows: rows.set_axis([";".join(rows.columns), *rows.columns[1:]], axis=1).iloc[:, :1],
                          ["has no ',' in its header line, but ';': say separator = \";\""]),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), HEADER.values(), ids=HEADER)
def test_a_wrong_header_is_told_column_by_column(small, change, expected):
    """Fails if a column is dropped in silence, a unit is guessed, or only the first problem is told."""
    small.measure(change(small.rows))
    told = small.refused("check")
    assert len(told) == len(expected), told
    for problem, start in zip(told, expected, strict=True):
        assert problem.startswith(f"measurements.csv:1: {start}")


CELLS = {
    "empty": (put("x_mm", 3, ""), ["5: column 'x_mm' is empty or not a number; complete the row or leave it out"]),
    "nan": (put("q1_deg", 3, "NaN"), ["5: column 'q1_deg' is empty or not a number"]),
    "infinite": (put("y_mm", 3, "-inf"), ["5: column 'y_mm' is empty or not a number"]),
    "too large": (put("y_mm", 3, "1e400"), ["5: column 'y_mm': expected at most 1e+06 m"]),
    "text": (put("x_mm", 3, "n.a."), ["5: column 'x_mm': expected a number, found 'n.a.'"]),
    "decimal comma": (put("x_mm", 3, "1,5"), ["5: column 'x_mm': expected a number, found '1,5' (written with ','? say decimal"]),
    "thousands": (put("x_mm", 3, "1_500"), ["5: column 'x_mm': expected a number, found '1_500'"]),
    "true": (with_columns(x_mm="True"), ["2: column 'x_mm': expected a number, found 'True' (and 79 more rows)"]),
    "digits of another script": (put("x_mm", 3, "１２"), ["5: column 'x_mm': expected a number, found '１２'"]),
    "a sign that is not seen": (put("x_mm", 3, "1\u200b2"), ["5: column 'x_mm': expected a number, found '1\\u200b2'"]),
    "many": (with_columns(x_mm=""), [*(f"{line}: column 'x_mm' is empty" for line in range(2, 7)), " column 'x_mm' is empty"]),
    "no pose": (put("pose", 3, ""), ["5: column 'pose' is empty"]),
    "unknown payload": (put("payload", 3, "havy"), ["5: unknown payload 'havy'; the robot file has light, heavy, did you"]),
    "no marker": (put("marker", 3, ""), ["5: column 'marker' is empty; the robot file has tool"]),
    "unknown marker": (put("marker", 3, "tol"), ["5: unknown marker 'tol'; the robot file has tool, did you mean 'tool'?"]),
    "approach": (approached("2"), [*(f"{line}: approach3: expected -1, 0 or 1" for line in range(2, 7)), " approach3"]),
    "approach missing": (both(approached("0"), put("approach3", 1, "")), ["3: column 'approach3' is empty"]),
    "approach in words": (both(approached("0"), put("approach3", 1, "up")), ["3: column 'approach3': expected a number"]),
    "sigma zero": (put("sigma_mm", 3, "0"), ["5: sigma: expected a positive standard deviation"]),
    "sigma negative": (put("sigma_mm", 3, "-1"), ["5: sigma: expected a positive standard deviation"]),
    "row twice": (put("repeat", 1, "1"), ["3: duplicate pose: the same pose, repeat and marker stand in line 2"]),
    "pose number twice": (both(put("pose", 2, "1"), put("repeat", 2, "3")),
                          ["4: duplicate pose: give each pose a number of its own, or leave out the column pose; this number has "
                           "other joint readings in line 2"]),
    "split of neither": (both(with_columns(split="train"), put("split", 2, "test")), ["4: split: expected 'train' or 'holdout'"]),
    "split empty": (both(with_columns(split="train"), put("split", 2, "")), ["4: split: expected 'train' or 'holdout'"]),
    "split within a pose": (both(with_columns(split="train"), put("split", 1, "holdout")),
                            [f"{line}: split: one pose is in train" for line in (2, 3)]),
    "huge": (put("y_mm", 3, "1e300"), ["5: column 'y_mm': expected at most 1e+06 m"]),
    "huge angle": (put("q1_deg", 3, "-1e300"), ["5: column 'q1_deg': expected at most 1e+07 rad"]),
    "no temperature": (lambda rows: put("temperature_degC", 3, "-999")(rows.assign(temperature_degC="21.5")),
                       ["5: temperature: expected -60 to 150 °C; is it in another unit, or a sign for no value?"]),
    "hardly any sigma": (put("sigma_mm", 3, "1e-300"), ["5: sigma: expected a positive standard deviation"]),
    "long text": (put("x_mm", 3, "9" + "x" * 100_000), [f"5: column 'x_mm': expected a number, found '9{'x' * 59} …'"]),
    "long name": (put("payload", 3, "p" * 100_000), ["5: unknown payload 'ppp"]),
    "many names": (lambda rows: rows.assign(payload=[f"p{i}" for i in range(80)]),
                   [*(f"{line}: unknown payload 'p{line - 2}'; the robot file has" for line in range(2, 22)),
                    " and 60 more names of a payload that is not there"]),
    "several": (both(put("x_mm", 3, ""), put("payload", 4, "havy"), put("sigma_mm", 5, "0"), put("y_mm", 6, "x")),
                ["5: column 'x_mm' is empty", "8: column 'y_mm': expected a number", "6: unknown payload", "7: sigma"]),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), CELLS.values(), ids=CELLS)
def test_a_wrong_row_is_told_by_its_line(small, change, expected):
    """Fails if a row is dropped or filled in silence, or told with the wrong line, or only the first one is told."""
    small.measure(change(small.rows))
    told = small.refused("check")
    assert len(told) == len(expected), told
    for problem, start in zip(told, expected, strict=True):
        assert problem.startswith(f"measurements.csv:{start}") or problem.startswith(
            f"measurements.csv:{start}".replace(": ", ":", 1)
        )


def as_radians(rows):
    return rows.rename(columns=dict(zip(Q, ["q1_rad", "q2_rad", "q3_rad"], strict=True)))


def as_metres(rows):
    return rows.rename(columns=dict(zip(X, ["x_m", "y_m", "z_m"], strict=True)))


UNITS = {
    "degrees in _rad": (as_radians, "does a column named _rad hold degrees? The largest reading is"),
    "few degrees in _rad": (
        lambda rows: as_radians(rows[rows[Q].astype(float).abs().max(axis=1) < 60]),
        "_rad hold degrees?",
    ),
    "radians in _deg": (scaled(Q, np.pi / 180), "does a column named _deg hold radians?"),
    "metres in _mm": (scaled(X, 1e-3), "does a column named _mm hold metres?"),
    "millimetres in _m": (as_metres, "does a column named _m hold millimetres?"),
    "both": (
        both(as_metres, scaled(Q, np.pi / 180)),
        "_deg hold radians? x, y, z: does a column named _m hold millimetres?",
    ),
}


@pytest.mark.parametrize(("change", "expected"), UNITS.values(), ids=UNITS)
@pytest.mark.parametrize("sigma", [True, False])
def test_a_wrong_unit_is_found(small, change, expected, sigma):
    """Fails if a robot is fitted to degrees called radians or millimetres called metres, or the wrong one is blamed."""
    rows = change(small.rows)
    small.measure(rows if sigma else rows.drop(columns="sigma_mm"))
    (told,) = small.refused("check")
    assert expected in told


def test_poor_but_right_units_pass(small):
    """Fails if a robot that is far from its file, or one bad point, is taken for a wrong unit."""
    small.edit("robot.toml", ("[payloads.light]", "[base]\nknown = false\n\n[payloads.light]"))
    rows = small.rows
    rows[X] = rows[X].astype(float) * 1.2 + [500.0, 0.0, -300.0]
    rows.loc[0, X] = [1e6, 0.0, 0.0]
    small.measure(rows)
    assert small.calflow("check").code == 0


def test_several_markers_need_their_column(small):
    """Fails if rows of an unknown marker are taken for the first one's."""
    small.edit("robot.toml", ("[markers.tool]", "[markers.other]\npoint_mm = [0, 0, 0]\n[markers.tool]"))
    assert small.calflow("check").code == 0
    small.measure(small.rows.drop(columns="marker"))
    (told,) = small.refused("check")
    assert told == "measurements.csv:1: missing column: expected marker"


TURNED = ('convention = "modified-dh"', 'convention = "modified-dh"\ntool_rotation_deg = [0, 0, 90]')
ANGLES, PARTS = dict.fromkeys(["rx_deg", "ry_deg", "rz_deg"], "0"), {"qw": "1", "qx": "0", "qy": "0", "qz": "0"}
SURE = {"sigma_rotation_mrad": "0.1"}
TURNS = {
    "no tool": (
        ANGLES | SURE,
        False,
        ["has measured orientations, but the robot file does not say how the tool is turned"],
    ),
    "not how sure": (ANGLES, True, ["has measured orientations, but not how sure they are"]),
    "sure of nothing": (ANGLES | {"sigma_rotation_mrad": "0"}, True, ["sigma_rotation: expected a positive"] * 6),
    "two angles": (SURE | {"rx_deg": "0", "ry_deg": "0"}, True, ["missing column: expected rz_rad or rz_deg"]),
    "three parts": (SURE | {"qw": "1", "qx": "0", "qy": "0"}, True, ["missing column: expected qz"]),
    "both": (ANGLES | PARTS | SURE, True, ["has orientations twice"]),
    "no length": (PARTS | SURE | {"qw": "0"}, True, ["qw, qx, qy, qz: expected a quaternion of norm 1"] * 6),
    "in words": (PARTS | SURE | {"qw": "w"}, True, ["column 'qw': expected a number, found 'w' (and 79 more rows)"]),
}


@pytest.mark.parametrize(("columns", "turned", "expected"), TURNS.values(), ids=TURNS)
def test_a_wrong_orientation_is_refused(small, columns, turned, expected):
    """Fails if an orientation that means nothing reaches the fit."""
    small.edit("robot.toml", *([TURNED] if turned else []))
    small.measure(small.rows.assign(**columns))
    told = small.refused("check")
    assert len(told) == len(expected), told
    for problem, part in zip(told, expected, strict=True):
        assert part in problem


FILES = {
    "empty": (b"", "is empty: expected a header line and a row per measured point"),
    "empty lines": (b"\n\n\n", "is empty"),
    "header only": (b"pose,q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n", "is empty"),
    "header and commas": (b"pose,q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n,,,,,,\n", "is empty"),
    "binary": (bytes(range(256)) * 99, "is not a text file: expected a CSV, found the control character"),
    "utf-16": ("pose,q1_deg\n1,2\n".encode("utf-16"), "is not a text file in UTF-8 but in UTF-16: save it as"),
    "utf-16 without a mark": ("pose,q1_deg\n1,2\n".encode("utf-16-le"), "in UTF-16: save it as"),
    "xlsx": (b"PK\x03\x04" + bytes(99), "is an Excel file (or another archive), not a CSV: save it as \"CSV UTF-8"),
    "xls": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(99), "is an Excel file"),
    "latin-1": ("pose,Meßpunkt\n1,2\n".encode("latin-1"), "1: is not in UTF-8: byte 0xdf would be 'ß' in Latin-1; save"),
    "a zero far down": (b"pose,q1_deg\n" + b"1,2\n" * 9999 + b"1,2\x003\n", "10001: is not a text file: expected a CSV, found the"),
    "a shorter row": (b"pose,q1_deg,payload\n1,2,heavy\n1,2\n", "3: has fewer values than the 3 names of the header line"),
    "a quote left open": (b'pose,q1_deg,session\n1,2,"A\n2,3,A\n3,4,A"\n4,5,A\n',
                          '2: a quote " is opened here, and not closed in this line'),
    "a quote left open to the end": (b'pose,q1_deg,session\n1,2,A\n2,3,"A\n3,4,A\n', '3: a quote " is opened here, and not closed'),
    "text after a quote": (b'pose,q1_deg,session\n1,2,"A"x\n', '2: a quote " is closed here, and text follows it'),
    "longer rows": (b"pose,q1_deg\n1,2,3\n1,2\n", "2: has more values than the 2 names of the header line"),
    "one longer row": (b"pose,q1_deg\n1,2\n1,2,3\n", "3: has more values than the 2 names of the header line"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), FILES.values(), ids=FILES)
def test_a_file_that_is_no_table_is_refused(small, content, expected):
    """Fails if such a file ends in a traceback, or its cells are shifted by one column in silence."""
    (small / "measurements.csv").write_bytes(content)
    (told,) = small.refused("check")
    assert expected in told


@pytest.mark.parametrize("content", [b"", b"garbage", b"\0" * 999, b"MATLAB 7.3 MAT-file" + b"\0" * 200])
def test_a_broken_matlab_file_is_refused(small, content):
    """Fails if one of scipy's many errors comes through."""
    (small / "m.mat").write_bytes(content)
    small.edit("study.toml", ("measurements.csv", "m.mat"))
    (told,) = small.refused("check")
    assert told.startswith("m.mat: cannot be read: ")


SOURCES = {
    "no such file": (("measurements.csv", "other.csv"), "other.csv: no such measurement file"),
    "misspelt file": (("measurements.csv", "measurments.csv"), "did you mean 'measurements.csv'?"),
    "a folder": (("measurements.csv", "."), "cannot be read: not a regular file but a folder"),
    "no hash": (("[split]", 'sha256 = ""\n[split]'), "study.toml:10: measurements.sha256: expected 64 digits"),
    "another hash": (("[split]", f'sha256 = "{"a" * 64}"\n[split]'), "measurements.csv: wrong SHA-256: the study names aaa"),
    "sigma twice": (("[split]", "sigma_mm = 1\n[split]"), "measurements.csv:1: column 'sigma_mm': the study's"),
    "mapping of nothing": (("[split]", '[measurements.columns]\nq1_deg = "q1_dg"\n[split]'),
                           "measurements.csv:1: no column 'q1_dg', which the study's mapping names, did you mean 'q1_deg'?"),
}  # fmt: skip


@pytest.mark.parametrize("command", ["check", "plan", "run"])
@pytest.mark.parametrize(("change", "expected"), SOURCES.values(), ids=SOURCES)
def test_a_source_that_does_not_fit_is_refused(small, command, change, expected):
    """Fails if another file than the study's is read, or a fault of the input counts as one of the machine."""
    small.edit("study.toml", change)
    answer = small.calflow(command)
    if command == "plan" and answer.code == 0:
        return  # the plan reads no rows
    (told,) = small.refused(command)
    assert expected in told
    assert not (small / "runs").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_a_forbidden_file_is_refused(small):
    """Fails if a missing permission ends in a traceback."""
    (small / "measurements.csv").chmod(0)
    (told,) = small.refused("check")
    assert "permission" in told.lower()


SIDE_BY_SIDE = """
[measurements.columns]
q1_deg = "q1_deg"
q2_deg = "q2_deg"
q3_deg = "q3_deg"
[measurements.markers.A]
x_mm = "A x"
y_mm = "A y"
z_mm = "A z"
[measurements.markers.B]
x_m = "B x"
y_m = "B y"
z_m = "B z"
[split]"""


@pytest.fixture
def side_by_side(small):
    """The study with two markers measured side by side, in millimetres and in metres."""
    small.edit("robot.toml", ("[markers.tool]\npoint_mm = [600, 50, 80]",
                              "[markers.A]\npoint_mm = [600, 50, 80]\n[markers.B]\npoint_mm = [600, 50, 80]"))  # fmt: skip
    small.edit("study.toml", ("[split]", SIDE_BY_SIDE))
    rows = small.rows
    small.measure(rows.assign(**{f"A {n}": rows[f"{n}_mm"] for n in "xyz"},
                              **{f"B {n}": rows[f"{n}_mm"].astype(float) / 1e3 for n in "xyz"}))  # fmt: skip
    return small


def test_a_marker_s_column_is_named_as_the_user_wrote_it(side_by_side):
    """Fails if another marker's column is blamed, calflow's name stands alone, or a line is told once a marker."""
    assert side_by_side.calflow("check").code == 0
    rows = side_by_side.rows
    side_by_side.measure(both(put("B y", 3, ""), put("A x", 4, "x"), put("q2_deg", 5, ""))(rows))
    assert [problem.split("; ")[0] for problem in side_by_side.refused("check")] == [
        "measurements.csv:7: column 'q2_deg' is empty or not a number",
        "measurements.csv:6: column 'A x' (x_mm): expected a number, found 'x'",
        "measurements.csv:5: column 'B y' (y_m) is empty or not a number",
    ]


def test_a_marker_lacks_a_column_of_its_own(side_by_side):
    """Fails if a coordinate that one marker's table leaves out is told as empty cells, or of the wrong marker."""
    side_by_side.edit("study.toml", ('z_m = "B z"\n', ""))
    (told,) = side_by_side.refused("check")
    assert told == (
        "measurements.csv:1: missing column: expected z_m or z_mm or z_um in the study's [measurements.markers.B]"
    )


def test_a_faulty_line_is_told_once(side_by_side):
    """Fails if a line with several markers is told once for each of them."""
    side_by_side.measure(side_by_side.rows.assign(payload="havy"))
    side_by_side.edit("study.toml", ('q1_deg = "q1_deg"', 'payload = "payload"\nq1_deg = "q1_deg"'))
    told = side_by_side.refused("check")
    assert [problem.split(": ")[0] for problem in told] == [f"measurements.csv:{i}" for i in range(2, 7)] + [
        "measurements.csv"
    ]
    assert told[-1].endswith("(and 75 more rows)")


def test_rows_without_a_measured_value_are_left_out_where_the_study_says_so(small):
    """Fails if such rows are dropped in silence, against the study's will, or others, with a missing reading or text, with them."""
    rows = small.rows
    rows.loc[[3, 8], ["x_mm", "y_mm", "z_mm", "sigma_mm"]] = ["", "NaN", "", ""]
    small.measure(put("y_mm", 5, "")(rows.copy()))
    assert [problem.split(":")[1] for problem in small.refused("check")] == ["7"]  # a part of a point is none
    small.measure(rows)
    answer = small.calflow("check")
    assert answer.code == 0
    assert "note: 2 of 80 rows have no measured value and are left out (line 5, 10)" in answer.out
    small.measure(put("y_mm", 5, "")(rows.copy()))
    small.edit("study.toml", ("[split]", 'missing = "refuse"\n[split]'))
    assert len(small.refused("check")) == 9
    small.edit("study.toml", ('missing = "refuse"', 'missing = "skip"'))
    answer = small.calflow("check")
    assert answer.code == 0
    assert 'note: missing = "skip": 3 of 80 rows have no measured value and are left out' in answer.out
    assert "77 rows" in answer.out
    small.measure(both(put("y_mm", 6, "lost"), put("q1_deg", 3, ""), put("sigma_mm", 7, ""))(rows.copy()))
    assert [problem.split(":")[1] for problem in small.refused("check")] == ["5", "8", "9"]
    small.measure(rows.assign(x_mm=""))
    assert small.refused("check") == [
        "measurements.csv: is empty: expected a header line and a row per measured point; no row has a measured value"
    ]


def test_the_joints_still_went_where_nothing_was_measured(small):
    """Fails if the approach of the row after one that was left out is worked out as if the robot had not been there."""
    small.edit("study.toml", ("[split]", 'in_order = true\nmissing = "skip"\n[split]'))
    whole = load_study(small.path).measurements().table
    rows = small.rows
    rows.loc[[10, 11], "x_mm"] = ""
    small.measure(rows)
    left = load_study(small.path).measurements().table
    columns = [name for name in whole if name.startswith(("approach", "travel"))]
    pd.testing.assert_frame_equal(left[columns], whole[columns].drop(index=[10, 11]).reset_index(drop=True))


@pytest.mark.parametrize("kind", ["pipe", "folder", "device"])
def test_what_is_no_regular_file_is_never_opened(small, kind):
    """Fails if a pipe or a device keeps a command waiting, or a folder ends in an error of the machine."""
    odd = {"pipe": small / "odd", "folder": small.path, "device": Path("/dev/zero")}[kind]
    if kind == "pipe":
        os.mkfifo(odd)
    for name, old, suffix in (("study.toml", '"robot.toml"', ""), ("study.toml", '"quick.toml"', ".toml"),
                              ("study.toml", '"measurements.csv"', "")):  # fmt: skip
        before = (small / name).read_text(encoding="utf-8")
        link = small / f"link{suffix}"
        link.symlink_to(odd)
        small.edit(name, (old, f'"{link.name}"'))
        (told,) = small.refused("check")
        assert f"not a regular file but a {kind}" in told, old
        (small / name).write_text(before, encoding="utf-8")
        link.unlink()
    if kind != "folder":
        with pytest.raises(InputError, match=f"not a regular file but a {kind}"):
            load_study(odd)
    assert "not a regular file" in small.refused("simulate", odd)[0]


def test_everything_that_check_finds_is_told_together(small):
    """Fails if wrong settings hide wrong measurements."""
    small.edit("study.toml", ("poses = 8", "poses = 1"))
    small.measure(put("x_mm", 0, "")(small.rows))
    assert [problem.split(":")[0] for problem in small.refused("check")] == ["study.toml", "measurements.csv"]


def test_a_study_without_measurements_says_how_to_go_on(small):
    """Fails if pose selection needs measurements, or identification goes without."""
    small.edit("study.toml", ('[measurements]\nfile = "measurements.csv"\n', ""))
    assert "--stage select" in small.calflow("check").out
    (told,) = small.refused("run")
    assert told.startswith("study.toml: has no measurements yet")
    assert small.calflow("run", "--stage", "select").code == 0


def test_fewer_equations_than_parameters_are_refused(small):
    """Fails if priors alone are sold as a calibration, or the user is not told how many poses are needed."""
    small.measure(small.rows[:12])
    (told,) = small.refused("run")
    assert told.startswith(
        "measurements.csv: 12 equations (4 training poses) for 17 parameters: measure at least 6 training poses"
    )
    assert not list((small / "runs" / "identify").glob("*"))


def test_a_run_refused_at_its_first_stage_leaves_no_run(small):
    """Fails if a folder looks like a run of a study of which nothing was made, or loses what else lies in it."""
    small.measure(small.rows[:12])
    (small / "runs" / "inputs").mkdir(parents=True)
    (small / "runs" / "inputs" / "mine.txt").write_text("kept", encoding="utf-8")
    small.refused("run", "--stage", "identify")
    left = {path.name for path in (small / "runs").rglob("*") if path.is_file()}
    assert left == {"mine.txt"}
    small.refused("run", "--stage", "identify", "--out", small / "new" / "run")
    assert not (small / "new").exists()


def test_a_stage_that_refuses_its_input_leaves_no_work_behind(finished):
    """Fails if a run that was refused looks as if it had been interrupted, and could be resumed."""
    finished.measure(finished.rows[:12])
    finished.refused("run", "--stage", "identify")
    assert (
        finished / "runs" / "identify" / "accuracy.csv"
    ).is_file()  # of the run before, which status says did not finish
    assert not (finished / "runs" / ".partial").exists()


def test_a_loop_that_cannot_be_closed_is_told_row_by_row(looped):
    """Fails if a pose where the four bars do not meet is fitted, or a good one is refused."""
    looped.edit("robot.toml", ("[loop.rod]\nlength_m = 1.6", "[loop.rod]\nlength_m = 1.2"))
    rows = pd.read_csv(looped / "measurements.csv")
    between = np.deg2rad(rows["q3_deg"] - rows["q2_deg"])
    distance = np.sqrt(1.6**2 + 0.8**2 - 2 * 1.6 * 0.8 * np.cos(between))  # what rod and rocker must span
    lines = 2 + np.flatnonzero((distance > 1.2 + 0.8) | (distance < 1.2 - 0.8))
    assert 5 < len(lines) < len(rows)
    told = looped.refused("check")
    assert [int(problem.split(":")[1]) for problem in told[:5]] == list(lines[:5])
    assert told[5].endswith(f"cannot be closed at these joint readings (and {len(lines) - 5} more rows)")


def test_a_study_states_no_step(small):
    """Fails if an effect without a known moment is fitted in silence, where it moves nothing."""
    small.edit("study.toml", ('"joint-compliance"]', '"joint-compliance", "joint-step"]'))
    (told,) = small.refused("check")
    assert told.startswith("study.toml:5: effects: effect 'joint-step' happens at a row that nobody knows yet")


@pytest.mark.parametrize("name", ["study.toml", "robot.toml", "quick.toml"])
@pytest.mark.parametrize("line", ["{} = 1\n", "x = {}\n"])
def test_tables_within_tables_without_end_are_refused(small, name, line):
    """Fails if a name of three thousand dots, or as many lists within each other, ends in a traceback."""
    deep = "[" * 3000 + "]" * 3000 if line.startswith("x") else ".".join("a" * 3000)
    text = (small / name).read_text(encoding="utf-8")
    (small / name).write_text(line.format(deep) + text, encoding="utf-8")
    (told,) = small.refused()
    assert "expected at most 20 tables and lists within each other" in told or "recursion" in told


def test_a_column_that_is_mapped_to_three_thousand_dots_is_refused(small):
    """Fails if a column's name may be a table within tables without end."""
    small.edit("study.toml", ("[split]", f"[measurements.columns]\n{'.'.join('a' * 3000)} = 'x_mm'\n\n[split]"))
    (told,) = small.refused()
    assert told.startswith("study.toml:11: measurements.columns.a.a.")


@pytest.mark.parametrize("sign", ["1.0", "-1.0", "true"])
def test_a_sign_is_a_whole_number(small, sign):
    """Fails if what is merely equal to 1 passes for it, and is another sign to whoever writes or hashes it."""
    small.edit("robot.toml", ("d_mm = 500", f"d_mm = 500\nsign = {sign}"))
    (told,) = small.refused()
    assert told == f"robot.toml:7: joints[1].sign: expected a whole number, found {sign}"


def test_of_many_unknown_names_few_are_compared(small, monkeypatch):
    """Fails if every name of a table of thousands is compared with every other, which takes minutes."""
    compared = []
    monkeypatch.setattr("difflib.get_close_matches", lambda word, known, **_: compared.append(len(list(known))) or [])
    many = [f"x{k}" for k in range(3000)]
    rows = small.rows.head(2)
    small.measure(pd.concat([rows, pd.DataFrame(1, rows.index, many)], axis=1))
    told = small.refused()
    assert "and 2980 more columns like these" in told[20]
    assert len(told) < 30
    small.edit(
        "study.toml", ("[split]", "[measurements.columns]\n" + "\n".join(f"{x} = 'y{x}'" for x in many) + "\n[split]")
    )
    told = small.refused()
    assert told[-1] == "measurements.csv:1: and 2980 more problems like this one"
    assert len(compared) <= 2 * 20 + 5
    assert max(compared) <= 1000
