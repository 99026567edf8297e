"""What no correction puts right is refused before any fit: poses past the limits, and data of another robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.faults import examined
from calflow.faults.implausible import nominal_misfit, past_limits
from calflow.faults.setup import Setup
from calflow.files.problems import InputError
from calflow.robot.parts import Coupling
from calflow.study import load_study
from conftest import in_process
from hidden.case import Case, write_case
from hidden.causes import Hidden


def case(folder, **more):
    """A case's measurements."""
    made = Case(poses=50, effects=("geometry",), workflow="paper-table", **more)
    write_case(folder, made, np.random.default_rng(6))
    return load_study(folder).measurements()


def with_joint(data, joint, **more):
    """The data of a robot whose joint (from 1) is stated otherwise."""
    joints = list(data.robot.joints)
    joints[joint - 1] = replace(joints[joint - 1], **more)
    return data.on(replace(data.robot, joints=tuple(joints)))


def test_a_pose_past_a_limit_is_an_error_of_the_file(tmp_path):
    """Fails if poses where the joint cannot be are fitted, or joint, line and limits are not said."""
    data = case(tmp_path)
    row = int(data.joints[:, 2].argmax())
    high = float(np.sort(data.joints[:, 2])[-2])
    wrong = with_joint(data, 3, limits=(-2.0, high))
    with pytest.raises(InputError) as told:
        examined(wrong)
    assert f"joint 3: in line {data.table['line'][row]} its angle is past the limits -114.592 to" in str(told.value)
    assert examined(with_joint(data, 3, limits=(-2.0, float(data.joints[:, 2].max()) - np.deg2rad(0.3))))[1] == ()


def test_limits_of_the_reading_are_told_as_such(tmp_path):
    """Fails if limits before `sign` or a coupling are not told from poses that cannot be."""
    data = case(tmp_path)
    turned = with_joint(data, 2, sign=-1)  # limits -60 to 75 are now meant of the angle, the readings are -75 to 60
    table = data.table.assign(q2=-data.table["q2"])
    assert list(past_limits(replace(turned, table=table))) == []
    as_read = with_joint(data, 2, sign=-1, limits=data.robot.joints[1].limits)
    ((_, said),) = past_limits(as_read)
    assert "seem to be given before `sign`" in said
    assert "here -75 to 60 deg" in said
    ((_, said),) = past_limits(
        with_joint(data, 2, limits=(-data.robot.joints[1].limits[1], -data.robot.joints[1].limits[0]))
    )
    assert "expected sign = -1" in said
    coupled = data.on(replace(data.robot, couplings=(Coupling(3, 2, 1.0),)))
    ((_, said),) = past_limits(coupled)
    assert "before its coupling" in said


def test_limits_past_which_a_turned_sign_leads_say_that_it_was_turned(tmp_path):
    """Fails if limits that are the readings' are complained of without a word of the sign that was turned before."""
    data = case(tmp_path)
    low, high = data.robot.joints[1].limits
    wrong = with_joint(data, 2, limits=(-high, -low))
    with pytest.raises(
        InputError, match=r"joint 2: all readings have the wrong sign.*corrected for this run only"
    ) as told:
        examined(replace(wrong, table=data.table.assign(q2=-data.table["q2"])))
    assert "its angle is past the limits -75 to 60 deg" in str(told.value)


def test_a_turn_that_is_put_right_is_no_error(tmp_path):
    """Fails if a reading that is back inside by a turn, or a column that counts the other way, is refused first."""
    data = case(tmp_path, hidden=(Hidden("encoder-turn", 5),))
    assert {one.cause for one in examined(data)[1]} == {"encoder-turn"}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("zero", "no fit can correct it: theta of joint 2 is mistyped; expected about theta_deg = -90"),
        ("rows", "measurements.csv: the nominal robot, with base and tool fitted, misses"),
    ],
)
def test_data_of_no_robot_are_refused_by_check_and_run(tmp_path, wrong, said):
    """Fails if a fit is made of readings and positions that no robot has, `check` calls them ok, or the one mistake is not said."""
    case(tmp_path)
    text = (tmp_path / "measurements.csv").read_text(encoding="utf-8")
    if wrong == "zero":
        robot = (tmp_path / "robot.toml").read_text(encoding="utf-8")
        (tmp_path / "robot.toml").write_text(robot.replace("theta_deg = -90", "theta_deg = -30"), encoding="utf-8")
    else:
        head, *rows = text.splitlines()
        text = "\n".join([head, *(_with_position(a, b) for a, b in zip(rows, rows[::-1], strict=True))])
    (tmp_path / "measurements.csv").write_text(text, encoding="utf-8")
    commands = [("check", tmp_path), ("run", tmp_path, "--out", tmp_path / "run")]
    for command in commands if wrong == "rows" else commands[:1]:
        answer = in_process(*command)
        assert answer.code == 2, answer
        assert said in answer.err


def test_a_worn_robot_with_an_unknown_tool_is_one(tmp_path):
    """Fails if base and tool that nobody stated count as a misfit."""
    data = case(tmp_path)
    base = replace(data.robot.base, known=False, origin=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0))
    markers = {name: replace(marker, point=(0.0, 0.0, 0.0)) for name, marker in data.robot.markers.items()}
    assert nominal_misfit(Setup.of(data.on(replace(data.robot, base=base, markers=markers)))) == ""


def test_a_base_that_stands_elsewhere_is_told_with_its_place(tmp_path):
    """Fails if a base that is stated wrongly is fitted against its bounds, or said to be a joint's sign."""
    origin, turn = (1.0, -0.4, 0.0), (0.0, 0.0, 90.0)
    data = case(tmp_path)
    base = data.robot.base
    assert base.known
    assert examined(data)[1] == ()
    wrong = replace(
        base, origin=tuple(np.add(base.origin, origin)), rotation=tuple(np.add(base.rotation, np.deg2rad(turn)))
    )
    with pytest.raises(InputError) as told:
        examined(data.on(replace(data.robot, base=wrong)))
    said = str(told.value)
    assert "the base is not where the robot file states it" in said
    stated = [float(value) for value in said.split("origin_mm = [")[1].split("]")[0].split(",")]
    assert stated == pytest.approx([1e3 * value for value in base.origin], abs=60)
    assert examined(data.on(replace(data.robot, base=replace(wrong, known=False))))[1] == ()


def test_check_tells_what_a_run_would_correct(tmp_path):
    """Fails if faults are only told by the run."""
    case(tmp_path, hidden=(Hidden("encoder-turn", 5),))
    answer = in_process("check", tmp_path)
    assert answer.code == 0, answer
    assert "fault: encoder turn: joint 5: in line" in answer.out


def _with_position(row: str, other: str) -> str:
    """A line with another one's x, y and z (pose, six joints, then these)."""
    mine, its = row.split(","), other.split(",")
    return ",".join([*mine[:7], *its[7:10], *mine[10:]])
