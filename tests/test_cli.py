"""The command line: what its user reads, and the exit codes that scripts rely on."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path

import pandas as pd
import pytest

from calflow import cli
from calflow.commands import console
from calflow.files.words import effect_words
from calflow.reporting.section import sections
from calflow.runs.lock import locked
from calflow.templates import write_study
from conftest import Folder, in_process

HH800 = str(Path(__file__).parents[1] / "studies" / "hh800" / "study.toml")

LOADED = """
import sys
from calflow.cli import main
sys.argv = ["calflow", *sys.argv[1:]]
try:
    main()
finally:
    print(*sys.modules)
"""
COMMANDS = [
    "check",
    "compensate",
    "doctor",
    "export",
    "filter",
    "fleet",
    "history",
    "new",
    "pack",
    "plan",
    "predict",
    "report",
    "reproduce",
    "run",
    "schema",
    "simulate",
    "status",
]
HEAVY = ["casadi", "emcee", "h5py", "matplotlib", "numpy", "pandas", "pint", "pydantic", "scipy"]


def test_help_names_every_command_and_loads_nothing_heavy(small):
    """Fails if a look at the help waits for libraries that only computing needs."""
    done = small.apart("-c", LOADED, "--help")
    assert done.returncode == 0, done.stderr
    text, modules = done.stdout.rsplit("\n", 2)[0], set(done.stdout.splitlines()[-1].split())
    assert all(f"\n  {command} " in text for command in COMMANDS)
    assert not modules & set(HEAVY)
    assert small.apart("-m", "calflow", "--version").stdout == f"calflow, version {metadata.version('calflow')}\n"


@pytest.mark.parametrize(
    ("command", "unwanted"),
    [
        (("new", "another"), ["matplotlib", "pandas", "scipy.linalg", "scipy.spatial", "scipy.special"]),
        (("status", "."), ["matplotlib", "pandas", "scipy.linalg", "scipy.spatial", "scipy.special"]),
        (("check", HH800), ["emcee", "h5py", "matplotlib", "scipy.linalg", "scipy.spatial", "scipy.special"]),
    ],
)
def test_a_quick_command_loads_nothing_that_it_does_without(small, command, unwanted):
    """Fails if a command that computes little waits for libraries of tables, turns, statistics or drawing."""
    done = small.apart("-c", LOADED, *command)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "calflow.study" in loaded, done.stderr
    assert not loaded & set(unwanted)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command):
    """Fails if a command has no help."""
    answer = in_process(command, "-h")
    assert answer.code == 0
    assert "Usage" in answer.out
    assert len(answer.out.splitlines()[2].split()) > 3


def test_a_decimal_comma_is_told():
    """Fails if a number written as a table of the same country has it is refused without saying how to write it."""
    answer = in_process("validate", "run", "new.csv", "--tolerance-mm", "0,3")
    assert answer.code == 2
    assert "'0,3' has a decimal comma: write 0.3" in answer.err


@pytest.mark.parametrize("arguments", [["rn"], ["run"], ["run", "a", "b"], ["run", "--bad", "a"], ["predict", "a"]])
def test_a_wrong_call_is_explained(arguments):
    """Fails if a wrong call does something, ends in a traceback or with another exit code than 2."""
    answer = in_process(*arguments)
    assert answer.code == 2
    assert "Error: " in answer.err


def test_a_stages_name_is_told_with_the_command_that_runs_it():
    """Fails if who takes `diagnose`, of which every page speaks, for a command is told that there is none."""
    answer = in_process("diagnose", "my-robot")
    assert (answer.code, "run STUDY --stage diagnose" in answer.err) == (2, True)


@pytest.mark.parametrize(("asked", "threads"), [(None, "1"), ("3", "3")])
def test_the_program_computes_on_one_thread_unless_asked(asked, threads, monkeypatch):
    """Fails if linear algebra is shared among threads that wait for each other, or what a user asks for is not taken."""
    monkeypatch.setenv(cli.THREADS, "0")  # is put back after the test
    monkeypatch.setenv(cli.THREADS, asked) if asked else monkeypatch.delenv(cli.THREADS)
    monkeypatch.setattr(cli, "main", lambda: None)
    cli.program()
    assert os.environ[cli.THREADS] == threads


@pytest.mark.parametrize("command", ["check", "plan", "run", "status", "simulate", "report"])
def test_a_file_that_is_not_there_is_named(tmp_path, command):
    """Fails if a misspelt path ends in a traceback or is made."""
    answer = in_process(command, tmp_path / "nowhere.toml")
    assert (answer.code, answer.err) == (2, f"{tmp_path / 'nowhere.toml'}: no such file\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("nowhere", "nowhere: no such file or folder in "),
        ("empty", "study.toml: no such file: expected a study in folder "),
        ("robot.toml", "robot.toml: is a robot file: expected the study that names it"),
        ("measurements.csv", "measurements.csv: is a table: expected a study's folder"),
        ("ran/report.pdf", "report.pdf: is a PDF file: expected a study's folder"),
        ("ran", "ran: is the folder of a run: expected the study that it was run from"),
    ],
)
def test_what_is_no_study_is_told_by_what_it_is(small, given, expected):
    """Fails if another folder, a robot file or a table in a study's place ends in words about keys and TOML."""
    (small / "empty").mkdir()
    (small / "ran").mkdir()
    (small / "ran" / "manifest.json").write_text("{}")
    (small / "ran" / "report.pdf").write_bytes(b"%PDF-1.7\x80")
    answer = in_process("check", small / given)
    assert (answer.code, len(answer.err.splitlines())) == (2, 1)
    assert expected in answer.err


