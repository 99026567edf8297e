"""Pages whose commands are run when the site is built, and the pictures that they show of what came out."""

from __future__ import annotations

import contextlib
import os
import shlex
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

from made.walk import SHOWN, ended_well, follow, picture, pictures

DOCS = Path(__file__).parents[1]
PAGES = {"index": "", "gallery": "", "tutorial": "fanuc-r2000"}  # and the folder of `CALFLOW_DATA` that they need


@cache
def made() -> dict[str, bytes]:
    """Every picture of the pages that can be followed here, by its path."""
    answer: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name in filter(can_be_made, PAGES):
            page = (DOCS / f"{name}.md").read_text(encoding="utf-8")
            follow(page, run)
            answer |= {path: picture(path) for path in pictures(page)}
    return answer


def can_be_made(page: str) -> bool:
    """Whether the measurements that a page needs are here."""
    return not PAGES[page] or Path(os.environ.get("CALFLOW_DATA", os.devnull), PAGES[page]).is_dir()


def without_pictures(markdown: str) -> str:
    """Return a page without the pictures of what was not made here."""
    return SHOWN.sub("", markdown)


def run(line: str) -> str:
    """Run a command of a page; what it printed.

    Raises:
        AssertionError: it failed.
    """
    answer = subprocess.run(
        [sys.executable, "-m", *shlex.split(line)], capture_output=True, text=True, encoding="utf-8"
    )
    assert ended_well(line, answer.returncode), f"{line}\n{answer.stdout}{answer.stderr}"
    return answer.stdout + answer.stderr
