"""Signs that a terminal obeys, in files and in their names: refused in files, spelled out in what is shown."""

from __future__ import annotations

import os
import shutil

import pytest

from calflow.files.toml import beyond_toml
from conftest import Folder, in_process
from trouble.campaign import unreadable

NAMED = b"\x1b[31m\xff\n\xe2\x80\xaered"  # red from here on, no UTF-8, an end of line, and from right to left


@pytest.mark.parametrize("sign", ["\\u0000", "\\u001b[31m", "\\u0007", "\\u009b31m", "\\u007f"])
@pytest.mark.parametrize(
    ("file", "key"),
    [("study.toml", "title"), ("robot.toml", "name"), ("quick.toml", "name"), ("truth.toml", "payloads")],
)
def test_a_control_character_in_a_file_is_refused(small, sign, file, key):
    """Fails if a text that would bring a terminal, a figure or the PDF out of step is accepted, or shown as it is."""
    text = (small / file).read_text()
    lines = [line for line in text.splitlines() if not line.startswith(f"{key} = ")]
    (small / file).write_text("\n".join([f'{key} = "light{sign}"', *lines]))
    answer = in_process(*(("simulate", small / file) if file == "truth.toml" else ("check", small.path)))
    assert answer.code == 2
    assert f"{small / file}:1: {key}: expected a text that can be seen, found the control character" in answer.err
    assert unreadable(answer) == ""


def test_a_control_character_in_a_key_or_a_list_is_found():
    """Fails if keys, or members of lists, are not looked at, or the ends of lines of a text are refused."""
    raw = {"notes": "two\n\tlines", "payloads": {"li\x1bght": {"mass": 1}}, "effects": ["geometry", "joint\x00"]}
    assert [where for where, _ in beyond_toml(raw)] == [("payloads", "li\x1bght"), ("effects", 1)]


def test_what_a_terminal_obeys_is_spelled_out(finished, tmp_path):
    """Fails if the name of a folder changes what a terminal shows, or ends a command with a traceback."""
    place = Folder(tmp_path / os.fsdecode(NAMED))
    shutil.copytree(finished.path, place.path)
    again = tmp_path / os.fsdecode(b"\x9b" + NAMED)
    shutil.copytree(place / "runs", again)
    for command in (
        ("check", place.path), ("plan", place.path), ("run", place.path, "--out", place / "runs"), ("status", again),
        ("compare", place / "runs", again, "--out", tmp_path / "compared"), ("pack", again, "--out", place / "run.zip"),
        ("validate", again, place / "measurements.csv", "--out", place / "validated"), ("new", place / "new"),
    ):  # fmt: skip
        answer = in_process(*command)
        assert answer.code == 0, answer
        assert unreadable(answer) == ""
    assert "\\x1b[31m\\udcff\\n\\u202ered" in answer.out


@pytest.mark.parametrize(
    "arguments", [("\x1b[31m",), ("plan", "--\x1b[31m"), ("plan", "\x1b[31m"), ("new", "\x1b", "x\x1b")]
)
def test_what_is_asked_is_spelled_out(arguments, tmp_path, monkeypatch):
    """Fails if a refused argument is shown as it is."""
    monkeypatch.chdir(tmp_path)
    answer = in_process(*arguments)
    assert answer.code == 2
    assert unreadable(answer) == ""
    assert "\\x1b" in answer.err
