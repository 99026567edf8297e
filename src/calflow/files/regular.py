"""Regular files: what calflow opens; a device or a pipe would keep it waiting for ever."""

from __future__ import annotations

import stat
from pathlib import Path

from calflow.files.problems import refuse

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}


def regular_file(path: Path) -> Path:
    """Return a path after a look at what is there, which opens nothing.

    Raises:
        FileNotFoundError: nothing is there.
        InputError: what is there is not a regular file.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:  # a name that is too long, or has a zero in it
        raise refuse(f"cannot be read: {getattr(error, 'strerror', None) or error}", path) from None
    if not stat.S_ISREG(mode):
        raise refuse(f"cannot be read: not a regular file but {KINDS.get(stat.S_IFMT(mode), 'something else')}", path)
    return path
