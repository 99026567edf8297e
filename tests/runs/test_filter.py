"""Filtering a program: what its user gives, gets and is told, on the command line and from Python."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from applied import filter_program
from calflow.commands.apply import summary_lines
from calflow.estimation.needed_conditions import NeededCondition, check_stated
from calflow.files.problems import InputError
from calflow.files.tables import columns
from calflow.programs.correction import FilteredTarget
from calflow.programs.filtering import GO_ON

PAGE = Path(__file__).parents[2] / "docs" / "programs.md"
PROGRAM = """/PROG  POINTS
/ATTR
/MN
   1:J P[1] 100% FINE    ;
   2:J P[2] 100% FINE    ;
/POS
P[1]{
   GP1:
\tUF : 0, UT : 1,\t
\tJ1=    10.000 deg,\tJ2=   -30.000 deg,\tJ3=    60.000 deg
};
P[2]{
   GP1:
\tUF : 0, UT : 1,\t
\tJ1=   -20.000 deg,\tJ2=   -40.000 deg,\tJ3=    50.000 deg
};
/END
"""


@pytest.fixture
def cell(finished):
    """A finished run of a robot with three joints, and a program for it."""
    (finished / "points.ls").write_bytes(PROGRAM.replace("\n", "\r\n").encode())
    return finished


def test_a_program_is_not_written_over_and_comes_before_its_summary(cell):
    """Fails if a corrected program that somebody has edited is lost, or a summary tells of one that is not there."""
    asked = ("filter", cell / "runs", cell / "points.ls", "--payload", "heavy", "--summary", cell / "sum.csv")
    corrected = cell / "points.corrected.ls"
    corrected.write_bytes(b"edited by hand")
    (told,) = cell.refused(*asked)
    assert "points.corrected.ls" in told
    assert "--force" in told
    assert corrected.read_bytes() == b"edited by hand"
    assert not (cell / "sum.csv").exists()
    assert cell.calflow(*asked, "--force").code == 0
    assert cell.calflow(*asked).code == 0  # it holds the same
    (cell / "sum.csv").unlink()
    (cell / "file").write_text("")
    answer = cell.calflow(*asked, "--out", cell / "file" / "points.ls")
    assert answer.code == 2
    assert "is no folder" in answer.err
    assert not (cell / "sum.csv").exists()


def readings(source: bytes) -> np.ndarray:
    """The joint readings of a program [deg]."""
    return np.array(re.findall(rb"J\d= *(-?[\d.]+)", source), dtype=float).reshape(-1, 3)


def test_the_tool_lands_where_the_nominal_robot_has_it(cell):
    """Fails if the corrected readings do not land where the program said, or a load that weighs is left out without a word."""
    answer = cell.calflow(
        "filter", cell / "runs", cell / "points.ls", "--payload", "heavy", "--summary", cell / "sum.csv"
    )
    assert answer.code == 0, answer
    assert "2 targets stated by numbers: 2 moved, 0 unchanged, 0 not reached; 0 left alone" in answer.out
    assert answer.out.endswith(f"wrote {cell / 'points.corrected.ls'}\n")
    source = (cell / "points.corrected.ls").read_bytes()
    assert re.sub(rb"J\d=[^d]*deg", b"", source) == re.sub(rb"J\d=[^d]*deg", b"", (cell / "points.ls").read_bytes())
    table = pd.read_csv(cell / "sum.csv")
    assert list(table["name"]) == ["P[1]", "P[2]"]
    assert table["remaining_mm"].max() < 1e-3
    assert table["moved_mm"].min() > 0.1
    assert source == filter_program(cell / "runs", cell / "points.ls", payload="heavy").source
    asked = ("filter", cell / "runs", cell / "points.ls", "--out", cell / "empty.ls")
    (told,) = cell.refused(*asked)
    assert told.startswith('payload: expected light, heavy or "" for nothing')
    empty = cell.calflow(*asked, "--payload", "")
    assert "FANUC shows joint 3 against the horizontal" in empty.err
    assert (cell / "empty.ls").read_bytes() != source


def test_targets_that_gain_nothing_for_certain_say_so(cell):
    """Fails if a program is rewritten by a model that may be off by more than the targets move, and nothing says so."""
    done = filter_program(cell / "runs", cell / "points.ls", payload="heavy")
    doubtful = replace(done, rows=tuple(replace(row, promised_mm=2 * row.moved_mm) for row in done.rows))
    for filtered, told in ((done, False), (doubtful, True)):
        assert any("no gain is certain" in line for line in summary_lines(cell / "points.ls", filtered)) == told


UNTAUGHT = """P[3]{
   GP1:
\tUF : 0, UT : 1,
\tJ1=  ******** deg,\tJ2=  ******** deg,\tJ3=  ******** deg
};
/END"""


def test_what_is_not_corrected_does_not_end_as_if_all_were(cell):
    """Fails if a program of which some targets stay as they are ends with 0, or does not say of what sort they are."""
    asked = ("filter", cell / "runs", cell / "points.ls", "--payload", "heavy")
    corrected = cell / "points.corrected.ls"
    (cell / "points.ls").write_bytes(PROGRAM.replace("/END", UNTAUGHT).replace("\n", "\r\n").encode())
    strict = cell.calflow(*asked, "--strict")
    assert (strict.code, corrected.exists()) == (3, False)
    assert strict.out.endswith("wrote no program: not corrected: 1 target\n")
    some = cell.calflow(*asked)
    assert (some.code, corrected.exists()) == (3, True)
    assert "not corrected, by reason: never taught 1" in some.out


@pytest.mark.parametrize(
    ("moves", "why"),
    [(True, "not corrected: 2 targets"), (False, "no target is stated by numbers")],
    ids=["untaught", "none"],
)
def test_nothing_is_written_as_corrected_that_is_not(cell, moves, why):
    """Fails if a program without a target that could be corrected leaves a file with the name of one that was."""
    text = PROGRAM.split("P[1]{")[0]
    text = text if moves else re.sub(r"(?m)^.*\bP\[\d.*\n", "", text)
    (cell / "points.ls").write_bytes(text.replace("\n", "\r\n").encode() + b"/END\r\n")
    answer = cell.calflow("filter", cell / "runs", cell / "points.ls", "--payload", "heavy")
    assert answer.code == 3, answer
    assert answer.out.endswith(f"wrote no program: {why}\n")
    assert not (cell / "points.corrected.ls").exists()


def test_a_model_that_is_not_to_be_used_moves_no_program_unasked(cell):
    """Fails if a program is rewritten by a model that its own report says not to use, and nobody asked for it."""
    table = pd.read_csv(cell / "runs" / "identify" / "accuracy.csv")
    table["mean_mm"] = table.groupby("split")["mean_mm"].transform("first")
    cell.rewrite("identify/accuracy.csv", table)
    asked = ("filter", cell / "runs", cell / "points.ls", "--payload", "heavy")
    (said,) = cell.refused(*asked)
    assert said.startswith("Do not use this model")
    assert not (cell / "points.corrected.ls").exists()
    answer = cell.calflow(*asked, "--although-unusable")
    assert answer.code == 0, answer
    assert "Do not use this model" in answer.err


def test_what_is_not_known_is_asked_for(cell):
    """Fails if a wrong option or program ends in a traceback, is passed over, or leaves a file behind."""
    wrong = [
        (("--payload", "none such"), "payload"),
        (("--tool", "1=1,2,3"), "expected X,Y,Z,W,P,R in mm and degrees"),
        (("--payload", "heavi"), "--payload: unknown payload 'heavi'; there are light, heavy, did you mean 'heavy'?"),
        (("--start", "1,2"), "expected 3 readings of the arm, found 2"),
        (("--start", "nan,1,2"), "expected finite readings"),
        (("--condition", "temperature_degC=nan"), "--condition temperature_degC: expected a finite number"),
        (("--condition", "temperature=20"), "expected one of temperature_degC"),
        (("--condition", "time_mm=20"), "expected one of temperature_degC"),
        (("--out", cell / "points.ls"), "would write over"),
        (("--summary", cell / "points.ls"), "would write over"),
        (("--summary", cell / "points.corrected.ls"), "would write over"),
    ]
    for options, told in wrong:
        answer = cell.calflow("filter", cell / "runs", cell / "points.ls", *options)
        assert (answer.code, told in answer.err) == (2, True), answer
    broken = (cell / "points.ls").read_text().replace("J2=   -40.000 deg,", "J2=   -40.000 deg")
    (cell / "points.ls").write_text(broken)
    (said,) = cell.refused("filter", cell / "runs", cell / "points.ls")
    assert said.startswith("points.ls:15: is not FANUC LS that calflow can parse")
    assert not list(Path(str(cell.path)).glob("*corrected*"))


@pytest.mark.parametrize("name", ["nothere.ls", "nothere.zip"])
def test_a_program_that_is_not_there_is_refused_in_words(cell, name):
    """Fails if a mistyped name ends in the operating system's words, or as if something had been left alone."""
    (message,) = cell.refused("filter", cell / "runs", cell / name, "--payload", "heavy")
    assert name in message
    assert "no such file or folder" in message


