"""The fleet's folder: where each robot's study, run, outcome and log are, and what the fleet has as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

TABLE, TYPES, UNLIKE, CAUSES = "fleet.csv", "type_parameters.csv", "unlike.csv", "common_causes.csv"
REPORT, PAGE = "report.pdf", "report.html"


@dataclass(frozen=True)
class FleetFolder:
    """A fleet's folder; its paths may not exist yet."""

    path: Path

    def study(self, robot: str) -> Path:
        """A robot's study file, written from its type's."""
        return self.path / "studies" / f"{robot}.toml"

    def run(self, robot: str) -> Path:
        """A robot's run folder."""
        return self.path / "robots" / robot

    def outcome(self, robot: str) -> Path:
        """What came out for a robot: that it is calibrated and how well, or that it failed and why."""
        return self.path / "outcomes" / f"{robot}.json"

    def log(self, robot: str) -> Path:
        """What a robot's run told, line by line."""
        return self.path / "logs" / f"{robot}.log"

    def type_robot(self, type_: str) -> Path:
        """The type's robot file with what its calibrated robots let expect of a further one."""
        return self.path / "types" / f"{type_}.toml"

    @property
    def results(self) -> tuple[Path, ...]:
        """The tables and the reports of the whole fleet."""
        return tuple(self.path / name for name in (TABLE, TYPES, UNLIKE, CAUSES, REPORT, PAGE))
