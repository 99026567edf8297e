"""The doctor: a machine that lacks things is told by name what is slow, what does not work and what to do, and nothing breaks."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import metadata

import pytest

from calflow.runs import doctor
from calflow.runs.doctor import examine
from forked import forked

DOCTOR = ("-m", "calflow", "doctor")


def environment(**changed):
    """The environment, some variables of which are changed (None: not there)."""
    kept = {name: value for name, value in os.environ.items() if name not in changed}
    return kept | {name: str(value) for name, value in changed.items() if value is not None}


def asked(cwd, **changed):
    """Call the doctor in a process of its own, in such an environment."""
    return forked(*DOCTOR, cwd=cwd, env=environment(**changed))


def test_a_poor_machine_is_slow_and_can_be_relied_on(tmp_path):
    """Fails if without compiler, home, cache and UTF-8 the doctor breaks, calls it trouble, or does not say what is slow."""
    (tmp_path / "file").write_text("", encoding="utf-8")
    poor = environment(
        CC="no-such-compiler", HOME="/proc/nowhere", XDG_CACHE_HOME=None, XDG_CONFIG_HOME=None, MPLCONFIGDIR=None,
        LC_ALL="de_DE.ISO-8859-1", PYTHONIOENCODING="latin-1", CALFLOW_DATA=None, COLUMNS="300",
    )  # fmt: skip
    done = subprocess.run([sys.executable, *DOCTOR], capture_output=True, env=poor, cwd=tmp_path)
    said = done.stdout.decode("latin-1")
    assert done.returncode == 0, (said, done.stderr)
    assert "there is no C compiler 'no-such-compiler'" in said
    assert "slow because of: compiler" in said
    assert "PYTHONIOENCODING" in said
    assert b"Traceback" not in done.stderr


def test_a_cache_that_cannot_be_written_is_told(tmp_path):
    """Fails if a compiler without a folder to keep its work in counts as well."""
    (tmp_path / "file").write_text("", encoding="utf-8")
    done = asked(tmp_path, XDG_CACHE_HOME=tmp_path / "file", CALFLOW_DATA=None, COLUMNS="300")
    assert done.returncode == 0
    assert "the folder of machine code cannot be used" in done.stdout


def test_temporary_files_that_lie_elsewhere_are_told(tmp_path):
    """Fails if a folder named for temporary files that is full, or no folder, is passed over without a word."""
    (tmp_path / "file").write_text("", encoding="utf-8")
    done = asked(tmp_path, TMPDIR=tmp_path / "file", CALFLOW_DATA=None, COLUMNS="300")
    assert done.returncode == 0
    assert "is full or cannot be written to" in done.stdout
    assert "temporary files" in done.stdout.splitlines()[-2]


def test_what_must_be_mended_ends_with_1(tmp_path):
    """Fails if scripts cannot see that data would not be found."""
    done = asked(tmp_path, CALFLOW_DATA=tmp_path / "nowhere", COLUMNS="300")
    assert done.returncode == 1
    assert "names no folder" in done.stdout
    assert done.stdout.splitlines()[-1] == "to be fixed first: CALFLOW_DATA"


def test_packages_that_are_too_old_or_not_there_are_named(monkeypatch):
    """Fails if a package that calflow needs in another version passes, or one of an extra counts as trouble."""
    versions = {"numpy": "1.26.4", "rich": None, "scikit-learn": None}
    monkeypatch.setattr(doctor, "_version", lambda name: versions.get(name, "999"))
    found = {one.what: one for one in examine()}
    assert (found["numpy"].state, found["rich"].state) == ("trouble", "trouble")
    assert "1.26.4" in found["numpy"].found
    assert found["numpy"].remedy.startswith("pip install 'numpy>=")
    if "scikit-learn" in str(metadata.requires("calflow")):
        assert found["extra bench"].state == "without"
        assert found["extra bench"].remedy.startswith("pip install 'scikit-learn>=")


@pytest.mark.parametrize(("free", "state"), [(1e6, "trouble"), (1e12, "ok")])
def test_a_full_disk_is_trouble(monkeypatch, free, state):
    """Fails if a run is begun that has no room."""
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _: type("Usage", (), {"free": free}))
    assert {one.what: one.state for one in examine()}["work folder"] == state
