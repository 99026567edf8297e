"""The command line."""

from __future__ import annotations

import gc
import io
import os
import sys
from typing import TYPE_CHECKING, Any, TextIO

import click

from calflow.commands.console import cli, say
from calflow.files.problems import InputError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer as Buffer

TROUBLE = 1  # exit code of system errors
THREADS = "OMP_NUM_THREADS"  # read by linear algebra libraries on import
# Objects made between looks for garbage: by Python's own 700, looks at all that the libraries load took a twelfth of a study.
COLLECTED = 10_000


def main() -> None:
    """Run the command line: invalid input ends with all problems and exit code 2, system errors with 1."""
    try:
        cli(prog_name="calflow", standalone_mode=False)
    except click.ClickException as error:
        shown = io.StringIO()
        error.show(shown)
        say(*shown.getvalue().splitlines(), err=True)
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt) as interruption:  # click raises its own from Python's
        notes = getattr(interruption.__cause__ or interruption, "__notes__", ["the same command begins anew"])
        say(f"interrupted: {' '.join(notes)}", err=True)
        sys.exit(130)
    except OSError as error:
        so = " ".join(
            getattr(error, "__notes__", ["Name another place, or repeat the command once this is corrected."])
        )
        what = f"{error.filename}: {error.strerror}" if error.filename and error.strerror else error
        say(f"error: {what}. {so}", err=True)
        sys.exit(TROUBLE)
    except InputError as error:
        say(*error.problems, err=True)
        sys.exit(2)


class _Output(io.RawIOBase):
    """Output to whose end a command goes on although its reader has left, as after `| head`: the exit code is the command's."""

    def __init__(self, stream: io.TextIOWrapper) -> None:
        self._stream = stream  # which would close the file behind it if it were let go
        self._raw: Any = getattr(stream.buffer, "raw", stream.buffer)  # by python -u the buffer is none

    def writable(self) -> bool:
        """It is."""
        return True

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._stream.fileno()

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self._stream.isatty()

    def write(self, data: Buffer, /) -> int | None:
        """Write, or pretend to where nobody reads."""
        try:
            written: int | None = self._raw.write(data)
            return written
        except BrokenPipeError:
            return memoryview(data).nbytes


def _readers_may_leave(stream: TextIO) -> TextIO:
    """Return a stream that goes on where nobody reads, with characters escaped that a terminal or a log cannot encode."""
    if not isinstance(stream, io.TextIOWrapper):  # what a program that imports this one has put in its place
        return stream
    stream.flush()
    by_line = stream.line_buffering or stream.write_through
    return io.TextIOWrapper(
        io.BufferedWriter(_Output(stream)), stream.encoding, "backslashreplace", line_buffering=by_line
    )


def program() -> None:
    """Run the command line and exit; single-threaded, since an arm's matrices are too small for several threads."""
    sys.stdout, sys.stderr = map(_readers_may_leave, (sys.stdout, sys.stderr))
    os.environ.setdefault(THREADS, "1")  # before numpy is there; they would wait for each other most of the time
    gc.set_threshold(COLLECTED)
    try:
        main()
    except SystemExit as leaving:
        # HDF5 crashes on the way out where a file could not be written.
        if leaving.code == TROUBLE and "h5py" in sys.modules:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(TROUBLE)
        raise
