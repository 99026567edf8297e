"""The run folder of a stranger: no command writes, empties or deletes a file outside of it through a link in it."""

from __future__ import annotations

import pytest

from trouble.workplace import few_sections


@pytest.fixture
def outside(tmp_path):
    """A folder of the user's that no run is concerned with."""
    folder = tmp_path / "outside"
    folder.mkdir()
    for name in ("mine.svg", "accuracy.csv", "chain.h5"):
        (folder / name).write_text("mine", encoding="utf-8")
    return folder


def untouched(outside):
    """Whether the folder is as it was."""
    held = {path.name: path.read_text(encoding="utf-8") for path in outside.iterdir()}
    return held == dict.fromkeys(("mine.svg", "accuracy.csv", "chain.h5"), "mine")


@pytest.mark.parametrize("name", ["inputs/study.toml.part", "manifest.json.part"])
def test_a_temporary_file_that_is_a_link_is_not_written_through(finished, outside, name):
    """Fails if a command that writes anew what is there writes through a link beside it."""
    (finished / "runs" / name).symlink_to(outside / "mine.svg")
    with few_sections():
        assert finished.calflow("report").code == 0
    assert finished.calflow("run", "--force", "--stage", "identify").code == 0
    assert untouched(outside)


@pytest.mark.parametrize(
    ("name", "target", "command"),
    [
        (".lock", "mine.svg", "run"),
        (".partial", "", "report"),
        ("validate", "", "validate"),
        ("drift", "", "drift"),
        ("validate/measurements/figures", "", "validate"),
    ],
)
def test_a_link_out_of_the_run_folder_is_refused(finished, outside, name, target, command):
    """Fails if a command follows a link on the way to one of its outputs."""
    link = finished / "runs" / name
    link.unlink(missing_ok=True)
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(outside / target)
    asked = () if command in ("run", "report") else (finished / "runs", finished / "measurements.csv")
    *_, told = finished.refused(command, *asked)
    assert "leads out of the folder" in told
    assert untouched(outside)


def test_what_a_killed_run_was_writing_goes(finished):
    """Fails if files that were not complete when a run was killed stay for ever, under names that nobody writes again."""
    halves = [finished / "runs" / name for name in (".0123456789abcdef.part", "inputs/.0123456789abcdef.part")]
    for half in halves:
        half.write_bytes(b"half")
    assert finished.calflow("run").code == 0
    assert not any(half.exists() for half in halves)
