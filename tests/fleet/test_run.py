"""A fleet is run: every robot that can be is calibrated, whatever befalls another, and nothing is done twice."""

from __future__ import annotations

import base64
import fcntl
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import threading

import pandas as pd
import pytest
from filelock import FileLock
from PIL import Image

from calflow.files.tables import from_frame
from calflow.files.toml import read_toml
from calflow.fleet import engine
from calflow.fleet.engine import FleetFolder
from calflow.fleet.fleet import load_fleet
from calflow.fleet.standing import Outcome, read_outcome
from calflow.study import StudyFile, workflow_folder
from conftest import in_process
from fleet.plant import KILLED, ROBOTS, befalls, calibrated

SNAKEFILE = workflow_folder() / "fleet.smk"


def rows(folder) -> dict[str, Outcome]:
    """The rows of fleet.csv by robot."""
    return {one.robot: one for one in from_frame(pd.read_csv(folder / "fleet.csv"), Outcome)}


def test_a_robot_that_fails_is_named_with_its_reason_and_harms_no_other(ran):
    """Fails if one misspelt column costs a night, nobody learns which robot's and where, or it is not tried once more."""
    plant, answer = ran
    assert answer.code == 3
    assert "2 of 3 robots calibrated; 1 failed (B-2)." in answer.out
    where = plant.measurements("B-2").relative_to(plant.path)
    assert f"! B-2 (small): Failed: {where}:1: unknown column 'y_mmm', did you mean 'y_mm'?" in answer.out
    found = rows(plant.out)
    assert list(found) == ["B-2", *sorted(("A-1", "C-3"), key=lambda name: -found[name].after_mean_mm)]
    assert [found[name].status for name in ROBOTS] == ["calibrated", "failed", "calibrated"]
    assert found["A-1"].after_mean_mm < found["A-1"].before_mean_mm
    assert found["B-2"].reason.count("unknown column") == answer.out.count("unknown column") == 1


def test_a_robot_whose_process_is_killed_once_is_calibrated_when_it_is_tried_again(ran):
    """Fails if a robot for which the memory did not suffice once is given up, or others are tried again because of it."""
    plant, _ = ran
    assert len((plant / "befalls" / "ids").read_text().split()) == 2
    log = (plant.out / "snakemake.log").read_text(encoding="utf-8")
    assert log.count("Trying to restart job") == 2  # of C-3, and of B-2, which fails again


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


def test_a_run_that_ended_counts_though_its_outcome_was_deleted(ran):
    """Fails if robots that have reported count as not calibrated after the engine, stopped, deleted what its jobs had written."""
    done, _ = ran
    outcome = done.out / "outcomes" / "A-1.json"
    kept = outcome.read_bytes()
    outcome.unlink()
    try:
        assert done.fleet("status").out.splitlines()[0] == "2 of 3 robots calibrated; 1 failed (B-2)."
    finally:
        outcome.write_bytes(kept)


def test_the_report_is_one_page_and_a_table_that_sorts(ran):
    """Fails if the page overflows, or the table lacks a robot."""
    plant, _ = ran
    before = {name: (plant.out / name).read_bytes() for name in ("fleet.csv", "report.pdf", "report.html")}
    assert plant.fleet("report").code == 0
    assert before == {name: (plant.out / name).read_bytes() for name in before}
    assert b"/Type/Pages/Count 1/" in before["report.pdf"]
    page = before["report.html"].decode()
    told = [
        len(re.findall(rf'<td>(?:<a href="robots/{name}/report.html">)?{name}(?:</a>)?</td>', page)) for name in ROBOTS
    ]
    assert told == [1, 2, 1]  # who needs no look is in the table of all alone
    assert "1 robot to look at, worst first" in page
    assert "aria-sort" in page


