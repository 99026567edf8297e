"""Projects: programs whose tools, frames and targets stand in each other's files land where they say, by another interpreter."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calflow.deployment.conventions import pose_matrix, pose_values
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.programs import correction
from calflow.programs.aims import FilterSettings
from calflow.programs.calibrated_robot import CalibratedRobot
from calflow.programs.correction import Filtered
from calflow.programs.formats import read_project
from calflow.programs.target import UNASKED, FanucConfiguration, RapidConfiguration
from estimation.data import calibration
from programs import interpreter
from programs.interpreter import ERRORS, Visit, difference, flange
from robots import ASKEW, industrial

RIGHT_MM = 5e-3  # what the digits that are written, and the turn of a tool by theirs, leave
TOOLS = {
    "tool0": np.eye(4),
    "gun": pose_matrix([0.0974, 0.0, 0.2231, 0.924, 0.0, 0.383, 0.0], "quaternion"),
    "torch": pose_matrix([-0.02, 0.11, 0.31, 1.0, 0.0, 0.0, 0.0], "quaternion"),
    "gripper": pose_matrix([0.0, 0.0, 0.18, np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)], "quaternion"),
}
FRAMES = {
    "wobj0": np.eye(4),
    "table": pose_matrix([0.9, -0.4, 0.35, 1.0, 0.0, 0.0, 0.0], "quaternion"),
    "fixture": pose_matrix([0.3, 0.8, 0.23, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], "quaternion"),
}
WAYS = np.random.default_rng(11).uniform(-1.0, 1.0, (40, 6)) * (1.2, 0.6, 0.6, 1.2, 0.5, 1.5) + (0, 0, 0, 0, 0.9, 0)
ANYWHERE = np.random.default_rng(12).uniform(-np.pi, np.pi, (300, 6))
FLANGES = np.stack([flange(q) for q in WAYS])


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
    """Files with the numbers of targets in the place of `<7|gun|fixture>`: readings by their number, tool and frame.

    In the place of `<7>` are readings themselves.
    """

    def of(found):
        number, tool, frame = found.groups()
        return state(WAYS[int(number)], TOOLS.get(tool), FRAMES.get(frame), arm)

    return {file: re.sub(r"<(\d+)(?:\|(\w+)\|(\w+))?>", of, text).encode("latin-1") for file, text in files.items()}


def corrected(files: dict[str, bytes], arm: CalibratedRobot, **choices):
    """A project, corrected."""
    programs, unread = read_project(files, Path())
    done = correction.filtered(programs, arm, FilterSettings(choices.get("tools", {}), choices.get("frames", {})))
    return {**files, **done.files}, done, unread


def corrected_beside(projects: list[dict[str, bytes]], arm: CalibratedRobot) -> Iterator[Filtered]:
    """Projects that have nothing to do with each other, corrected at once."""
    every = [{f"{k}/{file}": content for file, content in files.items()} for k, files in enumerate(projects)]
    read = [read_project(files, Path())[0] for files in every]
    done = correction.filtered([program for programs in read for program in programs], arm, FilterSettings({}, {}))
    for k, files in enumerate(every):
        after = {file.partition("/")[2]: done.files.get(file, content) for file, content in files.items()}
        rows = (row for row in done.rows if row.file.startswith(f"{k}/"))
        yield Filtered(after, tuple(replace(row, file=row.file.partition("/")[2]) for row in rows))


def check_landing(interpret, before, after, rows, shown=True, meant=True) -> tuple[int, int, int]:
    """Check that no move is wrong: it lands, or within what is said of it, or goes where it went; how many of each.

    shown: none lands without a correction. meant: the posture is that of readings near it; otherwise any that leads there is one.
    """
    texts = ({file: one.decode("latin-1") for file, one in files.items()} for files in (before, after))
    old, new = (interpret(one) for one in texts)
    declared = {row.file for row in rows if row.note.startswith("a second")}  # lines are moved on by these
    assert [(v.file, v.file in declared or v.line) for v in old] == [
        (v.file, v.file in declared or v.line) for v in new
    ]
    assert [_plain(v.name) for v in old] == [_plain(v.name) for v in new]
    said = [row for row in rows if row.outcome == "follows"]
    right = following = same = 0
    for was, now in zip(old, new, strict=True):
        miss = missed_mm(was, now, meant)
        here = [row for row in said if (row.file, row.line) == (was.file, was.line)]
        follows = [row.remaining_mm for row in here if "(" in was.name or "(" not in row.name]  # of two moves in a line
        moves = [v for v in old if (v.file, v.line, "(" in v.name) == (was.file, was.line, "(" in was.name)]
        matched = bool(follows) and min(abs(miss - remaining) for remaining in follows) < RIGHT_MM
        if matched or (
            follows and len(follows) >= len(moves)
        ):  # not every target that a name stands for need be corrected
            following += 1
            assert matched, (was, miss, follows)
        elif miss < RIGHT_MM:
            assert not shown or missed_mm(was, was, meant) > 10 * RIGHT_MM, (
                "the robot lands without a correction: nothing is shown"
            )
            right += 1
        elif miss == pytest.approx(unmoved := missed_mm(was, was, meant), abs=1e-9):
            same += 1
        else:  # in a posture that is not among those near the ones of the tests
            assert not meant, (was.file, was.line, was.name, miss, unmoved)
            assert _apart_mm(was, interpreter.readings(now.flange, ANYWHERE)) < RIGHT_MM, (was, miss, unmoved)
            right += 1
    return right, following, same


def _plain(name: str) -> str:
    """What a place is called without its numbers, those of a second target's name among them."""
    return re.sub(r"(?:_?\d)+\b|[-+.{}\[\]\d]+", "", re.sub(r"[.\d]+E[-+]?\d+", "", name)).lower()


