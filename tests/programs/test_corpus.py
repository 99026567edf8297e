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
        for stem in stems if (maker, stem) not in UNSTATED
    ]  # fmt: skip


# What the interpreter does not follow (loops over an array, records in records, threads, calls over several lines, a place given
# on the way, two moves in a line): these are held to the bytes alone.
BYTES_ALONE = {
    "copied", "expert", "shared_service", "confused", "nested", "row", "circle", "forces", "threads",
}  # fmt: skip
UNSTATED = {("RAPID", "chosen"), ("RAPID", "passed")}  # targets whose moves stand in a routine that is passed them
CORPUS = [(maker, files) for maker in CELL for files in programs_of(maker)]
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
