"""A corpus: programs as makers' manuals and backups have them, and mutations of each; what moves lands, by another interpreter.

Each program is a project of its own; `<3|gun|fixture>` stands for a target by its readings, tool and frame.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from calflow.files.problems import InputError
from programs.test_projects import (
    FANUC,
    KRL,
    RAPID,
    URSCRIPT,
    WHOLE,
    as_fanuc,
    as_krl,
    as_rapid,
    as_urscript,
    check_landing,
    corrected,
    filled,
    nominal_arm,
    true_arm,
)  # fmt: skip

__all__ = ["nominal_arm", "true_arm"]
GUN = "PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];"
FIXTURE = 'PERS wobjdata fixture:=[FALSE,TRUE,"",[[300,600,200],[1,0,0,0]],[[0,200,30],[0.7071068,0,0,0.7071068]]];'
AWAY = "[9E9,9E9,9E9,9E9,9E9,9E9]"
RAPID_PROGRAMS = [
    f"""%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%

MODULE MainModule
  {GUN}
  VAR speeddata slow:=[100,50,200,15];
  PROC main()
    ConfL\\On;
    MoveAbsJ [[10,-20,30,0,60,0],{AWAY}]\\NoEOffs,v1000,z50,tool0;
    MoveJ <0|gun|wobj0>,v1000\\V:=1100,z40\\Z:=45,gun;
    MoveL <1|gun|wobj0>, slow\\T:=5, fine\\Inpos:=inpos50, gun\\WObj:=wobj0;
    MoveC <2|gun|wobj0>,<3|gun|wobj0>,v500,z30,gun;
    Set do1;
    WaitTime 0.5;
  ENDPROC
ENDMODULE
""",
    f"""MODULE Palletising(NOSTEPIN)
    ! ***  points  ***
    TASK PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
    LOCAL {FIXTURE}
    CONST robtarget pPick:=<4|gun|fixture>;
    CONST robtarget pPlace{{2,2}}:=[[<5|gun|fixture>,<6|gun|fixture>],[<7|gun|fixture>,<8|gun|fixture>]];
    CONST num high:=2*60;
    VAR num n:=0;
    PROC pick()
        MoveJ Offs(pPick,0,0,high),v1500,z10,gun\\WObj:=fixture;
        MoveL pPick,v200,fine,gun\\WObj:=fixture;
        SetDO grip,1;
        MoveL Offs(pPick,0,-5,high/2),v500,z10,gun\\WObj:=fixture;
        TEST n
        CASE 0:
            MoveL pPlace{{1,1}},v200,fine,gun\\WObj:=fixture;
        CASE 1,2:
            MoveL pPlace{{1,2}},v200,fine,gun\\WObj:=fixture;
        DEFAULT:
            MoveL pPlace{{2,2}},v200,fine,gun\\WObj:=fixture;
        ENDTEST
        Incr n;
    ERROR
        IF ERRNO=ERR_WAIT_MAXTIME THEN
            TPWrite "MoveL pPick := [[1,2,3]]";
            RETRY;
        ENDIF
    ENDPROC
ENDMODULE
""",
    f"""MODULE Arc
  {GUN}
  {FIXTURE}
  PERS seamdata seam1:=[0.5,0.5,[5,0,24,120,0,0,0,0,0],0,0,0,0,0,[0,0,0,0,0,0,0,0,0],0,0,[0,0,0,0,0,0,0,0,0],0.5];
  CONST robtarget pStart:=<9|gun|fixture>;
  CONST robtarget pEnd:=<10|gun|fixture>;
  CONST robtarget pAbove:=RelTool(pStart,0,0,-50);
  PROC seam()
    MoveJ pAbove,v1000,z10,gun\\WObj:=fixture;
    ArcLStart pStart,v100,seam1,weld1\\Weave:=weave1,fine,gun\\WObj:=fixture;
    ArcL pEnd,v100,seam1,weld1,z1,gun\\WObj:=fixture;
    MoveL RelTool(pEnd,0,0,-50\\Rx:=5\\Ry:=-3),v1000,z10,gun\\WObj:=fixture;
  ENDPROC
  FUNC bool ready(\\switch Wait|switch Now,num limit)
    RETURN limit>3;
  ENDFUNC
  TRAP stopped
    StopMove;
  ENDTRAP
