"""Filtering whole projects on the command line: a folder or an archive becomes another, whole, and a stranger's is not trusted."""

from __future__ import annotations

import os
import stat
import zipfile
from io import BytesIO

import pandas as pd
import pytest

from runs.test_filter import PROGRAM

POSES = PROGRAM.replace("POINTS", "OTHER").replace("    10.000 deg", "    12.000 deg")
FILES = {
    "points.ls": PROGRAM.replace("\n", "\r\n").encode(),
    "sub/other.ls": POSES.encode(),
    "sub/errall.ls": b"ERRALL.LS  Robot Name R\r\n",
    "image.bin": bytes(range(256)),
}
BROKEN = PROGRAM.replace("J2=   -40.000 deg,", "J2=   -40.000 deg").encode()


@pytest.fixture
def cell(finished):
    """A finished run of a robot with three joints, and a project for it, in a folder and in an archive."""
    for name, content in FILES.items():
        path = finished / "backup" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    (finished / "backup.zip").write_bytes(archive(FILES))
    return finished


def archive(files, **attributes) -> bytes:
    """An archive of files, their entries with attributes."""
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as written:
        for name, content in files.items():
            info = zipfile.ZipInfo(name, (2020, 2, 3, 4, 5, 6))
            for attribute, value in attributes.items():
                setattr(info, attribute, value)
            written.writestr(info, content)
    return packed.getvalue()


def held(path) -> dict[str, bytes]:
    """The files of a folder or an archive."""
    if path.suffix == ".zip":
        with zipfile.ZipFile(path) as opened:
            return {name: opened.read(name) for name in opened.namelist()}
    return {one.relative_to(path).as_posix(): one.read_bytes() for one in path.rglob("*") if one.is_file()}


@pytest.mark.parametrize("name", ["backup", "backup.zip"])
def test_a_project_comes_out_whole_beside_the_one_that_went_in(cell, name):
    """Fails if a file is lost or one that is no program changed, if folder and archive differ, or the input is touched."""
    asked = ("filter", cell / "runs", cell / name, "--payload", "heavy", "--summary", cell / "sum.csv")
    answer = cell.calflow(*asked)
    assert answer.code == 0, answer
    out = cell / name.replace("backup", "backup.corrected")
    found = held(out)
    assert list(found) == list(FILES) or sorted(found) == sorted(FILES)
    assert {file for file in FILES if found[file] != FILES[file]} == {"points.ls", "sub/other.ls"}
    single = cell.calflow(
        "filter", cell / "runs", cell / "backup" / "points.ls", "--payload", "heavy", "--out", cell / "1.ls"
    )
    assert single.code == 0
    assert found["points.ls"] == (cell / "1.ls").read_bytes()
    assert held(cell / name) == FILES
    table = pd.read_csv(cell / "sum.csv")
    assert list(table["file"]) == ["points.ls"] * 2 + ["sub/other.ls"] * 2
    assert set(table["outcome"]) == {"moved"}
    assert cell.calflow(*asked).code == 0  # it holds the same
    (told,) = cell.refused("filter", cell / "runs", cell / name, "--payload", "light")
    assert "is there already" in told
    assert held(out) == found
    assert not list(cell.path.glob(".*part*"))


def test_a_file_that_cannot_be_read_is_named_and_stays(cell):
    """Fails if one broken program keeps all others from being corrected, or ends as if nothing were left."""
    (cell / "backup" / "broken.ls").write_bytes(BROKEN)
    asked = ("filter", cell / "runs", cell / "backup", "--payload", "heavy")
    strict = cell.calflow(*asked, "--strict")
    assert (strict.code, (cell / "backup.corrected").exists()) == (3, False)
    answer = cell.calflow(*asked)
    assert answer.code == 3
    assert "broken.ls:15" in answer.out
    assert "not read 1" in answer.out
    assert held(cell / "backup.corrected")["broken.ls"] == BROKEN


