"""The command line."""

from __future__ import annotations

import gc
import io
import os
import sys

import click

from calflow.commands import COMMANDS
from calflow.commands.console import say
from calflow.files.problems import InputError

TROUBLE = 1  # exit code of system errors
THREADS = "OMP_NUM_THREADS"  # read by linear algebra libraries on import
# Objects made between looks for garbage: by Python's own 700, looks at all that the libraries load took a twelfth of a study.
COLLECTED = 10_000


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="calflow")
def cli() -> None:
    """Calibrate robots: from measured positions to a model that can be trusted."""


for command in COMMANDS:
    cli.add_command(command)


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


def program() -> None:
    """Run the command line and exit; single-threaded, since an arm's matrices are too small for several threads."""
    # Characters that a terminal or a log cannot encode are escaped rather than raising an error.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
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
