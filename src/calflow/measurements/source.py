"""The measurement file that a study names: its `[measurements]` table; locating, downloading and verifying the file."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Mapping
from dataclasses import fields
from http.client import HTTPException
from pathlib import Path
from threading import Thread
from typing import Annotated, Any, Literal
from urllib.error import URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, build_opener

from pydantic import Field, field_validator, model_validator
from pydantic.json_schema import SkipJsonSchema

from calflow.files.problems import InputError, NoSuchFile, nearest_file, refuse, regular_file
from calflow.files.toml import Angle, Angles3, FileModel, Length, Lengths3, Sigma, Unit
from calflow.measurements.rows import Layout, Missing, Reported
from calflow.measurements.series import BeamNoise, Series, Setting, Station

LARGEST, LONGEST, SILENCE = 500_000_000, 900.0, 30.0  # limits of a download: bytes; s in total; s without data
PIECE = 2**16  # bytes read at a time


class StationFile(FileModel):
    """The pose of a series' device: the table `[measurements.station]`."""

    name: str = ""
    known: bool = False
    origin: Lengths3 = (0.0, 0.0, 0.0)
    rotation: Angles3 = (0.0, 0.0, 0.0)
    by_session: bool = False


class BeamFile(FileModel):
    """A tracker's noise as datasheets state it: floor + growth · range along the beam, and an angle across it."""

    floor: Length = Field(gt=0)
    growth: Annotated[float, Unit("ratio")] = Field(default=0.0, ge=0)
    angle: Angle = Field(gt=0)


class MeasurementSource(FileModel):
    """The location and the format of measurements: a `[measurements]` table of a study.

    kind is an observation's id, settings are the options of that kind.

    A url, by https, is downloaded once by a run and cached; it requires sha256. The folder that CALFLOW_DATA names is
    searched first. columns map calflow's names to the file's, or list the columns of a file without a header line. The
    other keys are those of `Layout`.
    """

    file: str
    name: str = ""
    kind: str = ""
    station: StationFile = StationFile()
    noise: BeamFile | None = None
    settings: dict[str, Any] = {}
    url: str | None = None
    sha256: str | None = None
    separator: str = ","
    decimal: Literal[".", ","] = "."
    encoding: str = "utf-8"
    header_line: int | None = Field(default=None, ge=1)
    sheet: str = ""
    columns: dict[str, str] | tuple[str, ...] = {}
    markers: dict[str, dict[str, str]] = {}
    sigma: Sigma | None = Field(default=None, gt=0)
    sigma_unit: SkipJsonSchema[str] = ""
    sigma_rotation: Angle | None = Field(default=None, gt=0)
    in_order: bool = False
    tracker: Lengths3 | None = None
    missing: Missing = "whole"

    @model_validator(mode="after")
    def _fetched_is_checked(self) -> MeasurementSource:
        if self.url and not self.sha256:
            raise ValueError("a url needs the file's sha256")
        _ = self.layout  # raises ValueError if it is invalid
        return self

    @field_validator("columns", mode="before")
    @classmethod
    def _are_names(cls, columns: Any) -> Any:
        names = columns.values() if isinstance(columns, dict) else columns if isinstance(columns, tuple) else [None]
        if not all(isinstance(name, str) for name in names):
            raise ValueError(
                'expected a table of names, our name = "its name", or a list of the file\'s columns in order'
            )
        return columns

    @field_validator("url")
    @classmethod
    def _is_fetched_safely(cls, url: str | None) -> str | None:
        if url is not None and not re.fullmatch(r"https://[!-~]+", url):
            raise ValueError(
                f"expected a url that begins with https:// and has no blanks, found {url!r}; fetch anything else "
                "yourself, into the folder that CALFLOW_DATA names"
            )
        return url

    @field_validator("sha256")
    @classmethod
    def _is_a_hash(cls, sha256: str | None) -> str | None:
        if sha256 is not None and not re.fullmatch("[0-9a-f]{64}", sha256):
            raise ValueError(f"expected 64 digits 0-9 and a-f, found {len(sha256)} characters: {sha256!r}")
        return sha256

    @property
    def layout(self) -> Layout:
        """The layout of the file, for positions and any orientations."""
        header = self.columns if isinstance(self.columns, tuple) else ()
        settings: dict[str, Any] = {
            "columns": {} if header else self.columns,
            "header": header,
            "header_line": self.header_line or (0 if header else 1),
        }
        names = [field.name for field in fields(Layout) if field.name not in ("reports", *settings)]
        return Layout(**settings, **{name: getattr(self, name) for name in names})

    def series(self, reports: Reported, settings: Mapping[str, Setting]) -> Series:
        """Return the series that the table describes, given the columns and the validated settings of its kind."""
        device = self.tracker or (0.0, 0.0, 0.0)
        beam = None if self.noise is None else BeamNoise(self.noise.floor, self.noise.growth, self.noise.angle, device)
        station = Station(**self.station.model_dump())
        return Series(
            self.name, self.kind, station, beam, tuple(settings.items()), reports.labels, tuple(reports.within)
        )