def test_wrong_input_ends_with_2_and_no_traceback(small):
    """Fails if a real process shows more than the problems, or scripts cannot see that it failed."""
    small.edit("robot.toml", ("a_mm = 100", "a = 100"))
    done = small.apart("-m", "calflow", "run", ".")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "robot.toml:12: joints[2].a: needs its unit in the key: a_m or a_mm or a_um\n"
    assert not (small / "runs").exists()


@pytest.mark.parametrize(("study", "code"), [(".", 0), ("nowhere", 2)])
def test_a_reader_who_leaves_changes_no_exit_code(small, study, code):
    """Fails if a command whose output nobody reads to its end, as after `| head`, ends as where the machine fails."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "calflow", "check", study]
    assert subprocess.run(command, stdout=writing, stderr=writing, cwd=small.path, check=False).returncode == code
    os.close(writing)


def test_ctrl_c_ends_with_130_and_goes_on(small):
    """Fails if a real interruption ends in a traceback, or leaves what cannot be resumed."""
    small.edit("quick.toml", ("max_steps = 60", "max_steps = 100000"), ("ess = 100", "ess = 100000000"))
    command = [sys.executable, "-m", "calflow", "run", small.path, "--out", small / "runs"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        for line in running.stdout:
            if "normal approximation" in line:
                break
        running.send_signal(signal.SIGINT)
        err = running.communicate(timeout=60)[1]
    assert running.returncode == 130, err
    assert err.strip() == "interrupted: the same command resumes where it stopped"
    assert "sample         run    did not finish last time (interrupted)" in small.calflow("plan").out


def test_ctrl_c_is_heeded_inside_a_fit(small):
    """Fails if an interruption waits for hours of fits to end, because IPOPT keeps it to itself."""
    small.edit("quick.toml", ("starts = 1", "starts = 20000"), (', "sample"]', "]"))
    small.edit("quick.toml", ("[settings.sample]\nmax_steps = 60\nblock = 20\ness = 100\n", ""))
    command = [sys.executable, "-m", "calflow", "run", small.path, "--out", small / "runs"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        for line in running.stdout:
            if line.startswith("identify: "):
                break
        time.sleep(0.7)  # well inside the fit
        running.send_signal(signal.SIGINT)
        err = running.communicate(timeout=60)[1]
    assert running.returncode == 130, err
    assert err.splitlines()[-1] == "interrupted: the same command resumes where it stopped"
    assert "identify       run    did not finish last time (interrupted)" in small.calflow("plan").out
    small.edit("quick.toml", ("starts = 20000", "starts = 1"))
    answer = small.calflow("run")
    assert answer.code == 0
    assert "select: reused" in answer.out


def test_an_interruption_that_nobody_asks_for_comes_again():
    """Fails if Ctrl-C, cleared by compiled code, is forgotten where no progress is told; or comes after the stage stopped."""
    with console.ProgressLines() as listener:
        with contextlib.suppress(KeyboardInterrupt):  # as a library's clean-up does
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012
            for _ in range(200):
                time.sleep(0.05)
        listener.stop(None)
        time.sleep(3 * console.AGAIN)


def test_trouble_of_the_machine_leaves_the_caller_alone(small, monkeypatch):
    """Fails if the command line, called from Python, ends the process that calls it."""
    import h5py  # noqa: F401  (the reason why the program itself leaves in haste)

    def full(*_):
        raise OSError("No space left on device")

    def killed(code):
        raise AssertionError("the process would be gone")

    monkeypatch.setattr(cli.os, "_exit", killed)
    monkeypatch.setattr("calflow.runs.run.execute", full)
    answer = small.calflow("run")
    assert answer.code == 1
    assert answer.err.startswith("error: No space left on device. Finished stages are kept")
    monkeypatch.setattr(sys, "argv", ["calflow", "run", str(small.path), "--out", str(small / "runs")])
    with pytest.raises(AssertionError, match="would be gone"):
        cli.program()


@pytest.fixture
def template(tmp_path, monkeypatch):
    """A new study with simulated measurements."""
    monkeypatch.delenv("CALFLOW_DATA", raising=False)
    answer = in_process("new", tmp_path / "robots" / "mine")
    assert answer.code == 0
    folder = Folder(tmp_path / "robots" / "mine")
    told = answer.out.splitlines()
    assert told[:3] == [f"wrote {folder / name}" for name in ("robot.toml", "study.toml", "truth.toml")]
    assert f"calflow check {folder.path}" in told[3]
    return folder


def test_a_new_study_says_what_it_lacks(template):
    """Fails if a study without data is accepted, or the user is not told which file is missing."""
    (told,) = template.refused("check")
    assert told.startswith("measurements.csv: no such measurement file")


def test_a_new_study_can_be_tried(template):
    """Fails if the template does not pass calflow's own checks, or its robot cannot be identified."""
    assert template.calflow("simulate", template / "truth.toml").code == 0
    answer = template.calflow("check")
    assert answer.code == 0, answer
    assert answer.out.splitlines()[0].startswith("study mine: my robot, workflow calibrate (select, identify")
    assert f"{template / 'measurements.csv'}: 180 rows, 90 poses, 62 of them to fit" in answer.out
    assert answer.out.endswith("35 parameters: geometry, joint-compliance\nok\n")
    assert template.calflow("run", "--stage", "identify").code == 0
    accuracy = pd.read_csv(template / "runs" / "identify" / "accuracy.csv")
    held = accuracy[accuracy["split"] == "holdout"]["mean_mm"]
    assert held.iloc[0] > 1 > 10 * held.iloc[-1]


