"""The measurement file that a study names: found or fetched, compared with its hash, and read."""

from __future__ import annotations

import os
import time
from http.client import HTTPException
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.error import URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, build_opener

from calflow.files.problems import InputError, refuse
from calflow.files.regular import regular_file
from calflow.measurements.measurements import Measurements
from calflow.measurements.source import MeasurementSource
from calflow.robot.robot import Robot

LARGEST, LONGEST, SILENCE = 500_000_000, 900.0, 30.0  # of what is fetched: bytes; s in all; s without a byte
PIECE = 2**16  # bytes


def read_measurements(path: Path, robot: Robot, source: MeasurementSource | None = None) -> Measurements:
    """Read and check a measurement file as a study says.

    Raises:
        InputError: with everything that is wrong in the file.
    """
    return Measurements.from_csv(path, robot, **({} if source is None else vars(source.layout)))


def data_folder() -> Path | None:
    """Return the folder in which measurements are looked for first: the one that CALFLOW_DATA names."""
    named = os.environ.get("CALFLOW_DATA")
    return Path(named) if named else None


def locate(source: MeasurementSource, folder: Path, data: Path | None = None) -> Path:
    """Return the path of the measurement file: in a folder of data, in the study's, or as it was fetched by its url.

    Raises:
        InputError: it is nowhere, or its SHA-256 differs from the study's.
    """
    path, reason = None, ""
    for place in _places(source, folder, data):
        try:
            path = regular_file(place)
            break
        except FileNotFoundError:
            continue
        except InputError as error:
            reason = reason or f" ({error.problems[0].message})"
    here = folder / source.file
    if path is None and source.url:
        raise refuse(f"is not fetched yet{reason}: 'calflow run' fetches it from {source.url}", here)
    if path is None:
        raise refuse(
            f"no such measurement file{reason}; expected it there, in the folder that CALFLOW_DATA names, or by a url in the "
            "study",
            here,
        )
    if not os.access(path, os.R_OK):
        raise refuse("cannot be read: permission denied", path)
    if source.sha256 and sha256(path) != source.sha256:
        raise refuse(f"wrong SHA-256: the study names {source.sha256}, the file has {sha256(path)}", path)
    return path


def is_to_fetch(source: MeasurementSource, folder: Path, data: Path | None = None) -> bool:
    """Return whether a measurement file has a url, and is nowhere yet."""
    return bool(source.url) and not any(map(os.path.exists, _places(source, folder, data)))


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    import hashlib

    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def fetch(source: MeasurementSource) -> None:
    """Fetch a measurement file by its url, and keep it where it has the study's SHA-256.

    Raises:
        InputError: it cannot be had by https, within `LARGEST` and `LONGEST`, or is another file.
    """
    import pooch

    kept = _kept(source)
    pooch.get_logger().setLevel("WARNING")  # whoever fetches has said so
    for old in kept.parent.glob("tmp*"):  # of a process that was killed
        if time.time() - old.stat().st_mtime > 2 * LONGEST:
            old.unlink(missing_ok=True)
    try:
        pooch.retrieve(source.url, f"sha256:{source.sha256}", kept.name, kept.parent, downloader=_download)
    except ValueError as error:
        raise refuse(f"wrong SHA-256: {error}", key=source.url) from None
    except (OSError, HTTPException) as error:
        raise refuse(
            f"could not be fetched ({error}); put the file into the folder that CALFLOW_DATA names, as {source.file}",
            key=source.url,
        ) from None


def _places(source: MeasurementSource, folder: Path, data: Path | None) -> list[Path]:
    """Where a measurement file may be, in the order in which it is looked for."""
    return [*([data / source.file] if data else []), folder / source.file, *([_kept(source)] if source.url else [])]


def _kept(source: MeasurementSource) -> Path:
    """Where a file is kept that was fetched: by its content, whatever it was called."""
    import pooch

    return Path(pooch.os_cache("calflow")) / f"{source.sha256}{Path(source.file).suffix}"


class _Redirects(HTTPRedirectHandler):
    """Follows a server to another place a few times, and by https alone."""

    max_redirections = 5

    def redirect_request(self, req: Any, fp: Any, code: Any, msg: Any, headers: Any, newurl: str) -> Any:
        if urlsplit(newurl).scheme != "https":
            raise URLError(f"it leads on to {newurl}, which is not https")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _download(url: str, path: str, _: Any) -> None:
    """Write what a url names into a file, within all limits: a downloader of pooch's.

    It goes on in a thread, which a server that answers byte by byte cannot keep from being given up.
    """
    failures: list[Exception] = []

    def copy() -> None:
        try:
            _copy(url, path, time.monotonic() + LONGEST)
        except (OSError, HTTPException) as error:
            failures.append(error)

    copying = Thread(target=copy, daemon=True)
    copying.start()
    copying.join(LONGEST)
    if copying.is_alive():
        raise TimeoutError(f"it takes longer than {LONGEST / 60:g} minutes")
    if failures:
        raise failures[0]


def _copy(url: str, path: str, until: float) -> None:
    with build_opener(_Redirects).open(url, timeout=SILENCE) as answer, open(path, "wb") as stream:
        left = LARGEST
        while (piece := answer.read1(PIECE)) and time.monotonic() < until:
            left -= len(piece)
            if left < 0:
                raise OSError(f"it is larger than {LARGEST / 1e6:g} MB")
            stream.write(piece)
