"""Patterns: where the files of all robots of a type are, such as `data/{robot}/measurements.csv`."""

from __future__ import annotations

import glob
import re
from pathlib import Path

ROBOT = "{robot}"  # what stands for a robot's name


def filled(pattern: str, robot: str) -> str:
    """Return a robot's file as its type's pattern has it."""
    return pattern.replace(ROBOT, robot)


def robots_of(pattern: str, folder: Path) -> list[str]:
    """Return the names that stand for `{robot}` in the files that there are, sorted; a pattern is seen from a folder."""
    parts = pattern.split(ROBOT)
    first, *again = (re.escape(part) for part in parts)
    name = re.compile(f"{first}(?P<robot>[^/]+){'(?P=robot)'.join(again)}")
    there = glob.glob("*".join(map(glob.escape, parts)), root_dir=folder)
    return sorted(found["robot"] for path in there if (found := name.fullmatch(path)))
