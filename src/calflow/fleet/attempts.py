"""Attempts: robots' runs in a process apart, so that whatever happens to one robot happens to no other."""

from __future__ import annotations

import signal
import time
import traceback
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

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


def attempts(robots: Sequence[FleetRobot], folder: FleetFolder, minutes: float) -> Iterator[Outcome]:
    """Run robots' studies one after the other in a process apart, and yield what comes of each; a failure is an outcome too.

    Where a robot ends that process, or takes so many minutes that the process is ended, another goes on with the next robot. One
    process has many, because what is worked out once for a type of robots would else be worked out for each.
    """
    left = list(robots)
    while left:
        apart = get_context("fork")  # a copy has all libraries loaded: that takes longer than many a robot
        receiving, sending = apart.Pipe(duplex=False)
        process = apart.Process(target=_told, args=(tuple(left), folder, receiving, sending))
        process.start()
        sending.close()
        while left:
            robot = left.pop(0)
            if not receiving.poll(60.0 * minutes):
                process.kill()
                process.join()
                yield _failed(robot, _too_long(minutes))
                break
            try:
                yield receiving.recv()
            except EOFError:
                process.join()
                yield _failed(robot, _ended(process.exitcode))
                break
        process.join()


def _told(robots: Sequence[FleetRobot], folder: FleetFolder, receiving: Connection, sending: Connection) -> None:
    """Run robots' studies and tell what comes of each, as long as there is somebody to be told."""
    receiving.close()  # the copy here, which would keep the pipe open when the other process is gone
    for robot in robots:
        log = Log(folder.log(robot.name))
        try:
            sending.send(_calibrated(robot, folder, log))
        except Exception as error:  # whatever it is, it is this robot's alone
            log.say(traceback.format_exc().rstrip())
            sending.send(_failed(robot, reason(error), log.stage))


def _calibrated(robot: FleetRobot, folder: FleetFolder, log: Log) -> Outcome:
    """Write a robot's study and run it."""
    study, run_folder = folder.study(robot.name), folder.run(robot.name)
    write_study(robot, study)
    wait_until_free(run_folder)  # the process of a job that was killed may still be at work there
    made = run(load_study(study), run_folder, listener=log)
    return judged(robot.name, robot.type.name, made.results)


def _failed(robot: FleetRobot, why: str, stage: str = "") -> Outcome:
    return Outcome(robot=robot.name, type=robot.type.name, status="failed", failed_stage=stage, reason=why)


def _too_long(minutes: float) -> str:
    """Say that a robot was given up, and what to do."""
    return (
        f"it had not ended after {minutes:g} minutes and was stopped; its log says how far it came, and 'minutes_per_robot' in "
        "[fleet] gives it longer"
    )


def _ended(code: int | None) -> str:
    """Say how a process ended that told nothing."""
    if code is not None and code < 0:
        return f"its process was ended by {signal.Signals(-code).name}: by hand, for want of memory, or by a fault of a library"
    return f"its process ended without a word, with code {code}"
