"""RO-Crate 1.1: a packed run described for people and programs that do not know calflow (https://w3id.org/ro/crate/1.1)."""

from __future__ import annotations

import hashlib
import json
import mimetypes
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from calflow.files.data_package import DATA_PACKAGE
from calflow.files.tables import columns
from calflow.run_folder import INPUTS, Manifest
from calflow.runs.terms import Terms
from calflow.stages import STAGES

NAME = "ro-crate-metadata.json"
VERSION = "https://w3id.org/ro/crate/1.1"
CONTEXT = [f"{VERSION}/context", {"sha256": "https://schema.org/sha256"}]
KINDS = {".csv": "text/csv", ".toml": "application/toml", ".h5": "application/x-hdf5", ".json": "application/json"}
RUN, PROGRAM = "#run", "#calflow"


def ro_crate(manifest: Manifest, files: Mapping[str, bytes], terms: Terms) -> bytes:
    """Return the crate's metadata; files are the archive's by their path in it, without the metadata, used by these terms.

    The run is a CreateAction of calflow on the inputs, whose results are all else; the data package has the schema of every table.
    """
    inputs = [name for name in files if name.startswith(f"{INPUTS}/")]
    results = [name for name in files if ("/" in name and name not in inputs) or name.startswith("report.")]
    licence, *authors = terms.entities()
    ended = max(entry.finished for entry in manifest.stages.values())
    graph: list[dict[str, Any]] = [
        {"@id": NAME, "@type": "CreativeWork", "conformsTo": {"@id": VERSION}, "about": {"@id": "./"}},
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
    kind = KINDS.get(path.suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    said: dict[str, Any] = {
        "@id": name, "@type": "File", "name": path.name, "encodingFormat": kind, "contentSize": str(len(content)),
        "sha256": hashlib.sha256(content).hexdigest(),
    }  # fmt: skip
    declared = {table: row for stage in STAGES.values() for table, row in stage.tables.items()}.get(name)
    if declared is not None:
        said["description"] = (declared.__doc__ or "").strip().splitlines()[0]
        said["variableMeasured"] = [one.name for one in columns(declared)]
        said["subjectOf"] = {"@id": DATA_PACKAGE}
    return said