def missed_mm(was: Visit, now: Visit, meant=True) -> float:
    """How far from where a move says the robot lands, sent as another says; in the best posture, where that meant is not known."""
    if now.joints is not None:
        return _apart_mm(was, now.joints[None])
    near = WAYS[np.abs(difference(FLANGES, now.flange)).sum(axis=1).argsort()[:8]]
    nearest = interpreter.readings(now.flange, near[:1]) if meant else near[:0]
    sent = nearest if len(nearest) else interpreter.readings(now.flange, near)
    miss = _apart_mm(was, sent[:1] if meant else sent)
    return miss if np.isfinite(miss) else 1e6 * (1 + float(np.abs(now.flange - was.flange).max()))


def _apart_mm(was: Visit, sent) -> float:
    """How far from where a move says the robot lands at the best of readings; without end where there are none."""
    aim = flange(was.joints) if was.flange is None else was.flange
    landed = (flange(sent, ERRORS) @ was.tool)[:, :3, 3]
    return 1e3 * float(np.linalg.norm(landed - (aim @ was.tool)[:3, 3], axis=1).min(initial=np.inf))


def as_rapid(q, tool, frame, arm) -> str:
    """Readings as a robtarget."""
    values = pose_values(np.linalg.inv(frame) @ flange(q) @ tool, "quaternion", np.array([0, 0, 0, 1.0, 0, 0, 0]))
    flags = ",".join(RapidConfiguration(()).of(arm.postures(q[None])[0]))
    place, turn = (",".join(f"{v:.{n}f}" for v in part) for part, n in ((1e3 * values[:3], 3), (values[3:], 9)))
    return f"[[{place}],[{turn}],[{flags}],[9E9,9E9,9E9,9E9,9E9,9E9]]"


def as_krl(q, tool, frame, arm) -> str:
    """Readings as an E6POS."""
    values = pose_values(np.linalg.inv(frame) @ flange(q) @ tool, "zyx", np.zeros(6))
    (posture,) = arm.postures(q[None])
    status = (not posture.front) + 2 * posture.elbow + 4 * (q[4] < 0)
    turn = sum(1 << k for k, angle in enumerate(q) if angle < 0)
    shown = ",".join(f"{name} {v:.5f}" for name, v in zip("XYZABC", in_mm_and_degrees(values), strict=True))
    return f"{{{shown},S {status},T {turn},E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}}"


