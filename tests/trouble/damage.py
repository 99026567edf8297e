"""Damage: a run folder whose files are cut, emptied, turned, zeroed, gone, no files any more, or not to be read.

What is done with a damaged run must be what is done with a sound one, or be refused with a message that leaves nothing behind, or
say that a stage runs again: never a traceback, never another result.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np

from calflow.run_folder import read_manifest
from conftest import Answer
from trouble.campaign import Hangs, patience, unreadable
from trouble.kills import tables
from trouble.workplace import OF_RUNS, Workplace

Damage = Callable[[Path, np.random.Generator], None]

RUN = "runs"
AS_USER = (
    "setpriv",
    "--bounding-set",
    "-dac_override,-dac_read_search",
)  # before a command: root with no more rights than others
SLOW = ("run", "report", "reproduce")  # of which a case of the campaign has one
REFUSED, TROUBLE = 2, 1


def cut(path: Path, rng: np.random.Generator) -> None:
    """A file cut off."""
    content = path.read_bytes()
    path.write_bytes(content[: int(rng.integers(max(len(content), 1)))])


def emptied(path: Path, rng: np.random.Generator) -> None:
    """A file of no length."""
    path.write_bytes(b"")


def turned(path: Path, rng: np.random.Generator) -> None:
    """A bit turned."""
    changed = bytearray(path.read_bytes())
    if changed:
        changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    path.write_bytes(bytes(changed))


def zeroed(path: Path, rng: np.random.Generator) -> None:
    """A block of zeros."""
    content = path.read_bytes()
    at = int(rng.integers(max(len(content), 1)))
    path.write_bytes(content[:at] + bytes(len(content[at : at + 512])) + content[at + 512 :])


def gone(path: Path, rng: np.random.Generator) -> None:
    """A file that is not there any more."""
    path.unlink()


def no_file(path: Path, rng: np.random.Generator) -> None:
    """A folder in its place."""
    path.unlink()
    path.mkdir()


def locked_away(path: Path, rng: np.random.Generator) -> None:
    """A file that its user may not read; one who may read everything (root) may still."""
    path.chmod(0)


DAMAGES: tuple[Damage, ...] = (cut, emptied, turned, zeroed, gone, no_file, locked_away)


@dataclass(frozen=True)
class Damaged:
    """What came of a case: the file, what was done to it, and what is wrong with what some command then said or made."""

    number: int
    file: str
    damage: str
    wrong: str


def reads_everything() -> bool:
    """Whether the modes of files do not keep this user from reading."""
    with NamedTemporaryFile() as file:
        os.chmod(file.name, 0)
        return os.access(file.name, os.R_OK)


@dataclass(frozen=True)
class Sound:
    """A finished run, a copy of it, and what each command says and makes of it."""

    place: Workplace
    kept: Path
    said: dict[str, Answer] = field(default_factory=dict)
    made: dict[str, dict[str, bytes]] = field(default_factory=dict)

    @staticmethod
    def of(place: Workplace, commands: Iterable[str] = OF_RUNS) -> Sound:
        """Ask commands of a workplace's run."""
        sound = Sound(place, place.path / "kept")
        shutil.copytree(sound.run, sound.kept, dirs_exist_ok=True)
        for name in commands:
            sound.said[name] = place.ask(OF_RUNS[name])
            sound.made[name] = place.made()
            assert sound.said[name].code in (0, 3), sound.said[name]
        sound.mend()
        return sound

    @property
    def run(self) -> Path:
        """The run folder."""
        return self.place.path / RUN

    def mend(self) -> None:
        """Put the run back as it was."""
        for path in self.run.rglob("*"):
            with suppress(FileNotFoundError):
                path.chmod(0o755)
        shutil.rmtree(self.run)
        shutil.copytree(self.kept, self.run)

    def files(self) -> list[str]:
        """Every file of the run."""
        return sorted(path.relative_to(self.kept).as_posix() for path in self.kept.rglob("*") if path.is_file())

    def wrong(self, name: str, damage: Damage, seed: int, without: Collection[str] = ()) -> str:
        """Damage a file, ask each command anew but for some, and say what was wrong; nothing where all was well."""
        asked = [command for command in self.said if command not in without]
        return "; ".join(said for command in asked for said in self._wrong(command, name, damage, seed))

    def _wrong(self, command: str, name: str, damage: Damage, seed: int) -> Iterator[str]:
        damage(self.run / name, np.random.default_rng(seed))
        try:
            with patience():
                answer = self.place.ask(OF_RUNS[command])
        except Hangs:
            yield f"{command} hangs"
        except Exception as error:
            yield f"{command}: traceback, {error!r}"
        else:
            yield from (f"{command}: {said}" for said in self._of(command, answer, name, damage))
        finally:
            self.mend()

    def _of(self, command: str, answer: Answer, name: str, damage: Damage) -> Iterator[str]:
        """Say what is wrong with an answer."""
        said = self.said[command]
        if odd := unreadable(answer, (said.code, REFUSED, *([TROUBLE] if damage in (locked_away, no_file) else []))):
            yield odd
        elif answer.code in (REFUSED, TROUBLE):
            if left := self.place.made():
                yield f"refused, but left {', '.join(left)}"
        elif command == "plan":
            yield from self._reused(answer, name)
        elif command in ("run", "report"):
            if "is left out" not in answer.out and tables(self.run) != tables(self.kept):
                yield "the run is not as it was"
        elif command == "reproduce":
            if answer.out.splitlines()[-1] != said.out.splitlines()[-1]:
                yield f"says {answer.out.splitlines()[-1]}"
        elif (answer.out, answer.err) != (said.out, said.err):
            yield "says something else in silence"
        elif self.place.made() != self.made[command]:
            yield "makes something else in silence"

    def _reused(self, answer: Answer, name: str) -> Iterator[str]:
        manifest = read_manifest(self.kept)
        assert manifest is not None
        stage = next((stage for stage in manifest.stages if name in manifest.outputs(stage)), None)
        again = next((line for line in answer.out.splitlines() if line.split()[0] == stage), "")
        if stage and (self.run / name).exists() and _same(self.run / name, self.kept / name):
            return
        if stage and " run " not in again:
            yield f"{stage} is reused, whose {name} is damaged"


def damaged(sound: Sound, seed: int, number: int) -> Damaged:
    """Damage a file of a run and ask the commands: each number has another file and damage, until all had all."""
    files = sound.files()
    name, damage = files[number % len(files)], DAMAGES[(number + number // len(files)) % len(DAMAGES)]
    slow = SLOW[(number + number // len(files)) % len(SLOW)]
    without = [command for command in SLOW if command != slow]
    return Damaged(number, name, damage.__name__, sound.wrong(name, damage, seed + number, without))


def _same(one: Path, other: Path) -> bool:
    """Whether a file can be read, and holds what another does."""
    try:
        return one.read_bytes() == other.read_bytes()
    except OSError:
        return False
