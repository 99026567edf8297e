"""A small robot with its study, and calflow as its user calls it."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: a core a worker
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else each process that a test starts compiles the package anew

import contextlib
import gc
import hashlib
import io
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from forked import forked

# Else each worker rewrites the assertions of all tests anew, which takes longer than to collect them.
sys.dont_write_bytecode = False
gc.set_threshold(
    50_000, 20
)  # little of what tests make goes round; to look for it as often as usual takes a twentieth of the time

SMALL = {
    "robot.toml": """\
# a robot with three joints
name = "small"
convention = "modified-dh"

[[joints]]
d_mm = 500
limits_deg = [-170, 170]
mass_kg = 60
com_mm = [0, 0, -100]

[[joints]]
a_mm = 100
alpha_deg = -90
limits_deg = [-100, 40]
mass_kg = 30
com_mm = [350, 0, 50]

[[joints]]
a_mm = 700
alpha_deg = 5
limits_deg = [-20, 140]
mass_kg = 15
com_mm = [300, 20, 0]

[payloads.light]
mass_kg = 2

[payloads.heavy]
mass_kg = 30
com_mm = [20, 10, 40]

[markers.tool]
point_mm = [600, 50, 80]
""",
    "study.toml": """\
name = "small"
robot = "robot.toml"
workflow = "quick.toml"
seed = 7
effects = ["geometry", "joint-compliance"]

[measurements]
file = "measurements.csv"

[split]
holdout = 0.3

[stages.select]
poses = 8
""",
    "quick.toml": """\
name = "quick"
stages = ["select", "identify", "sample"]

[settings.select]
candidates = 100

[settings.identify]
starts = 1

[settings.sample]
max_steps = 60
block = 20
ess = 100
""",
    "truth.toml": """\
robot = "robot.toml"
effects = ["geometry", "joint-compliance"]
seed = 3
repeats = 2
payloads = ["light", "heavy"]

[device]
origin_mm = [3000, 0, 1000]
floor_mm = 0.02
noise_mm_per_m = 0.005

[[sets]]
random = 40

