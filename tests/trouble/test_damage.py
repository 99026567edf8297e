"""Run folders with damaged files, and machines that lack something. The whole campaign is benchmarks/faults.py."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from trouble.damage import DAMAGES, Sound, gone, turned


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_every_damaged_file_of_a_run_is_noticed(finished, damage):
    """Fails if a result is used that was changed, or a stage whose file is damaged is reused, or a command ends in a traceback."""
    sound, rng = Sound.of(finished), np.random.default_rng(1)
    names = sound.files()
    assert len(names) > 20
    asked = names[:: 1 if damage in (turned, gone) else 3]
    assert {name: said for name in asked if (said := sound.wrong(name, damage, rng))} == {}


def test_a_damaged_run_is_mended_by_running_it(finished):
    """Fails if damage that was noticed is not computed anew, to the same bytes."""
    before, rng = finished.results(), np.random.default_rng(2)
    for name in ("identify/parameters.csv", "select/poses.csv", "inputs/robot.toml"):
        path = finished / "runs" / name
        path.write_bytes(turned(path.read_bytes(), rng))
    answer = finished.calflow("run")
    assert answer.code == 0
    assert answer.out.count("was changed by hand") == 2
    assert finished.results() == before


POOR = {
    "no compiler": {"CC": "/nowhere/cc", "PATH": ""},
    "no home": {"HOME": None, "XDG_CACHE_HOME": None},
    "a home that is not there": {"HOME": "/nowhere/at/all", "XDG_CACHE_HOME": None, "MPLCONFIGDIR": None},
    "a locale that is not there": {"LC_ALL": "tr_TR.ISO-8859-9", "LANG": "xx_XX"},
    "ASCII": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "ASCII asked for": {"PYTHONIOENCODING": "ascii"},
    "another code page": {"PYTHONIOENCODING": "cp1252"},
}


@pytest.mark.parametrize("lacking", POOR.values(), ids=POOR)
def test_a_poor_machine_gives_the_same_bytes(small, finished, lacking):
    """Fails if a table depends on the compiler, the home folder or the locale, or a sign that cannot be printed ends a run."""
    given = {name: value for name, value in (os.environ | lacking).items() if value is not None}
    command = [sys.executable, "-m", "calflow", "run", small.path, "--out", small / "runs", "--stage", "identify"]
    done = subprocess.run(command, capture_output=True, env=given)
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr
    left = {name: content for name, content in small.results().items() if name.startswith("identify/")}
    assert left.items() <= finished.results().items()
    assert left


def test_a_name_that_the_terminal_cannot_show_is_spelled_out(small):
    """Fails if a study's name that a code page lacks ends a command with a traceback."""
    small.edit("study.toml", ('"small"', '"Čapek"'))
    done = small.apart("-m", "calflow", "check", small.path, env=os.environ | {"PYTHONIOENCODING": "cp1252"})
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("study \\u010capek: small")


def test_a_folder_that_cannot_be_written_is_told(small):
    """Fails if a place where nobody may write ends a run with a traceback or anything but a message."""
    done = small.apart("-m", "calflow", "run", small.path, "--out", "/sys/calflow", "--stage", "select")
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("error: [Errno ")
    assert done.stderr.endswith("when this is mended the same command goes on.\n")


BACK = """
import sys, time
real = time.time
time.time = lambda start=real(): 2 * start - real() - 1e8  # runs backwards, years ago
time.monotonic_ns, time.time_ns = time.monotonic_ns, lambda: int(1e9 * time.time())
from calflow.cli import main
sys.argv[0] = "calflow"
main()
"""


def test_a_clock_that_goes_back_changes_nothing(small, finished):
    """Fails if a result, or what is reused, depends on the time of the day or of a file."""
    for path in small.path.iterdir():
        os.utime(path, (4e9, 4e9))  # of the year 2096
    for expected in ("was never run", "reused"):
        done = small.apart("-c", BACK, "run", small.path, "--out", small / "runs")
        assert done.returncode == 0, done.stderr
        assert done.stdout.count(expected) == 3
        for path in (small / "runs").rglob("*"):
            os.utime(path, (0, 0))
    assert small.results() == finished.results()


def test_of_two_runs_at_once_one_is_told(small, finished):
    """Fails if both write into the folder, neither does, or the one that does gives other bytes."""
    command = [sys.executable, "-m", "calflow", "run", small.path, "--out", small / "runs"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    both = [subprocess.Popen(command, **pipes) for _ in range(2)]
    said = [one.communicate()[1] for one in both]
    codes = sorted(one.returncode for one in both)
    assert codes in ([0, 2], [0, 0]), said  # the second may come when the first is through
    if codes == [0, 2]:
        assert "another run is at work in this folder" in "".join(said)
    assert small.results() == finished.results()
