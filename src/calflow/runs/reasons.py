"""Reasons: why a stage runs, in words that name what changed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from calflow.run_folder import StageEntry, damage

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


def difference(name: str, old: str | None, new: str | None) -> str:
    if name.startswith(("setting ", "study's ")) and len(f"{old}{new}") < LONGEST_CHANGE:
        return f"{name} changed from {old} to {new}"
    return f"{name.removeprefix('file ').removeprefix('after ')} changed"
