"""Run folders with damaged files, and machines that lack something. The whole campaign is benchmarks/faults.py."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from conftest import Answer, in_process, without_data
from trouble.campaign import unreadable
from trouble.damage import AS_USER, DAMAGES, Sound, cut, gone, no_file, reads_everything, turned
from trouble.workplace import few_sections, workplace

ASKED = ("status", "plan", "predict", "export", "pack", "compare")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    with without_data(), few_sections():
        yield Sound.of(workplace(tmp_path_factory.mktemp("damage") / "place"), ASKED)


@pytest.mark.parametrize("damage", [cut, turned, gone, no_file], ids=lambda damage: damage.__name__)
def test_every_damaged_file_of_a_run_is_noticed(sound, damage):
    """Fails if a changed result is used, a stage whose file is damaged is reused, or a command ends in a traceback."""
    names, first = sound.files(), DAMAGES.index(damage)
    assert len(names) > 45
    asked = {"manifest.json", "inputs/workflow.toml", "diagnose/parameters.csv", *names[first :: len(names) // 3]}
    assert {name: said for name in sorted(asked) if (said := sound.wrong(name, damage, 1))} == {}


def test_what_may_not_be_read_or_written_is_told(finished):
    """Fails if a file that is another user's, or a folder to be read only, ends a command with a traceback, or half is written."""
    user = AS_USER if reads_everything() else ()
    if user and shutil.which(user[0]) is None:
        pytest.skip("this user reads everything, and setpriv is not there")

    def ask(*command):
        called = [*user, sys.executable, "-m", "calflow", *command]
        done = subprocess.run(called, capture_output=True, text=True, cwd=finished.path)
        return Answer(done.returncode, done.stdout, done.stderr)

    run, before = finished / "runs", finished.results()
    rows = finished.rows.drop(columns=["x_mm", "y_mm", "z_mm", "sigma_mm"])
    finished.measure(rows, "rows.csv")
    for name in ("identify/parameters.csv", "manifest.json"):
        (run / name).chmod(0)
        answer = ask("predict", "runs", "rows.csv", "--out", "predicted.csv")
        (run / name).chmod(0o644)
        assert answer.code in (1, 2)
        assert unreadable(answer, (1, 2)) == ""
        assert name.split("/")[-1] in answer.err
        assert not (finished / "predicted.csv").exists()
    run.chmod(0o555)
    finished.edit("study.toml", ("seed = 7", "seed = 8"))
    for command in (("pack", "runs", "--out", "runs/a.zip"), ("run", ".", "--out", "runs")):
        answer = ask(*command)
        assert answer.code == 1, answer
        assert unreadable(answer, (1,)) == ""
        assert "Permission denied" in answer.err
    run.chmod(0o755)
    assert finished.results() == before
    assert not list(run.rglob("*.part"))


def test_an_old_diagnosis_is_not_used_beside_a_new_fit(finished):
    """Fails if predictions are silently of a diagnosis that was made of other results than those of the fit beside it."""
    finished.edit("quick.toml", ('"sample"]', '"diagnose"]'))
    assert finished.calflow("run").code == 0
    rows = finished.rows.drop(columns=["x_mm", "y_mm", "z_mm", "sigma_mm"])
    finished.measure(rows, "rows.csv")
    asked = ("predict", finished / "runs", finished / "rows.csv")
    old = finished.calflow(*asked)
    assert (old.code, old.err) == (0, "")
    finished.edit("study.toml", ("holdout = 0.3", "holdout = 0.5"))
    assert finished.calflow("run", "--stage", "identify").code == 0
    new = finished.calflow(*asked)
    assert new.err == "note: without what diagnose found: diagnose was made of other results; run the study again\n"
    assert new.out != old.out


def test_a_damaged_run_is_mended_by_running_it(finished):
    """Fails if damage that was noticed is not computed anew, to the same bytes."""
    before, rng = finished.results(), np.random.default_rng(2)
    for name in ("identify/parameters.csv", "select/poses.csv", "inputs/robot.toml"):
        path = finished / "runs" / name
        turned(path, rng)
    answer = finished.calflow("run")
    assert answer.code == 0
    assert answer.out.count("was changed by hand") == 2
    assert finished.results() == before


