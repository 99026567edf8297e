"""Round trip: what nothing changes stays as it is to the last byte, and a broken program is refused or rightly rewritten."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from calflow.files.problems import InputError
from calflow.programs.formats import parsed
from programs.samples import FILES, Hand, filtered

SHIFT = (0.0012, -0.0023, 0.0034, 0.0, 0.0, 0.0)
REMARKS = {".mod": "!", ".dat": ";", ".src": ";", ".ls": "", ".script": "#"}
NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_a_correction_of_nothing_changes_no_byte(name, ends):
    """Fails if blanks, ends of lines, odd characters or a number's way of being written do not survive."""
    text, choices = FILES[name]
    source = text.replace("\n", ends).encode("latin-1")
    found = filtered(parsed(source, Path(name)), Hand(), choices)
    assert found.source == source
    assert any(row.outcome == "unchanged" for row in found.rows)
    assert not any(row.outcome in ("moved", "not reached") for row in found.rows)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("change", [
    lambda source: b"\xef\xbb\xbf" + source,
    lambda source: b"\xef\xbb\xbf" + source.replace(b"\n", b"\r\n"),
    lambda source: source.replace(b"  ", b"\t"),
    lambda source: source.replace(b"\n", b"\r\n", 7),
    lambda source: source.rstrip(b"\n"),
    lambda source: source + b"\x1a",
], ids=["mark", "mark and CRLF", "tabs", "both ends", "no last end", "end of file"])  # fmt: skip
def test_files_as_editors_leave_them_survive(name, change):
    """Fails if a byte order mark, tabs, ends of lines of two kinds or a last line without one are refused or put right."""
    text, choices = FILES[name]
    for shift in ((0.0,) * 6, SHIFT):
        plain = filtered(parsed(text.encode(), Path(name)), Hand(shift), choices)
        assert filtered(parsed(change(text.encode()), Path(name)), Hand(shift), choices).source == change(plain.source)


@pytest.mark.parametrize("name", FILES)
def test_bytes_that_are_no_ascii_survive_in_remarks(name):
    """Fails if a remark in another encoding is changed, or refused."""
    text, choices = FILES[name]
    if not REMARKS[Path(name).suffix]:
        marked = text.replace("is a remark", "ist ein Geräusch").encode("cp437")
    else:
        first, rest = text.split("\n", 1)
        marked = (
            first.encode()
            + b"\n"
            + REMARKS[Path(name).suffix].encode()
            + " Größe 日本".encode()
            + b"\xff\n"
            + rest.encode()
        )
        if name == "weld.mod":
            marked = text.replace("is a remark", "Größe 日本").encode() + b"! \xff\n"
    assert filtered(parsed(marked, Path(name)), Hand(), choices).source == marked


@pytest.mark.parametrize("name", FILES)
def test_a_shift_moves_the_targets_and_nothing_else(name):
    """Fails if a target is missed, a number that is none is taken, or the move is another."""
    text, choices = FILES[name]
    program = parsed(text.encode(), Path(name))
    moved = filtered(program, Hand(SHIFT), choices)
    again = parsed(moved.source, Path(name))
    assert [target.name for target in again.targets] == [target.name for target in program.targets]
    assert len(program.targets) >= 3
    outside = [number for target in program.targets for number in target.numbers]
    spans = sorted((number.start, number.end) for number in outside)
    assert _without(program.source, spans) == _without(
        moved.source, sorted((n.start, n.end) for target in again.targets for n in target.numbers)
    )
    outcomes = check_shifted(program, moved, again)
    assert outcomes.count("moved") >= 3


@pytest.mark.parametrize("name", FILES)
def test_a_broken_program_is_refused_or_rightly_rewritten(name):
    """Fails if one of 300 damages leads to a traceback, a refusal without a line, or to bytes changed that are no target's."""
    rng = np.random.default_rng([len(name), ord(name[-1])])
    refused = 0
    for _ in range(60):
        source = damaged(FILES[name][0], rng).encode("latin-1")
        done = rewritten(source, Path(name), FILES[name][1])
        if isinstance(done, InputError):
            assert all(problem.line for problem in done.problems), done
            refused += 1
        else:
            check_rewritten(source, Path(name), *done)
    assert 20 < refused < 50


