"""A campaign of mutations: each file of each study spoilt in turn, and what calflow makes of it judged.

What is wrong: a traceback, a hang, trouble of the machine where the input is at fault, a warning of a library,
a message that cannot
be read; and input accepted that is held otherwise than the file says it, by readers that share no code with calflow.
"""

from __future__ import annotations

import json
import signal
import traceback
import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from calflow.files.toml import read_toml
from calflow.simulation import Truth
from calflow.stages.catalogue import STAGES
from calflow.study import Study, load_study
from conftest import Answer, in_process
from trouble import tables, toml, urdf
from trouble.mutations import BYTES, IN_TOML, IN_URDF, Mutation, in_table
from trouble.studies import write_studies

PATIENCE = 20.0  # s of the processor, after which a command hangs
LONGEST_LINE, MOST_LINES = 1500, 100  # of what a user reads
ALONE = 0.6  # share of the cases with a single mutation
STRUCTURED = 0.7  # share of mistakes of people, the rest are of bytes

TARGETS = (  # study, file, how often
    ("plain", "measurements.csv", 6), ("mapped", "measurements.csv", 5), ("plain", "study.toml", 2), ("mapped", "study.toml", 3),
    ("plain", "robot.toml", 4), ("plain", "quick.toml", 2), ("plain", "truth.toml", 3), ("urdf", "arm.urdf", 4), ("urdf",
    "robot.toml", 1),
)  # fmt: skip


class Hangs(BaseException):
    """A command took longer than a user waits; no error, so that nothing takes it for one."""


@dataclass(frozen=True)
class Verdict:
    """What came of a case: its study, file and mutations, the exit code, and what is wrong (nothing, where all is well)."""

    number: int
    study: str
    file: str
    mutations: str
    code: int
    wrong: str = ""
    content: bytes = field(default=b"", repr=False)


@dataclass
class Campaign:
    """Studies in a folder, with what calflow holds of each before anything is spoilt."""

    folder: Path

    def __post_init__(self) -> None:
        self.studies = write_studies(self.folder)
        self.held = {name: _held(load_study(path)) for name, path in self.studies.items()}
        self.true = _true(self.studies["plain"])

    def verdicts(self, seed: int, first: int = 0) -> Iterator[Verdict]:
        """Judge one case after the other, for ever; a case depends on the seed and its number alone."""
        for number in count(first):
            yield self.judged(number, *self.spoilt(np.random.default_rng((seed, number)), number))

    def spoilt(self, rng: np.random.Generator, number: int) -> tuple[str, str, str, bytes]:
        """Return a study, a file of it, what is done to it, and what it then holds."""
        every = [(study, file) for study, file, often in TARGETS for _ in range(often)]
        study, file = every[number % len(every)]
        mutations = chosen(Path(file).suffix, ";" if study == "mapped" else ",", rng)
        content, done = spoilt((self.studies[study] / file).read_bytes(), mutations, rng)
        return study, file, done, content

    def judged(self, number: int, study: str, file: str, mutations: str, content: bytes) -> Verdict:
        """Judge one file's content."""
        path = self.studies[study] / file
        before = path.read_bytes()
        try:
            path.write_bytes(content)
            answer, wrong = _asked(study, self.studies[study], file)
            if not wrong and answer.code == 0:
                wrong = self._difference(study, file, before, content)
        finally:
            path.write_bytes(before)
        return Verdict(number, study, file, mutations, answer.code, wrong, content if wrong else b"")

    def _difference(self, study: str, file: str, before: bytes, content: bytes) -> str:
        """Say where what is held differs from what the file says; empty where it does not."""
        try:
            return "; ".join(self._differences(study, file, before, content))
        except (ValueError, SyntaxError, LookupError) as error:
            return f"accepted, but other readers refuse it: {error!r}"

    def _differences(self, study: str, file: str, before: bytes, content: bytes) -> Iterator[str]:
        folder = self.studies[study]
        if file == "truth.toml":
            yield from toml.differences(before.decode(), content.decode("utf-8-sig"), self.true, _true(folder))
        elif file.endswith(".toml"):
            yield from toml.differences(
                before.decode(), content.decode("utf-8-sig"), self.held[study], _held(load_study(folder))
            )
        elif file.endswith(".urdf"):
            yield from urdf.differences(folder / file, "tool0", load_study(folder).robot, np.random.default_rng(0))
        else:
            yield from _of_rows(load_study(folder), folder / file)


