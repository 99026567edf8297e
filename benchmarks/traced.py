"""How many files a reader goes through to follow one thing: calflow's files whose functions run on the way.

    python benchmarks/traced.py [--files]

The tutorial's arm with play hidden in joint 2 is simulated, run stage by stage and sent to one target, all in this process. What
runs as modules are imported does not count. `--files` names the files.
"""

from __future__ import annotations

import argparse
import contextlib
import inspect
import io
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

PLAY = ("[values.joint2]", "[values.joint2]\nb_urad = 300")


@dataclass(frozen=True)
class Question:
    """A command, and the two functions (file: name) between which files are counted; all where there are none."""

    name: str
    command: tuple[str, ...]
    first: str = ""
    last: str = ""


QUESTIONS = (
    Question("diagnose", ("run", "arm", "--stage", "diagnose"), "stages/diagnose.py:run", "stages/diagnose.py:run"),
    Question(
        "findings to page one", ("run", "arm", "--stage", "report"), "document.py:write_report", "verdict.py:first_page"
    ),
    Question("compensate", ("compensate", "arm", "targets.csv")),
)


@dataclass
class Trace:
    """The functions of calflow that run from the first call of one to the first return of another."""

    first: str = ""
    last: str = ""
    seen: set[tuple[str, str]] = field(default_factory=set)
    begun: bool = False
    over: bool = False

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        """Note a call, as `sys.setprofile` asks."""
        code = frame.f_code
        if self.over or "/src/calflow/" not in code.co_filename or not code.co_flags & inspect.CO_OPTIMIZED:
            return  # what modules and classes are made of has other flags than functions
        here = place(code)
        if event == "call":
            self.begun = self.begun or self.is_at(here, self.first)
            if self.begun:
                self.seen.add(here)
        elif event == "return" and self.begun and self.last and self.is_at(here, self.last):
            self.over = True

    @staticmethod
    def is_at(here: tuple[str, str], asked: str) -> bool:
        """Whether a function is the one asked for: by the end of its file's name, and its name, private or not."""
        path, _, name = asked.partition(":")
        return here[0].endswith(path) and (not name or here[1].lstrip("_") == name)

    @property
    def files(self) -> list[str]:
        """The files."""
        return sorted({path for path, _ in self.seen})


def place(code: CodeType) -> tuple[str, str]:
    """Return a function's file below the package, and its qualified name."""
    return code.co_filename.rpartition("/src/calflow/")[2], code.co_qualname


@contextlib.contextmanager
def traced(trace: Trace) -> Iterator[Trace]:
    """Trace what is done within."""
    sys.setprofile(trace)
    try:
        yield trace
    finally:
        sys.setprofile(None)


def call(*words: str) -> None:
    """Run a command in this process, without what it prints."""
    from calflow.cli import main

    sys.argv = ["calflow", *words]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        main()


def residuals(study: Path) -> None:
    """Read a study's measurements and return what its model leaves of them before any fit, by their noise."""
    from calflow.estimation.least_squares import LeastSquares
    from calflow.estimation.noise import measured_noise
    from calflow.model import build
    from calflow.study import load_study

    asked = load_study(study)
    data = asked.measurements()
    train = data.only(data.train)
    model = build(asked.robot, asked.file.effects, data.given)
    problem = LeastSquares.of(model, train, measured_noise(train, "auto", model))
    [part.linearised(model.nominal) for part in problem.parts()]


def main() -> None:
    """Print a line a question: files, functions, and how many of the files are of the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", action="store_true")
    asked = parser.parse_args()
    sys.argv = sys.argv[:1]
    with tempfile.TemporaryDirectory() as work, contextlib.chdir(work):
        call("new", "arm")
        truth = Path("arm/truth.toml")
        text = truth.read_text().replace('"joint-compliance"]', '"joint-compliance", "joint-backlash"]')
        truth.write_text(text.replace("repeats = 2", "repeats = 2\napproach = true").replace(*PLAY))
        call("simulate", "arm/truth.toml")
        sides = "".join(f",approach{k}" for k in range(1, 7))
        Path("targets.csv").write_text(f"x_m,y_m,z_m,payload{sides}\n1.5,0.3,1.0,full{',1' * 6}\n")
        with traced(Trace()) as trace:
            residuals(Path("arm/study.toml"))
        tell("a coordinate to its residual", trace, asked.files)
        call("run", "arm", "--stage", "identify")
        for question in QUESTIONS:
            with traced(Trace(question.first, question.last)) as trace:
                call(*question.command)
            tell(question.name, trace, asked.files)


def tell(name: str, trace: Trace, files: bool) -> None:
    """Print what a trace saw."""
    of_report = sum(path.startswith("reporting/") for path in trace.files)
    print(f"{name:32} {len(trace.files):4} files, {len(trace.seen):4} functions, {of_report} of reporting")
    if files:
        print("\n".join(f"    {path}" for path in trace.files))


if __name__ == "__main__":
    main()