def check_rewritten(source, path, program, same, moved, again):
    """Check that a program that was read is changed where its targets are and nowhere else, and by the shift."""
    assert same.source == source
    spans = [(number.start, number.end) for target in program.targets for number in target.numbers]
    assert all(NUMBER.fullmatch(source[start:end].replace(b" ", b"")) for start, end in spans)
    remark = REMARKS[path.suffix]
    assert not any(in_remark_or_text(source, start, remark) for start, _ in spans)
    assert [target.name for target in again.targets] == [target.name for target in program.targets]
    check_shifted(program, moved, again)


def check_shifted(program, moved, again):
    """Check that each target has the shift, or is said to be left alone and has none; the outcomes."""
    outcomes = []
    for before, after in zip(program.targets, again.targets, strict=True):
        far = after.values - before.values
        own = [row.outcome for row in moved.rows if (row.name, row.line) == (before.name, before.line)]
        assert set(own) <= {"moved", "left alone"}
        if "moved" not in own:
            assert not far.any()
        elif before.turn:  # a frame turns the shift, and keeps its length
            assert np.linalg.norm(far[:3]) == pytest.approx(np.linalg.norm(SHIFT), abs=2e-6)
        else:
            assert far == pytest.approx(np.array(SHIFT), abs=2e-6)
        outcomes += own
    return outcomes


def rewritten(source, path, choices):
    """A program, itself after a correction of nothing, after a shift, and that read again; or why it is refused."""
    try:
        program = parsed(source, path)
        moved = filtered(program, Hand(SHIFT), choices)
        return program, filtered(program, Hand(), choices), moved, parsed(moved.source, path)
    except InputError as error:
        return error


def damaged(text: str, rng: np.random.Generator) -> str:
    """A text with one damage: as typing, cutting, copying or a broken disk makes it."""
    place = int(rng.integers(len(text)))
    lines = text.split("\n")
    k = int(rng.integers(len(lines)))
    other = "0123456789.,;:-+=[]{}()\"'!#/\\ \n\tABCEJPXxepg$%&<>*_~?\x00é"
    letter = other[int(rng.integers(len(other)))]
    tokens = re.findall(r"\w+|\s+|[^\w\s]", text)
    t = int(rng.integers(len(tokens)))
    u = int(rng.integers(len(tokens)))
    swapped = list(tokens)
    swapped[t], swapped[u] = swapped[u], swapped[t]
    return [
        text[:place] + text[place + 1 :],
        text[:place] + letter + text[place:],
        text[:place] + letter + text[place + 1 :],
        text[:place],
        "\n".join(lines[:k] + lines[k + 1 :]),
        "\n".join(lines[: k + 1] + lines[k:]),
        "".join(tokens[:t] + tokens[t + 1 :]),
        "".join(tokens[: t + 1] + tokens[t:]),
        "".join(swapped),
        text[:place] + text[place + 1 : place + 2] + text[place : place + 1] + text[place + 2 :],
    ][int(rng.integers(10))]


def in_remark_or_text(source: bytes, place: int, remark: str) -> bool:
    """Whether a byte stands in a remark or a text in quotes, read apart from calflow: from the beginning of its line."""
    begin = max(source.rfind(b"\n", 0, place), source.rfind(b"\r", 0, place)) + 1
    quoted = False
    for letter in source[begin:place].decode("latin-1"):
        if letter == '"':
            quoted = not quoted
        elif remark and letter == remark and not quoted:
            return True
    return quoted


def _without(source: bytes, spans: list[tuple[int, int]]) -> bytes:
    pieces, place = [], 0
    for start, end in spans:
        pieces.append(source[place:start])
        place = end
    return b"#".join([*pieces, source[place:]])
