"""A corpus: programs as makers' manuals and backups have them, and mutations of each; what moves lands, by another interpreter.

Each program is a project of its own; `<3|gun|fixture>` stands for a target by its readings, tool and frame.
"""

from __future__ import annotations

import re
from pathlib import Path

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
    on_disk,
    true_arm,
)  # fmt: skip

__all__ = ["nominal_arm", "true_arm"]
FOLDER = Path(__file__).parent / "corpus"
CELL = {
    "KRL": "$config.dat",
    "FANUC": "sysframe.va",
    "RAPID": "user.sys",
    "URScript": "",
}  # tools and frames of all programs


def programs_of(maker: str) -> list[dict[str, str]]:
    """The programs of a maker with what their cell states, each a project of its own."""
    folder, cell = FOLDER / maker.lower(), CELL[maker]
    stems = sorted({path.stem for path in folder.iterdir() if path.name != cell})
    return [
        {
            path.name: path.read_bytes().decode("latin-1")
            for path in sorted(folder.iterdir())
            if path.stem == stem or path.name == cell
        }
        for stem in stems
    ]


BYTES_ALONE = {"shared_service"}  # whose targets stand in another module
CORPUS = [(maker, files) for maker in CELL for files in programs_of(maker)]
PROJECTS = {  # of which maker, and their files
    "RAPID": ("RAPID", RAPID), "KRL": ("KRL", KRL), "FANUC": ("FANUC", FANUC), "URScript": ("URScript", URSCRIPT),
    "ABB backup": ("RAPID", on_disk("abb")), "KUKA backup": ("KRL", on_disk("kuka")),
}  # fmt: skip
MUTATIONS = 12  # of each project
MUTATED = 1  # mutations of each program
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
        stems = {file.partition(".")[0] for file in files}
        if stems & BYTES_ALONE:
            continue
        before = filled(files, STATES[maker], true_arm)
        after, done, unread = corrected(before, true_arm)
        assert not unread, (files, unread)
        landed, following, same = check_landing(WHOLE[maker][2], before, after, done.rows)
        assert landed
        right, other = right + landed + following, other + same
    assert other <= 0.1 * (right + other), (right, other)


CHANGES = (bytes, lambda content: content.replace(b"\n", b"\r\n"), lambda content: content.replace(b"  ", b"\t"))


@pytest.mark.parametrize("number", range(len(CORPUS)))
def test_a_model_that_changes_nothing_gives_a_program_back(number, nominal_arm):
    """Fails if a byte of a program of the corpus is another, or, of one in four, of what its lines look like after other tools."""
    maker, files = CORPUS[number]
    before = filled(files, STATES[maker], nominal_arm)
    for change in CHANGES if number % 4 == 0 else CHANGES[:1]:
        changed = {file: change(content) for file, content in before.items()}
        after, done, _ = corrected(changed, nominal_arm)
        assert after == changed
        assert any(row.outcome == "unchanged" for row in done.rows)


OTHERS = (
    ("tool", "gun", "torch"), ("tool", "torch", "gun"), ("tool", "gripper", "gun"), ("tool", "TOOL_NO 1", "TOOL_NO 2"),
    ("tool", "#TOOL,1", "#TOOL,2"), ("tool", "#TOOL,2", "#TOOL,3"), ("tool", "TOOL_DATA[3]", "TOOL_DATA[1]"),
    ("tool", "UT : 1", "UT : 2"), ("frame", "table", "fixture"), ("frame", "fixture", "table"),
    ("frame", "BASE_NO 1", "BASE_NO 2"), ("frame", "#BASE,1", "#BASE,2"), ("frame", "#BASE,2", "#BASE,1"),
    ("frame", "BASE_DATA[2]", "BASE_DATA[1]"), ("frame", "UF : 1", "UF : 2"), ("frame", "UF : 2", "UF : 1"),
)  # fmt: skip
MOVE = re.compile(r"(?i)\s*(\d+:\s*)?(MoveL|MoveJ|PTP|LIN|movej\(|movel\(|[JL] P\[)[^;\n]*;?\s*$")
UNKNOWN = ("gone", "twice", "tool", "frame")  # after which a name may be one that no file states


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
        for what, old, new in OTHERS:
            places = [m.start() for m in re.finditer(re.escape(old) + r"\b(?!\|)", text)]
            if places:
                at = places[int(rng.integers(len(places)))]
                yield what, {**files, file: text[:at] + new + text[at + len(old) :]}
        lines = text.split("\n")
        both = [i for i in range(len(lines) - 1) if MOVE.match(lines[i]) and MOVE.match(lines[i + 1])]
        if both:
            i = both[int(rng.integers(len(both)))]
            lines[i : i + 2] = lines[i + 1], lines[i]
            yield "order", {**files, file: "\n".join(lines)}
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


@pytest.mark.parametrize("maker", CELL)
def test_a_mutated_program_is_never_corrected_wrongly(maker, true_arm):
    """Fails if a number, a tool, a frame or the order of two moves is another in a program, and a move is wrong and not named."""
    rng = np.random.default_rng(7)
    kinds, landed = set[str](), 0
    for files in programs_of(maker):
        cell = {CELL[maker]: files[CELL[maker]]} if CELL[maker] in files else {}
        own = {file: text for file, text in files.items() if file not in cell}
        if {file.partition(".")[0] for file in own} & BYTES_ALONE:
            continue
        every = [each for each in mutations(maker, own, rng) if each[0] in ("number", "tool", "frame", "order")]
        for what, changed in (every[k] for k in rng.permutation(len(every))[:MUTATED]):
            before = filled({**changed, **cell}, STATES[maker], true_arm)
            after, done, unread = corrected(before, true_arm)
            assert not unread
            try:
                meant = what not in ("tool", "frame")
                counts = check_landing(WHOLE[maker][2], before, after, done.rows, shown=False, meant=meant)
            except (KeyError, NameError):  # a name that no file states
                assert what in UNKNOWN, (what, own)
                assert done.uncorrected, (what, own)
                continue
            assert not counts[2] or done.uncorrected, (what, own)
            kinds.add(what)
            landed += sum(counts[:2])
    assert landed > 10
    assert len(kinds) > 1


@pytest.mark.parametrize("project", PROJECTS)
def test_a_mutated_project_is_never_corrected_wrongly(project, true_arm):
    """Fails if, in a project that is another in one thing, a move goes elsewhere than before and not where it should."""
    maker, whole = PROJECTS[project]
    rng = np.random.default_rng(len(project))
    outcomes, refused = [], set[str]()
    every = list(mutations(maker, whole, rng))
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
            assert what in UNKNOWN, what
            assert done.uncorrected, what
            continue
        try:
            meant = what not in ("tool", "frame")
            outcomes.append(check_landing(WHOLE[maker][2], before, after, done.rows, shown=False, meant=meant))
        except AssertionError as error:
            raise AssertionError(f"{what}: {error}") from error
        if what in ("number", "line ends", "remark", "case"):
            assert not done.uncorrected, (what, done.uncorrected)
    assert sum(map(sum, outcomes)) > 3 * MUTATIONS
    assert refused <= {"gone", "twice", "TOOL_DATA[1].Z=1"}
