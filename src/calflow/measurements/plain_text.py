"""Plain text: what a measurement file must be before its cells are read."""

from __future__ import annotations

from pathlib import Path

from calflow.files.problems import CONTROL, refuse

REMEDY = 'save it as "CSV UTF-8 (comma delimited)", as Excel calls it'
ARCHIVE, OLE = b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"  # how .xlsx and .xls begin
HEAD = 4096  # bytes that tell what a file is


def check_text(path: Path, separator: str = ",") -> None:
    """Refuse what is not text in UTF-8, with what to do about it.

    Raises:
        InputError: it is an Excel file, text in another encoding, or no text.
    """
    with path.open("rb") as stream:
        head = stream.read(HEAD)
        if head.startswith((ARCHIVE, OLE)):
            raise refuse(f"is an Excel file (or another archive), not a CSV: {REMEDY}", path)
        even, odd = head[::2], head[1::2]
        if head.startswith((b"\xff\xfe", b"\xfe\xff")) or (b"\0" in head and not (any(even) and any(odd))):
            raise refuse(f"is not a text file in UTF-8 but in UTF-16: {REMEDY}", path)
        stream.seek(0)
        for line, text in enumerate(stream, start=1):
            try:
                signs = text.decode()
            except UnicodeDecodeError as error:
                sign = text[error.start : error.start + 1]
                raise refuse(f"is not in UTF-8: byte {sign[0]:#x} would be {sign.decode('latin-1')!r} in Latin-1; {REMEDY}",
                             path, line) from None  # fmt: skip
            control = CONTROL.search(signs.replace(separator, ""))
            if control:
                raise refuse(
                    f"is not a text file: expected a CSV, found the control character {control.group()!r}", path, line
                )
