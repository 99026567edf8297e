"""Packing a run with everything needed to reproduce it elsewhere into one archive, byte by byte the same each time.

The archive is an RO-Crate 1.1 (https://w3id.org/ro/crate/1.1), for people and programs that do not know calflow; it
states the licence and the authors of its files.
"""

from __future__ import annotations

import hashlib
import io
import json
import mimetypes
import re
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from packaging.version import VERSION_PATTERN

from calflow.files.data_package import DATA_PACKAGE
from calflow.files.problems import InputError, Problem, escaped, refuse, refuse_any
from calflow.files.tables import columns, document_text
from calflow.files.writing import inside
from calflow.run_folder import INPUTS, LAID_OUT, NAME, Manifest, check_inputs, laid_out, lay_out
from calflow.runs.kept import run_package
from calflow.runs.reproduce import checked_run, finished
from calflow.stages.catalogue import STAGES

LICENCE = "#licence"
SPDX = "https://spdx.org/licenses/"
REFERENCE = "LicenseRef-"  # SPDX prefix of licences that are not on its list
METADATA = "ro-crate-metadata.json"
RO_CRATE_VERSION = "https://w3id.org/ro/crate/1.1"
CONTEXT = [f"{RO_CRATE_VERSION}/context", {"sha256": "https://schema.org/sha256"}]
MEDIA_TYPES = {
    ".csv": "text/csv",
    ".toml": "application/toml",
    ".h5": "application/x-hdf5",
    ".json": "application/json",
}
RUN, PROGRAM = "#run", "#calflow"
ENVIRONMENT = "environment.txt"
BEGINNING = (1980, 1, 1, 0, 0, 0)  # the earliest date of a zip, so that its bytes do not depend on the time of packing
PACKAGE = re.compile("[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?")
VERSION = re.compile(VERSION_PATTERN, re.VERBOSE | re.IGNORECASE)
READABLE, UNIX = 0o100644 << 16, 3


@dataclass(frozen=True)
class Terms:
    """A licence as an SPDX expression (https://spdx.org/licenses), e.g. `CC-BY-4.0`, and authors by name, if stated."""

    licence: str = ""
    authors: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

        if not all(name.strip() for name in self.authors):
            raise refuse("--author is empty: expected a name")
        if not self.licence:
            return
        try:
            object.__setattr__(self, "licence", canonicalize_license_expression(self.licence))
        except InvalidLicenseExpression:
            raise refuse(
                f"--licence '{self.licence}' is no SPDX licence expression: expected e.g. CC-BY-4.0, CC0-1.0, MIT, "
                f"'MIT AND CC-BY-4.0', or {REFERENCE}NAME for terms of your own ({SPDX} has the list)"
            ) from None

    def entities(self) -> list[dict[str, Any]]:
        """Return the licence and the authors as entities of an RO-Crate, the licence first."""
        people = [{"@id": f"#author-{k}", "@type": "Person", "name": name} for k, name in enumerate(self.authors, 1)]
        return [self._licence(), *people]

    def _licence(self) -> dict[str, Any]:
        if not self.licence:
            return {
                "@id": LICENCE,
                "@type": "CreativeWork",
                "name": "no licence stated",
                "description": "Who packed this run has not said under which terms its files may be used.",
            }
        listed = " " not in self.licence and not self.licence.startswith(REFERENCE)
        description = f"SPDX licence expression {self.licence}: the terms under which the files may be used."
        name = f"{SPDX}{self.licence}" if listed else LICENCE
        return {"@id": name, "@type": "CreativeWork", "name": self.licence, "description": description}


def ro_crate(manifest: Manifest, files: Mapping[str, bytes], terms: Terms) -> bytes:
    """Return the crate's metadata for an archive of these files, by path, under these terms.

    The run is a CreateAction of calflow from the inputs to the results; the data package has the schema of every table.
    """
    inputs = [name for name in files if name.startswith(f"{INPUTS}/")]
    results = [name for name in files if ("/" in name and name not in inputs) or name.startswith("report.")]
    licence, *authors = terms.entities()
    ended = max(entry.finished for entry in manifest.stages.values())
    graph: list[dict[str, Any]] = [
        {"@id": METADATA, "@type": "CreativeWork", "conformsTo": {"@id": RO_CRATE_VERSION}, "about": {"@id": "./"}},
        {
            "@id": "./", "@type": "Dataset", "name": f"calflow run of study {manifest.study}",
            "description": "A robot calibration: its inputs, its results, and what it takes to repeat it. Unpack it; 'calflow "
            "reproduce FOLDER' runs it again and tells what differs. environment.txt has the versions it was made with.",
            "datePublished": ended, "license": _reference(licence), **({"author": [*map(_reference, authors)]} if authors else {}),
            "hasPart": _named(files), "mentions": {"@id": RUN},
        },
        licence, *authors,
        {
            "@id": RUN, "@type": "CreateAction", "name": f"workflow {manifest.workflow} of study {manifest.study}",
            "endTime": ended, "instrument": {"@id": PROGRAM}, "object": _named(inputs), "result": _named(results),
        },
        {
            "@id": PROGRAM, "@type": "SoftwareApplication", "name": "calflow", "version": manifest.calflow,
            "identifier": manifest.code, "description": "calibrates robots; identifier is a hash of its code",
            "operatingSystem": manifest.machine,
        },
        *(_file(name, content) for name, content in files.items()),
    ]  # fmt: skip
    return f"{json.dumps({'@context': CONTEXT, '@graph': graph}, indent=2, ensure_ascii=False)}\n".encode()


