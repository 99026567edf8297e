"""The console: what commands print and hand over, how long work goes on, the arguments they share, and their exit codes."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from calflow.files.problems import seen

if TYPE_CHECKING:
    from calflow.stages.stage import Stage
OUT = click.option("--out", type=click.Path(path_type=Path), help="Run folder; runs/<study name> by default.")
STAGE = click.option("--stage", help="This stage alone, with what it needs.")
FORCE = click.option("--force", is_flag=True, help="Do not reuse earlier results.")
OVER = click.option("--force", is_flag=True, help="Write over a file that holds something else.")
FILE = click.Path(path_type=Path)
# Exit codes of a verdict against the robot, of none, and of one that says nothing.
NOT_WELL, NOT_TOLD, NOT_SEEN = 3, 4, 5
STATION = click.option(
    "--station",
    type=click.Choice(["auto", "known", "fitted"]),
    default="auto",
    show_default=True,
    help="Whether the device stood where it stood in the calibration.",
)
AGAIN = 0.1  # s after which an interruption that was swallowed comes again


def say(*lines: object, err: bool = False) -> None:
    """Say lines, on the standard error stream where asked; a terminal obeys nothing that a file or its name brings into them."""
    for line in lines:
        click.echo(seen(str(line)), err=err)


def hand_over(document: str) -> None:
    """Write a document on the standard output, for other programs: every sign of it is its own."""
    click.echo(document, nl=False)


class _Number(click.types.FloatParamType):
    """A number, of which a decimal comma is told as such."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number."""
        whole, comma, part = str(value).partition(",")
        if comma and whole.lstrip("+-").isdigit() and part.isdigit():
            self.fail(f"'{value}' has a decimal comma: write {whole}.{part}", param, ctx)
        return super().convert(value, param, ctx)


NUMBER = _Number()
FALSE_ALARM = click.option(
    "--false-alarm", type=NUMBER, default=0.01, show_default=True, help="Chance of an alarm where nothing moved."
)


class ArgumentCommand(click.Command):
    """A command that tells what is wrong with an argument of its function by the option that sets it."""

    def invoke(self, ctx: click.Context) -> Any:
        """Call the function.

        Raises:
            InputError: as the function does, `--task` in the place of `task`, `--tolerance-mm` in that of `tolerance`.
        """
        from calflow.files.problems import InputError

        try:
            return super().invoke(ctx)
        except InputError as error:
            options = self._options()
            problems = (replace(problem, key=options.get(problem.key or "", problem.key)) for problem in error.problems)
            raise InputError(problems) from None

    def _options(self) -> dict[str, str]:
        """Options by the names of the arguments that they set, which carry no unit."""
        from calflow.files.units import split_unit

        return {
            (split_unit(param.name or "") or (param.name or "",))[0]: param.opts[0]
            for param in self.params
            if isinstance(param, click.Option)
        }