def in_mm_and_degrees(values) -> np.ndarray:
    return np.concatenate([1e3 * values[:3], np.rad2deg(values[3:])])


def as_fanuc(q, tool, frame, arm) -> str:
    """Readings as the figures of a position."""
    values = in_mm_and_degrees(pose_values(np.linalg.inv(frame) @ flange(q) @ tool, "xyz", np.zeros(6)))
    flip, elbow, front, *turns = FanucConfiguration(()).of(arm.postures(q[None])[0])
    units = ("mm",) * 3 + ("deg",) * 3
    shown = ",\t".join(f"{name} = {v:9.3f} {unit}" for name, v, unit in zip("XYZWPR", values, units, strict=True))
    return f"CONFIG : '{flip} {elbow} {front}, {', '.join(turns)}',\n\t{shown}"


def as_urscript(q, tool, frame, arm) -> str:
    """Readings as a pose, or themselves."""
    if tool is None:
        return f"[{', '.join(f'{v:.6f}' for v in q)}]"
    values = pose_values(np.linalg.inv(frame) @ flange(q) @ tool, "vector", np.zeros(6))
    return f"p[{', '.join(f'{v:.6f}' for v in values)}]"


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


KRL = {
    "KRC/R1/System/$config.dat": """&ACCESS RVO
DEFDAT  $CONFIG
;FOLD BASISTECH GLOBALS
DECL FDAT FDAT_ACT={TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}
;ENDFOLD
TOOL_DATA[1]={X 97.4,Y 0.0,Z 223.1,A 0.0,B 45.0389,C 0.0}
TOOL_DATA[2]={X -20.0,Y 110.0,Z 310.0,A 0.0,B 0.0,C 0.0}
BASE_DATA[1]={X 300.0,Y 800.0,Z 230.0,A 90.0,B 0.0,C 0.0}
BASE_NAME[1,]="fixture"
E6AXIS XHOME={A1 10.0,A2 -20.0,A3 30.0,A4 0.0,A5 60.0,A6 0.0,E1 0.0}
DECL E6POS XSERVICE=<0|gun|wobj0>
ENDDAT
""",
    "KRC/R1/Program/weld.dat": """DEFDAT  WELD PUBLIC
;FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS
EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )
;ENDFOLD
DECL E6POS XP1=<1|gun|fixture>
DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}
DECL E6POS XP2=<2|torch|fixture>
DECL FDAT FP2={TOOL_NO 2,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}
DECL E6POS RACK[2]
RACK[1]=<3|gun|fixture>
RACK[2]=<4|gun|fixture>
DECL FRAME LIFT={X 0.0,Y 0.0,Z -60.0,A 0.0,B 0.0,C 15.0}
DECL GLOBAL E6POS XSHARED=<5|torch|wobj0>
ENDDAT
""",
    "KRC/R1/Program/weld.src": """&ACCESS RVP
DEF  WELD( )
;FOLD PTP HOME Vel= 100 % DEFAULT;%{PE}
PTP XHOME
;ENDFOLD
FDAT_ACT=FP1
PTP XP1
FDAT_ACT=FP2
LIN XP2 C_DIS
LIN XP2:LIFT
BAS (#TOOL,1 )
BAS (#BASE,1 )
LIN RACK[1]
LIN RACK[2]:{X 0.0,Y 0.0,Z -100.0,A 0.0,B 0.0,C 0.0}
LIN RACK[2]
CIRC <6|gun|fixture>,<7|gun|fixture>
END
""",
    "KRC/R1/Program/service.src": """DEF  SERVICE( )
$TOOL=TOOL_DATA[1]
$BASE=$NULLFRAME
PTP XSERVICE
$TOOL={X -20.0,Y 110.0,Z 310.0,A 0.0,B 0.0,C 0.0}
PTP XSHARED
END
""",
    "KRC/R1/Mada/$machine.dat": "DEFDAT  $MACHINE PUBLIC\nCHAR $TRAFONAME[32]\n$TRAFONAME[]=\"ARM\"\nENDDAT\n",
}  # fmt: skip