def _reference(entity: Mapping[str, Any]) -> dict[str, str]:
    return {"@id": entity["@id"]}


def _named(names: Mapping[str, bytes] | list[str]) -> list[dict[str, str]]:
    return [{"@id": name} for name in names]


def _file(name: str, content: bytes) -> dict[str, Any]:
    path = PurePosixPath(name)
    kind = MEDIA_TYPES.get(path.suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    entity: dict[str, Any] = {
        "@id": name, "@type": "File", "name": path.name, "encodingFormat": kind, "contentSize": str(len(content)),
        "sha256": hashlib.sha256(content).hexdigest(),
    }  # fmt: skip
    declared = {table: row for stage in STAGES.values() for table, row in stage.tables.items()}.get(name)
    if declared is not None:
        entity["description"] = (declared.__doc__ or "").strip().splitlines()[0]
        entity["variableMeasured"] = [column.name for column in columns(declared)]
        entity["subjectOf"] = {"@id": DATA_PACKAGE}
    return entity


UNSTATED = Terms()


def pack(folder: str | Path, terms: Terms = UNSTATED) -> bytes:
    """Return a run folder as a zip archive: results, inputs, versions and RO-Crate metadata.

    Unpacked it is a run folder from which `calflow reproduce` can repeat the run. The same run gives the same bytes.
    terms are the licence and authors of its files.

    Raises:
        InputError: an input has changed, is missing, or is named by an absolute path; results were changed; or the run
            was made by an earlier version of calflow.
    """
    folder = Path(folder)
    manifest = checked_run(folder)
    check_inputs(folder, manifest)
    files = _files(manifest, folder)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in {METADATA: ro_crate(manifest, files, terms), **files}.items():
            entry = zipfile.ZipInfo(name, BEGINNING)
            entry.external_attr, entry.create_system, entry.compress_type = READABLE, UNIX, zipfile.ZIP_DEFLATED
            archive.writestr(entry, content, compresslevel=9)
    return packed.getvalue()


def environment_lock(manifest: Manifest) -> str:
    """Return the versions of a run's environment as a requirements file; calflow, in no index, is named in a comment.

    Raises:
        InputError: an entry of the manifest is not the version of a package; pip would execute other lines as options.
    """
    versions = {**manifest.versions, **manifest.environment}
    python, _ = versions.pop("python", "unknown"), versions.pop("calflow", None)
    wrong = [
        (name, version)
        for name, version in versions.items()
        if not (PACKAGE.fullmatch(name) and VERSION.fullmatch(version))
    ]
    refuse_any(
        Problem(f"expected the version of a package, found {version!r}; run the study again", Path(NAME), key=name)
        for name, version in wrong
    )
    software = f"calflow {manifest.calflow} (code {manifest.code}), from its own wheel or sources"
    head = f"# {escaped(f'Python {python}, {manifest.machine}')}\n# and {escaped(software)}\n"
    return head + "".join(f"{name}=={version}\n" for name, version in sorted(versions.items()))


def _files(manifest: Manifest, folder: Path) -> dict[str, bytes]:
    """Return the contents of the archive's files, except the metadata, by path in the archive, sorted."""
    outputs = {name: digest for stage in finished(manifest) for name, digest in manifest.outputs(stage).items()}
    files = {name: (inside(folder, name), digest) for name, digest in outputs.items()}
    names = [NAME, *outputs]
    names += [f"{INPUTS}/{path.name}" for path in (folder / INPUTS).glob("*") if path.is_file()]
    contents = {name: inside(folder, name).read_bytes() for name in names}
    contents |= {f"{LAID_OUT}/{place}": content for place, content in _inputs(manifest, folder).items()}
    contents[ENVIRONMENT] = environment_lock(manifest).encode()
    contents[DATA_PACKAGE] = document_text(run_package(manifest.study, files)).encode()
    return dict(sorted(contents.items()))


def _inputs(manifest: Manifest, folder: Path) -> dict[str, bytes]:
    """Return the content of every input by its path under `LAID_OUT`."""
    places = laid_out(manifest.files)
    if elsewhere := [name for name in manifest.files if name not in places]:
        message = "is named by an absolute path, which another machine does not have: name it as seen from the study, and run again"
        raise InputError(Problem(message, Path(manifest.study_file), key=name) for name in elsewhere)
    with tempfile.TemporaryDirectory() as made:
        lay_out(manifest, folder, Path(made))
        return {place: (Path(made) / place).read_bytes() for place in places.values()}
