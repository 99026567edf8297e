"""Measurements: what every accepted form of a file becomes."""

from __future__ import annotations

import hashlib

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from calflow.files.problems import InputError
from calflow.files.units import SUFFIXES
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import column_names
from calflow.measurements.source import MeasurementSource, data_folder, locate
from calflow.robot.robot import Robot

Q = ["q1_deg", "q2_deg", "q3_deg"]
X = ["x_mm", "y_mm", "z_mm"]


@pytest.fixture
def read(small):
    """Read the study's measurements after changes of the robot's file, by a mapping."""

    def reader(rows=None, robot=(), name="measurements.csv", **source):
        if rows is not None:
            small.measure(rows)
        small.edit("robot.toml", *robot)
        layout = MeasurementSource(file=name, **source).layout
        return Measurements.from_csv(small / name, Robot.from_toml(small / "robot.toml"), **vars(layout))

    return reader


def numbers(rows, columns):
    return rows[columns].astype(float).to_numpy()


def test_columns_become_si_to_the_last_bit(small, read):
    """Fails if a unit is missed, rows are reordered, or a number is rounded on the way."""
    data, rows = read(), small.rows
    np.testing.assert_array_equal(data.joints, numbers(rows, Q) * (np.pi / 180))
    np.testing.assert_array_equal(data.position, numbers(rows, X) * 1e-3)
    np.testing.assert_array_equal(data.sigma, rows["sigma_mm"].astype(float) * 1e-3)
    assert list(data.table["payload"]) == list(rows["payload"])
    assert list(data.table["line"]) == list(range(2, len(rows) + 2))
    assert data.given == ("order",)
    assert data.notes == ()


def as_excel(text):
    return text.replace(",", ";").replace(".", ",")


FORMS = {
    "bom": (lambda text: "\ufeff" + text, {}),
    "crlf": (lambda text: text.replace("\n", "\r\n"), {}),
    "no last newline": (str.rstrip, {}),
    "blanks about the values": (lambda text: text.replace("\n", " \n").replace(" \n", "\n", 1), {}),
    "quotes": (lambda text: text.replace("tool", '"tool"'), {}),
    "decimal comma": (as_excel, {"separator": ";", "decimal": ","}),
    "tabs": (lambda text: text.replace(",", "\t"), {"separator": "\t"}),
    "exponents": (lambda text: text.replace("\n1,1,", "\n1.0,1e0,").replace("1e0", "1"), {}),
}


@pytest.mark.parametrize(("form", "source"), FORMS.values(), ids=FORMS)
def test_the_form_of_a_csv_does_not_matter(small, read, form, source):
    """Fails if a file as Windows, Excel or another country writes it is refused or read otherwise."""
    plain = read()
    text = (small / "measurements.csv").read_text(encoding="utf-8")
    (small / "measurements.csv").write_bytes(form(text).encode())
    pd.testing.assert_frame_equal(read(**source).table, plain.table)


def test_empty_lines_are_left_out_and_counted(small, read):
    """Fails if an empty line becomes a row, or lines after it are told with the wrong number."""
    plain = read()
    head, first, rest = (small / "measurements.csv").read_text(encoding="utf-8").split("\n", 2)
    (small / "measurements.csv").write_text(f"{head}\n{first}\n\n,,,,,,,,,,\n{rest}\n\n", encoding="utf-8")
    data = read()
    assert list(data.table["line"]) == [2, *range(5, len(plain) + 4)]
    pd.testing.assert_frame_equal(data.table.drop(columns="line"), plain.table.drop(columns="line"))


def test_other_units_are_converted(small, read):
    """Fails if an offset is forgotten, a time stays in minutes, or radians and metres are not understood."""
    rows = small.rows
    q, x = numbers(rows, Q), numbers(rows, X)
    rows[["q1_rad", "q2_mrad", "q3_urad"]] = np.deg2rad(q) * [1, 1e3, 1e6]
    rows[["x_m", "y_um", "z_mm"]] = x * [1e-3, 1e3, 1]
    tau = {f"tau{i}_kNm": i for i in (1, 2, 3)}
    force = {"fx_N": 1, "fy_kN": 2, "fz_N": 3, "mx_Nm": 4, "my_kNm": 5, "mz_Nm": 6}
    rows = rows.drop(columns=[*Q, "x_mm", "y_mm"]).assign(temperature_degC=20, time_min=1.5, **tau, **force)
    data = read(rows)
    np.testing.assert_allclose(data.joints, np.deg2rad(q), rtol=1e-12)
    np.testing.assert_allclose(data.position, x / 1e3, rtol=1e-12)
    assert data.given == ("wrench", "torque", "time", "temperature", "order")
    np.testing.assert_allclose(data.conditions[-12:, 0], [1, 2000, 3, 4, 5000, 6, 1000, 2000, 3000, 0, 293.15, 1])