FANUC = {
    "SYSFRAME.VA": """[*SYSTEM*]$MNUFRAME  Storage: SHADOW  Access: RW  : ARRAY[1,9] OF POSITION
     [1,1] =
      Group: 1   Config: N D B, 0, 0, 0
      X:   300.000   Y:   800.000   Z:   230.000
      W:      .000   P:      .000   R:    90.000
     [1,2] = Uninitialized
[*SYSTEM*]$MNUFRAMENUM  Storage: CMOS  Access: RW  : ARRAY[1] OF BYTE
     [1] = 1
[*SYSTEM*]$MNUTOOL  Storage: SHADOW  Access: RW  : ARRAY[1,10] OF POSITION
     [1,1] = 'gun'
      Group: 1   Config: N D B, 0, 0, 0
      X:    97.400   Y:      .000   Z:   223.100
      W:      .000   P:    45.039   R:      .000
     [1,2] =
      Group: 1   Config: N D B, 0, 0, 0
      X:   -20.000   Y:   110.000   Z:   310.000
      W:      .000   P:      .000   R:      .000
[*SYSTEM*]$MNUTOOLNUM  Storage: CMOS  Access: RW  : ARRAY[1] OF BYTE
     [1] = 1
""",
    "WELD.LS": """/PROG  WELD
/ATTR
COMMENT\t\t= "seam";
/MN
   1:  UFRAME_NUM=1 ;
   2:J P[1] 100% FINE    ;
   3:L P[2:"seam"] 500mm/sec CNT100    ;
   4:L P[3] 500mm/sec CNT100    ;
   5:J P[4] 20% FINE    ;
/POS
P[1]{
   GP1:
\tUF : 0, UT : 1,\t\t<0|gun|wobj0>
};
P[2:"seam"]{
   GP1:
\tUF : 1, UT : 1,\t\t<1|gun|fixture>
};
P[3]{
   GP1:
\tUF : 1, UT : 2,\t\t<2|torch|fixture>
};
P[4]{
   GP1:
\tUF : 1, UT : 2,
\tJ1=    10.000 deg,\tJ2=   -20.000 deg,\tJ3=    30.000 deg,
\tJ4=     0.000 deg,\tJ5=    60.000 deg,\tJ6=     0.000 deg
};
/END
""",
    "DROP.LS": """/PROG  DROP
/ATTR
/MN
   1:J P[1] 100% FINE    ;
/POS
P[1]{
   GP1:
\tUF : 0, UT : 2,\t\t<5|torch|wobj0>
};
/END
""",
    "ERRALL.LS": "ERRALL.LS      Robot Name ROBOT 01-JAN-20 12:00\r\n",
    "NUMREG.VA": "[*NUMREG*]$NUMREG  Storage: CMOS  Access: RW  : ARRAY[200] OF Numeric Reg\n     [1] = 3  ''\n",
}  # fmt: skip

URSCRIPT = {
    "programs/weld.script": """def weld():
  set_tcp(p[0.0974, 0.0, 0.2231, 0.0, 0.7858398, 0.0])
  set_payload(1.5, [0.0, 0.0, 0.05])
  global fixture_1 = p[0.3, 0.8, 0.23, 0.0, 0.0, 1.5707963267948966]
  global Waypoint_1_p = <1|gun|wobj0>
  global Waypoint_1_q = <1>
  global Waypoint_2_p = <2|gun|fixture>
  global above = 0.05
  global approach = pose_trans(Waypoint_1_p, p[0, 0, -above, 0, 0, d2r(10)])
  movej(<1>, a=1.4, v=1.05)
  movel(approach, a=1.2, v=0.25)
  movel(Waypoint_1_p, a=1.2, v=0.25)
  movel(pose_add(Waypoint_1_p, p[0, 0.02, above + 0.01, 0, 0, 0]), a=1.2, v=0.25)
  movel(pose_trans(fixture_1, Waypoint_2_p), a=1.2, v=0.25)
  movel(pose_trans(fixture_1, <3|gun|fixture>), a=1.2, v=0.25)
  set_tcp(p[-0.02, 0.11, 0.31, 0.0, 0.0, 0.0])
  movep(<4|torch|wobj0>, a=1.2, v=0.25, r=0.01)
  movec(<5|torch|wobj0>, <6|torch|wobj0>, a=1.2, v=0.25)
end
weld()
""",
    "programs/weld.txt": " Program\n   Robot Program\n     MoveJ\n",
}  # fmt: skip


