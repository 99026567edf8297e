"""A full disk. The whole campaign is benchmarks/faults.py."""

from __future__ import annotations

import shutil

import pytest

from conftest import Answer
from trouble.campaign import unreadable
from trouble.disk import LARGE, NoMount, disk, resize, used
from trouble.kills import tables
from trouble.workplace import Workplace


def test_a_full_disk_is_told_and_what_it_stopped_goes_on(finished, tmp_path):
    """Fails if a disk that fills up ends it with a traceback or another message, or leaves half a file, or later other tables."""
    try:
        with disk(tmp_path / "disk") as at:
            whole = tables(finished / "runs")
            shutil.copytree(finished.path, at / "study", ignore=shutil.ignore_patterns("runs"))
            resize(at, used(at) + (128 << 10))
            study = at / "study"
            answer = finished.forked("-m", "calflow", "run", study, "--out", study / "runs")
            assert unreadable(Answer(answer.returncode, answer.stdout, answer.stderr), (1,)) == ""
            assert "No space left on device" in answer.stderr
            assert answer.stderr.endswith("once this is corrected, the same command goes on.\n")
            assert not list(study.rglob("*.part"))
            resize(at, LARGE)
            assert Workplace(study).ask(("run", ".", "--out", "runs")).code == 0
            assert tables(study / "runs") == whole
    except NoMount as reason:
        pytest.skip(f"a file system of its own cannot be mounted: {reason}")
