"""A corpus: programs as makers' manuals and backups have them, and mutations of each; what moves lands, by another interpreter.

Each program is a project of its own; `<3|gun|fixture>` stands for a target by its readings, tool and frame.
"""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from calflow.files.problems import InputError
from calflow.programs.formats import read_project
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
    corrected_beside,
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
MUTATIONS = 6  # of each project
MUTATED = 1  # of each program, in one thing that means another
HANDS = 1  # of each program, in several things that mean the same
STATES = {"RAPID": as_rapid, "KRL": as_krl, "FANUC": as_fanuc, "URScript": as_urscript}
REMARK = {
    "RAPID": "! p10:=[[1,2,3],[1,0,0,0]];",
    "KRL": "; PTP {X 1,Y 2,Z 3}",
    "URScript": "# movel(p[1,2,3,0,0,0])",
    "FANUC": "",
}


@pytest.fixture(scope="module")
def landings(true_arm):
    """Of each maker its programs, with the numbers of targets too, and how many moves of each are right, follow and stay."""
    every = {}
    for maker in CELL:
        programs = [
            files for files in programs_of(maker) if not {file.partition(".")[0] for file in files} & BYTES_ALONE
        ]
        programs += [files for of, files in PROJECTS.values() if of == maker]
        before = [filled(files, STATES[maker], true_arm) for files in programs]
        counts = [
            check_landing(WHOLE[maker][2], files, done.files, done.rows)
            for files, done in zip(before, corrected_beside(before, true_arm), strict=True)
        ]
        every[maker] = list(zip(programs, before, counts, strict=True))
    return every


def test_nine_targets_of_ten_move_and_all_that_move_land(landings):
    """Fails if a program of the corpus is refused, less than nine in ten targets of it are corrected, or a move is wrong."""
    counts = [counts for every in landings.values() for _, _, counts in every]
    assert len(counts) == len(CORPUS) - len(BYTES_ALONE) + len(PROJECTS)
    assert all(landed for landed, _, _ in counts)
    assert sum(same for _, _, same in counts) <= 0.1 * sum(map(sum, counts))


def blanks(maker: str, text: str, rng: np.random.Generator) -> str:
    """Other blanks, in and after lines."""
    if maker != "FANUC":
        text = re.sub(
            r'"[^"\n]*"|,', lambda m: m.group() if m.group() != "," else (",", ", ", " ,")[rng.integers(3)], text
        )
    lines = (("\t" * (len(line) - len(line.lstrip(" ")))) + line.lstrip(" ") for line in text.split("\n"))
    return "\n".join(f"{line}{' ' * int(rng.integers(3))}" if line else line for line in lines)


def remarks(maker: str, text: str, rng: np.random.Generator) -> str:
    """Remarks that read like moves behind lines."""
    plain = re.compile(r'[^"%&;!#\\]+;?')
    return "\n".join(
        f"{line} {REMARK[maker]}" if REMARK[maker] and plain.fullmatch(line) and rng.random() < 0.5 else line
        for line in text.split("\n")
    )


def cases(maker: str, text: str, rng: np.random.Generator) -> str:
    """Words in capitals, and in small letters, where that means nothing."""
    if maker not in ("RAPID", "KRL"):
        return text
    words = re.compile(r'"[^"\n]*"|%%%[^%]*%%%|(?<![\w.])[A-Za-z_$]\w*')
    turns = (str, str.upper, str.lower)
    return words.sub(lambda m: m.group() if m.group()[0] in '"%' else turns[rng.integers(3)](m.group()), text)


def numbers(maker: str, text: str, rng: np.random.Generator) -> str:
    """Numbers with further zeros, without one before the point, or with an exponent."""
    ways = [str, lambda text: f"{text}0", lambda text: re.sub(r"^(-?)0\.", r"\1.", text)]
    ways += [] if maker == "FANUC" else [lambda text: f"{Decimal(text):E}"]
    return re.sub(r"(?<![\w.])-?\d+\.\d{2,}(?![\w.])", lambda m: ways[rng.integers(len(ways))](m.group()), text)


DECLARED = {
    "RAPID": r"(?m)(?:^ *(?:LOCAL )?(?:CONST|PERS) robtarget \w+:=[^;\n]*;\n){2,}",
    "KRL": r"(?m)(?:^ *DECL (?:E6POS|FDAT) [^\n]*\n){2,}",
    "URScript": r"(?m)(?:^ *(?:global )?Waypoint_\w+ ?=[^\n]*\n){2,}",
    "FANUC": r"(?s)(?:P\[\d[^\n]*\{\n.*?\n\};\n){2,}",
}


def declarations(maker: str, text: str, rng: np.random.Generator) -> str:
    """Declarations of targets that stand below each other, in another order."""
    part = r"(?s)P\[\d.*?\};\n" if maker == "FANUC" else r".*\n"
    return re.sub(DECLARED[maker], lambda m: "".join(rng.permutation(re.findall(part, m.group()))), text)


OPTIONS = {
    "RAPID": (r"(,\s*v\d+|,\s*z\d+)(?=,)", ("\\1", "\\1\\\\V:=100", "\\1\\\\T:=2")),
    "KRL": (r"(?m)^(\s*(?:PTP|LIN) \w+)$", ("\\1", "\\1 C_DIS", "\\1 C_PTP C_DIS")),
    "URScript": (r",\s*a ?= ?[\d.]+", ("", ", a=0.8", ", 0.8")),
    "FANUC": (r"\b(CNT\d+|FINE)\s*;", ("\\1 ;", "\\1 ACC80 ;", "\\1 Wjnt ;")),
}