@pytest.mark.parametrize(
    ("member", "attributes", "told"),
    [
        ("../evil.ls", {}, "leads out"),
        ("/evil.ls", {}, "leads out"),
        ("C:\\evil.ls", {}, "leads out"),
        ("sub\\..\\..\\evil.ls", {}, "leads out"),
        ("link.ls", {"external_attr": (stat.S_IFLNK | 0o777) << 16}, "is a link"),
    ],
)
def test_an_archive_from_a_stranger_leads_nowhere(cell, member, attributes, told):
    """Fails if a member's name, or a link, leads out of the archive, and the archive is taken."""
    (cell / "bad.zip").write_bytes(archive({"points.ls": FILES["points.ls"], member: b"x"}, **attributes))
    there = sorted(cell.path.rglob("*"))
    said = cell.refused("filter", cell / "runs", cell / "bad.zip", "--payload", "heavy")
    assert any(told in one for one in said)
    assert sorted(cell.path.rglob("*")) == there


def test_an_archive_that_unpacks_to_more_than_it_says_is_refused(cell, monkeypatch):
    """Fails if a small archive can fill the memory, if a broken one ends in a traceback, or a name twice is taken once."""
    monkeypatch.setattr("calflow.programs.backup.MOST_BYTES", 100_000)
    (cell / "bad.zip").write_bytes(archive({"zeros.bin": bytes(200_000)}))
    assert "more than" in cell.refused("filter", cell / "runs", cell / "bad.zip")[0]
    whole = archive(FILES)
    (cell / "bad.zip").write_bytes(whole[: len(whole) // 2])
    assert "not a readable archive" in cell.refused("filter", cell / "runs", cell / "bad.zip")[0]
    twice = archive({"points.ls": FILES["points.ls"], "pointz.ls": b""}).replace(b"pointz.ls", b"points.ls")
    (cell / "bad.zip").write_bytes(twice)
    assert "twice" in cell.refused("filter", cell / "runs", cell / "bad.zip")[0]
    monkeypatch.setattr("calflow.programs.backup.MOST_FILES", 2)
    assert "more than 2 files" in cell.refused("filter", cell / "runs", cell / "backup")[0]


def test_links_of_a_folder_are_not_followed(cell):
    """Fails if a file outside is read, or copied, because a link in the folder leads there; or a pipe keeps the command waiting."""
    outside = cell / "secret.ls"
    outside.write_bytes(FILES["points.ls"])
    (cell / "backup" / "linked.ls").symlink_to(outside)
    (cell / "backup" / "around").symlink_to(cell / "backup")
    os.mkfifo(cell / "backup" / "pipe.ls")
    said = cell.refused("filter", cell / "runs", cell / "backup", "--payload", "heavy")
    assert len(said) == 3
    assert all("link" in one for one in said)
    assert not (cell / "backup.corrected").exists()


def test_what_comes_out_is_never_over_or_in_what_goes_in(cell):
    """Fails if a project can be written into itself, over itself, or over a folder that holds something else."""
    for out in (cell / "backup", cell / "backup" / "new", cell.path):
        answer = cell.calflow("filter", cell / "runs", cell / "backup", "--payload", "heavy", "--out", out, "--force")
        assert answer.code == 2, answer
    (cell / "other").mkdir()
    (cell / "other" / "mine.txt").write_text("mine")
    (told,) = cell.refused(
        "filter", cell / "runs", cell / "backup", "--payload", "heavy", "--out", cell / "other", "--force"
    )
    assert "remove it" in told
    assert held(cell / "backup") == FILES
    assert held(cell / "other") == {"mine.txt": b"mine"}


def test_what_is_no_project_is_refused(cell):
    """Fails if programs of several makers, or a folder without any, are taken."""
    (cell / "empty").mkdir()
    assert "no robot program" in cell.refused("filter", cell / "runs", cell / "empty")[0]
    (cell / "backup" / "home.mod").write_text("MODULE M\nENDMODULE\n")
    assert "several makers" in cell.refused("filter", cell / "runs", cell / "backup")[0]
