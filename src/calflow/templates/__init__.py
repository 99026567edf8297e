"""Templates: the files of a new study, commented, with a robot that runs as it is."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

from calflow.files.problems import InputError, Problem, refuse

FILES = ("robot.toml", "study.toml", "truth.toml")


def write_study(folder: Path) -> list[Path]:
    """Write a new study's files into a folder and return their paths.

    Raises:
        InputError: one of them is there already.
    """
    if folder.exists() and not folder.is_dir():
        raise refuse("is a file; expected a folder, which may not exist yet", folder)
    there = [folder / name for name in FILES if (folder / name).exists()]
    if there:
        raise InputError(Problem("is there already; nothing was written", path) for path in there)
    folder.mkdir(parents=True, exist_ok=True)
    study = re.sub(r"^\W+|[^\w.-]+", "-", folder.resolve().name).strip("-") or "study"
    try:
        for name in FILES:
            text = resources.files(__name__).joinpath(name).read_text(encoding="utf-8")
            (folder / name).write_text(text.replace("STUDY_NAME", study), encoding="utf-8")
    except OSError:
        for name in FILES:
            (folder / name).unlink(missing_ok=True)
        raise
    return [folder / name for name in FILES]
