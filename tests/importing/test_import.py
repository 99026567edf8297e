"""What people have comes in without a file being edited, or is refused in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.importing.standstill import find_standstills
from calflow.model import build
from calflow.templates import library_file
from conftest import in_process
from importing.exports import EXPORTS, Campaign, campaign, lines, of_another_robot, recorded

POINT = (30.0, -45.0, 80.0)  # mm: the reflector in the flange's frame


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the robot file of a UR10e and its reflector."""
    text = library_file("ur10e")
    robot = cf.Robot.from_toml(_written(tmp_path / "library.toml", text))
    placed = {"reflector": cf.Marker(tuple(v / 1e3 for v in POINT))}
    replace(robot, markers=placed, payloads={}).to_toml(tmp_path / "robot.toml")
    return tmp_path


def _written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def right(folder: Path, of: Campaign) -> None:
    """The measurements are what was measured, row by row: readings to what a recording's noise leaves, points likewise."""
    data = cf.Measurements.from_csv(folder / "measurements.csv", cf.Robot.from_toml(folder / "robot.toml"))
    assert data.table["pose"].nunique() == len(data) >= len(of.q) - 3
    nearest = np.argmin(np.abs(data.joints[:, None] - of.q[None]).max(axis=2), axis=1)
    assert len(set(nearest)) == len(data)
    np.testing.assert_allclose(data.joints, of.q[nearest], atol=5e-5)
    np.testing.assert_allclose(data.position, of.points[nearest], atol=2e-5)


@pytest.mark.parametrize("name", EXPORTS)
@pytest.mark.parametrize("seed", [1])
def test_a_messy_export_comes_in(folder, name, seed):
    """Fails if a column is read as another joint, in another unit or sign, or a row is lost or doubled, without being asked."""
    (folder / "theirs").mkdir()
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), seed)
    files = EXPORTS[name](folder / "theirs", of)
    answer = in_process("import", *files, "--into", folder)
    assert answer.code == 0, answer.err
    right(folder, of)
    checked = in_process("check", folder)
    assert checked.code == 0, checked


def test_a_fault_is_refused_in_words(folder):
    """Fails if points of other poses come in as measurements, or anything is written of what was refused."""
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 1)
    answer = in_process("import", *of_another_robot(folder, of), "--into", folder)
    assert answer.code == 2
    assert "mixed.csv: no order, unit or sign of its joints puts robot" in answer.err
    assert {path.name for path in folder.iterdir()} == {"library.toml", "robot.toml", "mixed.csv"}


def table(of: Campaign, names: str, *columns: np.ndarray) -> str:
    """A CSV of columns under names."""
    return names + "\n" + lines(np.column_stack(columns), ",")


def beside(of: Campaign) -> np.ndarray:
    """Points that are as near to the robot's as those measured, and are others."""
    return of.points + of.q[:, :3] / 9e3


