"""The console: what commands print and hand over, the arguments they share, and their exit codes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from calflow.files.problems import seen


def say(*lines: object, err: bool = False) -> None:
    """Say lines, on the standard error stream where asked; a terminal obeys nothing that a file or its name brings into them."""
    for line in lines:
        click.echo(seen(str(line)), err=err)


def hand_over(document: str) -> None:
    """Write a document on the standard output, for other programs: every sign of it is its own."""
    click.echo(document, nl=False)


OUT = click.option("--out", type=click.Path(path_type=Path), help="Run folder; runs/<study name> by default.")
STAGE = click.option("--stage", help="This stage alone, with what it needs.")
FORCE = click.option("--force", is_flag=True, help="Do not reuse earlier results.")
OVER = click.option("--force", is_flag=True, help="Write over a file that holds something else.")
FILE = click.Path(path_type=Path)
NOT_WELL, NOT_TOLD = 3, 4  # exit codes of a verdict that is against the robot, and of one that cannot be given
FALSE_ALARM = click.option(
    "--false-alarm", type=float, default=0.01, show_default=True, help="Chance of an alarm where nothing moved."
)
STATION = click.option(
    "--station",
    type=click.Choice(["auto", "known", "fitted"]),
    default="auto",
    show_default=True,
    help="Whether the device stood where it stood in the calibration.",
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
            problems = (replace(one, key=options.get(one.key or "", one.key)) for one in error.problems)
            raise InputError(problems) from None

    def _options(self) -> dict[str, str]:
        """Options by the names of the arguments that they set, which carry no unit."""
        from calflow.files.units import split_unit

        return {
            (split_unit(one.name or "") or (one.name or "",))[0]: one.opts[0]
            for one in self.params
            if isinstance(one, click.Option)
        }


def exit_code(verdict: str) -> int:
    """Return the exit code of a verdict."""
    return {"moved": NOT_WELL, "not met": NOT_WELL, "cannot be told": NOT_TOLD}.get(verdict, 0)


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
        error.add_note("Finished stages are kept; when this is mended the same command goes on.")
        raise
