"""Writing: files are whole, lie where they are meant to, and follow no link."""

from __future__ import annotations

import os

import pytest

from calflow.files.problems import InputError
from calflow.files.writing import inside, write_whole


def test_a_link_under_a_temporary_name_is_not_followed(tmp_path, monkeypatch):
    """Fails if a file that is not complete yet is written through a link that lies there, even where its name was guessed."""
    (tmp_path / "outside").write_bytes(b"mine")
    monkeypatch.setattr("secrets.token_hex", lambda _: "guessed")
    for name in ("a.csv.part", ".guessed.part"):
        (tmp_path / name).symlink_to(tmp_path / "outside")
    with pytest.raises(FileExistsError):
        write_whole(tmp_path / "a.csv", b"theirs")
    assert (tmp_path / "outside").read_bytes() == b"mine"


def test_a_link_in_the_place_of_a_file_is_replaced(tmp_path):
    """Fails if what a link names is written to instead."""
    (tmp_path / "outside").write_bytes(b"mine")
    (tmp_path / "a.csv").symlink_to(tmp_path / "outside")
    write_whole(tmp_path / "a.csv", b"theirs")
    assert (tmp_path / "outside").read_bytes() == b"mine"
    assert (tmp_path / "a.csv").read_bytes() == b"theirs"


def test_a_write_that_fails_leaves_nothing(tmp_path, monkeypatch):
    """Fails if half a file, or its temporary one, stays where a disk is full or the program is interrupted."""
    for error in (OSError, KeyboardInterrupt):
        monkeypatch.setattr(os, "replace", lambda *_, kind=error: (_ for _ in ()).throw(kind))
        with pytest.raises(error):
            write_whole(tmp_path / "new" / "a.csv", b"theirs")
    assert not list((tmp_path / "new").iterdir())


def test_a_write_that_fails_names_the_file_that_was_asked_for(tmp_path, monkeypatch):
    """Fails if a full disk, or a folder that may not be written to, is told with the name of a temporary file."""

    def fail(*names):
        raise PermissionError(13, "Permission denied", *names[:2])

    for call in ("open", "replace"):
        with monkeypatch.context() as broken:
            broken.setattr(os, call, fail)
            with pytest.raises(PermissionError) as told:
                write_whole(tmp_path / "a.csv", b"")
        assert str(told.value) == f"[Errno 13] Permission denied: '{tmp_path / 'a.csv'}'"


def test_what_is_written_may_be_read_by_whom_the_user_lets(tmp_path):
    """Fails if a table is closed to others whose umask allows them to read it."""
    before = os.umask(0o022)
    try:
        write_whole(tmp_path / "a.csv", b"")
    finally:
        os.umask(before)
    assert (tmp_path / "a.csv").stat().st_mode & 0o777 == 0o644


def test_a_folder_that_is_a_link_leads_nowhere(tmp_path):
    """Fails if a folder on the way to a file may be a link out of the folder that the file is meant for."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "figures").symlink_to(tmp_path)
    assert inside(tmp_path / "run", "tables/a.csv") == tmp_path / "run" / "tables" / "a.csv"
    with pytest.raises(InputError, match="remove the link"):
        inside(tmp_path / "run", "figures/a.svg")
