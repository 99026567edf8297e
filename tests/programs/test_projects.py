"""Projects: programs whose tools, frames and targets stand in each other's files land where they say, by another interpreter."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calflow.deployment.conventions import pose_matrix, pose_values
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.programs import filtering
from calflow.programs.calibrated_robot import CalibratedRobot
from calflow.programs.filtering import FilterSettings
from calflow.programs.formats import read_project
from calflow.programs.target import RapidConfiguration
from estimation.data import calibration
from programs import interpreter
from programs.interpreter import ERRORS, Visit, difference, flange
from robots import ASKEW, industrial

RIGHT_MM = 5e-3  # what the digits that are written, and the turn of a tool by theirs, leave
TOOLS = {
    "tool0": np.eye(4),
    "gun": pose_matrix([0.0974, 0.0, 0.2231, 0.924, 0.0, 0.383, 0.0], "quaternion"),
    "torch": pose_matrix([-0.02, 0.11, 0.31, 1.0, 0.0, 0.0, 0.0], "quaternion"),
}
FRAMES = {
    "wobj0": np.eye(4),
    "fixture": pose_matrix([0.3, 0.8, 0.23, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], "quaternion"),
}
WAYS = np.random.default_rng(11).uniform(-1.0, 1.0, (40, 6)) * (1.2, 0.6, 0.6, 1.2, 0.5, 1.5) + (0, 0, 0, 0, 0.9, 0)


def corrector(errors) -> CalibratedRobot:
    """A calibrated arm whose errors are known."""
    robot = replace(industrial(), base=ASKEW)
    model = build(robot, ("geometry",), ())
    p = model.nominal.copy()
    for k, parameter in enumerate(model.parameters):
        p[k] += dict(errors).get(parameter.name, 0.0)

    def rows(q):
        return Measurements.from_arrays(robot, q, None, pose=np.arange(len(q)), payload="load")

    return CalibratedRobot(calibration(model, p, 1e-16 * np.eye(len(p)), sigma=1e-5), rows)


@pytest.fixture(scope="module")
def true_arm():
    return corrector(ERRORS)


@pytest.fixture(scope="module")
def nominal_arm():
    return corrector({})


def test_the_interpreters_arm_is_the_calibrated_one(true_arm):
    """Fails if arm and errors are not the same in both, so that what lands in one need not land in the other."""
    from programs.test_calibrated_robot import truly

    landed = truly(true_arm, WAYS[:5])
    for q, pose in zip(WAYS[:5], landed, strict=True):
        assert np.abs(difference(pose, flange(q, ERRORS))).max() < 1e-9


def filled(files: dict[str, str], state, arm: CalibratedRobot) -> dict[str, bytes]:
    """Files with the numbers of targets in the place of `<7|gun|fixture>`: readings by their number, tool and frame."""

    def of(found):
        number, tool, frame = found.groups()
        return state(WAYS[int(number)], TOOLS[tool or "tool0"], FRAMES[frame or "wobj0"], arm)

    return {file: re.sub(r"<(\d+)(?:\|(\w+)\|(\w+))?>", of, text).encode("latin-1") for file, text in files.items()}


def corrected(files: dict[str, bytes], arm: CalibratedRobot, **choices):
    """A project, corrected."""
    programs, unread = read_project(files, Path())
    done = filtering.filtered(programs, arm, FilterSettings(choices.get("tools", {}), choices.get("frames", {})))
    return {**files, **done.files}, done, unread


def check_landing(interpret, before, after, rows) -> tuple[int, int, int]:
    """Check that no move is wrong: it lands, or within what is said of it, or goes where it went; how many of each."""
    texts = ({file: one.decode("latin-1") for file, one in files.items()} for files in (before, after))
    old, new = (interpret(one) for one in texts)
    assert [(v.file, v.line, re.sub(r"[-\d.]+", "", v.name)) for v in old] == [
        (v.file, v.line, re.sub(r"[-\d.]+", "", v.name)) for v in new
    ]
    said = {(row.file, row.line): row for row in rows if row.outcome == "follows"}
    right = following = same = 0
    for was, now in zip(old, new, strict=True):
        miss = missed_mm(was, now)
        unmoved = missed_mm(was, was)
        follows = said.get((was.file, was.line))
        if follows is not None:
            following += 1
            assert miss < follows.remaining_mm + RIGHT_MM, (was, miss, follows)
            assert follows.remaining_mm < miss + RIGHT_MM, (was, miss, follows)
        elif miss < RIGHT_MM:
            assert unmoved > 10 * RIGHT_MM, "the robot lands without a correction: nothing is shown"
            right += 1
        else:
            assert miss == pytest.approx(unmoved, abs=1e-9), (was.file, was.line, was.name, miss, unmoved)
            same += 1
    return right, following, same


def missed_mm(was: Visit, now: Visit) -> float:
    """How far from where a move says the robot lands, sent as another says."""
    if was.joints is not None:
        aim, sent = flange(was.joints), now.joints
    else:
        aim = was.flange
        near = min(WAYS, key=lambda q: float(np.abs(difference(flange(q), now.flange)).sum()))
        sent = interpreter.readings(now.flange, near)
    return 1e3 * float(np.linalg.norm((flange(sent, ERRORS) @ was.tool)[:3, 3] - (aim @ was.tool)[:3, 3]))


def as_rapid(q, tool, frame, arm) -> str:
    """Readings as a robtarget."""
    values = pose_values(np.linalg.inv(frame) @ flange(q) @ tool, "quaternion", np.array([0, 0, 0, 1.0, 0, 0, 0]))
    flags = ",".join(RapidConfiguration(()).of(arm.postures(q[None])[0]))
    place, turn = (",".join(f"{v:.{n}f}" for v in part) for part, n in ((1e3 * values[:3], 3), (values[3:], 9)))
    return f"[[{place}],[{turn}],[{flags}],[9E9,9E9,9E9,9E9,9E9,9E9]]"


RAPID = {
    "RAPID/TASK1/SYSMOD/user.sys": """MODULE user(SYSMODULE)
  ! tools of the cell
  PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  TASK PERS tooldata torch:=[TRUE,[[-20,110,310],[1,0,0,0]],[2,[0,0,50],[1,0,0,0],0,0,0]];
  PERS wobjdata fixture:=[FALSE,TRUE,"",[[300,600,200],[1,0,0,0]],[[0,200,30],[0.7071068,0,0,0.7071068]]];
  CONST num above:=40;
  RECORD station
    robtarget place;
    num part;
  ENDRECORD