def test_a_new_study_overwrites_nothing(template):
    """Fails if a study that was filled in is replaced, or one missing file is enough to go on."""
    template.edit("robot.toml", ("my robot", "their robot"))
    (template / "study.toml").unlink()
    told = template.refused("new", template.path)
    assert told == [f"{name}: is there already; nothing was written" for name in ("robot.toml", "truth.toml")]
    assert not (template / "study.toml").exists()
    assert "their robot" in (template / "robot.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("folder", "name"), [('a "robot" 1', "a-robot-1"), ("Prüfling", "Prüfling"), ("...", "study"), ("-x", "x")]
)
def test_a_new_studys_name_is_valid(tmp_path, folder, name):
    """Fails if a folder's odd name makes a study that calflow refuses."""
    write_study(tmp_path / folder)
    simulated = in_process("simulate", tmp_path / folder / "truth.toml")
    checked = in_process("check", tmp_path / folder)
    assert (simulated.code, checked.code) == (0, 0), checked
    assert checked.out.startswith(f"study {name}: ")


def test_a_new_study_in_a_files_place_is_refused(small):
    """Fails if it ends in a traceback or as trouble of the machine."""
    (told,) = small.refused("new", small / "robot.toml")
    assert told.startswith("robot.toml: is a file; expected a folder")


