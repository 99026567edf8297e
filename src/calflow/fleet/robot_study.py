"""A robot's own study: its type's, with the robot's name and measurements in it, so that every other command takes it too."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from calflow.files.problems import refuse
from calflow.files.toml import parse_toml
from calflow.files.writing import write_whole
from calflow.fleet.fleet import FleetRobot
from calflow.run_folder import beside

FOUND_BY = {"file", "url", "sha256"}  # keys that say which file the measurements are in


def write_study(robot: FleetRobot, path: Path) -> None:
    """Write a robot's study file."""
    write_whole(path, tomli_w.dumps(study_of(robot, path.parent)).encode())


def study_of(robot: FleetRobot, folder: Path) -> dict[str, Any]:
    """Return a robot's study as a file in a folder has it: paths are seen from there, so that all can be moved and packed."""
    study = robot.type.study
    raw, _ = parse_toml(study.path)
    title = {"title": f"{study.file.title}, {robot.name}"} if study.file.title else {}
    own = {"workflow": beside(folder, study.workflow_path)} if study.file.workflow.endswith(".toml") else {}
    files = [beside(folder, path) for path in robot.data]
    measured = raw.get("measurements", {})
    several = isinstance(measured, list)
    sources = [_with_file(one, file) for one, file in zip(measured if several else [measured], files, strict=True)]
    return {
        **raw, "name": robot.name, **title, "robot": beside(folder, study.robot_path), **own,
        "measurements": sources if several else sources[0],
    }  # fmt: skip


def _with_file(source: Mapping[str, Any], file: str) -> dict[str, Any]:
    return {"file": file} | {key: value for key, value in source.items() if key not in FOUND_BY}


def lacking(library: str) -> Exception:
    """Return the error for a library of the extra that is not installed, to be raised by the caller."""
    return refuse(f"a fleet needs {library}, which is not installed: pip install 'calflow[fleet]'")
