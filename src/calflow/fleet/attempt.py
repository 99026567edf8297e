"""An attempt: one robot's run in a process of its own, so that whatever happens to it happens to no other."""

from __future__ import annotations

import signal
import time
import traceback
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from calflow.files.problems import InputError
from calflow.fleet.fleet import FleetRobot
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.judged import judged
from calflow.fleet.outcome import Outcome
from calflow.fleet.reason import reason
from calflow.fleet.robot_study import write_study
from calflow.runs.lock import wait_until_free
from calflow.runs.run import run
from calflow.stages.stage import Stage
from calflow.study import load_study


class Log:
    """A listener that writes what a run tells into a file, and knows which stage it is in."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("w", encoding="utf-8", buffering=1)
        self.stage = ""

    def start(self, stage: Stage, reason: str) -> None:
        """Write that a stage begins, and why."""
        self.stage = stage.name
        self.say(f"{stage.name}: {stage.title} ({reason})")

    def reuse(self, stage: Stage, reason: str) -> None:
        """Write that a stage's results are reused, and why."""
        self.say(f"{stage.name}: reused ({reason})")

    def say(self, line: str) -> None:
        """Write a line."""
        self._file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line}\n")

    def advance(self, share: float) -> None:
        """Do nothing: nobody looks on."""

    def stop(self, stage: Stage) -> None:
        """Write that a stage ends before it is done."""
        self.say(f"{stage.name}: stopped")

    def finish(self, stage: Stage, seconds: float) -> None:
        """Write that a stage is done."""
        self.stage = ""
        self.say(f"{stage.name}: done in {seconds:.1f} s")


def attempt(robot: FleetRobot, folder: FleetFolder) -> Outcome:
    """Run a robot's study in a process of its own and return what came of it; a failure is an outcome too."""
    name, type_ = robot.name, robot.type.name
    try:
        write_study(robot, folder.study(name))
    except (InputError, OSError) as error:
        return _failed(name, type_, "", error)
    apart = get_context("fork")  # a copy has all libraries loaded: that takes longer than many a robot
    receiving, sending = apart.Pipe(duplex=False)
    process = apart.Process(target=_told, args=(name, type_, folder, sending))
    process.start()
    sending.close()
    try:
        outcome = receiving.recv()
    except EOFError:
        process.join()
        outcome = Outcome(robot=name, type=type_, status="failed", reason=_ended(process.exitcode))
    process.join()
    return outcome


def _told(robot: str, type_: str, folder: FleetFolder, sending: Connection) -> None:
    """Run a robot's study and tell what came of it."""
    log = Log(folder.log(robot))
    try:
        wait_until_free(folder.run(robot))  # the process of a job that was killed may still be at work there
        made = run(load_study(folder.study(robot)), folder.run(robot), listener=log)
        outcome = judged(robot, type_, made.results)
    except Exception as error:  # whatever it is, it is this robot's alone
        log.say(traceback.format_exc().rstrip())
        outcome = _failed(robot, type_, log.stage, error)
    sending.send(outcome)


def _failed(robot: str, type_: str, stage: str, error: Exception) -> Outcome:
    return Outcome(robot=robot, type=type_, status="failed", failed_stage=stage, reason=reason(error))


def _ended(code: int | None) -> str:
    """Say how a process ended that told nothing."""
    if code is not None and code < 0:
        return f"its process was ended by {signal.Signals(-code).name}: by hand, for want of memory, or by a fault of a library"
    return f"its process ended without a word, with code {code}"
