"""Writing: a file appears whole or not at all, whatever stops the program, and only in the folder that it is meant for."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from calflow.files.problems import refuse

PART = ".part"  # ending of a file that is not complete yet
# A file that nobody has made before, links included; Windows would turn ends of lines.
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


def utf8(text: str) -> bytes:
    """Return a text as it is written; bytes of a file's name that are no text are spelled out."""
    return text.encode(errors="backslashreplace")


def write_text(path: Path, text: str) -> None:
    """Write a text whole or not at all."""
    write_whole(path, utf8(text))


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place and move it there when it is complete; folders that lack are made.

    It is written under a name of chance, so that no link that lies there leads elsewhere; a link in its place is replaced.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{secrets.token_hex(8)}{PART}")
    try:
        with os.fdopen(os.open(part, _NEW, 0o666), "wb") as stream:
            stream.write(content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def contained(folder: Path, name: str) -> Path | None:
    """Return the path of a name in a folder; None where it lies outside, on any system and through any link."""
    parts = name.split("/")
    if any(part in ("", ".", "..") for part in parts) or set(name) & set("\\:\0"):  # a drive letter has a colon
        return None
    path = folder.joinpath(*parts)
    return path if is_within(path, folder) else None


def inside(folder: Path, name: str) -> Path:
    """Return the path of a name in a folder.

    Raises:
        InputError: a link leads out of the folder there.
    """
    path = folder / name
    if not is_within(path, folder):
        raise refuse("leads out of the folder: nothing is read, written or deleted there; remove the link", path)
    return path


def is_within(path: Path, folder: Path) -> bool:
    """Return whether a path leads into a folder when every link is followed."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a name that is too long, or links that go round
        return False