def test_a_program_for_another_robot_is_refused(cell):
    """Fails if six joints are given to a robot of three."""
    (cell / "home.mod").write_text(
        "MODULE M\n  CONST jointtarget home:=[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\nENDMODULE\n"
    )
    (said,) = cell.refused("filter", cell / "runs", cell / "home.mod", "--payload", "heavy")
    assert said == "home.mod:2: home has 6 joints, the robot's arm 3"


def test_conditions_that_a_program_cannot_show_are_asked_for():
    """Fails if a model that needs them goes on in silence, or the user is not told which option says them."""
    names = ("approach", "temperature", "wrench")
    needed = [NeededCondition(condition=name, effects=("e",), columns="", spread_mm=1.0) for name in names]
    check_stated(needed, names, GO_ON)
    with pytest.raises(InputError) as refused:
        check_stated(needed, (), GO_ON)
    assert len(refused.value.problems) == len(names)
    for problem in refused.value.problems:
        for words in ("--in-order", "--condition", "temperature_degC", "cannot be stated", "--without-conditions"):
            assert words in problem.message


def test_the_page_has_every_column():
    """Fails if the summary's columns and the page that explains them part."""
    told = dict(re.findall(r"^\| `(\w+)` \| (.*?) \|$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE))
    assert {one.name: one.meaning for one in columns(FilteredTarget)} == told
