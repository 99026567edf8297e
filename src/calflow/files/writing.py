"""Writing: a file appears whole or not at all, whatever stops the program."""

from __future__ import annotations

import os
from pathlib import Path


def utf8(text: str) -> bytes:
    """Return a text as it is written; bytes of a file's name that are no text are spelled out."""
    return text.encode(errors="backslashreplace")


def write_text(path: Path, text: str) -> None:
    """Write a text whole or not at all."""
    write_whole(path, utf8(text))


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place and move it there when it is complete; folders that lack are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
