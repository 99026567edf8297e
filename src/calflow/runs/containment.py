"""Containment: no name in a manifest, and no link in a run folder, leads out of the folder."""

from __future__ import annotations

from pathlib import Path

from calflow.files.problems import refuse


def contained(folder: Path, name: str) -> Path | None:
    """Return the path of a name in a folder; None where it lies outside, on any system and through any link."""
    parts = name.split("/")
    if any(part in ("", ".", "..") for part in parts) or set(name) & set("\\:\0"):  # a drive letter has a colon
        return None
    path = folder.joinpath(*parts)
    try:
        return path if path.resolve().is_relative_to(folder.resolve()) else None
    except (OSError, RuntimeError):  # a name that is too long, or links that go round
        return None


def inside(folder: Path, name: str) -> Path:
    """Return the path of a name in a folder.

    Raises:
        InputError: a link leads out of the folder there.
    """
    path = contained(folder, name)
    if path is None:
        raise refuse(
            "leads out of the run folder: nothing is read, written or deleted there; remove the link", folder / name
        )
    return path