def test_check_says_what_it_assumed(small):
    """Fails if an assumption about the measurements is made in silence."""
    small.measure(small.rows.drop(columns=["pose", "repeat", "payload"]))
    out = small.calflow("check").out
    assert "note: no column 'pose': rows with equal joint readings and payload count as one pose (40)" in out
    assert "note: no column 'payload': no row counts as carrying light or heavy" in out


def test_check_says_first_that_repeats_contradict_a_stated_noise(small):
    """Fails if a sigma a thousand times too large passes the check without a word, or after all else."""
    small.measure(small.rows.assign(sigma_mm=40.0))
    lines = small.calflow("check").out.splitlines()
    assert lines[1].startswith("warning: The stated noise, 40 mm per axis, is ")
    assert "times too large: repeats of one pose scatter by" in lines[1]


def test_a_run_that_was_killed_is_not_running(finished):
    """Fails if what a run wrote down before it was killed is told as what it does."""
    finished.vouch(lambda manifest: manifest["stages"]["sample"].update(status="running"))
    assert "sample         interrupted" in finished.calflow("status", finished / "runs").out
    with locked(finished / "runs"):
        assert "sample         running" in finished.calflow("status", finished / "runs").out


def test_status_tells_each_stage(finished, tmp_path, monkeypatch):
    """Fails if a run folder and its study tell differently, or a stage's state, time or reason is missing."""
    by_run = finished.calflow("status", finished / "runs")
    assert by_run.code == 0
    lines = by_run.out.splitlines()
    assert lines[0] == f"{finished / 'runs'}: study small, workflow quick, calflow {metadata.version('calflow')}"
    assert [line.split()[:2] for line in lines[1:]] == [[stage, "done"] for stage in ("select", "identify", "sample")]
    assert all(line.endswith("s  ran because: was never run") for line in lines[1:])
    monkeypatch.chdir(tmp_path)
    (told,) = finished.refused("status", finished.path)
    assert told.startswith("runs/small: nothing has been run here yet")
    shutil.copytree(finished / "runs", tmp_path / "runs" / "small")
    assert finished.calflow("status", finished.path).out.splitlines()[1:] == lines[1:]
    assert finished.calflow("run", "--stage", "identify").code == 0
    reused = finished.calflow("status", finished / "runs").out.splitlines()
    assert reused[2] == f"{lines[2]}; reused since: inputs, settings, upstream results and code are unchanged"