ENDMODULE
""",
    "RAPID/TASK1/PROGMOD/points.mod": """MODULE Points
  CONST robtarget pHome:=<0|gun|wobj0>;
  CONST robtarget pWeld{3}:=[<1|gun|fixture>,
    <2|gun|fixture>,<3|gun|fixture>];
  PERS station st1:=[<4|torch|fixture>,7];
  CONST jointtarget jPark:=[[10,-20.5,30,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  LOCAL CONST robtarget p10:=<5|gun|wobj0>;
  PROC park()
    MoveAbsJ jPark\\NoEOffs,v1000,z50,tool0;
    MoveL p10,v200,fine,gun;
  ENDPROC
ENDMODULE
""",
    "RAPID/TASK1/PROGMOD/weld.mod": """MODULE Weld
  LOCAL CONST robtarget p10:=<6|torch|fixture>;
  CONST robtarget pOver:=Offs(p10,0,0,above);
  PROC main()
    MoveJ pHome,v1000,z50,gun;
    MoveL PWELD{1},v200,fine,gun\\WObj:=fixture;
    MoveC pWeld{2},pWeld{3},v200,z10,gun\\WObj:=fixture;
    MoveL p10,v200,fine,torch\\WObj:=fixture;
    MoveL Offs(p10,0,0,above+10),v200,fine,torch\\WObj:=fixture;
    MoveL pOver,v200,fine,torch\\WObj:=fixture;
    MoveL RelTool(p10,0,0,-above\\Rz:=10),v200,fine,torch\\WObj:=fixture;
    MoveL st1.place,v200,fine,torch\\WObj:=fixture;
    MoveL Offs(<7|gun|fixture>,10,-20,30),v200,fine,gun\\WObj:=fixture;
    ArcL pHome,v100,seam1,weld1,fine,gun;
  ENDPROC
ENDMODULE
""",
    "SYSPAR/EIO.cfg": "EIO:CFG_1.0:6:1::\n#\nEIO_SIGNAL:\n      -Name \"p10\"\n",
    "BACKINFO/backinfo.txt": "MODULE is a word here\n",
}  # fmt: skip


def test_rapid_modules_know_each_others_tools_frames_and_targets(true_arm):
    """Fails if a tool, work object, array, record or constant of another module is not found, or a move misses."""
    before = filled(RAPID, as_rapid, true_arm)
    after, done, unread = corrected(before, true_arm)
    assert not unread
    assert not [row for row in done.rows if row.outcome not in ("moved", "follows")]
    assert check_landing(interpreter.rapid, before, after, done.rows) == (10, 3, 0)
    assert {file for file in before if before[file] != after[file]} == {
        "RAPID/TASK1/PROGMOD/points.mod", "RAPID/TASK1/PROGMOD/weld.mod"
    }  # fmt: skip


def test_a_model_that_changes_nothing_gives_a_project_back_to_the_last_byte(nominal_arm):
    """Fails if the way through names, tools and joint readings changes a digit."""
    before = filled(RAPID, as_rapid, nominal_arm)
    after, done, _ = corrected(before, nominal_arm)
    assert after == before
    assert {row.outcome for row in done.rows} == {"unchanged", "follows"}
    assert not done.uncorrected
