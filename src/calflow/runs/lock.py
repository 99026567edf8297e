"""The lock: one run at a time in a folder."""

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
    """Keep a second run out of the folder; the system releases the lock of a process that is gone.

    Raises:
        InputError: another run is at work there, or the lock is a link that leads out of it.
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
    """Wait until no run is at work in a folder, which may not exist yet."""
    if folder.is_dir():
        with FileLock(inside(folder, NAME)):
            pass


def is_locked(folder: Path) -> bool:
    """Return whether a run is at work in a folder, as far as whoever asks may know."""
    try:
        with FileLock(inside(folder, NAME), timeout=0):
            return False
    except OSError:  # somebody has it, or the folder cannot be written to
        return True