POOR = {  # of what does not touch, several at once: a process takes longer to begin than to fit
    "no compiler, no home, ASCII": {
        **{"CC": "/nowhere/cc", "PATH": "", "HOME": None, "XDG_CACHE_HOME": None},
        **{"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    },
    "a home and a locale that are not there, another code page": {
        **{"HOME": "/nowhere/at/all", "XDG_CACHE_HOME": None, "MPLCONFIGDIR": None},
        **{"LC_ALL": "tr_TR.ISO-8859-9", "LANG": "xx_XX", "PYTHONIOENCODING": "cp1252"},
    },
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


COMMAS = """
import locale, sys
locale.setlocale(locale.LC_ALL, "")  # as a program does that shows calflow's results in its own windows
assert locale.localeconv()["decimal_point"] == ","
from calflow.cli import main
study, runs = sys.argv[1:]
for command in (["check", study], ["run", study, "--out", runs, "--stage", "identify"]):
    sys.argv = ["calflow", *command]
    main()
"""


def test_decimal_commas_of_a_locale_change_nothing(small, finished, tmp_path):
    """Fails if a figure is read or written as the locale has it, or a name is put into capitals as Turkish does."""
    made = ["localedef", "-i", "tr_TR", "-f", "UTF-8", tmp_path / "tr_TR.UTF-8"]
    if shutil.which("localedef") is None or subprocess.run(made, capture_output=True).returncode:
        pytest.skip("the locale tr_TR cannot be made here")
    given = os.environ | {"LOCPATH": str(tmp_path), "LC_ALL": "tr_TR.UTF-8"}
    checked = in_process("check", small.path).out
    done = small.forked("-c", COMMAS, small.path, small / "runs", env=given)
    assert (done.returncode, done.stderr) == (0, "")
    left = small.results()
    assert "identify/parameters.csv" in left
    assert left.items() <= finished.results().items()
    assert done.stdout.startswith(checked)
    assert done.stdout.removeprefix(checked).startswith("identify: ")


def test_a_name_that_the_terminal_cannot_show_is_spelled_out(small):
    """Fails if a study's name that a code page lacks ends a command with a traceback."""
    small.edit("study.toml", ('"small"', '"Čapek"'))
    done = small.apart("-m", "calflow", "check", small.path, env=os.environ | {"PYTHONIOENCODING": "cp1252"})
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("study \\u010capek: small")


def test_a_folder_that_cannot_be_written_is_told(small):
    """Fails if a place where nobody may write ends a run with a traceback or anything but a message."""
    done = small.forked("-m", "calflow", "run", small.path, "--out", "/sys/calflow", "--stage", "select")
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("error: /sys/calflow")
    assert done.stderr.endswith("once this is corrected, the same command goes on.\n")


BACK = """
import sys, time
real = time.time
time.time = lambda start=real(): 2 * start - real() - 1e8  # runs backwards, years ago
time.monotonic_ns, time.time_ns = time.monotonic_ns, lambda: int(1e9 * time.time())
sys.argv[0] = "calflow"
from calflow.cli import main
main()
"""


def test_a_clock_that_goes_back_changes_nothing(small, finished):
    """Fails if a result, or what is reused, depends on the time of the day or of a file."""
    for path in small.path.iterdir():
        os.utime(path, (4e9, 4e9))  # of the year 2096
    for expected in ("was never run", "reused"):
        done = small.forked("-c", BACK, "run", small.path, "--out", small / "runs")
        assert done.returncode == 0, done.stderr
        assert done.stdout.count(expected) == 3
        for path in (small / "runs").rglob("*"):
            os.utime(path, (0, 0))
    assert small.results() == finished.results()


def test_of_two_runs_at_once_one_is_told(small, finished):
    """Fails if a second run writes into a folder where one is at work, or the first gives other bytes for it."""
    command = [sys.executable, "-m", "calflow", "run", small.path, "--out", small / "runs", "--stage", "identify"]
    first = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"})
    assert first.stdout is not None
    assert first.stdout.readline().startswith("identify: ")  # so it is at work
    (told,) = small.refused("run")
    assert told.startswith("runs: another run is at work in this folder")
    first.communicate()
    assert first.returncode == 0
    left = small.results()
    assert "identify/parameters.csv" in left
    assert left.items() <= finished.results().items()