def test_each_report_is_linked_by_a_small_picture(ran):
    """Fails if a robot's map of errors is not seen beside its name, or leads elsewhere than to its report."""
    plant, _ = ran
    run = plant.out / "robots" / "A-1"
    (run / "figures").mkdir()
    try:
        drawing = '<svg xmlns="http://www.w3.org/2000/svg" width="288pt" height="144pt"><path d="M0 0H99V99z"/></svg>'
        (run / "figures" / "region.svg").write_text(drawing, encoding="utf-8")
        (run / "report.html").write_text("A-1", encoding="utf-8")
        assert plant.fleet("report").code == 0
        page = (plant.out / "report.html").read_text(encoding="utf-8")
    finally:
        shutil.rmtree(run / "figures")
        (run / "report.html").unlink(missing_ok=True)
    assert plant.fleet("report").code == 0
    (picture,) = re.findall(r'<a href="robots/A-1/report.html"><img src="data:image/webp;base64,([^"]+)"', page)
    assert Image.open(io.BytesIO(base64.b64decode(picture))).size == (192, 96)


def test_what_was_killed_goes_on(ran, plant):
    """Fails if a kill costs more than the robot at hand, leaves a lock behind, or an outcome tells that it happened."""
    done, _ = ran
    assert "identify: reused" in (done.out / "logs" / "A-1.log").read_text(encoding="utf-8")
    unbroken = calibrated(load_fleet(plant.file), FleetFolder(plant.out), ["A-1"])
    assert read_outcome(FleetFolder(done.out).outcome("A-1")) == unbroken["A-1"]


def test_the_snakefile_is_used_by_hand(ran):
    """Fails if what calflow kept for Snakemake is not all that it needs, or a finished fleet is run again."""
    plant, _ = ran
    called = [sys.executable, "-m", "snakemake", "-s", SNAKEFILE, "--configfile", plant.out / "snakemake.json",
              "--directory", plant.out, "--cores", "1", "--dry-run"]  # fmt: skip
    done = subprocess.run(called, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Nothing to be done" in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("what", "reason"),
    [(KILLED, "its process was ended by SIGKILL"),
     ("time.sleep(3600)", "it had not ended after 0.02 minutes and was stopped")],
    ids=["killed", "endless"],
)  # fmt: skip
def test_a_robot_whose_process_is_killed_or_never_ends_is_named(plant, monkeypatch, tmp_path, what, reason):
    """Fails if a robot that hangs, or lacks memory, is not tried once more, is waited for for ever, or is left at work."""
    called = ("work", "B-2", "--minutes", 0.02, "--attempt")
    ids = befalls(what, "B-2", monkeypatch, tmp_path / "befalls")
    folder = FleetFolder(plant.out)
    assert plant.fleet(*called, 1).code == 1  # it is tried again
    assert not folder.outcome("B-2").exists()
    assert plant.fleet(*called, 2).code == 0
    found = read_outcome(folder.outcome("B-2"))
    assert (found.status, found.failed_stage) == ("failed", "")
    assert found.reason.startswith(reason)
    processes = [int(process) for process in ids.read_text().split()]
    assert len(processes) == 2
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


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
    assert plant.fleet("work", "A-1", "--minutes", 30, "--attempt", 1).code == 0
    assert read_outcome(folder.outcome("A-1")).status == "calibrated"
    assert not held.is_locked


def test_a_folder_is_snakemakes_as_long_as_it_works_there(plant):
    """Fails if a second command works beside the Snakemake of one that was killed, and each deletes the other's files."""
    plant.out.mkdir()
    began = """
import pathlib, sys
from calflow.fleet.engine import held, running

folder = pathlib.Path(sys.argv[1])
with held(folder) as lock, running([sys.executable, "-c", "import time; time.sleep(60)"], folder, lock) as process:
    print(process.pid, flush=True)
"""
    with subprocess.Popen([sys.executable, "-c", began, plant.out], stdout=subprocess.PIPE) as command:
        outlives = int(command.stdout.readline())
        command.kill()
    try:
        answer = plant.fleet("run")
        assert answer.code == 2
        assert answer.err.startswith(f"{plant.out}: Snakemake of a killed command is at work")
        assert not (plant.out / "snakemake.json").exists()
    finally:
        os.kill(outlives, signal.SIGKILL)
    with (plant.out / "snakemake.log").open("rb") as log:
        fcntl.flock(log, fcntl.LOCK_EX)  # as soon as it is gone
    with engine.held(plant.out):
        pass


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