def on_disk(name: str) -> dict[str, str]:
    """The files of a backup beside the tests."""
    folder = Path(__file__).parent / "corpus" / "projects" / name
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes().decode("latin-1") for path in paths}


WHOLE = {  # files, how they write a target, who interprets them, and how many moves are right, follow, go where they went
    "RAPID": (RAPID, as_rapid, interpreter.rapid, (10, 3, 0)),
    "KRL": (KRL, as_krl, interpreter.krl, (9, 2, 0)),
    "FANUC": (FANUC, as_fanuc, interpreter.fanuc, (5, 0, 0)),
    "URScript": (URSCRIPT, as_urscript, interpreter.urscript, (7, 2, 0)),
    "ABB backup": (on_disk("abb"), as_rapid, interpreter.rapid, (16, 10, 0)),
    "KUKA backup": (on_disk("kuka"), as_krl, interpreter.krl, (14, 5, 0)),
}  # fmt: skip


@pytest.mark.parametrize("maker", WHOLE)
def test_files_of_a_project_know_each_others_tools_frames_and_targets(maker, true_arm):
    """Fails if a tool, frame, array, record or constant of another file is not found, or a move misses."""
    files, state, interpret, counts = WHOLE[maker]
    before = filled(files, state, true_arm)
    after, done, unread = corrected(before, true_arm)
    assert not unread
    assert not [row for row in done.rows if row.outcome not in ("moved", "follows") and row.reason not in UNASKED]
    assert check_landing(interpret, before, after, done.rows) == counts
    assert not done.uncorrected


@pytest.mark.parametrize("maker", WHOLE)
def test_a_model_that_changes_nothing_gives_a_project_back_to_the_last_byte(maker, nominal_arm):
    """Fails if the way through names, tools and joint readings changes a digit."""
    files, state, _, _ = WHOLE[maker]
    before = filled(files, state, nominal_arm)
    after, done, _ = corrected(before, nominal_arm)
    assert after == before
    assert {row.outcome for row in done.rows if row.reason not in UNASKED} <= {"unchanged", "follows"}