REFUSED = {
    "no points": (lambda of: table(of, "J1,J2,J3,J4,J5,J6", np.rad2deg(of.q)),
                  "cannot tell x, y and z of a measured point among its columns 'J1'"),
    "no joints": (lambda of: table(of, "no,X,Y,Z", np.arange(40), of.points), "cannot tell 6 columns of joints among its columns"),
    "computed": (lambda of: table(of, "J1,J2,J3,J4,J5,J6,X,Y,Z", np.rad2deg(of.q), 1e3 * of.nominal),
                 "'X', 'Y', 'Z' are where the nominal robot is"),
    "planned": (lambda of: table(of, "J1,J2,J3,J4,J5,J6,goal x,goal y,goal z", np.rad2deg(of.q), np.round(1e3 * of.nominal, 1)),
                "have the names of planned positions"),
    "two that fit": (lambda of: table(of, "J1,J2,J3,J4,J5,J6,x1,y1,z1,x2,y2,z2", np.rad2deg(of.q), of.points, beside(of)),
                     "their names do not say which was measured. Name the columns: --column x_mm=NAME"),
    "too few": (lambda of: table(of, "J1,J2,J3,J4,J5,J6,X,Y,Z", np.rad2deg(of.q), of.points).split("\n4", 1)[0][:700],
                "fewer than 6 different poses"),
    "a letter": (lambda of: "Dear all,\nplease find the figures attached.\n", "no table is found in it"),
    "nothing": (lambda of: "", "no table is found in it"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_told_is_asked_for(folder, content, expected):
    """Fails if something is guessed that the file does not tell, or the message does not say what is missing."""
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 2)
    (folder / "theirs.csv").write_text(content(of))
    answer = in_process("import", folder / "theirs.csv", "--into", folder)
    assert (answer.code, answer.out) == (2, "")
    assert expected in answer.err
    assert not (folder / "measurements.csv").exists()


@pytest.mark.parametrize(
    ("columns", "kind"), [("length_mm", "distance"), ("px_x_mm,px_y_mm,px_z_mm,u_px,v_px", "camera")]
)
def test_what_another_device_reports_is_left_to_the_study(folder, columns, kind):
    """Fails if lengths or image points are taken for those of a wrong robot, and nothing says how a study reads them."""
    rng = np.random.default_rng(4)
    rows = pd.DataFrame(rng.uniform(-90, 90, (20, 6)), columns=[f"q{k}_deg" for k in range(1, 7)])
    given = rows.assign(**{name: rng.uniform(100, 900, 20) for name in columns.split(",")})
    given.to_csv(folder / "theirs.csv", index=False)
    answer = in_process("import", folder / "theirs.csv", "--into", folder)
    assert (answer.code, len(answer.err.splitlines())) == (2, 1)
    assert f'kind = "{kind}"' in answer.err


@pytest.mark.parametrize("letters", [[f"Gelenk {letter}" for letter in "ABCDEF"], [*"SLURBT"]])
def test_lettered_joints_are_told_by_their_names(folder, letters):
    """Fails if joints that are lettered have to be stated one by one, or their letter is taken for a unit or a time."""
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 2)
    names = ",".join((*letters, "X", "Y", "Z"))
    (folder / "theirs.csv").write_text(table(of, names, np.rad2deg(of.q), 1e3 * of.points))
    answer = in_process("import", folder / "theirs.csv", "--into", folder)
    assert (answer.code, answer.out.count("its name")) == (0, 9), answer.err


def test_what_is_stated_is_not_guessed(folder):
    """Fails if a stated column, or its sign, gives way to what fits as well or better."""
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 3)
    names = "a1,a2,a3,a4,a5,a6,x1,y1,z1,x2,y2,z2"
    (folder / "theirs.csv").write_text(table(of, names, np.rad2deg(of.q), of.points, beside(of)))
    columns = [word for axis in "xyz" for word in ("--column", f"{axis}_mm={axis}1")]
    assert in_process("import", folder / "theirs.csv", "--into", folder, *columns).code == 0
    right(folder, of)
    wrong = [word for i in range(1, 7) for word in ("--column", f"q{i}_deg={'-' * (i == 2)}a{i}")]
    (folder / "measurements.csv").unlink()
    assert "puts robot" in in_process("import", folder / "theirs.csv", "--into", folder, *columns, *wrong).err


def test_nothing_is_written_over(folder):
    """Fails if measurements or a study that are there are changed, or a dry run writes."""
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 4)
    (folder / "theirs.csv").write_text(table(of, "J1,J2,J3,J4,J5,J6,X,Y,Z", np.rad2deg(of.q), of.points))
    assert in_process("import", folder / "theirs.csv", "--into", folder, "--dry-run").code == 0
    assert not (folder / "measurements.csv").exists()
    (folder / "study.toml").write_text("mine")
    answer = in_process("import", folder / "theirs.csv", "--into", folder)
    assert (folder / "study.toml").read_text() == "mine"
    assert "study.toml is as it was" in answer.out
    before = (folder / "measurements.csv").read_bytes()
    again = in_process("import", folder / "theirs.csv", "--into", folder)
    assert again.code == 2
    assert "measurements.csv: is there already" in again.err
    assert (folder / "measurements.csv").read_bytes() == before


def test_a_standstill_begins_when_all_joints_have_settled():
    """Fails if a slow last approach counts as standing still, or noise ends a standstill."""
    time = np.arange(0, 12, 0.02)
    way = np.clip((time - 3) / 2, 0, 1)
    creep = np.where((time > 5) & (time < 7), 0.01 * (7 - time), 0.0)
    noise = np.random.default_rng(1).normal(0, 1e-5, len(time))
    found = find_standstills(time, np.column_stack([way - creep, 0.5 * way]) + noise[:, None])
    assert len(found) == 2
    assert found[0].end == pytest.approx(3.0, abs=0.05)
    assert 6.8 < time[found[1].first] < 7.1


