"""Jobs: the robots of a fleet in groups, each of which one process calibrates, with what it reads and what it makes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from calflow.fleet.fleet import Fleet, FleetRobot
from calflow.fleet.fleet_folder import FleetFolder
from calflow.runs.cache_key import code_digest, versions

MOST = 25  # robots in a job: what a job that dies has to look through again


@dataclass(frozen=True)
class Job:
    """Robots that one process calibrates, one after the other."""

    robots: tuple[FleetRobot, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The robots' names."""
        return tuple(robot.name for robot in self.robots)

    @property
    def inputs(self) -> tuple[Path, ...]:
        """What it reads, as far as it is there: a robot whose measurements are not fails by itself."""
        files = (path for robot in self.robots for path in (*robot.type.files, *robot.data))
        return tuple(dict.fromkeys(path.resolve() for path in files if path.is_file()))

    def outputs(self, folder: FleetFolder) -> tuple[Path, ...]:
        """What it makes: an outcome a robot."""
        return tuple(folder.outcome(name) for name in self.names)


def jobs(fleet: Fleet, size: int) -> list[Job]:
    """Return the fleet's robots in groups of a size."""
    return [Job(tuple(fleet.robots[k : k + size])) for k in range(0, len(fleet.robots), size)]


def size_for(robots: int, cores: int) -> int:
    """Return how many robots a job has: few enough for two jobs a core, many enough to start Python seldom."""
    return min(MOST, max(1, math.ceil(robots / (2 * cores))))


def made_by() -> str:
    """Return what outcomes depend on besides the files: the program."""
    return " ".join((code_digest(), *(f"{name}={version}" for name, version in versions().items())))
