"""Damage: a run folder whose files are cut, turned, zeroed or gone, and machines that lack something.

What is done with a damaged run must be what is done with a sound one, or be refused with a message, or say that a stage runs again:
never a traceback, never another result.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calflow.runs.manifest import read_manifest
from conftest import Answer, Folder
from trouble.campaign import Hangs, patience, unreadable

Damage = Callable[[bytes, np.random.Generator], bytes | None]


def cut(content: bytes, rng: np.random.Generator) -> bytes:
    """A file cut off."""
    return content[: int(rng.integers(max(len(content), 1)))]


def turned(content: bytes, rng: np.random.Generator) -> bytes:
    """A bit turned."""
    changed = bytearray(content)
    if changed:
        changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def zeroed(content: bytes, rng: np.random.Generator) -> bytes:
    """A block of zeros."""
    at = int(rng.integers(max(len(content), 1)))
    return content[:at] + bytes(len(content[at : at + 512])) + content[at + 512 :]


def gone(content: bytes, rng: np.random.Generator) -> None:
    """A file that is not there any more."""


DAMAGES: tuple[Damage, ...] = (cut, turned, zeroed, gone)


@dataclass(frozen=True)
class Sound:
    """A finished run, and what the commands say of it: status, plan, and a prediction of some rows."""

    folder: Folder
    said: dict[str, Answer]

    @staticmethod
    def of(folder: Folder) -> Sound:
        """Ask of a finished study's run."""
        rows = folder.rows.drop(columns=["x_mm", "y_mm", "z_mm", "sigma_mm"])
        folder.measure(rows, "asked.csv")
        said = {command: folder.calflow(command, *arguments) for command, arguments in _commands(folder).items()}
        assert all(answer.code == 0 for answer in said.values()), said
        return Sound(folder, said)

    def files(self) -> list[str]:
        """Every file of the run."""
        run = self.folder / "runs"
        return sorted(path.relative_to(run).as_posix() for path in run.rglob("*") if path.is_file())

    def wrong(self, name: str, damage: Damage, rng: np.random.Generator) -> str:
        """Damage a file, ask, mend it, and say what was wrong; nothing where all was well."""
        path = self.folder / "runs" / name
        before = path.read_bytes()
        after = damage(before, rng)
        if after == before:
            return ""
        manifest = read_manifest(self.folder / "runs")
        assert manifest is not None
        stage = next((stage for stage in manifest.stages if name in manifest.outputs(stage)), None)
        try:
            path.unlink() if after is None else path.write_bytes(after)
            return "; ".join(self._wrong(name, stage))
        finally:
            path.write_bytes(before)

    def _wrong(self, name: str, stage: str | None) -> Iterator[str]:
        for command, arguments in _commands(self.folder).items():
            try:
                with patience():
                    answer = self.folder.calflow(command, *arguments)
            except Hangs:
                yield f"{command} hangs"
                continue
            except Exception as error:
                yield f"{command}: traceback, {error!r}"
                continue
            if said := unreadable(answer):
                yield f"{command}: {said}"
            if answer.code != 0:
                continue
            if command == "plan":
                again = next((line for line in answer.out.splitlines() if line.split()[0] == stage), "")
                if stage and " run " not in again:
                    yield f"{stage} is reused, whose {name} is damaged"
            elif answer.out != self.said[command].out:
                yield f"{command} says something else in silence"


def copied(folder: Folder, to: Path) -> Folder:
    """Return a copy of a study's folder."""
    shutil.copytree(folder.path, to)
    return Folder(to)


def _commands(folder: Folder) -> dict[str, tuple[Path, ...]]:
    return {"status": (folder / "runs",), "plan": (), "predict": (folder / "runs", folder / "asked.csv")}
