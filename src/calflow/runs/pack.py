"""Packing: a run with all that it takes to repeat it elsewhere, in one archive that is the same byte by byte each time."""

from __future__ import annotations

import io
import re
import tempfile
import zipfile
from pathlib import Path

from packaging.version import VERSION_PATTERN

from calflow.files.data_package import DATA_PACKAGE
from calflow.files.problems import InputError, Problem, seen
from calflow.files.results import document_text
from calflow.files.writing import inside
from calflow.run_folder import INPUTS, LAID_OUT, NAME, Manifest, check_inputs, laid_out, lay_out
from calflow.runs.kept import run_package
from calflow.runs.reproduce import checked_run, finished
from calflow.runs.ro_crate import NAME as METADATA
from calflow.runs.ro_crate import ro_crate
from calflow.runs.terms import Terms

ENVIRONMENT = "environment.txt"
BEGINNING = (1980, 1, 1, 0, 0, 0)  # the earliest date that a zip can state: the archive's bytes tell no time
UNSTATED = Terms()
PACKAGE = re.compile("[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?")
VERSION = re.compile(VERSION_PATTERN, re.VERBOSE | re.IGNORECASE)
READABLE, UNIX = 0o100644 << 16, 3


def pack(folder: str | Path, terms: Terms = UNSTATED) -> bytes:
    """Return a run folder as a zip: what its stages wrote, all its inputs, the versions it was made with, and RO-Crate metadata.

    Unpacked it is a run folder, of which `calflow reproduce` needs nothing else. The same run gives the same bytes.
    terms are those under which its files may be used.

    Raises:
        InputError: an input has changed or is missing, or is named by an absolute path; results were changed; or an earlier
            version of calflow made the run.
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
    """Return the versions that a run was made with, as pip reads them; calflow itself, which no index has, in words.

    Raises:
        InputError: what the manifest states is no version of a package: pip obeys whatever else a line says.
    """
    versions = {**manifest.versions, **manifest.environment}
    python, _ = versions.pop("python", "unknown"), versions.pop("calflow", None)
    wrong = [
        (name, said) for name, said in versions.items() if not (PACKAGE.fullmatch(name) and VERSION.fullmatch(said))
    ]
    if wrong:
        raise InputError(
            Problem(f"expected the version of a package, found {said!r}; run the study again", Path(NAME), key=name)
            for name, said in wrong
        )
    own = f"calflow {manifest.calflow} (code {manifest.code}), from its own wheel or sources"
    head = f"# {seen(f'Python {python}, {manifest.machine}')}\n# and {seen(own)}\n"
    return head + "".join(f"{name}=={version}\n" for name, version in sorted(versions.items()))


def _files(manifest: Manifest, folder: Path) -> dict[str, bytes]:
    """The archive's files by their path in it, but for the metadata, in order."""
    outputs = {name: said for stage in finished(manifest) for name, said in manifest.outputs(stage).items()}
    files = {name: (inside(folder, name), said) for name, said in outputs.items()}
    names = [NAME, *outputs]
    names += [f"{INPUTS}/{path.name}" for path in (folder / INPUTS).glob("*") if path.is_file()]
    found = {name: inside(folder, name).read_bytes() for name in names}
    found |= {f"{LAID_OUT}/{place}": content for place, content in _inputs(manifest, folder).items()}
    found[ENVIRONMENT] = environment_lock(manifest).encode()
    found[DATA_PACKAGE] = document_text(run_package(manifest.study, files)).encode()
    return dict(sorted(found.items()))


def _inputs(manifest: Manifest, folder: Path) -> dict[str, bytes]:
    """Every input by its place under the archive's inputs."""
    places = laid_out(manifest.files)
    if elsewhere := [name for name in manifest.files if name not in places]:
        said = "is named by an absolute path, which another machine does not have: name it as seen from the study, and run again"
        raise InputError(Problem(said, Path(manifest.study_file), key=name) for name in elsewhere)
    with tempfile.TemporaryDirectory() as made:
        lay_out(manifest, folder, Path(made))
        return {place: (Path(made) / place).read_bytes() for place in places.values()}
