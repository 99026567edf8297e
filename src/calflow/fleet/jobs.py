"""Jobs: the robots of a fleet in groups, each of which one process calibrates, with what it reads and what it makes."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

from calflow.fleet.fleet import Fleet, FleetRobot
from calflow.fleet.fleet_folder import FleetFolder
from calflow.run_folder import code_digest, versions

MOST = 100  # robots in a job: with more, the time that Python takes to start would not be felt less


@dataclass(frozen=True)
class Job:
    """Robots that one process calibrates, one after the other."""

    robots: tuple[FleetRobot, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The robots' names."""
        return tuple(robot.name for robot in self.robots)

    @property
    def inputs(self) -> str:
        """The state of what it reads, as far as it is there, in a word: a robot whose measurements are not fails by itself."""
        files = {path for robot in self.robots for path in (*robot.type.files, *robot.data)}
        there = sorted((str(path.resolve()), path.stat()) for path in files if path.is_file())
        state = [(name, found.st_size, found.st_mtime_ns) for name, found in there]
        return hashlib.sha256(repr(state).encode()).hexdigest()

    def outputs(self, folder: FleetFolder) -> tuple[Path, ...]:
        """What it makes: an outcome a robot."""
        return tuple(folder.outcome(name) for name in self.names)


def jobs(fleet: Fleet, size: int) -> list[Job]:
    """Return the fleet's robots in groups of at most a size; neighbours are in different ones, so that types are spread evenly."""
    number = math.ceil(len(fleet.robots) / size)
    return [Job(fleet.robots[k::number]) for k in range(number)]


def size_for(robots: int, cores: int) -> int:
    """Return how many robots a job has where each core is to have as many jobs as another, and as few as may be."""
    each = math.ceil(robots / (MOST * cores))
    return math.ceil(robots / (each * cores))


def made_by() -> str:
    """Return what outcomes depend on besides the files: the program."""
    return " ".join((code_digest(), *(f"{name}={version}" for name, version in versions().items())))