def show_table(rows: Iterable[Sequence[str]], header: Sequence[str], *figures: str) -> None:
    """Show rows of texts on the terminal, as a file brought them; columns of figures keep to one line and to the right."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    for name in header:
        table.add_column(name, **({"justify": "right", "no_wrap": True} if name in figures else {"overflow": "fold"}))
    for row in rows:
        table.add_row(*map(seen, row))
    Console(highlight=False, markup=False, soft_wrap=True).print(table)


def exit_code(verdict: str) -> int:
    """Return the exit code of a verdict."""
    return {"moved": NOT_WELL, "not met": NOT_WELL, "cannot be told": NOT_TOLD, "cannot be seen": NOT_SEEN}.get(
        verdict, 0
    )


def deliver(document: str, out: Path | None, force: bool) -> None:
    """Write a document where an option says, not over something else unless that is forced; on the standard output without one.

    Raises:
        InputError: it would write over something else.
    """
    if out is None:
        hand_over(document)
    else:
        write_free(out, document.encode(), force)


def say_notes(notes: Iterable[str]) -> None:
    """Say notes on the standard error stream."""
    for note in notes:
        say(f"note: {note}", err=True)


def check_apart(written: Path | None, option: str, *others: Path) -> None:
    """Check that a file that an option names is none of the others, which it would write over.

    Raises:
        UsageError: it is.
    """
    for other in others:
        if written is not None and written.resolve() == other.resolve():
            raise click.UsageError(f"{option} {written} would write over {other}: expected another file")


def check_unwritten(path: Path, content: bytes, force: bool, other: str = "--out") -> None:
    """Check that what is to be written does not write over a file that holds something else, unless that is forced.

    other is what else its user may give.

    Raises:
        InputError: it would.
    """
    from calflow.files.problems import refuse

    if not force and path.exists() and (path.is_dir() or path.read_bytes() != content):
        raise refuse(f"is there already and holds something else; give --force to write over it, or {other}", path)


def write_free(path: Path, content: bytes, force: bool) -> None:
    """Write what an option names whole, not over something else unless that is forced, and say so.

    Raises:
        InputError: it would write over something else.
    """
    from calflow.files.writing import write_whole

    check_unwritten(path, content, force, "another name")
    write_whole(path, content)
    say(f"wrote {path}")


@contextmanager
def resumable() -> Iterator[None]:
    """Have an interruption, and trouble of the machine, tell that the same command goes on where it stopped."""
    try:
        yield
    except KeyboardInterrupt as interruption:
        interruption.add_note("the same command resumes where it stopped")
        raise
    except OSError as error:
        error.add_note("Finished stages are kept: once this is corrected, the same command goes on.")
        raise


def progress() -> ProgressLines:
    """Return what shows progress where the command runs."""
    return ProgressBar() if sys.stderr.isatty() else ProgressLines()


class ProgressLines:
    """Progress as plain lines, for a log.

    Compiled code may swallow a KeyboardInterrupt that comes while it runs (CasADi's conversions do), so it comes again until
    the stage stops, and is raised at the next progress.
    """

    def __init__(self) -> None:
        self._told = 0.0
        self._interrupted = False
        self._again: threading.Timer | None = None

    def __enter__(self) -> ProgressLines:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        self._heeded()
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _interrupt(self, *_: object) -> None:
        self._interrupted = True
        self._heeded()
        self._again = threading.Timer(AGAIN, _thread.interrupt_main)
        self._again.daemon = True
        self._again.start()
        raise KeyboardInterrupt

    def _heeded(self) -> None:
        if self._again:
            self._again.cancel()

    def start(self, stage: Stage, reason: str) -> None:
        self._told = time.monotonic()
        say(f"{stage.name}: {stage.title} ({reason})")

    def reuse(self, stage: Stage, reason: str) -> None:
        say(f"{stage.name}: reused ({reason})")

    def say(self, line: str) -> None:
        say(f"  {line}")

    def advance(self, share: float) -> None:
        if self._interrupted:
            raise KeyboardInterrupt
        self._show(share)

    def _show(self, share: float) -> None:
        if time.monotonic() - self._told > 10:
            self._told = time.monotonic()
            say(f"  {share:.0%}")

    def stop(self, stage: Stage) -> None:
        self._heeded()

    def finish(self, stage: Stage, seconds: float) -> None:
        say(f"  done in {seconds:.1f} s")


class ProgressBar(ProgressLines):
    """Progress as a bar, for a terminal."""

    def __enter__(self) -> ProgressBar:
        super().__enter__()
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

        self._console = Console(stderr=True, highlight=False)
        columns = (TextColumn("{task.description:10}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._progress = Progress(*columns, console=self._console)
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()
        super().__exit__()

    def start(self, stage: Stage, reason: str) -> None:
        self.say(f"{stage.name}: {stage.title} ({reason})")
        self._task = self._progress.add_task(stage.name, total=1.0)

    def reuse(self, stage: Stage, reason: str) -> None:
        self.say(f"{stage.name}: reused ({reason})")

    def say(self, line: str) -> None:
        self._progress.print(seen(line), markup=False)

    def _show(self, share: float) -> None:
        self._progress.update(self._task, completed=share)

    def finish(self, stage: Stage, seconds: float) -> None:
        self._progress.update(self._task, completed=1.0)
