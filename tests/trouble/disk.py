"""A full disk: commands on a file system of their own that has little left, asked again when there is space.

Each must end with one message and nothing half written, and the same command again with what it would have made at once.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calflow.measurements.source import sha256
from conftest import Answer
from trouble.campaign import unreadable
from trouble.kills import tables
from trouble.workplace import Workplace

LARGE, LEAST, MOST = (
    256 << 20,
    4 << 10,
    3 << 20,
)  # bytes of the disk with space, and that are left of it at least and at most
TROUBLE = 1
# the report has two sections only, so that it takes no longer than all the rest
FEW = """
import sys
from calflow.reporting import document
first = document.sections()[:2]
document.sections = lambda: first
from calflow.cli import program
sys.argv[0] = "calflow"
program()
"""
ASKED = {
    "run": ("run", ".", "--out", "new"),
    "report": ("report", "runs"),
    "pack": ("pack", "runs", "--out", "run.zip"),
    "fleet": ("fleet", "run", "plant/plant.toml", "--out", "fleet", "--cores", "1"),
}
ARCHIVE = "run.zip"


class NoMount(Exception):
    """This user may not mount a file system."""


@dataclass(frozen=True)
class Filled:
    """What came of a case: the command, the bytes left, whether temporary files lie there too, the exit code, and what is wrong."""

    number: int
    command: str
    left: int
    temporary: bool
    code: int
    wrong: str = ""


@contextmanager
def disk(at: Path) -> Iterator[Path]:
    """Mount a file system in memory.

    Raises:
        NoMount: this user may not.
    """
    at.mkdir(parents=True, exist_ok=True)
    _mount("-t", "tmpfs", "-o", f"size={LARGE}", "tmpfs", str(at))
    try:
        yield at
    finally:
        subprocess.run(["umount", "--lazy", str(at)], check=True)


def at_once(place: Workplace, at: Path) -> dict[str, dict[str, str]]:
    """Return what each command makes where there is space."""
    made = {}
    for command in ASKED:
        with disk(at):
            here = _copied(place, at)
            answer = ask(here, command)
            assert answer.code == 0, answer
            made[command] = _made(here)
    return made


def filled(whole: dict[str, dict[str, str]], place: Workplace, at: Path, seed: int, number: int) -> Filled:
    """Ask a command on a disk with little space, then with enough, and say what was wrong; whole is what each makes at once."""
    rng = np.random.default_rng((seed, number))
    command = list(ASKED)[number % len(ASKED)]
    temporary = bool(rng.random() < 0.5)
    with disk(at):
        here, elsewhere = _copied(place, at), at if temporary else None
        left = int(np.exp(rng.uniform(np.log(LEAST), np.log(MOST))))
        resize(at, used(at) + left)
        answer = ask(here, command, elsewhere)
        wrong = list(_refused(here, command, answer))
        resize(at, LARGE)
        again, expected = ask(here, command, elsewhere), whole[command]
        if again.code != 0 or "Traceback" in again.err:
            wrong.append(f"asked again ends with {again.code}: {again.err[-300:]}")
        made = _made(here)
        differs = [name for name in {**expected, **made} if expected.get(name) != made.get(name)]
        if differs:
            wrong.append(f"asked again makes other {', '.join(differs)}")
    return Filled(number, command, left, temporary, answer.code, "; ".join(wrong))


def ask(place: Workplace, command: str, temporary: Path | None = None) -> Answer:
    """Call the command line in a workplace, with temporary files and caches elsewhere, or in a folder."""
    given = dict(os.environ)
    if temporary is not None:
        given |= dict.fromkeys(("TMPDIR", "HOME", "XDG_CACHE_HOME", "MPLCONFIGDIR"), str(temporary / "tmp"))
    done = subprocess.run(
        [sys.executable, "-c", FEW, *ASKED[command]], capture_output=True, text=True, cwd=place.path, env=given
    )
    return Answer(done.returncode, done.stdout, done.stderr)


def _copied(place: Workplace, at: Path) -> Workplace:
    shutil.copytree(place.path, at / "place")
    (at / "tmp").mkdir()
    return Workplace(at / "place")


def _made(place: Workplace) -> dict[str, str]:
    """Return the hash of each table that is there, and of the archive."""
    archive = place.path / ARCHIVE
    return tables(place.path) | ({ARCHIVE: sha256(archive)} if archive.exists() else {})


def _refused(place: Workplace, command: str, answer: Answer) -> Iterator[str]:
    """Say what is wrong with what a command said and left on a full disk."""
    if said := unreadable(answer, (0, TROUBLE, *([3] if command == "fleet" else []))):
        yield said
    if answer.code == TROUBLE and "No space left on device" not in answer.err:
        yield f"does not say why: {answer.err[:300]}"
    if halves := [path.name for path in place.path.rglob("*.part")]:
        yield f"left {', '.join(halves)} half written"
    if answer.code != 0 and (place.path / ARCHIVE).exists():
        yield "left an archive"


def used(at: Path) -> int:
    """Return how many bytes of a file system are taken."""
    said = os.statvfs(at)
    return (said.f_blocks - said.f_bfree) * said.f_frsize


def resize(at: Path, size: int) -> None:
    """Give a mounted file system another size [bytes]."""
    _mount("-o", f"remount,size={size}", str(at))


def _mount(*arguments: str) -> None:
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True)
    if done.returncode:
        raise NoMount(done.stderr.strip().splitlines()[0])
