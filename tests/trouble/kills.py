"""Runs that are killed: a whole study stopped at a random moment, gone on with, and compared with one that was left alone."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from conftest import SMALL, in_process
from forked import processes

STAGES = ("select", "identify", "diagnose", "sample", "report")
EVERY = SMALL["quick.toml"].replace('"sample"]', '"diagnose", "sample", "report"]')
SIGNALS = (signal.SIGKILL, signal.SIGTERM)


@dataclass(frozen=True)
class Unbroken:
    """A study, what an unbroken run of it left, and how long each part of that took [s]: the start first, then stage by stage."""

    study: Path
    tables: dict[str, str]
    seconds: tuple[float, ...]


@dataclass(frozen=True)
class Kill:
    """What came of one run that was killed: by what, when [s], in what, how it ended, and what is wrong after it was resumed."""

    number: int
    signal: str
    after: float
    within: str
    code: int
    wrong: str


def unbroken(folder: Path) -> Unbroken:
    """Write a study of all stages, measure it, and run it through."""
    study = folder / "study"
    study.mkdir(parents=True)
    for name, text in (SMALL | {"quick.toml": EVERY}).items():
        (study / name).write_text(text, encoding="utf-8")
    assert in_process("simulate", study / "truth.toml").code == 0
    begun = time.monotonic()
    running = _Running(study, folder / "unbroken")
    stamps = [running.until(stage) - begun for stage in STAGES]
    running.process.join()
    assert running.process.exitcode == 0, running.said
    seconds = np.diff([0.0, *stamps, time.monotonic() - begun])
    return Unbroken(study, tables(folder / "unbroken"), tuple(map(float, seconds)))


def killed(whole: Unbroken, run: Path, seed: int, number: int) -> Kill:
    """Kill a run at a random moment, the same for a seed and number, run it again, and say what is wrong with what it left.

    Half of the moments are anywhere in a run, half anywhere in one of its parts, so that short ones are met as often as long ones.
    """
    rng = np.random.default_rng((seed, number))
    how = SIGNALS[number % len(SIGNALS)]
    part = int(rng.integers(len(whole.seconds))) if rng.random() < 0.5 else None
    share = rng.random()
    shutil.rmtree(run, ignore_errors=True)
    begun, running = time.monotonic(), _Running(whole.study, run)
    if part:
        running.until(STAGES[part - 1])
    running.process.join(share * (sum(whole.seconds) if part is None else whole.seconds[part]))
    after, within = time.monotonic() - begun, running.within
    with suppress(ProcessLookupError):  # it has ended by itself
        os.kill(running.process.pid or 0, how)
    running.process.join()
    code = running.process.exitcode
    wrong = (
        [] if code in (-how, 0) and "Traceback" not in running.said else [f"ended with {code}: {running.said[-300:]}"]
    )
    resumed = _Running(whole.study, run)
    resumed.process.join()
    if resumed.process.exitcode != 0 or "Traceback" in resumed.said:
        wrong.append(f"resumed with {resumed.process.exitcode}: {resumed.said[-300:]}")
    wrong += differences(whole, run)
    return Kill(number, how.name, round(after, 3), within, code or 0, "; ".join(wrong))


def differences(whole: Unbroken, run: Path) -> list[str]:
    """Say where a run folder is not as an unbroken run leaves it."""
    left = tables(run)
    wrong = [f"{name} differs" for name in {**whole.tables, **left} if whole.tables.get(name) != left.get(name)]
    lying = {path.relative_to(run).as_posix() for path in run.rglob("*") if path.is_file()}
    entries = json.loads((run / "manifest.json").read_text(encoding="utf-8"))["stages"]
    outputs = {name for entry in entries.values() for name in entry["outputs"]}
    inputs = {f"inputs/{name}.toml" for name in ("study", "robot", "workflow")}
    unknown = lying - outputs - inputs - {"manifest.json", "datapackage.json", ".lock"}
    wrong += [f"{name} lies about" for name in unknown]
    return wrong + [f"{name}: {entry['status']}" for name, entry in entries.items() if entry["status"] != "done"]


def tables(run: Path) -> dict[str, str]:
    """Return the hash of every CSV and JSON of a run, but for the manifest, which tells times."""
    every = [path for path in run.rglob("*") if path.is_file() and path.name != "manifest.json"]
    paths = [path for path in every if path.suffix in (".csv", ".json")]
    return {path.relative_to(run).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


class _Running:
    """A run in a process of its own, forked from one that has loaded all but run nothing: threads do not outlive a fork."""

    def __init__(self, study: Path, run: Path) -> None:
        self._log = run.with_name(f"{run.name}.log")
        self._log.unlink(missing_ok=True)
        self.process = processes().Process(target=_run, args=(study, run, self._log))
        self.process.start()

    @property
    def said(self) -> str:
        """What it has said so far."""
        return self._log.read_text(encoding="utf-8") if self._log.exists() else ""

    @property
    def within(self) -> str:
        """The stage it has begun last."""
        begun = [line.split(":")[0] for line in self.said.splitlines()]
        return next((stage for stage in reversed(STAGES) if stage in begun), "start")

    def until(self, stage: str) -> float:
        """Wait until a stage has begun, and return when that was."""
        while self.process.is_alive() and f"{stage}: " not in self.said:
            time.sleep(0.002)
        return time.monotonic()


def _run(study: Path, run: Path, log: Path) -> None:
    """Run a study as the command line does; the report has two sections only, so that it takes no longer than all the rest."""
    from calflow.cli import main
    from calflow.reporting import document as written

    first = written.sections()[:2]
    written.sections = lambda: first
    sys.argv = ["calflow", "run", str(study), "--out", str(run)]
    with log.open("w", encoding="utf-8", buffering=1) as stream:
        sys.stdout = sys.stderr = stream
        main()
