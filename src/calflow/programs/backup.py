"""Backups: a controller's project in a folder or a zip archive, read as untrusted input and written atomically."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path

from calflow.files.problems import Problem, refuse, refuse_any, regular_file
from calflow.files.writing import PART, contained, write_whole

MOST_FILES = 20_000
MOST_BYTES = 500_000_000  # of all files, unpacked
ARCHIVE = ".zip"


def is_backup(path: Path) -> bool:
    """Return whether a path is a project of several files: a folder or an archive."""
    return path.is_dir() or path.suffix.lower() == ARCHIVE


def read_files(path: Path) -> dict[str, bytes]:
    """Return the contents of a project's files by their relative path (POSIX); for a single file, its own.

    Raises:
        InputError: the path does not exist, or a member is a link or device, leads out of the project, or is too large.
    """
    if path.is_dir():
        return _folder_files(path)
    content = regular_file(path, "no such file or folder").read_bytes()
    if path.suffix.lower() == ARCHIVE:
        return {info.filename: member for info, member in _members(content, path)}
    return {path.name: content}


def _folder_files(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder and its subfolders."""
    paths, problems, size = list[Path](), list[Problem](), 0
    for here, folders, names in os.walk(folder, followlinks=False):
        for path in sorted(Path(here) / name for name in (*folders, *names)):
            mode = path.lstat()
            if stat.S_ISREG(mode.st_mode):
                paths.append(path)
                size += mode.st_size
            elif not stat.S_ISDIR(mode.st_mode):
                problems.append(Problem("is a link, a device or the like; a project has only files and folders", path))
        _check_size(len(paths), size, folder)
    refuse_any(problems)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(paths)}


def _check_size(files: int, size: int, path: Path) -> None:
    if files > MOST_FILES or size > MOST_BYTES:
        raise refuse(f"holds more than {MOST_FILES} files or {MOST_BYTES / 1e6:.0f} MB unpacked", path)


def _members(packed: bytes, path: Path) -> Iterator[tuple[zipfile.ZipInfo, bytes]]:
    """Yield the files of an archive, which is never unpacked to disk."""
    try:
        archive = zipfile.ZipFile(BytesIO(packed))
        infos = [info for info in archive.infolist() if not info.is_dir()]
        refuse_any(Problem(why, path) for info in archive.infolist() if (why := _unsafe(info)))
        names = [info.filename for info in infos]
        refuse_any(Problem(f"holds '{name}' twice", path) for name in sorted({n for n in names if names.count(n) > 1}))
        size = 0
        for info in infos:
            with archive.open(info) as stream:  # the size in the header may be false
                content = stream.read(MOST_BYTES - size + 1)
            size += len(content)
            _check_size(len(infos), size, path)
            yield info, content
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise refuse(f"is not a readable archive: {error}", path) from None


def _unsafe(info: zipfile.ZipInfo) -> str:
    """Return why a member must not be read; empty if it may."""
    name = info.filename.rstrip("/").replace("\\", "/")
    if contained(Path(), name) is None:
        return f"holds '{info.filename}', which leads out of the archive"
    if stat.S_ISLNK(info.external_attr >> 16):
        return f"holds '{info.filename}', which is a link"
    return f"holds '{info.filename}', which is encrypted" if info.flag_bits & 1 else ""


def content_of(path: Path, files: Mapping[str, bytes]) -> bytes:
    """Return the content of an archive, or of a single file, with the contents of its files replaced."""
    if path.suffix.lower() != ARCHIVE:
        (content,) = files.values()
        return content
    source = path.read_bytes()
    members = list(_members(source, path))
    if all(files[info.filename] == content for info, content in members):
        return source
    written = BytesIO()
    with zipfile.ZipFile(written, "w") as archive:
        for info, _ in members:
            archive.writestr(info, files[info.filename])
    return written.getvalue()


def write_files(path: Path, files: Mapping[str, bytes], out: Path) -> None:
    """Write a project's files atomically to a path that does not exist yet, or holds the same.

    Raises:
        InputError: the folder exists and holds something else.
    """
    if not path.is_dir():
        write_whole(out, content_of(path, files))
        return
    check_folder(files, out)
    out.parent.mkdir(parents=True, exist_ok=True)
    part = out.with_name(f".{secrets.token_hex(8)}{PART}")
    try:
        for name, content in files.items():
            write_whole(part / name, content)
        if out.exists():
            shutil.rmtree(out)  # it holds the same files: see check_folder
        os.rename(part, out)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def check_folder(files: Mapping[str, bytes], out: Path) -> None:
    """Check that a folder does not exist yet, or holds exactly these files.

    Raises:
        InputError: it holds something else.
    """
    if (out.exists() or out.is_symlink()) and not (out.is_dir() and _folder_files(out) == files):
        raise refuse("is there already with other content; remove it, or give another name (--out)", out)