def options(maker: str, text: str, rng: np.random.Generator) -> str:
    """Moves with further arguments that one may give, or without."""
    pattern, others = OPTIONS[maker]
    return re.sub(pattern, lambda m: m.expand(others[rng.integers(len(others))]), text)


def line_ends(maker: str, text: str, rng: np.random.Generator) -> str:
    """Lines that end as on other systems."""
    return text.replace("\n", ("\r\n", "\r")[rng.integers(2)])


REWRITINGS = (declarations, options, numbers, cases, blanks, remarks, line_ends)  # each takes the lines that it knows


def rewritten(maker: str, files: dict[str, bytes], rng: np.random.Generator) -> tuple[dict[str, bytes], set[str]]:
    """The same program as others would write it, and in what it is another."""
    chosen = [change for change in REWRITINGS if rng.random() < 0.7]
    texts, kinds = {file: content.decode("latin-1") for file, content in files.items()}, set[str]()
    for change in chosen:
        changed = {file: change(maker, text, rng) for file, text in texts.items()}
        kinds |= {change.__name__} if changed != texts else set()
        texts = changed
    return {file: text.encode("latin-1") for file, text in texts.items()}, kinds


@pytest.mark.parametrize("maker", CELL)
def test_a_model_that_changes_nothing_gives_a_program_back(maker, nominal_arm):
    """Fails if a byte of a program of the corpus is another, or of what it is in another's hand."""
    rng = np.random.default_rng(3)
    plain = [filled(files, STATES[maker], nominal_arm) for files in programs_of(maker)]
    before = [*plain, *(rewritten(maker, files, rng)[0] for files in plain)]
    for files, done in zip(before, corrected_beside(before, nominal_arm), strict=True):
        assert done.files == files
        assert any(row.outcome == "unchanged" for row in done.rows)


@pytest.mark.parametrize("maker", CELL)
def test_a_program_in_another_hand_is_corrected_alike(maker, landings, true_arm):
    """Fails if blanks, remarks, cases, notations of numbers, orders of declarations or further arguments change what lands."""
    rng = np.random.default_rng(13)
    expected = [counts for _, _, counts in landings[maker] for _ in range(HANDS)]
    before, kinds = zip(
        *(rewritten(maker, files, rng) for _, files, _ in landings[maker] for _ in range(HANDS)), strict=True
    )
    alike = zip(before, corrected_beside([*before], true_arm), expected, kinds, strict=True)
    for files, done, counts, kind in alike:
        assert check_landing(WHOLE[maker][2], files, done.files, done.rows) == counts, (sorted(files), kind)
    assert len(set[str]().union(*kinds)) >= {"RAPID": 7, "KRL": 7, "FANUC": 5, "URScript": 6}[maker]


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
def test_a_mutated_program_is_never_corrected_wrongly(maker, landings, true_arm):
    """Fails if a number, a tool, a frame or the order of two moves is another in a program, and a move is wrong and not named."""
    rng = np.random.default_rng(7)
    whats, before = [], []
    for files, _, _ in landings[maker]:
        cell = {CELL[maker]: files[CELL[maker]]} if CELL[maker] in files else {}
        own = {file: text for file, text in files.items() if file not in cell}
        every = [each for each in mutations(maker, own, rng) if each[0] in ("number", "tool", "frame", "order")]
        for what, changed in (every[k] for k in rng.permutation(len(every))[:MUTATED]):
            whats.append(what)
            before.append(rewritten(maker, filled({**changed, **cell}, STATES[maker], true_arm), rng)[0])
    kinds, landed = set[str](), 0
    for what, files, done in zip(whats, before, corrected_beside(before, true_arm), strict=True):
        try:
            meant = what not in ("tool", "frame")
            counts = check_landing(WHOLE[maker][2], files, done.files, done.rows, shown=False, meant=meant)
        except (KeyError, NameError):  # a name that no file states
            assert what in UNKNOWN, (what, sorted(files))
            assert done.uncorrected, (what, sorted(files))
            continue
        assert not counts[2] or done.uncorrected, (what, sorted(files))
        kinds.add(what)
        landed += sum(counts[:2])
    assert landed > 10 * MUTATED
    assert len(kinds) > 1


@pytest.mark.parametrize("project", PROJECTS)
def test_a_mutated_project_is_never_corrected_wrongly(project, true_arm):
    """Fails if, in a project that is another in one thing, a move goes elsewhere than before and not where it should."""
    maker, whole = PROJECTS[project]
    rng = np.random.default_rng(len(project))
    outcomes, refused, mutated = [], set[str](), []
    every = list(mutations(maker, whole, rng))
    for what, files in (every[k] for k in np.sort(rng.permutation(len(every))[:MUTATIONS])):
        before = filled(files, STATES[maker], true_arm)
        try:
            read_project(before, Path())
        except InputError:
            refused.add(what)
        else:
            mutated.append((what, before))
    for (what, before), done in zip(mutated, corrected_beside([one for _, one in mutated], true_arm), strict=True):
        try:
            WHOLE[maker][2]({file: one.decode("latin-1") for file, one in before.items()})
        except (KeyError, NameError, TypeError, AttributeError):  # a name that no file states any more
            assert what in UNKNOWN, what
            assert done.uncorrected, what
            continue
        try:
            meant = what not in ("tool", "frame")
            outcomes.append(check_landing(WHOLE[maker][2], before, done.files, done.rows, shown=False, meant=meant))
        except AssertionError as error:
            raise AssertionError(f"{what}: {error}") from error
        if what in ("number", "line ends", "remark", "case"):
            assert not done.uncorrected, (what, done.uncorrected)
    assert sum(map(sum, outcomes)) > 3 * MUTATIONS
    assert refused <= {"gone", "twice", "TOOL_DATA[1].Z=1"}
