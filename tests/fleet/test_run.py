"""A fleet is run: every robot that can be is calibrated, whatever befalls another, and nothing is done twice."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing import active_children

import pandas as pd
from filelock import FileLock

from calflow.files.tables import from_frame
from calflow.files.toml import read_toml
from calflow.fleet import engine
from calflow.fleet.attempts import attempts
from calflow.fleet.fleet import load_fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.outcome import Outcome
from calflow.study import StudyFile, load_study, workflow_folder
from conftest import in_process
from fleet.plant import ROBOTS, broken, mended

SNAKEFILE = workflow_folder() / "fleet.smk"
MINUTES = 30.0  # that a robot may take


def rows(folder) -> dict[str, Outcome]:
    """The rows of fleet.csv by robot."""
    return {one.robot: one for one in from_frame(pd.read_csv(folder / "fleet.csv"), Outcome)}


def test_a_robot_that_fails_is_named_with_its_reason_and_harms_no_other(ran):
    """Fails if one misspelt column costs a night, or nobody learns which robot's and where."""
    plant, answer = ran
    assert answer.code == 3
    assert "2 of 3 robots calibrated; 1 failed (B-2)." in answer.out
    assert (
        f"! B-2 (small): Failed: {plant.measurements('B-2')}:1: unknown column 'y_mmm', did you mean 'y_mm'?"
        in answer.out
    )
    found = rows(plant.out)
    assert list(found) == ["B-2", *sorted(("A-1", "C-3"), key=lambda name: -found[name].after_mean_mm)]
    assert [found[name].status for name in ROBOTS] == ["calibrated", "failed", "calibrated"]
    assert found["A-1"].after_mean_mm < found["A-1"].before_mean_mm
    assert found["B-2"].reason.count("unknown column") == 1


def test_a_robot_of_a_fleet_is_what_it_is_alone(ran):
    """Fails if a fleet calibrates otherwise than `calflow run`, or its run folder is of no use to other commands."""
    plant, _ = ran
    alone = plant / "alone"
    assert in_process("run", plant.out / "studies" / "A-1.toml", "--out", alone).code == 0
    for name in ("parameters", "accuracy", "covariance"):
        assert (alone / "identify" / f"{name}.csv").read_bytes() == (
            plant.out / f"robots/A-1/identify/{name}.csv"
        ).read_bytes()
    assert in_process("status", plant.out / "robots" / "A-1").code == 0
    assert in_process("pack", plant.out / "robots" / "A-1", "--out", plant / "A-1.zip").code == 0
    assert read_toml(plant.out / "robots" / "A-1" / "inputs" / "study.toml", StudyFile).name == "A-1"


def test_plan_and_status_say_how_far_it_is(ran, plant):
    """Fails if a user cannot see before and after which robots are done, which failed, and why."""
    done, _ = ran
    told = done.fleet("plan").out.splitlines()
    assert [line.split()[2] for line in told] == ["reuse", "would", "reuse"]  # fail again
    answer = done.fleet("status")
    assert (answer.code, answer.out.splitlines()[0]) == (0, "2 of 3 robots calibrated; 1 failed (B-2).")
    assert "B-2 (small): Failed: " in answer.out
    assert all("was never run" in line for line in plant.fleet("plan").out.splitlines())
    assert plant.fleet("status").out.splitlines()[0] == "0 of 3 robots calibrated; 3 not run (A-1, B-2 and C-3)."


def test_the_report_is_one_page_and_a_table_that_sorts(ran):
    """Fails if the page overflows, or the table lacks a robot."""
    plant, _ = ran
    before = {name: (plant.out / name).read_bytes() for name in ("fleet.csv", "report.pdf", "report.html")}
    assert plant.fleet("report").code == 0
    assert before == {name: (plant.out / name).read_bytes() for name in before}
    assert b"/Type/Pages/Count 1/" in before["report.pdf"]
    page = before["report.html"].decode()
    assert [page.count(f"<td>{name}</td>") for name in ROBOTS] == [2] * 3
    assert "aria-sort" in page


def test_what_was_killed_goes_on_and_what_failed_is_tried_again(ran, plant):
    """Fails if a kill costs more than the robot at hand, leaves a lock behind, or the tables tell that it happened."""
    broken(plant, "B-2")
    called = [
        sys.executable,
        "-m",
        "calflow",
        "fleet",
        "run",
        plant.file,
        "--out",
        plant.out,
        "--cores",
        "1",
        "--batch",
        "3",
    ]
    apart = subprocess.Popen(called, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (plant.out / "outcomes" / "A-1.json").exists():
        assert apart.poll() is None
        time.sleep(0.02)
    os.killpg(apart.pid, signal.SIGKILL)
    apart.wait()
    assert not (plant.out / "fleet.csv").exists()
    assert plant.fleet("report").code == 0  # of what there is, which is no reason not to go on
    mended(plant, "B-2")
    answer = plant.fleet("run", "--cores", 1, "--batch", 3)
    assert answer.code == 0
    assert "3 of 3 robots calibrated." in answer.out
    assert "identify: reused" in (plant.out / "logs" / "A-1.log").read_text(encoding="utf-8")
    unbroken = (ran[0].out / "fleet.csv").read_text(encoding="utf-8").splitlines()
    lines = (plant.out / "fleet.csv").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if "B-2" not in line] == [line for line in unbroken if "B-2" not in line]


