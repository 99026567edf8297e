"""Templates: the files of a new study, commented, with a robot that runs as it is."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from calflow.problems import refuse

FILES = ("robot.toml", "study.toml", "truth.toml")


def write_study(folder: Path) -> list[Path]:
    """Write a new study's files into a folder and return their paths.

    Raises:
        InputError: one of them is there already.
    """
    there = [folder / name for name in FILES if (folder / name).exists()]
    if there:
        raise refuse("is there already; nothing was written", there[0])
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name in FILES:
        text = resources.files(__name__).joinpath(name).read_text(encoding="utf-8")
        (folder / name).write_text(text.replace("STUDY_NAME", folder.resolve().name), encoding="utf-8")
        written.append(folder / name)
    return written