TWO_TOOLS = """MODULE Two
  PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  PERS tooldata long:=[TRUE,[[97.4,0,263.1],[0.924,0,0.383,0]],[2,[0,0,50],[1,0,0,0],0,0,0]];
  PERS tooldata alike:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[7,[0,0,75],[1,0,0,0],0,0,0]];
  CONST robtarget both:=<1|gun|wobj0>;
  CONST robtarget same:=<2|gun|wobj0>;
  PROC main()
    MoveL both,v100,fine,gun;
    MoveL both,v100,fine,long;
    MoveL same,v100,fine,gun;
    MoveL same,v100,fine,alike;
  ENDPROC
ENDMODULE
"""
SPLIT = {  # files, those of the targets' declarations after it, and how many moves are right and follow
    "RAPID": (
        {
            "two.mod": TWO_TOOLS,
            "more.mod": """MODULE More
  ! taught with the gun
  PERS wobjdata fixture:=[FALSE,TRUE,"",[[20,30,-40],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
\tLOCAL CONST robtarget pRow{2}:=[<3|gun|wobj0>,<4|gun|wobj0>]; ! a row
  PERS robtarget both_2:=<5|gun|wobj0>; CONST num n:=1;
  PROC more()
    MoveL both,v100,fine,gun;
    MoveL both,v100,fine,long;
    MoveL Offs(both,0,0,40),v100,fine,long;
    MoveC pRow{1},pRow{2},v100,fine,gun;
    MoveC pRow{1},pRow{2},v100,fine,long;
    MoveL both_2,v100,fine,gun;
    MoveL both_2,v100,fine,gun\\WObj:=fixture;
  ENDPROC
ENDMODULE
""",
        },
        (
            "both_3:=",
            "; ! a row\n\tLOCAL CONST robtarget pRow_1_2:=",
            "\n\tLOCAL CONST robtarget pRow_2_2:=",
            "both_2_2:=",
        ),
        (12, 1, 0),
    ),
    "KRL": (
        {
            "R1/$config.dat": KRL["KRC/R1/System/$config.dat"].replace(
                "DECL E6POS XSERVICE=<0|gun|wobj0>\n",
                "TOOL_DATA[3]={X 97.4,Y 0,Z 263.1,A 0,B 45.0389,C 0}\nBASE_DATA[3]={X 330,Y 800,Z 200,A 90,B 0,C 0}\n",
            ),
            "R1/two.dat": """DEFDAT TWO PUBLIC
  DECL E6POS XP1=<1|gun|fixture> ; taught
DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}
DECL GLOBAL E6POS RACK[2]
RACK[1]=<2|gun|fixture>
RACK[2]=<3|gun|fixture>
ENDDAT
""",
            "R1/two.src": """DEF TWO( )
FDAT_ACT=FP1
LIN xp1
BAS(#TOOL,3)
LIN XP1 C_DIS
LIN RACK[1]
BAS(#BASE,3)
LIN RACK[1]
LIN RACK[2]
BAS(#BASE,1)
CIRC RACK[2],XP1
END
""",
        },
        ("; taught\n  DECL E6POS XP1_2={", "DECL GLOBAL E6POS RACK_1_2={", "DECL GLOBAL E6POS RACK_2_2={"),
        (7, 0, 0),
    ),
    "URScript": (
        {
            "two.script": """def two():
  global there = <1|gun|wobj0>  # taught
  fixture = p[0.3, 0.8, 0.23, 0.0, 0.0, 1.5707963267948966]
  set_tcp(p[0.0974, 0.0, 0.2231, 0.0, 0.7858398, 0.0])
  movej(<1>)
  movel(there, a=1.2)
  set_tcp(p[0.0974, 0.0, 0.2631, 0.0, 0.7858398, 0.0])
  movel(there, a=1.2)
  movel(pose_trans(there, p[0, 0, -0.03, 0, 0, 0]), a=1.2)
end
"""
        },
        ("# taught\n  global there_2 = p[",),
        (3, 1, 0),
    ),
}


@pytest.mark.parametrize("maker", SPLIT)
def test_a_target_of_two_tools_is_split(maker, true_arm, nominal_arm):
    """Fails if it lands with one of its tools and is wrong with the other, or tools of one place count as two.

    Or if a second target is declared where nothing is corrected, takes a name that there is, or loses scope, indent or remark.
    """
    files, declared, counts = SPLIT[maker]
    before = filled(files, WHOLE[maker][1], true_arm)
    after, done, _ = corrected(before, true_arm)
    assert check_landing(WHOLE[maker][2], before, after, done.rows) == counts
    assert not done.uncorrected
    text = "".join(one.decode("latin-1") for one in after.values())
    assert [text.count(one) for one in declared] == [1] * len(declared)
    assert len([row for row in done.rows if row.note.startswith("a second")]) == len(declared)
    again, _, _ = corrected(before, nominal_arm)
    assert again == before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("  PROC main()", "  CONST robtarget pOver:=Offs(both,0,0,50);\n  PROC main()\n    MoveL pOver,v1,fine,gun;\n"
                           "    MoveL pOver,v1,fine,long;"),
        ("CONST robtarget both", "VAR robtarget both:=<6|gun|wobj0>;\n  PROC again()\n  both"),
        ("fine,long", "fine,other"),
    ],
)  # fmt: skip
def test_what_cannot_be_split_is_named_and_stays(old, new, true_arm):
    """Fails if one move of several is wrong: by a name for both tools, by a value given on the way, by a tool not known."""
    text = TWO_TOOLS.replace(old, new)
    if "again" in new:
        text = text.replace("  CONST robtarget same", "  ENDPROC\n  CONST robtarget same").replace(
            "  CONST robtarget same:=<2|gun|wobj0>;\n", ""
        ).replace("MODULE Two\n", "MODULE Two\n  CONST robtarget same:=<2|gun|wobj0>;\n")  # fmt: skip
    before = filled({"two.mod": text}, as_rapid, true_arm)
    after, done, _ = corrected(before, true_arm)
    reasons = {row.name: row.reason for row in done.uncorrected}
    if "other" in new:
        assert reasons == {"both": "unknown tool or frame"}
        assert b"both_2" in after["two.mod"]
        return
    assert set(reasons.values()) <= {"several tools or frames", "shared"}
    assert reasons["both"] == "several tools or frames"
    assert "gun, long" in next(row.note for row in done.uncorrected if row.name == "both")
    assert b"both_2" not in after["two.mod"]