def test_a_slide_is_read_in_millimetres(small, read):
    """Fails if a prismatic joint's reading is taken for an angle."""
    slide = ("a_mm = 700\nalpha_deg = 5\nlimits_deg = [-20, 140]", 'kind = "prismatic"\nlimits_mm = [0, 500]')
    rows = small.rows.rename(columns={"q3_deg": "q3_mm"})
    data = read(rows, robot=[slide])
    np.testing.assert_allclose(data.joints[:, 2], rows["q3_mm"].astype(float) / 1e3)


def test_orientations_come_as_angles_or_quaternions(small, read):
    """Fails if the order of angles or of a quaternion's parts is another, or a sign decides."""
    rows = small.rows
    turns = Rotation.random(len(rows), rng=np.random.default_rng(1))
    angles = dict(zip(("rx_deg", "ry_deg", "rz_deg"), turns.as_euler("XYZ", degrees=True).T, strict=True))
    parts = dict(zip(("qx", "qy", "qz", "qw"), -turns.as_quat().T, strict=True))
    tool = [('convention = "modified-dh"', 'convention = "modified-dh"\ntool_rotation_deg = [0, 0, 90]')]
    by_angles = read(rows.assign(sigma_rotation_mrad=0.1, **angles), robot=tool)
    by_parts = read(rows.assign(**parts), sigma_rotation_mrad=0.1)
    for data in (by_angles, by_parts):
        np.testing.assert_allclose(data.rotation, turns.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(data.table["sigma_rotation"], 1e-4)


@pytest.mark.parametrize("name", ["None", "NA", "null", "5", "007", "1e3"])
def test_names_stay_names(small, read, name):
    """Fails if a payload called `None` counts as none, or one called `5` becomes 5.0 beside empty cells."""
    rows = small.rows.assign(payload=[name, ""] * 40, repeat=range(80))
    data = read(rows, robot=[("[payloads.heavy]", f'[payloads."{name}"]')])
    assert list(data.table["payload"]) == [name, ""] * 40
    assert data.conditions[3:5].sum(axis=1).tolist() == [0, 40]


def test_what_may_be_left_out_is_filled_in_and_said(small, read):
    """Fails if poses are not told apart by their readings and payloads, or an assumption is made in silence."""
    data = read(small.rows.drop(columns=["pose", "repeat", "marker", "payload"]))
    assert list(data.table["pose"]) == list(np.repeat(np.arange(1, 41), 2))
    assert list(data.table["repeat"]) == [1, 2] * 40
    assert set(data.table["marker"]) == {"tool"}
    assert set(data.table["payload"]) == {""}
    assert len(data.notes) == 2
    assert "no column 'payload'" in data.notes[0]
    assert "count as one pose (40)" in data.notes[1]


def test_poses_may_have_names(small, read):
    """Fails if a pose's name must be a number, or 1.0 and 1 are two poses."""
    rows = small.rows
    assert list(read(rows.assign(pose="P" + rows["pose"])).table["pose"])[:3] == ["P1", "P1", "P2"]
    assert list(read(rows.assign(pose=rows["pose"] + ".0")).table["pose"])[:3] == [1, 1, 2]


def test_a_sigma_for_all_stands_in_the_study(small, read):
    """Fails if the study's sigma is dropped."""
    np.testing.assert_allclose(read(small.rows.drop(columns="sigma_mm"), sigma_um=30).sigma, np.full(80, 3e-5))


MARKERS = ("[markers.tool]\npoint_mm = [600, 50, 80]",
           "[markers.A]\npoint_mm = [600, 50, 80]\n[markers.B]\npoint_mm = [500, 50, 80]")  # fmt: skip


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".MAT"])
def test_markers_side_by_side_become_rows(small, read, suffix):
    """Fails if a marker's columns go to another, rows lose their place, or MATLAB's arrays are read transposed."""
    rows = small.rows
    q, a = np.deg2rad(numbers(rows, Q)), numbers(rows, X) / 1e3
    b = a - [0.1, 0.0, 0.0]
    name = f"foreign{suffix}"
    if suffix == ".csv":
        columns = {
            f"{name}_{j + 1}": v[:, j] for name, v in (("q", q), ("A", a), ("B", b), ("other", b)) for j in range(3)
        }
        pd.DataFrame(columns).to_csv(small / name, index=False)
    else:
        savemat(small / name, {"q": q, "A": a, "B": b, "n": 40, "words": "text"}, appendmat=False)
    mapping = {f"q{i}_rad": f"q_{i}" for i in (1, 2, 3)}
    markers = {marker: {f"{axis}_m": f"{marker}_{i + 1}" for i, axis in enumerate("xyz")} for marker in "AB"}
    data = read(robot=[MARKERS], name=name, columns=mapping, markers=markers)
    assert list(data.table["marker"]) == ["A", "B"] * len(rows)
    np.testing.assert_allclose(data.position[::2], a, rtol=1e-12)
    np.testing.assert_allclose(data.position[1::2], b, rtol=1e-12)
    np.testing.assert_allclose(data.joints[::2], q, rtol=1e-12)
    assert list(data.table["line"][::2]) == [i + (2 if suffix == ".csv" else 1) for i in range(len(rows))]