def test_a_sign_that_points_do_not_tell_is_said(folder):
    """Fails if a joint's sign is guessed in silence where the reflector is on its axis."""
    robot = cf.Robot.from_toml(folder / "robot.toml")
    replace(robot, markers={"reflector": cf.Marker((0, 0, 0.1))}).to_toml(folder / "robot.toml")
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 5)
    (folder / "theirs.csv").write_text(table(of, "J1,J2,J3,J4,J5,J6,X,Y,Z", np.rad2deg(of.q), of.points))
    answer = in_process("import", folder / "theirs.csv", "--into", folder)
    assert "note: the sign of q6 cannot be told: the points fit as well with it turned" in answer.err
    right(folder, of)


CONVENTIONS = {
    "fixed axes in degrees": ("rx [deg],ry [deg],rz [deg]", lambda turns: turns.as_euler("xyz", degrees=True)),
    "moving axes in rad": ("roll,pitch,yaw", lambda turns: turns.as_euler("XYZ")),
    "rotation vector": ("rx,ry,rz", lambda turns: turns.as_rotvec()),
    "quaternion": ("orientation.x,orientation.y,orientation.z,orientation.w", lambda turns: turns.as_quat()),
}


@pytest.mark.parametrize(("names", "written"), CONVENTIONS.values(), ids=CONVENTIONS)
def test_orientations_come_in_whatever_their_convention(folder, names, written):
    """Fails if angles are taken in another convention, or the tool's turn that is proposed is another's, or minus nothing."""
    robot = cf.Robot.from_toml(folder / "robot.toml")
    of, tool = campaign(robot, 6), (0.1, -2e-4, 1.5)
    turned = replace(robot, tool_rotation=tool)
    model = build(turned, ())
    rows = np.zeros((model.n_conditions, len(of.q)))
    rows[:6], rows[-1] = of.q.T, 1.0
    turns = Rotation.from_euler("xyz", (1, 0.5, -2)) * Rotation.from_matrix(model.rotation(model.nominal, rows))
    heading = f"J1,J2,J3,J4,J5,J6,X,Y,Z,{names}"
    (folder / "theirs.csv").write_text(table(of, heading, np.rad2deg(of.q), of.points, written(turns)))
    said = in_process("import", folder / "theirs.csv", "--into", folder, "--dry-run").err
    assert "with tool_rotation_deg = [5.7, 0.0, 85.9] in the robot file and --sigma-rotation-mrad they come in" in said
    turned.to_toml(folder / "robot.toml")
    assert in_process("import", folder / "theirs.csv", "--into", folder, "--sigma-rotation-mrad", "0.1").code == 0
    data = cf.Measurements.from_csv(folder / "measurements.csv", turned)
    np.testing.assert_allclose(data.rotation, turns.as_matrix(), atol=1e-8)


def test_external_axes_are_counted_apart(folder):
    """Fails if a controller's E1 is taken for the arm's first joint, or a rail's metres for millimetres."""
    arm = cf.Robot.from_toml(folder / "robot.toml")
    rail = cf.Joint(cf.modified_dh(alpha=-np.pi / 2), kind="prismatic", limits=(0, 4.0), external=1, name="rail")
    robot = replace(arm, joints=(rail, *(replace(joint, mass=None) for joint in arm.joints)), gravity=(0, 9.80665, 0))
    robot.to_toml(folder / "robot.toml")
    of = campaign(robot, 7)
    for heading, rail_is in (("A1,A2,A3,A4,A5,A6,E1 [mm],X,Y,Z", 1e3), ("A1,A2,A3,A4,A5,A6,E1,X,Y,Z", 1.0)):
        text = table(of, heading, np.rad2deg(of.q[:, 1:]), rail_is * of.q[:, :1], 1e3 * of.points)
        (folder / "theirs.csv").write_text(text)
        assert in_process("import", folder / "theirs.csv", "--into", folder).code == 0
        right(folder, of)
        (folder / "measurements.csv").unlink()


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        (["x_mm=X9"], "--column x_mm: no column 'X9', did you mean 'X'?"),
        (["x_mm=X"], "expected all of x, y and z"),
        (["q1=A1"], "expected OURS=NAME, found 'q1=A1', did you mean 'q1_"),
        (["q1_deg"], "expected OURS=NAME"),
    ],
)
def test_a_wrong_option_is_refused(folder, column, expected):
    """Fails if a column that is not there is passed over, and the rest guessed."""
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 8)
    (folder / "theirs.csv").write_text(table(of, "A1,A2,A3,A4,A5,A6,X,Y,Z", np.rad2deg(of.q), of.points))
    options = [word for one in column for word in ("--column", one)]
    answer = in_process("import", folder / "theirs.csv", "--into", folder, *options)
    assert (answer.code, answer.out) == (2, "")
    assert expected in answer.err


