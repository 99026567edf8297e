"""Spoilt files before the whole command line: each command in a process of its own, as its user calls it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from conftest import Answer
from forked import forked
from trouble.campaign import chosen, spoilt, unreadable
from trouble.workplace import OF_FILES, READ, Workplace

PATIENCE = 300.0  # s, after which a command hangs
VERDICTS = (3, 4)  # exit codes of a verdict against the robot, and of one that cannot be given
PAIRS = tuple((name, file) for name, files in READ.items() for file in files)


@dataclass(frozen=True)
class Called:
    """What came of a case: the command, the spoilt file, how it was spoilt, the exit code, and what is wrong."""

    number: int
    command: str
    file: str
    mutations: str
    code: int
    wrong: str = ""


def called(place: Workplace, seed: int, number: int, kept: Path | None = None) -> Called:
    """Spoil a file that a command reads, and call the command; what went wrong is kept in a folder."""
    rng = np.random.default_rng((seed, number))
    command, file = PAIRS[number % len(PAIRS)]
    path = place.path / file
    before = path.read_bytes()
    content, done = spoilt(before, chosen(Path(file).suffix, ",", rng), rng)
    path.write_bytes(content)
    try:
        answer = _apart(place, OF_FILES[command])
        wrong = "; ".join(_wrong(place, answer))
    finally:
        path.write_bytes(before)
    if wrong and kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
        (kept / f"{number}-{path.name}").write_bytes(content)
    return Called(number, command, file, done, answer.code, wrong)


def _apart(place: Workplace, arguments: tuple[str, ...]) -> Answer:
    with place.here():
        try:
            done = forked("-m", "calflow", *arguments, cwd=place.path, timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            return Answer(-1, "", "hangs")
    return Answer(done.returncode, done.stdout, done.stderr)


def _wrong(place: Workplace, answer: Answer) -> Iterator[str]:
    if said := unreadable(answer, (0, 2, *VERDICTS)):
        yield said
    left = place.made()
    if answer.code == 2 and left:
        yield f"refused, but left {', '.join(left)}"
    if halves := [name for name in left if name.endswith(".part")]:
        yield f"left {', '.join(halves)} half written"
