"""The fleet's folder: where each robot's study, run, outcome and log are, and what the fleet has as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calflow.files.writing import inside

TABLE, TYPES, UNLIKE, CAUSES = "fleet.csv", "type_parameters.csv", "unlike.csv", "common_causes.csv"
PARTS = ("studies", "robots", "outcomes", "logs", "types")  # folders in it
REPORT, PAGE = "report.pdf", "report.html"


@dataclass(frozen=True)
class FleetFolder:
    """A fleet's folder; its paths may not exist yet, and where a link leads out of it there is an InputError."""

    path: Path

    def study(self, robot: str) -> Path:
        """A robot's study file, written from its type's."""
        return inside(self.path, f"studies/{robot}.toml")

    def run(self, robot: str) -> Path:
        """A robot's run folder."""
        return inside(self.path, f"robots/{robot}")

    def outcome(self, robot: str) -> Path:
        """What came out for a robot: that it is calibrated and how well, or that it failed and why."""
        return inside(self.path, f"outcomes/{robot}.json")

    def log(self, robot: str) -> Path:
        """What a robot's run told, line by line."""
        return inside(self.path, f"logs/{robot}.log")

    def type_robot(self, type_: str) -> Path:
        """The type's robot file with what its calibrated robots let expect of a further one."""
        return inside(self.path, f"types/{type_}.toml")

    @property
    def results(self) -> tuple[Path, ...]:
        """The tables and the reports of the whole fleet."""
        return tuple(self.path / name for name in (TABLE, TYPES, UNLIKE, CAUSES, REPORT, PAGE))