FOLLOWING = """MODULE Far
  CONST robtarget p:=<1|tool0|wobj0>;
  VAR num n:=10;
  CONST robtarget q:=<2|tool0|wobj0>;
  PROC main()
    MoveL p,v100,fine,tool0;
    MoveL Offs(p,0,0,5),v100,fine,tool0;
    MoveL Offs(p,-700,300,0),v100,fine,tool0;
    MoveL Offs(q,0,0,n),v100,fine,tool0;
  ENDPROC
ENDMODULE
"""


def test_what_follows_a_target_is_promised_as_it_lands(true_arm):
    """Fails if a place far from its origin counts as corrected though it misses, or one that is moved by a variable as known."""
    before = filled({"far.mod": FOLLOWING}, as_rapid, true_arm)
    after, done, _ = corrected(before, true_arm)
    rows = {row.line: row for row in done.rows}
    assert [rows[line].outcome for line in (2, 7, 8)] == ["moved", "follows", "follows"]
    assert rows[7].remaining_mm < 0.05 < 10 * rows[7].remaining_mm < rows[8].remaining_mm
    assert all(row.promised_mm >= row.remaining_mm for row in (rows[2], rows[7], rows[8]))
    assert rows[8].remaining_mm > rows[8].moved_mm / 2
    assert [(row.line, row.reason) for row in done.uncorrected] == [(8, "shared"), (9, "shared")]
    known = {file: re.sub(rb"MoveL Offs\(q[^;]*;", b"", one) for file, one in before.items()}
    sent = {file: re.sub(rb"MoveL Offs\(q[^;]*;", b"", one) for file, one in after.items()}
    assert check_landing(interpreter.rapid, known, sent, done.rows) == (1, 2, 0)


def test_a_project_of_which_no_target_is_reached_is_told_so(true_arm):
    """Fails if poses that no stance of the arm reaches end in a traceback."""
    before = filled({"far.mod": FOLLOWING}, as_rapid, true_arm)
    away = {file: re.sub(rb"\[\[[-\d.]+,", b"[[9000,", one) for file, one in before.items()}
    after, done, _ = corrected(away, true_arm)
    assert after == away
    assert {row.outcome for row in done.rows} <= {"not reached", "left alone"}
    assert not done.is_corrected


def test_modules_beside_the_tasks_are_by_themselves(true_arm):
    """Fails if an old version in a backup, or the controller's disk, changes what a task's modules mean, or the other way round."""
    old = TWO_TOOLS.replace("97.4", "99.4").replace("fine,long", "fine,gun").replace("fine,alike", "fine,gun")
    before = filled(RAPID | {"NOTES/old.mod": old, "HOME/older.mod": old}, as_rapid, true_arm)
    after, done, _ = corrected(before, true_arm)
    assert not done.uncorrected
    alone = filled(RAPID, as_rapid, true_arm)
    expected, _, _ = corrected(alone, true_arm)
    assert {file: after[file] for file in alone} == expected
    notes = ({"old.mod": files["NOTES/old.mod"]} for files in (before, after))
    assert check_landing(interpreter.rapid, *notes, ()) == (4, 0, 0)