def keep(verdict: Verdict, folder: Path) -> None:
    """Keep what a wrong case was made of."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{verdict.number}-{verdict.study}-{verdict.file}").write_bytes(verdict.content)


def chosen(suffix: str, separator: str, rng: np.random.Generator) -> list[Mutation]:
    """Choose what is done to a file of a kind, by its ending; to a kind that is none of these only what disks do."""
    known = {".csv": in_table(separator), ".toml": IN_TOML, ".urdf": IN_URDF}.get(suffix, BYTES)
    number = 1 if rng.random() < ALONE else int(rng.integers(2, 5))
    of_each = [known if rng.random() < STRUCTURED else BYTES for _ in range(number)]
    return [own[int(rng.integers(len(own)))] for own in of_each]


def spoilt(content: bytes, mutations: Sequence[Mutation], rng: np.random.Generator) -> tuple[bytes, str]:
    """Return what a file then holds, and what was done to it."""
    done = []
    for mutation in mutations:
        try:
            content = mutation(content.decode(), rng)
        except (UnicodeDecodeError, ValueError, IndexError):  # nothing left to spoil
            break
        done.append(getattr(mutation, "func", mutation).__name__)
    return content, " ".join(done)


def _asked(study: str, folder: Path, file: str) -> tuple[Answer, str]:
    """Ask calflow, and return what it says and what is wrong with that."""
    command = (
        ("simulate", folder / file, "--out", folder / "simulated.csv", "--force")
        if file == "truth.toml"
        else ("check", folder)
    )
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            with patience():
                answer = in_process(*command)
        except Hangs:
            return Answer(-1, "", ""), "hangs"
        except BaseException:
            return Answer(-1, "", ""), f"traceback: {traceback.format_exc(limit=-3)}"
    return answer, unreadable(answer) or "; ".join(f"warning: {one.message}" for one in warned)


def unreadable(answer: Answer, codes: Collection[int] = (0, 2)) -> str:
    """Say why an answer is none for a user, who expects some exit codes; empty where it is one."""
    lines = answer.err.splitlines()
    if answer.code not in codes:
        return f"exit code {answer.code}: {answer.err[:300]}"
    if answer.code == 2 and not lines:
        return "refused without a word"
    if "Traceback" in answer.err or len(lines) > MOST_LINES or max(map(len, lines), default=0) > LONGEST_LINE:
        return f"a message of {len(lines)} lines, the longest {max(map(len, lines))} characters"
    odd = {sign for sign in answer.err + answer.out if not (sign.isprintable() or sign == "\n")}
    return f"a message with {odd}" if odd else ""


@contextmanager
def patience(seconds: float = PATIENCE) -> Iterator[None]:
    """Stop what takes too long: of the processor, so that a busy machine is no hang, or a hundred times as long waiting.

    Raises:
        Hangs: it does.
    """

    def stop(*_: object) -> None:
        raise Hangs

    timers = {signal.SIGPROF: (signal.ITIMER_PROF, seconds), signal.SIGALRM: (signal.ITIMER_REAL, 100 * seconds)}
    before = {number: signal.signal(number, stop) for number in timers}
    for timer, after in timers.values():
        signal.setitimer(timer, after, 1.0)  # again, should something swallow the first
    try:
        yield
    finally:
        for number, (timer, _) in timers.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])


def _held(study: Study) -> Any:
    """Return what calflow holds of a study's files, as JSON's values."""
    settings = {
        name: study.validated_settings(name, stage.settings).model_dump(mode="json") for name, stage in STAGES.items()
    }
    return [
        study.file.model_dump(mode="json", exclude={"stages"}),
        json.loads(study.robot.canonical()),
        study.workflow.model_dump(mode="json", exclude={"settings"}),
        settings,
    ]


def _true(folder: Path) -> Any:
    """Return what calflow holds of a truth file, and the table that it makes of it."""
    out = folder / "simulated.csv"
    answer = in_process("simulate", folder / "truth.toml", "--out", out, "--force")
    assert answer.code == 0, answer
    held = read_toml(folder / "truth.toml", Truth).model_dump(mode="json", exclude={"values"})
    rows = out.read_text()
    out.unlink()
    return [held, json.loads(load_study(folder).robot.canonical()), rows]


def _of_rows(study: Study, path: Path) -> Iterator[str]:
    data, source = study.measurements(), study.file.sources[0]
    read = data.table
    if data.time_origin is not None:
        read = read.assign(time=read["time"] + data.time_origin)
    notes = " ".join(data.notes)
    yield from tables.differences(path, read, notes, source.separator, source.decimal, source.columns, source.markers)