def data_folder() -> Path | None:
    """Return the folder searched first for measurements, which CALFLOW_DATA names; None if it is unset."""
    named = os.environ.get("CALFLOW_DATA")
    return Path(named) if named else None


def locate(source: MeasurementSource, folder: Path, data: Path | None = None) -> Path:
    """Return the path of the measurement file: in the data folder, in the study's folder, or in the cache of downloads.

    Raises:
        InputError: it is in none of them, or its SHA-256 differs from the study's.
    """
    path, wrong = None, None
    for place in _paths(source, folder, data):
        try:
            path = regular_file(place)
            break
        except NoSuchFile:
            continue
        except InputError as error:
            wrong = wrong or error
    here = folder / source.file
    if path is None and wrong:
        raise wrong
    if path is None and source.url:
        raise refuse(f"is not fetched yet: 'calflow run' fetches it from {source.url}", here)
    if path is None:
        raise refuse(
            f"no such measurement file; expected it there, in the folder that CALFLOW_DATA names, or by a url in the "
            f"study{nearest_file(here)}",
            here,
        )
    if not os.access(path, os.R_OK):
        raise refuse("cannot be read: permission denied", path)
    if source.sha256 and sha256(path) != source.sha256:
        raise refuse(f"wrong SHA-256: the study names {source.sha256}, the file has {sha256(path)}", path)
    return path


def is_to_fetch(source: MeasurementSource, folder: Path, data: Path | None = None) -> bool:
    """Whether a measurement file has a url and is not on this machine yet."""
    return bool(source.url) and not any(map(os.path.exists, _paths(source, folder, data)))


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits."""
    import hashlib

    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def fetch(source: MeasurementSource) -> None:
    """Download a measurement file from its url, and cache it if it has the study's SHA-256.

    Raises:
        InputError: the download by https fails, exceeds `LARGEST` or `LONGEST`, or has another SHA-256.
    """
    import pooch

    kept = _cached(source)
    pooch.get_logger().setLevel("WARNING")  # the caller announces the download
    for old in kept.parent.glob("tmp*"):  # left by a killed process
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


def _paths(source: MeasurementSource, folder: Path, data: Path | None) -> list[Path]:
    """Return the possible paths of a measurement file, in order of search."""
    return [*([data / source.file] if data else []), folder / source.file, *([_cached(source)] if source.url else [])]


def _cached(source: MeasurementSource) -> Path:
    """Return the cache path of a downloaded file, named by its SHA-256."""
    import pooch

    return Path(pooch.os_cache("calflow")) / f"{source.sha256}{Path(source.file).suffix}"


class _Redirects(HTTPRedirectHandler):
    """A redirect handler that follows a few redirects, to https only."""

    max_redirections = 5

    def redirect_request(self, req: Any, fp: Any, code: Any, msg: Any, headers: Any, newurl: str) -> Any:
        if urlsplit(newurl).scheme != "https":
            raise URLError(f"it leads on to {newurl}, which is not https")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _download(url: str, path: str, _: Any) -> None:
    """Download a url into a file within all limits: a downloader for pooch.

    It runs in a thread, so that it can be abandoned even if the server sends byte by byte.
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
