"""A small plant: three robots of one type, of which the fleet file is told by a pattern; and what its user does there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from calflow.files.problems import InputError
from calflow.fleet.calibration import calibrate
from calflow.fleet.engine import FleetFolder
from calflow.fleet.fleet import Fleet
from calflow.fleet.standing import Outcome, read_outcome
from conftest import SMALL, Answer, Folder, in_process

ROBOTS = ("A-1", "B-2", "C-3")
FLEET = """\
[fleet]
name = "plant"
title = "The small plant"

[types.small]
study = "type/study.toml"
data = "data/{robot}/measurements.csv"
"""
IDENTIFY = """\
name = "quick"
stages = ["identify"]

[settings.identify]
starts = 1
"""


@dataclass(frozen=True)
class Plant:
    """A plant's folder."""

    path: Path

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    @property
    def file(self) -> Path:
        """The fleet file."""
        return self / "plant.toml"

    @property
    def out(self) -> Path:
        """The fleet's folder."""
        return self / "out"

    def fleet(self, command: str, *arguments: object) -> Answer:
        """Run a command on the fleet file, into its folder unless told otherwise."""
        out = () if "--out" in arguments else ("--out", self.out)
        return in_process("fleet", command, self.file, *out, *arguments)

    def measurements(self, robot: str) -> Path:
        """A robot's measurements."""
        return self / "data" / robot / "measurements.csv"


def built(path: Path, measured: Path) -> Plant:
    """Build the plant in a folder; its robots have the same measurements but for some noise."""
    plant = Plant(path)
    (plant / "type").mkdir(parents=True)
    plant.file.write_text(FLEET, encoding="utf-8")
    for name in ("robot.toml", "study.toml"):
        (plant / "type" / name).write_text(SMALL[name].replace("\n[stages.select]\nposes = 8\n", ""), encoding="utf-8")
    (plant / "type" / "quick.toml").write_text(IDENTIFY, encoding="utf-8")
    for k, robot in enumerate(ROBOTS):
        plant.measurements(robot).parent.mkdir(parents=True)
        shutil.copy(measured, plant.measurements(robot))
        rows = Folder(plant.measurements(robot).parent)
        table = rows.rows
        table["x_mm"] = [f"{float(x) + 0.01 * ((j * (k + 2)) % 3 - 1):.4f}" for j, x in enumerate(table["x_mm"])]
        rows.measure(table)
    return plant


def broken(plant: Plant, robot: str) -> None:
    """Misspell a column of a robot's measurements."""
    path = plant.measurements(robot)
    path.write_text(path.read_text(encoding="utf-8").replace("y_mm", "y_mmm", 1), encoding="utf-8")


BEFALLS = """\
import sys
if {"calibrate", "ROBOT"} <= set(sys.orig_argv):
    import os, signal, time
    with open(os.environ["BEFALLEN"], "a") as told:
        told.write(f"{os.getpid()} ")
    WHAT
"""
KILLED = "os.kill(os.getpid(), signal.SIGKILL)"


def befalls(what: str, robot: str, patch: pytest.MonkeyPatch, folder: Path) -> Path:
    """Have something befall every process that calibrates a robot; return the file that has their ids."""
    folder.mkdir()
    source = BEFALLS.replace("WHAT", what).replace("ROBOT", robot)
    (folder / "sitecustomize.py").write_text(source, encoding="utf-8")
    patch.setenv("PYTHONPATH", os.pathsep.join((str(folder), os.environ.get("PYTHONPATH", ""))))
    patch.setenv("BEFALLEN", str(folder / "ids"))
    return folder / "ids"


def calibrated(fleet: Fleet, folder: FleetFolder, robots: Iterable[str]) -> dict[str, Outcome]:
    """What comes of robots, calibrated one after the other in this process."""
    for name in robots:
        with suppress(InputError):
            calibrate(fleet.robot(name), folder)
    return {name: read_outcome(folder.outcome(name)) for name in robots}
