"""Reasons: why a stage runs, in words that name what changed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from calflow.measurements.reading import sha256
from calflow.robot.robot import Robot
from calflow.runs.cache_key import after, robot_digest
from calflow.runs.manifest import Manifest, StageEntry

UNCHANGED = "inputs, settings, upstream results and code are unchanged"
FORCED = "forced"
LONGEST_CHANGE = 200  # characters of an old and a new value that a reason still shows


def reason(before: StageEntry | None, key: Mapping[str, str], folder: Path, run_again: Collection[str]) -> str | None:
    """Return why a stage must run; None where its results can be reused. run_again names earlier stages that run."""
    if before is None:
        return "was never run"
    if before.status != "done":
        return f"did not finish last time ({before.status})"
    again = [name for name in run_again if f"after {name}" in key]
    if again:
        return f"{again[0]} runs again"
    old = before.key
    changed = [name for name in {**old, **key} if old.get(name) != key.get(name)]
    if changed:
        return "; ".join(difference(name, old.get(name), key.get(name)) for name in changed)
    return damage(before, folder)


def damage(entry: StageEntry, folder: Path) -> str | None:
    """Return what happened to a stage's files since it wrote them; None where they are as they were."""
    for name, digest in (entry.outputs or {}).items():
        if not (folder / name).is_file():
            return f"{name} is missing"
        if sha256(folder / name) != digest:
            return f"{name} was changed by hand"
    return None


def outdated(manifest: Manifest, folder: Path, stage: str, robot: Robot) -> str | None:
    """Return why a stage's results do not hold for a robot; None where they do."""
    entry = manifest.stages.get(stage)
    if entry is None:
        return f"{stage} was never run"
    if entry.status != "done":
        return f"{stage} did not finish ({entry.status})"
    if robot_digest(robot) not in entry.key.values():
        return f"the robot file changed after {stage} ran"
    return damage(entry, folder)


def of_others(manifest: Manifest, stage: str, bases: Collection[str]) -> str | None:
    """Return that a stage's results are of others than those of its bases that are there; None where they are of these."""
    made = {name: key for name, key in manifest.stages[stage].key.items() if name.startswith("after ")}
    same = made == after({name: manifest.stages[name].key for name in bases})
    return None if same else f"{stage} was made of other results"


def difference(name: str, old: str | None, new: str | None) -> str:
    if name.startswith(("setting ", "study's ")) and len(f"{old}{new}") < LONGEST_CHANGE:
        return f"{name} changed from {old} to {new}"
    return f"{name.removeprefix('file ').removeprefix('after ')} changed"
