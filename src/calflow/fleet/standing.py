"""How a fleet stands: what came of each robot so far, and which are still to be calibrated."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from calflow.files.problems import InputError, refuse
from calflow.files.writing import inside
from calflow.fleet.fleet import Fleet, FleetRobot
from calflow.fleet.fleet_folder import PARTS, FleetFolder
from calflow.fleet.outcome import Outcome, read_outcome
from calflow.fleet.planned import steps
from calflow.run_folder import NAME, read_manifest

LOOK = 0.5  # s between looks for outcomes


def default_fleet_folder(fleet: Fleet) -> Path:
    """Return where a fleet's results go unless said otherwise."""
    return Path("runs") / fleet.name


def fleet_folder(fleet: Fleet, out: Path | None) -> FleetFolder:
    """Return the folder of a fleet, which may not exist yet.

    Raises:
        InputError: it is a file, or the run folder of a study, or one of its own folders is a link that leads out of it.
    """
    folder = out or default_fleet_folder(fleet)
    if folder.exists() and not folder.is_dir():
        raise refuse("is a file; expected a fleet's folder, which may not exist yet", folder)
    if (folder / NAME).exists():
        raise refuse("is the run folder of a study; give the fleet another with --out, or another name", folder)
    for part in PARTS:
        inside(folder, part)
    return FleetFolder(folder.resolve())


def outcomes(fleet: Fleet, folder: FleetFolder) -> list[Outcome]:
    """Return what came of every robot of a fleet so far, in the order of their names."""
    return [read_outcome(folder.outcome(robot.name)) or _unknown(robot, folder) for robot in fleet.robots]


def forget_stale(fleet: Fleet, folder: FleetFolder) -> None:
    """Delete the outcomes of robots to be tried anew: those that failed, or that a run of theirs would not leave as they are.

    Snakemake looks at the dates of files, which a copy keeps, and a clock that was set back takes from others.
    """
    for robot in fleet.robots:
        if not _holds(robot, folder):
            folder.outcome(robot.name).unlink(missing_ok=True)


def _holds(robot: FleetRobot, folder: FleetFolder) -> bool:
    try:
        found = read_outcome(folder.outcome(robot.name))
        return found is not None and found.status == "calibrated" and all(step.reuse for step in steps(robot, folder))
    except InputError:
        return False


def arriving(fleet: Fleet, folder: FleetFolder, ended: Callable[[], bool]) -> Iterator[Outcome]:
    """Yield what comes of each robot from now on, as it comes, until all has ended."""
    began, told, last = time.time_ns(), set[str](), False
    while not last:
        last = ended()
        for robot in fleet.robots:
            path = folder.outcome(robot.name)
            if robot.name not in told and path.is_file() and path.stat().st_mtime_ns > began:
                told.add(robot.name)
                if found := read_outcome(path):
                    yield found
        time.sleep(0 if last else LOOK)


def _unknown(robot: FleetRobot, folder: FleetFolder) -> Outcome:
    """The outcome of a robot of which there is none: how far its run is."""
    manifest = read_manifest(folder.run(robot.name))
    begun = [name for name, entry in manifest.stages.items() if entry.status != "done"] if manifest else []
    said = f"{begun[0]} was begun" if begun else "its outcome is not written yet" if manifest else "was not begun"
    return Outcome(robot=robot.name, type=robot.type.name, status="not run", reason=said)