def test_targets_of_two_robots_are_refused(true_arm):
    """Fails if the second robot's program is corrected as if it were the first's; a task without targets is none."""
    files = filled(RAPID, as_rapid, true_arm)
    second = {file.replace("TASK1", "TASK2"): one for file, one in files.items()}
    with pytest.raises(InputError, match="several tasks"):
        corrected(files | second, true_arm)
    corrected(
        files | {"RAPID/TASK2/PROGMOD/watch.mod": b"MODULE w\nPROC main()\nWaitTime 1;\nENDPROC\nENDMODULE\n"}, true_arm
    )


SETTING = {
    "KRL": {
        "R1/System/$config.dat": KRL["KRC/R1/System/$config.dat"],
        "R1/Program/main.src": """DEF MAIN( )
BAS (#TOOL,1)
BAS (#BASE,1)
LIN <1|gun|fixture>
COUNT( )
LIN <2|gun|fixture>
STEPS( )
LIN <3|torch|fixture>
END
""",
        "R1/Program/steps.src": "DEF STEPS( )\nCHANGE( )\nEND\nDEF CHANGE( )\n$TOOL=TOOL_DATA[2]\nEND\n",
        "R1/Program/count.src": "DEF COUNT( )\nN=N+1\nEND\n",
    },
    "URScript": {
        "main.script": """def main():
  def change():
    set_tcp(p[-0.02, 0.11, 0.31, 0.0, 0.0, 0.0])
  end
  def steps():
    change()
  end
  set_tcp(p[0.0974, 0.0, 0.2231, 0.0, 0.7858398, 0.0])
  movej(<1>)
  movel(<1|gun|wobj0>)
  count()
  movel(<2|gun|wobj0>)
  steps()
  movel(<3|torch|wobj0>)
end
"""
    },
}


FUNCTIONS = """def main():
  set_tcp(p[0.0974, 0.0, 0.2231, 0.0, 0.7858398, 0.0])
  def pick(place, drop):
    movej(<1>)
    movel(pose_trans(place, p[0, 0, -0.05, 0, 0, 0]))
    movel(place)
    movel(drop)
  end
  def place(drop):
    set_tcp(p[-0.02, 0.11, 0.31, 0.0, 0.0, 0.0])
    movel(drop)
  end
  taken = <1|gun|wobj0>
  mine = <2|gun|wobj0>
  given = <3|torch|wobj0>
  pick(taken, mine)
  place(given)
end
"""


@pytest.mark.parametrize("tools", [1, 2])
def test_a_function_has_the_tool_with_which_it_is_called(tools, true_arm):
    """Fails if what a function is given is not followed, or counts as of a tool that is not the only one."""
    text = (
        FUNCTIONS
        if tools == 2
        else FUNCTIONS.replace("p[-0.02, 0.11, 0.31, 0.0, 0.0, 0.0]", "p[0.0974, 0.0, 0.2231, 0.0, 0.7858398, 0.0]")
    )
    _, done, _ = corrected(
        filled({"main.script": text.replace("torch", "gun") if tools == 1 else text}, as_urscript, true_arm), true_arm
    )
    moved = {row.name for row in done.rows if row.outcome == "moved" and row.kind == "pose"}
    assert moved == ({"taken", "mine", "given"} if tools == 1 else {"given"})
    assert {row.reason for row in done.uncorrected} == (set() if tools == 1 else {"unknown tool or frame"})


@pytest.mark.parametrize("maker", SETTING)
def test_a_routine_that_sets_the_tool_leaves_it_unknown(maker, true_arm):
    """Fails if a move after a call of what sets another tool, in whichever file, counts as with the tool before."""
    before = filled(SETTING[maker], WHOLE[maker][1], true_arm)
    _, done, unread = corrected(before, true_arm)
    assert not unread
    moved = [row for row in done.rows if row.outcome == "moved" and row.kind == "pose" and "XSERVICE" not in row.name]
    assert len(moved) == 2
    (row,) = [row for row in done.uncorrected if "XSERVICE" not in row.name]
    assert row.reason == "unknown tool or frame"
    assert "does not state the tool" in row.note