ENDMODULE
""",
    f"""MODULE Records
  RECORD part
    robtarget grasp;
    robtarget drop;
    string label;
  ENDRECORD
  {GUN}
  PERS part left:=[<11|gun|wobj0>,<12|gun|wobj0>,"left; [[1,2,3]]"];
  ALIAS robtarget place;
  CONST place pWait:=<13|gun|wobj0>;
  PROC serve(num which,\\PERS wobjdata WObj)
    IF which=1 MoveL left.grasp,v100,fine,gun;
    MoveL left.drop,v100,fine,gun;
    MoveJ pWait,v100,fine,gun;
  ENDPROC
ENDMODULE
""",
]
CONFIG = {"R1/System/$config.dat": KRL["KRC/R1/System/$config.dat"].replace("DECL E6POS XSERVICE=<0|gun|wobj0>\n", "")}
KRL_PROGRAMS = [
    {
        **CONFIG,
        "R1/Program/a.dat": """&ACCESS RVP
DEFDAT  A
DECL BASIS_SUGG_T LAST_BASIS={POINT1[] "P1   ",POINT2[] "P1   "}
DECL E6POS XP1=<0|gun|fixture>
DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}
DECL PDAT PPDAT1={VEL 100.000,ACC 100.000,APO_DIST 100.000,APO_MODE #CDIS}
DECL E6POS XP2=<1|torch|fixture>
DECL FDAT FP2={TOOL_NO 2,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}
DECL LDAT LCPDAT1={VEL 2.0,ACC 100.0,APO_DIST 100.0}
ENDDAT
""",
        "R1/Program/a.src": """&ACCESS RVP
&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe
DEF A( )
;FOLD INI;%{PE}
  GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
  INTERRUPT ON 3
  BAS (#INITMOV,0 )
;ENDFOLD (INI)
;FOLD PTP P1 Vel=100 % PDAT1 Tool[1]:gun Base[1]:fixture;%{PE}
$BWDSTART=FALSE
PDAT_ACT=PPDAT1
FDAT_ACT=FP1
BAS(#PTP_PARAMS,100)
PTP XP1
;ENDFOLD
;FOLD LIN P2 CONT Vel=2 m/s CPDAT1 Tool[2]:torch Base[1]:fixture;%{PE}
LDAT_ACT=LCPDAT1
FDAT_ACT=FP2
BAS(#CP_PARAMS,2)
LIN XP2 C_DIS C_DIS
;ENDFOLD
PTP XHOME
END
""",
    },
    {
        **CONFIG,
        "R1/Program/b.src": """DEF B( )
DECL INT I
$TOOL=TOOL_DATA[1]
$BASE=BASE_DATA[1]
PTP {A1 10,A2 -20,A3 30,A4 0,A5 60,A6 0}
LIN <2|gun|fixture> C_DIS ; LIN {X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2}
FOR I=1 TO 3
  LIN <3|gun|fixture>
ENDFOR
WAIT FOR $IN[1]
IF $IN[2]==TRUE THEN
  $OUT[3]=TRUE
ELSE
  CIRC <4|gun|fixture>,<5|gun|fixture>,CA 180.0
ENDIF
SLIN <6|gun|fixture>
END
""",
    },
    {
        **CONFIG,
        "R1/Program/c.dat": """DEFDAT C PUBLIC
DECL GLOBAL E6POS XSTART=<7|torch|fixture>
E6POS GRID[3]
GRID[1]=<8|torch|fixture>
GRID[2]=<9|torch|fixture>
GRID[3]=<10|torch|fixture>
DECL E6POS XOVER
FRAME RISE={X 0,Y 0,Z -75.5,A 5,B 0,C 0}
ENDDAT
""",
        "R1/Program/c.src": """DEF C( )
BAS (#TOOL,2)
BAS (#BASE,1)
PTP XSTART
LIN XSTART:RISE
LIN GRID[1]
LIN GRID[2]
LIN GRID[3]:{X 0.0,Y 10.0,Z 0.0,A 0.0,B 0.0,C 0.0}
LIN GRID[3]
END
""",
        "R1/Program/d.src": """DEF D( )
$TOOL=TOOL_DATA[2]
$BASE=BASE_DATA[1]
LIN XSTART
END
""",
    },
]
LS = """/PROG  {name}\tMacro
/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "P[1] X = 5 mm";
CREATE\t\t= DATE 23-07-09  TIME 09:02:48;
DEFAULT_GROUP\t= 1,*,*,*,*;
CONTROL_CODE\t= 00000000 00000000;
/APPL
/MN
{moves}/POS
{points}/END
"""


def ls(name: str, moves: list[str], *points: tuple[int, int, str]) -> str:
    """A program of FANUC's of lines and of points by user frame, tool and place."""
    lines = "".join(f"{k:4}:{move} ;\n" for k, move in enumerate(moves, start=1))
    data = "".join(
        f"P[{k}]{{\n   GP1:\n\tUF : {frame}, UT : {tool},\t\t{place}\n}};\n"
        for k, (frame, tool, place) in enumerate(points, start=1)
    )
    return LS.format(name=name, moves=lines, points=data)


JOINTS = ",\t".join(f"J{k}= {v:9.3f} deg" for k, v in enumerate((10, -20, 30, 0, 60, 0), start=1))
LISTING = {"frames/sysframe.va": FANUC["SYSFRAME.VA"]}
FANUC_PROGRAMS = [
    LISTING | {"A.LS": ls("A", ["  UFRAME_NUM=1", "  UTOOL_NUM=1", "J P[1] 100% CNT100 ACC100 TB    .10sec,P-SPS   ",
                                "L P[2] 500mm/sec FINE    ", "L P[3] 250cm/min CNT50 COORD   ", "  DO[1]=ON"],
                          (0, 1, "<0|gun|wobj0>"), (1, 1, "<1|gun|fixture>"), (1, 1, "<2|gun|fixture>"))},
    LISTING | {"B.LS": ls("B", ["J P[1] 10% FINE    ", "  LBL[1]", "  IF DI[1]=ON,JMP LBL[1]", "L P[2] 100mm/sec CNT10    ",
                                "L P[3] 100mm/sec FINE Wjnt    ", "  CALL OTHER(1,'P[1]')", "  !L P[9] is a remark"],
                          (1, 2, JOINTS), (1, 2, "<3|torch|fixture>"), (0, 2, "<4|torch|wobj0>"))},
    {"C.LS": ls("C", ["J P[1] 10% FINE    ", "L P[2] R[1]mm/sec FINE    "], (0, 0, JOINTS), (0, 0, "<5|tool0|wobj0>"))},
]  # fmt: skip
UR_PROGRAMS = [
    """def Simple():
  set_tcp(p[0.0974, 0.0, 0.2231, 0.0, 0.7858398, 0.0])
  while (True):
    $ 2 "MoveJ"
    $ 3 "Waypoint_1" "breakAfter"
    movej(get_inverse_kin(<0|gun|wobj0>, qnear=<0>), a=1.3962634015954636, v=1.0471975511965976)
    movel(<1|gun|wobj0>, a=1.2, v=0.25, t=0, r=0.02)
    movel(pose_trans(<1|gun|wobj0>, p[0.0, 0.0, -0.05, 0.0, 0.0, 0.0]), a=1.2, v=0.25)
    sync()
  end
end
""".replace("movel(pose_trans(<1|gun|wobj0>, p[0.0, 0.0, -0.05, 0.0, 0.0, 0.0]), a=1.2, v=0.25)\n    ", ""),
    """# a script file
def pick():
  set_tcp(p[0.0974, 0.0, 0.2231, 0.0, 0.7858398, 0.0])
  home = <2>
  table = p[0.3, 0.8, 0.23, 0.0, 0.0, 1.5707963267948966]
  grasp = <3|gun|fixture>
  rise = 0.08
  movej(home, a=1.4, v=1.05)
  movel(pose_trans(pose_trans(table, grasp), p[0, 0, -rise, 0, 0, 0]), a=1.2, v=0.25)
  movel(pose_trans(table, grasp), a=1.2, v=0.25)
  movel(pose_trans(table, <4|gun|fixture>), a=1.2, v=0.25)
  movej(home)
end
""",
    """def path():
  set_tcp(p[-0.02, 0.11, 0.31, 0.0, 0.0, 0.0])
  global first_p = <5|torch|wobj0>
  global first_q = <5>
  movej(get_inverse_kin(first_p, first_q), a=1.4, v=1.05)
  movep(<6|torch|wobj0>, a=1.2, v=0.25, r=0.005)
  movec(<7|torch|wobj0>, <8|torch|wobj0>, a=1.2, v=0.25, r=0.005)
  movel(pose_add(first_p, p[0, 0, 0.1, 0, 0, 0]), a=1.2, v=0.25)
end
""",
]
CORPUS = [
    *(("RAPID", {f"m{k}.mod": text}) for k, text in enumerate(RAPID_PROGRAMS)),
    *(("KRL", files) for files in KRL_PROGRAMS),
    *(("FANUC", files) for files in FANUC_PROGRAMS),
    *(("URScript", {f"m{k}.script": text}) for k, text in enumerate(UR_PROGRAMS)),
]
PROJECTS = {"RAPID": RAPID, "KRL": KRL, "FANUC": FANUC, "URScript": URSCRIPT}
MUTATIONS = 12  # of each project
STATES = {"RAPID": as_rapid, "KRL": as_krl, "FANUC": as_fanuc, "URScript": as_urscript}
REMARK = {
    "RAPID": "! p10:=[[1,2,3],[1,0,0,0]];",
    "KRL": "; PTP {X 1,Y 2,Z 3}",
    "URScript": "# movel(p[1,2,3,0,0,0])",
    "FANUC": "",
}


def test_nine_targets_of_ten_move_and_all_that_move_land(true_arm):
    """Fails if a program of the corpus is refused, less than nine in ten targets of it are corrected, or a move is wrong."""
    right = other = 0
    for maker, files in CORPUS:
        before = filled(files, STATES[maker], true_arm)
        after, done, unread = corrected(before, true_arm)
        assert not unread, (files, unread)
        landed, following, same = check_landing(WHOLE[maker][2], before, after, done.rows)
        assert landed
        right, other = right + landed + following, other + same
    assert other <= 0.1 * (right + other), (right, other)


@pytest.mark.parametrize("number", range(len(CORPUS)))
def test_a_model_that_changes_nothing_gives_a_program_back(number, nominal_arm):
    """Fails if a byte of a program of the corpus, or of what its lines look like after other tools, is another."""
    maker, files = CORPUS[number]
    before = filled(files, STATES[maker], nominal_arm)
    for change in (bytes, lambda one: one.replace(b"\n", b"\r\n"), lambda one: one.replace(b"  ", b"\t")):
        changed = {file: change(content) for file, content in before.items()}
        after, done, _ = corrected(changed, nominal_arm)
        assert after == changed
        assert any(row.outcome == "unchanged" for row in done.rows)


def mutations(maker: str, files: dict[str, str], rng: np.random.Generator):
    """Projects that are others in one thing, each with what that is: names, numbers, cases, places, and what is there twice."""
    names = list(files)
    numbered = re.compile(r"(?<![\w.<|])\d{2,}\.\d+(?![\w>|])")
    for k, file in enumerate(names):
        text = files[file]
        found = [m for m in numbered.finditer(text) if "VERSION" not in text[max(0, m.start() - 12) : m.start()]]
        if found:
            spot = found[int(rng.integers(len(found)))]
            changed = f"{float(spot.group()) + 0.05:.3f}"
            yield "number", {**files, file: text[: spot.start()] + changed + text[spot.end() :]}
        yield "line ends", {**files, file: text.replace("\n", "\r\n")}
        if REMARK[maker] and not text.startswith(("&", "%", "[*", "EIO", " ")) and "MODULE is" not in text:
            lines = text.split("\n")
            lines.insert(1, REMARK[maker])
            yield "remark", {**files, file: "\n".join(lines)}
        for tools in (
            ("gun", "torch"),
            ("torch", "gun"),
            ("TOOL_NO 1", "TOOL_NO 2"),
            ("#TOOL,1", "#TOOL,2"),
            ("UT : 1", "UT : 2"),
        ):
            places = [m.start() for m in re.finditer(re.escape(tools[0]) + r"\b(?!\|)", text)]
            if places:
                at = places[int(rng.integers(len(places)))]
                yield "tool", {**files, file: text[:at] + tools[1] + text[at + len(tools[0]) :]}
        if len(names) > 1:
            yield "gone", {name: one for name, one in files.items() if name != file}
            yield (
                "twice",
                {**files, f"{file.rpartition('.')[0]}{k}.{file.rpartition('.')[2]}": text.replace("97.4", "99.4")},
            )
    if maker == "RAPID":
        for line in (
            "gun.tframe.trans.z:=gun.tframe.trans.z+1;",
            "gun:=torch;",
            "pHome.trans.x:=1;",
            "fixture.uframe:=pose0;",
        ):
            changed = {file: text.replace("ENDPROC", f"  {line}\n  ENDPROC", 1) for file, text in files.items()}
            yield line, changed
        yield "case", {file: re.sub(r"\bgun\b(?!\|)", "GUN", text) for file, text in files.items()}
    if maker == "KRL":
        for line in ("TOOL_DATA[1].Z=1", "BASE_DATA[I]=$NULLFRAME", "TOOL_DATA[1]=TOOL_DATA[2]", "XP1.X=5"):
            yield (
                line,
                {f: t.replace("\nEND\n", f"\n{line}\nEND\n", 1) if f.endswith(".src") else t for f, t in files.items()},
            )


@pytest.mark.parametrize("maker", PROJECTS)
def test_a_mutated_project_is_never_corrected_wrongly(maker, true_arm):
    """Fails if, in a project that is another in one thing, a move goes elsewhere than before and not where it should."""
    rng = np.random.default_rng(len(maker))
    outcomes, refused = [], set[str]()
    every = list(mutations(maker, PROJECTS[maker], rng))
    for what, files in (every[k] for k in np.sort(rng.permutation(len(every))[:MUTATIONS])):
        before = filled(files, STATES[maker], true_arm)
        try:
            after, done, _ = corrected(before, true_arm)
        except InputError:
            refused.add(what)
            continue
        assert set(after) == set(before)
        try:
            WHOLE[maker][2]({file: one.decode("latin-1") for file, one in before.items()})
        except (KeyError, NameError, TypeError, AttributeError):  # a name that no file states any more
            assert what in ("gone", "twice", "tool"), what
            assert done.uncorrected, what
            continue
        try:
            outcomes.append(check_landing(WHOLE[maker][2], before, after, done.rows, shown=False))
        except AssertionError as error:
            raise AssertionError(f"{what}: {error}") from error
        if what in ("number", "line ends", "remark", "case"):
            assert not done.uncorrected, (what, done.uncorrected)
    assert sum(map(sum, outcomes)) > 3 * MUTATIONS
    assert refused <= {"gone", "twice", "TOOL_DATA[1].Z=1"}