@pytest.fixture
def at_home(finished, tmp_path, monkeypatch):
    """The finished run where its study's name puts it."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished / "runs", tmp_path / "runs" / "small")
    return finished


def test_predict_and_report_take_a_run_or_its_study(at_home, tmp_path, monkeypatch):
    """Fails if a user must know where a run folder is, or which study it is of."""
    monkeypatch.setattr("calflow.reporting.document.sections", lambda: sections()[:1])  # one page is enough
    at_home.measure(at_home.rows.drop(columns=["x_mm", "y_mm", "z_mm", "sigma_mm"]), "asked.csv")
    ways = (at_home / "runs", at_home.path, at_home / "study.toml", tmp_path / "runs" / "small")
    predicted = [in_process("predict", way, at_home / "asked.csv") for way in ways]
    assert {answer.code for answer in predicted} == {0}
    assert len({answer.out for answer in predicted}) == 1
    for way in (at_home / "runs", at_home.path, at_home / "study.toml"):
        answer = in_process("report", way)
        assert answer.code == 0, answer
    assert (at_home / "runs" / "report.pdf").exists()
    assert (tmp_path / "runs" / "small" / "report.pdf").exists()


def test_a_report_of_a_run_whose_study_is_gone_is_refused(finished, tmp_path):
    """Fails if it ends in a traceback, or the user is not told what to give instead."""
    assert finished.calflow("run").code == 0
    shutil.copytree(finished / "runs", tmp_path / "sent")
    shutil.rmtree(finished.path)
    answer = in_process("report", tmp_path / "sent")
    assert answer.code == 2
    assert "is not there any more; give the study file, and this folder with --out" in answer.err


def test_a_run_ends_with_what_it_reached(finished):
    """Fails if the accuracy is not the table's, or the folder of the results is not told."""
    lines = finished.calflow("run").out.splitlines()
    table = pd.read_csv(finished / "runs" / "identify" / "accuracy.csv")
    shown = [line.rsplit(None, 3) for line in lines[4 : 4 + len(table)]]
    assert [(row[0].strip(), row[1], float(row[2]), float(row[3])) for row in shown] == [
        (effect_words(row.model), row.split, round(row.mean_mm, 3), round(row.max_mm, 3)) for row in table.itertuples()
    ]
    judged, gained = lines[4 + len(table) :][:2]
    assert judged == "Calibrated: only measurement noise is left."
    assert gained.startswith("At poses that no fit has seen, calibration reduces the error from ")
    assert all(line.startswith("! ") for line in lines[6 + len(table) : -1])
    assert lines[-1] == f"results: {finished / 'runs'} (calflow report {finished / 'runs'} makes a PDF)"


def test_a_terminal_gets_a_bar_with_the_same_words(small, monkeypatch):
    """Fails if the bar swallows a reason or a note, breaks on brackets, or a refused study leaves it running."""
    small.measure(small.rows.drop(columns="pose"))

    class Terminal(io.StringIO):
        """An output that claims to be a terminal."""

        def isatty(self):
            return True

    monkeypatch.setattr(io, "StringIO", Terminal)
    answer = small.calflow("run", "--stage", "identify")
    shown = " ".join((answer.out + answer.err).split())
    assert answer.code == 0
    assert "identify: identify geometry and compliance (was never run)" in shown
    assert "count as one pose (40)" in shown
    assert "100%" in shown
    answer = small.calflow("run", "--stage", "identify")
    assert "identify: reused (inputs, settings" in " ".join((answer.out + answer.err).split())
    small.edit("robot.toml", ("a_mm = 100", "a = 100"))
    answer = small.calflow("run")
    assert answer.code == 2
    assert "joints[2].a: needs its unit" in answer.err


def test_a_run_tells_what_is_wrong(small):
    """Fails if two axes that were exchanged are put right without a word, or not put right."""
    swapped = small.rows.rename(columns={"x_mm": "y_mm", "y_mm": "x_mm"})
    small.measure(swapped)
    answer = small.calflow("run", "--stage", "identify")
    assert answer.code == 0
    assert "frame mirrored" in answer.out


def test_simulate_does_not_write_over_measurements(small):
    """Fails if simulated rows take the place of measured ones unasked."""
    target = small / "measurements.csv"
    target.write_text("my own rows\n", encoding="utf-8")
    (told,) = small.refused("simulate", small / "truth.toml")
    assert "--force" in told
    assert target.read_text(encoding="utf-8") == "my own rows\n"
    assert small.calflow("simulate", small / "truth.toml", "--force").code == 0


def test_an_interruption_that_a_library_swallows_is_heeded():
    """Fails if Ctrl-C, cleared by compiled code, leaves a run that goes on for hours."""
    with console.ProgressLines() as listener:
        with contextlib.suppress(KeyboardInterrupt):  # as a library's clean-up does
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            listener.advance(0.5)