def recording(of: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """A recording of a clock, joints, their speeds and efforts, and points, (m, 22); and which pose each sample is next to."""
    time, q, p = recorded(of, 12.0, 3, 1234.5)
    rng = np.random.default_rng(5)
    speeds = np.gradient(q, axis=0) * 12 + rng.normal(0, 1e-4, q.shape)
    efforts = 20 * np.sin(q) + 5 * np.cos(q[:, ::-1]) + rng.normal(0, 0.5, q.shape)
    nearest = np.argmin(np.abs(q[:, None] - of.q).max(axis=2), axis=1)
    return np.column_stack([time, q, speeds, efforts, p]), nearest


def test_a_recording_without_names_comes_in(folder):
    """Fails if speeds or efforts are taken for joints, or points, where no name says what a column holds."""
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 1, 14)
    np.savetxt(folder / "log.csv", recording(of)[0], delimiter=",", fmt="%.7f")
    answer = in_process("import", folder / "log.csv", "--into", folder)
    assert answer.code == 0
    assert "as far apart" not in answer.err
    right(folder, of)


def test_texts_of_a_recording_are_kept(folder):
    """Fails if the payload or the marker that a recording names is lost where its standstills become rows."""
    robot = cf.Robot.from_toml(folder / "robot.toml")
    load = {"gripper": cf.Payload(4.0, (0, 0, 0.1))}
    replace(robot, payloads=load, markers={**robot.markers, "other": cf.Marker((0, 0.2, 0))}).to_toml(
        folder / "robot.toml"
    )
    of = campaign(robot, 1, 14)
    figures, pose = recording(of)
    words = [("gripper" if k % 3 else "", "reflector") for k in pose]
    heading = ",".join(["time", *(f"J{i + 1}" for i in range(6)), "X", "Y", "Z", "load", "target"])
    rows = [[*row, *both] for row, both in zip(figures[:, [*range(7), 19, 20, 21]], words, strict=True)]
    (folder / "log.csv").write_text(heading + "\n" + lines(rows, ","))
    assert in_process("import", folder / "log.csv", "--into", folder).code == 0
    table = pd.read_csv(folder / "measurements.csv", keep_default_na=False)
    assert list(table["payload"]) == ["gripper" if k % 3 else "" for k in range(14)]
    assert set(table["marker"]) == {"reflector"}


def test_rows_without_a_partner_are_counted(folder):
    """Fails if points that no joints belong to, or joints without a point, are left out in silence, or counted as poses."""
    of = campaign(cf.Robot.from_toml(folder / "robot.toml"), 1)
    number = np.arange(len(of.q))[:, None]
    joints, points = np.hstack([number, np.degrees(of.q)])[:-2], np.hstack([number, 1e3 * of.points])[3:]
    (folder / "j.csv").write_text(table(of, "nr,J1,J2,J3,J4,J5,J6", joints))
    (folder / "p.csv").write_text(table(of, "nr,x,y,z", points))
    answer = in_process("import", folder / "j.csv", folder / "p.csv", "--into", folder)
    assert answer.code == 0, answer.err
    assert "; 3 rows of j.csv without a partner left out; 2 rows of p.csv without a partner left out" in answer.err
    figures = np.hstack([np.degrees(of.q), 1e3 * of.points])
    figures[4, 7] = np.nan
    (folder / "one.csv").write_text(table(of, "J1,J2,J3,J4,J5,J6,x,y,z", figures))
    answer = in_process("import", folder / "one.csv", "--into", folder, "--dry-run")
    assert f"one pose: {len(of.q) - 1}" in " ".join(answer.out.split()), answer