[values.joint2]
a_mm = 0.5
s_rad_per_Nm = 2e-6
""",
}


@dataclass(frozen=True)
class Answer:
    """What a command said, and its exit code."""

    code: int
    out: str
    err: str


def in_process(*arguments: object) -> Answer:
    """Call the command line in this process; a traceback is an error of the test."""
    from calflow.cli import main

    out, err, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["calflow", *map(str, arguments)]
    code = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as leaving:
        code = int(leaving.code or 0)
    finally:
        sys.argv = before
    return Answer(code, out.getvalue(), err.getvalue())


@dataclass(frozen=True)
class Folder:
    """A study's folder, and what its user does there."""

    path: Path

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    def calflow(self, command: str, *arguments: object) -> Answer:
        """Run a command, on this study if it takes one, into this folder's `runs` unless told otherwise."""
        study = (self.path,) if command in ("check", "plan", "run", "report") else ()
        out = ("--out", self / "runs") if study and command != "check" and "--out" not in arguments else ()
        return in_process(command, *study, *out, *arguments)

    def apart(self, *arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
        """Run python in a process of its own in this folder."""
        return subprocess.run(
            [sys.executable, *map(str, arguments)], capture_output=True, text=True, cwd=self.path, **options
        )

    def forked(self, *arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
        """The same in a process that has loaded all libraries before, for what does not concern python itself; see `forked`."""
        return forked(*arguments, cwd=self.path, **options)

    def refused(self, *command: object) -> list[str]:
        """Run a command that must be refused; its problems, without this folder's name."""
        answer = self.calflow(*(command or ("check",)))
        assert answer.code == 2, answer
        assert "Traceback" not in answer.err
        return answer.err.replace(f"{self.path}{os.sep}", "").splitlines()

    def edit(self, name: str, *changes: tuple[str, str]) -> None:
        """Replace pieces of a file, each the first time it occurs."""
        text = (self / name).read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text, f"{name} has no {old!r}"
            text = text.replace(old, new, 1)
        (self / name).write_text(text, encoding="utf-8")

    @property
    def rows(self) -> pd.DataFrame:
        """The measurements as text."""
        return pd.read_csv(self / "measurements.csv", dtype=str, keep_default_na=False)

    def measure(self, rows: pd.DataFrame, name: str = "measurements.csv") -> None:
        """Write measurements."""
        rows.to_csv(self / name, index=False)

    def rewrite(self, name: str, table: pd.DataFrame, run: str = "runs") -> None:
        """Write another table of a run, as if the run had made it: its manifest vouches for it."""
        old = hashlib.sha256((self / run / name).read_bytes()).hexdigest()
        table.to_csv(self / run / name, index=False)
        new = hashlib.sha256((self / run / name).read_bytes()).hexdigest()
        self.edit(f"{run}/manifest.json", (old, new))
        self.vouch(lambda manifest: None, run)

    def vouch(self, change: Callable[[dict[str, Any]], object], run: str = "runs") -> None:
        """Change a run's manifest as a program would that knows how: as an earlier version's, it states no sum of itself."""
        path = self / run / "manifest.json"
        manifest = json.loads(path.read_text(encoding="utf-8"))
        manifest.pop("sha256", None)
        change(manifest)
        path.write_text(json.dumps(manifest), encoding="utf-8")

    def copied(self, to: Path) -> Folder:
        """A copy of all that is here."""
        shutil.copytree(self.path, to, dirs_exist_ok=True)
        return Folder(to)

    def results(self, run: str = "runs") -> dict[str, bytes]:
        """The bytes of every table of a run."""
        return {str(path.relative_to(self / run)): path.read_bytes() for path in sorted((self / run).rglob("*.csv"))}


@contextlib.contextmanager
def without_data() -> Iterator[pytest.MonkeyPatch]:
    """Without the user's data, which must not stand in for a study's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("CALFLOW_DATA", raising=False)
        yield patch


@pytest.fixture(scope="session")
def _measured(tmp_path_factory):
    folder = Folder(tmp_path_factory.mktemp("study"))
    for name, text in SMALL.items():
        (folder / name).write_text(text, encoding="utf-8")
    assert folder.calflow("simulate", folder / "truth.toml").code == 0
    return folder


@pytest.fixture(scope="session")
def _finished(_measured, tmp_path_factory):
    folder = _measured.copied(tmp_path_factory.mktemp("finished"))
    with without_data():
        answer = folder.calflow("run")
    assert answer.code == 0, answer
    assert answer.out.count("was never run") == 3
    return folder


@pytest.fixture
def small(_measured, tmp_path, monkeypatch):
    """A study of its own for the test, measured and not run yet."""
    monkeypatch.delenv("CALFLOW_DATA", raising=False)
    return _measured.copied(tmp_path / "small")


@pytest.fixture
def finished(_finished, tmp_path, monkeypatch):
    """The same, with a finished run in `runs`."""
    monkeypatch.delenv("CALFLOW_DATA", raising=False)
    return _finished.copied(tmp_path / "finished")


@pytest.fixture
def looped(tmp_path, monkeypatch):
    """The study of a robot with a four-bar loop."""
    monkeypatch.delenv("CALFLOW_DATA", raising=False)
    shutil.copytree(Path(__file__).parents[1] / "studies" / "hh800", tmp_path / "hh800")
    return Folder(tmp_path / "hh800")


def pytest_collection_finish():
    """Look no more through what was imported and collected for what goes round."""
    gc.freeze()


def pytest_collection_modifyitems(items):
    """Begin with the longest, pages and whole diagnoses, so that no worker is left alone with them at the end."""
    longest = ("test_docs.py", "test_studies.py", "test_photographs_page.py", "test_notebook.py", "hidden", "effects")
    items.sort(key=lambda item: next((k for k, part in enumerate(longest) if part in item.path.parts), len(longest)))