def test_the_snakefile_is_used_by_hand(ran):
    """Fails if what calflow kept for Snakemake is not all that it needs, or a finished fleet is run again."""
    plant, _ = ran
    called = [sys.executable, "-m", "snakemake", "-s", SNAKEFILE, "--configfile", plant.out / "snakemake.json",
              "--directory", plant.out, "--cores", "1", "--dry-run"]  # fmt: skip
    done = subprocess.run(called, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Nothing to be done" in done.stdout + done.stderr


def run_with(befalls: Callable[[], object], monkeypatch, plant, minutes: float) -> list[Outcome]:
    """What comes of the plant's robots where something befalls the process of the second while it is at work."""

    def read(path):
        if path.stem == ROBOTS[1]:
            befalls()
        return load_study(path)

    monkeypatch.setattr("calflow.fleet.attempts.load_study", read)
    return list(attempts(load_fleet(plant.file).robots, FleetFolder(plant.out), minutes))


def test_a_robot_whose_process_is_killed_is_named_and_harms_no_other(plant, monkeypatch):
    """Fails if a robot for which the memory does not suffice takes the others of its job with it."""
    found = run_with(lambda: os.kill(os.getpid(), signal.SIGKILL), monkeypatch, plant, MINUTES)
    assert [one.robot for one in found] == list(ROBOTS)
    assert [one.status for one in found] == ["calibrated", "failed", "calibrated"]
    assert found[1].reason.startswith("its process was ended by SIGKILL")
    monkeypatch.undo()
    left = load_fleet(plant.file).robots[1:2]
    assert [one.status for one in attempts(left, FleetFolder(plant.out), MINUTES)] == ["calibrated"]


def test_a_robot_that_never_ends_is_stopped_and_harms_no_other(plant, monkeypatch):
    """Fails if one robot that hangs keeps those after it from being calibrated, or is left at work."""
    fleet, folder = load_fleet(plant.file), FleetFolder(plant.out)
    list(attempts(fleet.robots, folder, MINUTES))  # those that do not hang end at once the next time
    found = run_with(lambda: time.sleep(3600), monkeypatch, plant, 0.1)
    assert [one.status for one in found] == ["calibrated", "failed", "calibrated"]
    assert found[1].reason.startswith("it had not ended after 0.1 minutes and was stopped")
    assert not active_children()


def test_a_limit_that_is_no_time_is_refused(plant):
    """Fails if a fleet whose every robot would be stopped at once is begun."""
    plant.file.write_text(plant.file.read_text(encoding="utf-8").replace("[fleet]", "[fleet]\nminutes_per_robot = 0"))
    answer = plant.fleet("plan")
    assert answer.code == 2
    assert "minutes_per_robot" in answer.err


def test_a_job_waits_for_one_that_outlived_its_command(plant):
    """Fails if a robot is said to have failed because the job of a command that was killed is still at work on it."""
    folder = FleetFolder(plant.out)
    folder.run("A-1").mkdir(parents=True)
    held = FileLock(folder.run("A-1") / ".lock", thread_local=False)
    held.acquire()
    threading.Timer(0.5, held.release).start()
    assert [one.status for one in attempts(load_fleet(plant.file).robots[:1], folder, MINUTES)] == ["calibrated"]
    assert not held.is_locked


def test_what_is_not_installed_is_told_in_one_line(plant, monkeypatch):
    """Fails if a user without the extra sees a traceback, or something is begun."""
    monkeypatch.setattr(engine, "find_spec", lambda name: None if name == "snakemake" else name)
    answer = plant.fleet("run")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == "a fleet needs Snakemake, which is not installed: pip install 'calflow[fleet]'\n"
    assert not plant.out.exists()


def test_a_studys_run_folder_is_not_taken_for_a_fleets(ran, tmp_path):
    """Fails if a fleet's files are strewn over a run."""
    plant, _ = ran
    shutil.copytree(plant.out / "robots" / "A-1", tmp_path / "run")
    answer = plant.fleet("run", "--out", tmp_path / "run")
    assert answer.code == 2
    assert "is the run folder of a study" in answer.err
