"""Atomic writing: a file appears complete or not at all, whatever stops the program, and only in its own folder."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from calflow.files.problems import refuse

PART = ".part"  # suffix of an incomplete file
# Create a new file and never follow a link; without O_BINARY, Windows would translate the ends of lines.
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


def utf8(text: str) -> bytes:
    """Return a text as UTF-8; characters that cannot be encoded, as in names of files, are backslash-escaped."""
    return text.encode(errors="backslashreplace")


def write_text(path: Path, text: str) -> None:
    """Write a text atomically, as UTF-8."""
    write_whole(path, utf8(text))


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically: into a temporary file beside it that then replaces it; missing folders are created.

    The temporary name is random, so that no existing link can redirect the write; a link at the path is replaced.

    Raises:
        InputError: a folder is there, or a file where its folder should be.
        OSError: it cannot be written; its file is the path that was asked for.
    """
    if path.is_dir():
        raise refuse("is a folder: expected the name of a file", path)
    if file := next((above for above in path.parents if above.exists() and not above.is_dir()), None):
        raise refuse(f"cannot be written: {file} is no folder", path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{secrets.token_hex(8)}{PART}")
    try:
        with os.fdopen(os.open(part, _NEW, 0o666), "wb") as stream:
            stream.write(content)
        os.replace(part, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None  # nobody knows the temporary name
    finally:
        part.unlink(missing_ok=True)


def contained(folder: Path, name: str) -> Path | None:
    """Return the path of a name in a folder; None if it leads outside, on any system or through a link."""
    parts = name.split("/")
    if any(part in ("", ".", "..") for part in parts) or set(name) & set("\\:\0"):  # a drive letter has a colon
        return None
    path = folder.joinpath(*parts)
    return path if is_within(path, folder) else None


def inside(folder: Path, name: str) -> Path:
    """Return the path of a name in a folder.

    Raises:
        InputError: a link in the path leads out of the folder.
    """
    path = folder / name
    if not is_within(path, folder):
        raise refuse("leads out of the folder: nothing is read, written or deleted there; remove the link", path)
    return path


def is_within(path: Path, folder: Path) -> bool:
    """Whether a path lies in a folder once all links are resolved."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a name that is too long, or a cycle of links
        return False
