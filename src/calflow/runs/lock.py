"""The lock of a run folder, which admits one run at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from calflow.files.problems import refuse
from calflow.files.writing import inside

NAME = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder against a second run; the system releases the lock when the process ends.

    Raises:
        InputError: another run has locked the folder, or the lock file is a link that leads out of it.
    """
    lock = FileLock(inside(folder, NAME), timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise refuse("another run is at work in this folder; wait for it, or give another with --out", folder) from None
    try:
        yield
    finally:
        lock.release()


def wait_until_free(folder: Path) -> None:
    """Wait until no run has locked a folder, which may not exist yet."""
    if folder.is_dir():
        with FileLock(inside(folder, NAME)):
            pass


def is_locked(folder: Path) -> bool:
    """Whether a run has locked a folder; also true if the folder is not writable."""
    try:
        with FileLock(inside(folder, NAME), timeout=0):
            return False
    except OSError:  # it is locked, or the folder is not writable
        return True
