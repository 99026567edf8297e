"""The measurement file that a study names: found, compared with its hash, and read."""

from __future__ import annotations

import os
from pathlib import Path

from calflow.files.problems import InputError, refuse
from calflow.files.regular import regular_file
from calflow.measurements.measurements import Measurements
from calflow.measurements.source import MeasurementSource
from calflow.robot.robot import Robot


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
    """Return the path of the measurement file: in a folder of data, then in the study's, then fetched by its url.

    Raises:
        InputError: it is nowhere, or its SHA-256 differs from the study's.
    """
    here = folder / source.file
    path, said = None, ""
    for place in [data / source.file, here] if data else [here]:
        try:
            path = regular_file(place)
            break
        except FileNotFoundError:
            continue
        except InputError as error:
            said = said or f" ({error.problems[0].message})"
    if path is None and source.url:
        path = _fetch(source)
    if path is None:
        raise refuse(
            f"no such measurement file{said}; expected it there, in the folder that CALFLOW_DATA names, or by a url in the "
            "study",
            here,
        )
    if not os.access(path, os.R_OK):
        raise refuse("cannot be read: permission denied", path)
    if source.sha256 and sha256(path) != source.sha256:
        raise refuse(f"wrong SHA-256: the study names {source.sha256}, the file has {sha256(path)}", path)
    return path


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    import hashlib

    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _fetch(source: MeasurementSource) -> Path:
    import pooch

    try:
        return Path(pooch.retrieve(source.url, f"sha256:{source.sha256}", path=pooch.os_cache("calflow")))
    except Exception as error:  # any network fault: requests' many classes are pooch's, not ours
        if "hash" in str(error):
            raise refuse(f"wrong SHA-256: {error}", key=source.url) from None
        raise refuse(
            f"could not be fetched ({error}); put the file into the folder that CALFLOW_DATA names, as {source.file}",
            key=source.url,
        ) from None
