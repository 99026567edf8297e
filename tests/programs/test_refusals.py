"""Refusals: what no controller would take is refused with its line, and what is no target is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from calflow.files.problems import InputError
from calflow.programs.formats import parsed
from programs.samples import FILES

BROKEN = [
    ("weld.mod", "600,-500,225.3", "600,-500 225.3", 9),
    ("weld.mod", "600,-500,225.3", "600,-500", 9),
    ("weld.mod", "600,-500,225.3", "6O0,-500,225.3", 9),
    ("weld.mod", "600,-500,225.3", "600,-500,225.3.1", 9),
    ("weld.mod", "600,-500,225.3", "600,--500,(225.3", 9),
    ("weld.mod", "600,-500,225.3", "600,-500,225.3E999", 9),
    ("weld.mod", "[-1,0,-1,0]", "[-1,0,-1.5,0]", 9),
    ("weld.mod", "v1000, z50, gun;", "v1000, z50 gun;", 26),
    ("weld.mod", "ENDPROC", "", 50),
    ("weld.mod", "ENDMODULE", "", 54),
    ("weld.mod", "    ENDFOR\n", "", 45),
    ("weld.mod", '"p10:=[[600,', "p10:=[[600,", 33),
    ("weld.mod", "z50, gun \\WObj:=fixture;", "z50, gun \\WObj:=fixture", 32),
    ("weld.dat", "X 1025.50,Y", "X 1025.50 Y", 10),
    ("weld.dat", "X 1025.50,Y", "X 1025.50,X", 10),
    ("weld.dat", "S 2,T 35,E1", "S 2.5,T 35,E1", 10),
    ("weld.dat", "S 2,T 35,E1", "S 2,T 35,Q1", 10),
    ("weld.dat", "E6 0.0}", "E6 0.0", 10),
    ("weld.dat", "ENDDAT", "", 23),
    ("weld.dat", "Z 1.1E3", "Z 1.1E", 13),
    ("weld.src", "\nENDFOR", "", 25),
    ("weld.src", "B 90.0,C 0.0,S 2,T 35} C_PTP", "B 90.0,C 0.0,S 2,T 35 C_PTP", 12),
    ("weld.src", "END\nDEFFCT", "DEFFCT", 26),
    ("weld.ls", "X =  1171.166  mm,", "X =  1171.166  mm", 26),
    ("weld.ls", "X =  1171.166  mm,", "X =  1171.166  deg,", 28),
    ("weld.ls", "X =  1171.166  mm,", "X =  1171,166  mm,", 26),
    ("weld.ls", "X =  1171.166  mm,", "", 26),
    ("weld.ls", "'N U T, 0, 0, -1'", "'N U X, 0, 0, -1'", 25),
    ("weld.ls", "'N U T, 0, 0, -1'", "'N U T, 0, 0, -1", 25),
    ("weld.ls", "J2=   -50.000", "J3=   -50.000", 41),
    ("weld.ls", 'P[2:"seam, start"]{', "P[1]{", 33),
    ("weld.ls", "/END\n", "", 56),
    ("weld.ls", "/POS\n", "", 22),
    ("weld.script", "-.467959205379,", "-.467959205379", 4),
    ("weld.script", "p[.433025361705, ", "p[", 4),
    ("weld.script", ".530987104689]", ".530987104689", 5),
    ("weld.script", "d2r(-90)", "d2r(-90", 6),
    ("weld.script", "    end\n  end\nend", "    end\n  end", 32),
    ("weld.script", "while (x < 3) and not done:", "while (x < 3) and not done", 14),
]


@pytest.mark.parametrize(("name", "old", "new", "line"), BROKEN)
def test_what_no_controller_takes_is_refused_with_its_line(name, old, new, line):
    """Fails if a broken program is accepted, or the line that is told is not where it breaks."""
    text, _ = FILES[name]
    assert old in text
    with pytest.raises(InputError) as refused:
        parsed(text.replace(old, new, 1).encode(), Path(name))
    (problem,) = refused.value.problems
    assert problem.line == line, problem
    assert problem.file == Path(name)


@pytest.mark.parametrize(
    ("name", "left"),
    [
        ("weld.mod", {"shifted": "computed", "p10.trans.x": "on the way", "here": "computed"}),
        ("weld.dat", {"FIXTURE": "no move of this file", "HALF": "keeps"}),
        ("weld.src", {"LIN_REL in line 16": "relative", "LIN in line 21": "computed", "XP9": "not stand in this file",
                      "LIN in line 25": "does not give Y"}),
        ("weld.ls", {"P[4]": "never taught", "P[5]": "INC", "move in line 19": "offset", "move in line 21": "register"}),
        ("weld.script", {"feature": "no move", "movel in line 23": "there", "movej in line 29": "computed"}),
    ],
)  # fmt: skip
def test_what_is_no_target_is_named(name, left):
    """Fails if a target that is computed is guessed, or passed over in silence."""
    text, _ = FILES[name]
    told = {one.name: one.note for one in parsed(text.encode(), Path(name)).skipped}
    assert set(told) == set(left)
    assert all(word in told[what] for what, word in left.items())


def test_a_literal_in_an_expression_is_named():
    """Fails if a target that a function returns, or that is given to a routine, is passed over in silence."""
    literal = "[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    lines = ["MODULE M", "FUNC robtarget f()", f"RETURN {literal};", "ENDFUNC", "PROC p()", f"go {literal}, v100;",
             f"MoveL Offs({literal},0,0,1),v100,fine,tool0;", "ENDPROC", "ENDMODULE"]  # fmt: skip
    program = parsed("\n".join(lines).encode(), Path("m.mod"))
    assert [(one.name, one.line) for one in program.targets] == [
        ("Offs(…)", 7)
    ]  # the one of which it is known what is made
    assert [one.line for one in program.skipped] == [3, 6]
    text = "DEF P( )\nGO({X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2})\nEND\n"
    assert [one.line for one in parsed(text.encode(), Path("p.src")).skipped] == [2]
    text = "def go(x):\n  movel(x)\nend\ngo(p[0.1,0.2,0.3,0,0,0])\n"
    assert [one.line for one in parsed(text.encode(), Path("p.script")).skipped] == [2, 4]


PASSED_ON = r"""MODULE M
  CONST robtarget p10:=[[600,0,500],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST jointtarget parked:=[[9E9,-20,30,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC go(\PERS wobjdata WObj \num T, \switch Fast | switch Slow)
    MoveL p10, v100\T?T, fine, tool0\WObj?WObj\NoEOffs;
    IF Present(Fast) go\WObj?WObj\Fast?Fast;
    MoveAbsJ parked, v100, fine, tool0;
  ENDPROC
ENDMODULE
"""


def test_what_a_routine_passes_on_is_not_known():
    """Fails if an argument passed on is refused, taken for the module's own work object, or a placeholder for a reading."""
    program = parsed(PASSED_ON.encode(), Path("m.mod"))
    (target,) = program.targets
    assert [(use.tool, use.frame) for use in target.uses] == [("tool0", "?wobj")]
    assert [(one.name, one.reason) for one in program.skipped] == [("parked", "never taught")]


def test_what_controllers_write_and_manuals_leave_out_is_read():
    """Fails if a section that stands twice, an empty instruction, or a parameter without a direction is refused."""
    text, _ = FILES["weld.ls"]
    twice = text.replace(
        "/APPL\n", "/APPL\n/APPL\n\nAUTO_SINGULARITY_HEADER;\n  ENABLE_SINGULARITY_AVOIDANCE   : TRUE;\n"
    )
    twice = twice.replace("   3:  !L P[4]", " ;\n   3:  !L P[4]")
    assert len(parsed(twice.encode(), Path("weld.ls")).targets) == len(parsed(text.encode(), Path("weld.ls")).targets)
    text = "DEF PICK (FUNCT )\nR=SEND(# State,1)\nPTP {X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2}\nEND\n"
    assert len(parsed(text.encode(), Path("p.src")).targets) == 1


def test_what_stands_after_the_end_of_a_program_stays():
    """Fails if a file that an editor, or a transfer, left something behind its end in is refused."""
    text, _ = FILES["weld.ls"]
    program = parsed(f"{text}\r\nleft by an editor {{\x1a\0".encode(), Path("weld.ls"))
    assert len(program.targets) == len(parsed(text.encode(), Path("weld.ls")).targets)


def test_a_file_is_told_by_name_and_beginning():
    """Fails if a file in another language than its name says is read, or one without a known name is not recognised."""
    rapid, krl = FILES["weld.mod"][0], FILES["weld.src"][0]
    assert parsed(rapid.encode(), Path("weld.txt")).maker == "rapid"
    for name, text, told in (("weld.mod", krl, "begins like KUKA KRL"), ("notes.txt", "nothing\n", "no robot program")):
        with pytest.raises(InputError, match=told):
            parsed(text.encode(), Path(name))


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("m.src", ("DEF M( )", "BAS(#TOOL,1)", "IF $IN[1] THEN", "BAS(#TOOL,2)", "ELSE", "PTP A", "BAS(#TOOL,1)", "ENDIF", "PTP B",
                   "END", "DEFDAT M", *(f"DECL E6POS {one}={{X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2}}" for one in "AB"), "ENDDAT")),
        ("m.script", ("A = p[1,2,3,0,0,0]", "B = p[1,2,3,0,0,0]", "set_tcp(p[0,0,1,0,0,0])", "if x == 1:",
                      "set_tcp(p[0,0,2,0,0,0])", "else:", "movel(A)", "end", "movel(B)")),
    ],
)  # fmt: skip
def test_a_tool_set_in_a_branch_holds_in_it_alone(name, lines):
    """Fails if one branch has the tool that another sets, or what follows the tool that only some branches end with."""
    tools = {
        one.name: {use.tool for use in one.uses} for one in parsed("\n".join([*lines, ""]).encode(), Path(name)).targets
    }
    assert len(tools["A"]) == 1
    assert None not in tools["A"]
    assert tools["B"] == {None}


def test_a_move_to_a_point_that_has_no_position_is_named():
    """Fails if a program that sends the robot to a point stated nowhere counts as corrected."""
    text, _ = FILES["weld.ls"]
    other = text.replace(":J P[1]", ":J P[77]", 1)
    program = parsed(other.encode("latin-1"), Path("weld.ls"))
    (lacking,) = [one for one in program.skipped if one.name == "P[77]"]
    assert lacking.reason == "never taught"
    assert "P[77]" in other.splitlines()[lacking.line - 1]
