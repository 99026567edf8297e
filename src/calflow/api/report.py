"""The report of what a notebook found, or of a run."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from calflow.api.diagnosed import Diagnosis
from calflow.api.fit import Fit
from calflow.files.problems import refuse


def report(found: Fit | Diagnosis | str | Path, path: str | Path, title: str = "") -> Path:
    """Write the report as a PDF, or as a page for browsers, and return its path.

    Args:
        found: a fit, a diagnosis, or a run's folder or study whose report is copied.
        path: of the file, which ends in .pdf or .html.
        title: of the report; that of a run is its study's.

    Raises:
        InputError: the run has no report, or path is neither PDF nor HTML.
    """
    path = Path(path)
    if path.suffix.lower() not in (".pdf", ".html"):
        raise refuse("expected a name that ends in .pdf or .html", path)
    name = f"report{path.suffix.lower()}"
    if isinstance(found, str | Path):
        return _copied(Path(found), name, path)
    if not isinstance(found, Fit | Diagnosis):
        raise TypeError(f"expected a fit, a diagnosis or a run folder, found {type(found).__name__}")
    from calflow.reporting.document import write_report

    with TemporaryDirectory() as folder:
        write_report(found.material(title), Path(folder))
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(Path(folder) / name, path)
    return path


def _copied(study_or_run: Path, name: str, path: Path) -> Path:
    from calflow.run_folder import run_folder

    written = run_folder(study_or_run) / name
    if not written.is_file():
        raise refuse("there is no report yet; run the study", written)
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(written, path)
    return path
