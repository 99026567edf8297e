"""The console: output of commands, progress display, shared options, and exit codes."""

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

from calflow.files.problems import escaped

if TYPE_CHECKING:
    from calflow.stages.stage import Stage
OUT = click.option("--out", type=click.Path(path_type=Path), help="Run folder; runs/<study name> by default.")
STAGE = click.option("--stage", help="This stage alone, with what it needs.")
FORCE = click.option("--force", is_flag=True, help="Do not reuse earlier results.")
OVER = click.option("--force", is_flag=True, help="Write over a file that holds something else.")
FILE = click.Path(path_type=Path)
NEW_FILE, FOLDER = (
    click.Path(path_type=Path, dir_okay=False, readable=False),
    click.Path(path_type=Path, file_okay=False),
)
# Exit codes of a negative verdict, of an undecided one, and of poses that could not reveal anything.
NOT_WELL, NOT_TOLD, NOT_SEEN = 3, 4, 5
STATION = click.option(
    "--station",
    type=click.Choice(["auto", "known", "fitted"]),
    default="auto",
    show_default=True,
    help="Whether the device stood where it stood in the calibration.",
)
AGAIN = 0.1  # s after which a swallowed interruption is repeated


class _Commands(click.Group):
    """The commands; a stage's name in place of one is told with the command that runs it."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command's name, the command and its arguments."""
        if not self.get_command(ctx, args[0]):
            from calflow.stages.catalogue import STAGES  # takes a second, which commands spare

            if args[0] in STAGES:
                ctx.fail(f"{args[0]} is a stage: calflow run STUDY --stage {args[0]}")
        return super().resolve_command(ctx, args)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="calflow")
def cli() -> None:
    """Calibrate robots: from measured positions to a model that can be trusted."""


def say(*lines: object, err: bool = False) -> None:
    """Print lines, optionally on standard error, with control sequences from files or their names made harmless."""
    for line in lines:
        click.echo(escaped(str(line)), err=err)


def hand_over(document: str) -> None:
    """Write a document unchanged to standard output, for other programs."""
    click.echo(document, nl=False)


class _Number(click.types.FloatParamType):
    """A number, with a specific error message for a decimal comma."""

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
    """A command that reports errors in arguments of its function under the names of its options, or of the file given."""

    def invoke(self, ctx: click.Context) -> Any:
        """Call the function.

        Raises:
            InputError: as the function does, with `--task` instead of `task`, `--tolerance-mm` instead of `tolerance`, and the
                file's name instead of `data`.
        """
        from calflow.files.problems import InputError

        try:
            return super().invoke(ctx)
        except InputError as error:
            options = self._options()
            files = {
                param.name: ctx.params.get(param.name or "")
                for param in self.params
                if param.param_type_name == "argument"
            }
            problems = (
                replace(problem, file=file, key=None)
                if isinstance(file := files.get(problem.key or ""), Path) and not problem.file
                else replace(problem, key=options.get(problem.key or "", problem.key))
                for problem in error.problems
            )
            raise InputError(problems) from None

    def _options(self) -> dict[str, str]:
        """Return the options by the names of the arguments that they set, without unit."""
        from calflow.files.units import split_unit

        return {
            split_unit(param.name or "")[0]: param.opts[0] for param in self.params if isinstance(param, click.Option)
        }


def show_table(rows: Iterable[Sequence[str]], header: Sequence[str], *figures: str) -> None:
    """Print a table of texts without interpreting markup; columns named figures are right-aligned and unwrapped."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    for name in header:
        table.add_column(name, **({"justify": "right", "no_wrap": True} if name in figures else {"overflow": "fold"}))
    for row in rows:
        table.add_row(*map(escaped, row))
    Console(highlight=False, markup=False, soft_wrap=True).print(table)


def exit_code(verdict: str) -> int:
    """Return the exit code of a verdict."""
    return {"moved": NOT_WELL, "not met": NOT_WELL, "cannot be told": NOT_TOLD, "cannot be seen": NOT_SEEN}.get(
        verdict, 0
    )


def deliver(document: str, out: Path | None, force: bool) -> None:
    """Write a document to the file of an option, or else to standard output; overwrite other content only if forced.

    Raises:
        InputError: it would overwrite other content.
    """
    if out is None:
        hand_over(document)
    else:
        write_free(out, document.encode(), force)


def say_notes(notes: Iterable[str]) -> None:
    """Print notes on standard error."""
    for note in notes:
        say(f"note: {note}", err=True)


def check_apart(written: Path | None, option: str, *others: Path) -> None:
    """Check that the output file of an option is none of the other files, which it would overwrite.

    Raises:
        UsageError: it is.
    """
    for other in others:
        if written is not None and written.resolve() == other.resolve():
            raise click.UsageError(f"{option} {written} would write over {other}: expected another file")


def check_unwritten(path: Path, content: bytes, force: bool, other: str = "--out") -> None:
    """Check that writing a file does not overwrite other content, unless that is forced.

    other is the alternative that the message proposes to the user.

    Raises:
        InputError: it would overwrite other content.
    """
    from calflow.files.problems import refuse

    if not force and path.exists() and (path.is_dir() or path.read_bytes() != content):
        raise refuse(f"is there already and holds something else; give --force to write over it, or {other}", path)


def write_free(path: Path, content: bytes, force: bool) -> None:
    """Write the complete file of an option, and report it; overwrite other content only if forced.

    Raises:
        InputError: it would overwrite other content.
    """
    from calflow.files.writing import write_whole

    check_unwritten(path, content, force, "another name")
    write_whole(path, content)
    say(f"wrote {path}")


@contextmanager
def resumable() -> Iterator[None]:
    """Add to an interruption, or an error of the operating system, the note that the same command resumes the work."""
    try:
        yield
    except KeyboardInterrupt as interruption:
        interruption.add_note("the same command resumes where it stopped")
        raise
    except OSError as error:
        error.add_note("Finished stages are kept: once this is corrected, the same command goes on.")
        raise


def progress() -> ProgressLines:
    """Return the progress display: a bar on a terminal, else lines."""
    return ProgressBar() if sys.stderr.isatty() else ProgressLines()


class ProgressLines:
    """Progress as plain lines, for a log.

    Compiled code may swallow a KeyboardInterrupt while it runs (CasADi's conversions do), so it is repeated until the
    stage stops, and raised at the next progress message.
    """

    def __init__(self) -> None:
        self._last_shown = 0.0
        self._interrupted = False
        self._repetition: threading.Timer | None = None

    def __enter__(self) -> ProgressLines:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        self._cancel_repetition()
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _interrupt(self, *_: object) -> None:
        self._interrupted = True
        self._cancel_repetition()
        self._repetition = threading.Timer(AGAIN, _thread.interrupt_main)
        self._repetition.daemon = True
        self._repetition.start()
        raise KeyboardInterrupt

    def _cancel_repetition(self) -> None:
        if self._repetition:
            self._repetition.cancel()

    def start(self, stage: Stage, reason: str) -> None:
        self._last_shown = time.monotonic()
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
        if time.monotonic() - self._last_shown > 10:
            self._last_shown = time.monotonic()
            say(f"  {share:.0%}")

    def stop(self, stage: Stage) -> None:
        self._cancel_repetition()

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
        self._progress.print(escaped(line), markup=False)

    def _show(self, share: float) -> None:
        self._progress.update(self._task, completed=share)

    def finish(self, stage: Stage, seconds: float) -> None:
        self._progress.update(self._task, completed=1.0)