def test_a_mapping_reads_only_what_it_names(small, read):
    """Fails if a foreign column slips in, or the renamed ones are not converted."""
    rows = small.rows.rename(columns={"q1_deg": "axis 1", "x_mm": "line"})
    mapping = {name: name for name in (*Q, *X)} | {"q1_deg": "axis 1", "x_mm": "line"}
    data = read(rows, columns=mapping)
    np.testing.assert_array_equal(data.position[:, 0], rows["line"].astype(float) * 1e-3)
    assert list(data.table["line"])[:2] == [2, 3]
    assert data.sigma is None


def sha(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_file_is_looked_for_in_order(small, tmp_path, monkeypatch):
    """Fails if CALFLOW_DATA is not first, is needed, or the study's own file is not found."""
    source = MeasurementSource(file="measurements.csv")
    assert locate(source, small.path, data_folder()) == small / "measurements.csv"
    monkeypatch.setenv("CALFLOW_DATA", str(tmp_path))
    assert locate(source, small.path, data_folder()) == small / "measurements.csv"
    (tmp_path / "measurements.csv").write_text("other", encoding="utf-8")
    assert locate(source, small.path, data_folder()) == tmp_path / "measurements.csv"
    with pytest.raises(InputError, match="wrong SHA-256: the study names"):
        locate(
            MeasurementSource(file="measurements.csv", sha256=sha(small / "measurements.csv")),
            small.path,
            data_folder(),
        )


def test_the_known_columns_are_those_that_are_read(small, read):
    """Fails if the list of columns has a name that is refused."""
    rows = small.rows
    extra = [
        f"{name}_{SUFFIXES[dimension][0]}" if dimension else name
        for name, dimension in column_names(Robot.from_toml(small / "robot.toml")).items()
        if name.startswith(("time", "temp", "tau", "appr"))
    ]
    assert len(extra) == 8
    given = dict.fromkeys(extra, 1) | {"temperature_K": 293}
    assert read(rows.assign(**given)).given == ("approach", "torque", "time", "temperature", "order")


def test_rows_without_payload_or_session_are_split_as_one_block(small):
    """Fails if a table of a program's own making is not split where nothing but the pose says what belongs together."""
    table = pd.DataFrame({"pose": np.repeat([f"p{i}" for i in range(10)], 2)})
    split = Measurements(Robot.from_toml(small / "robot.toml"), table).split(holdout=0.3).table
    assert (split.groupby("pose")["split"].nunique() == 1).all()
    assert (split["split"] == "holdout").sum() == 6
