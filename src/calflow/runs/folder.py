"""The run folder: where a study's run goes, whose run a folder holds, and the results in it."""

from __future__ import annotations

import json
from pathlib import Path

from calflow.files.csv import read_csv
from calflow.files.problems import refuse
from calflow.files.results import Results
from calflow.runs.identity import beside
from calflow.runs.manifest import NAME, Manifest, read_manifest
from calflow.stages import STAGES
from calflow.study import Study, load_study


def default_folder(study: Study) -> Path:
    """Return where a study's run goes unless said otherwise."""
    return Path("runs") / study.name


def run_folder(study_or_run: Path) -> Path:
    """Return the run folder that is named by itself, by its study file or by that file's folder; it may not exist yet.

    Raises:
        InputError: it is neither, or the study's files are at fault.
    """
    if (study_or_run / NAME).exists():
        return study_or_run
    is_study = study_or_run.suffix == ".toml" or study_or_run.is_file() or (study_or_run / "study.toml").exists()
    if not is_study:
        raise refuse("holds no run: expected a folder that 'calflow run' has filled, or a study", study_or_run)
    return default_folder(load_study(study_or_run))


def study_and_folder(study_or_run: Path, out: Path | None) -> tuple[Study, Path]:
    """Return the study and the run folder that are named by a run folder, a study file or its folder, and --out.

    Raises:
        InputError: a run folder's study is not where it was, or the study's files are at fault.
    """
    if not (study_or_run / NAME).exists():
        study = load_study(study_or_run)
        return study, out or default_folder(study)
    if out is not None and out.resolve() != study_or_run.resolve():
        raise refuse(f"is a run folder: --out {out} goes with a study, not with a run", study_or_run)
    manifest = read_manifest(study_or_run)
    assert manifest is not None
    return load_study(_study_file(manifest, study_or_run)), study_or_run


def read_results(manifest: Manifest, folder: Path, stage: str) -> Results:
    """Return a stage's tables and documents by their path in the run folder."""
    outputs = manifest.outputs(stage)
    tables = {name: read_csv(folder / name) for name in outputs if name.endswith(".csv")}
    names = [name for name in outputs if name in STAGES[stage].documents]
    return Results(tables, {name: json.loads((folder / name).read_text(encoding="utf-8")) for name in names})


def _study_file(manifest: Manifest, folder: Path) -> Path:
    """Return the file of a run's study: as it lies beside the run folder, which may have moved with it, or where it was."""
    was = Path(manifest.study_file)
    moved = folder / beside(Path(manifest.folder), was) if manifest.folder else was
    found = next((path for path in (moved, was) if path.is_file()), None)
    if found is None:
        raise refuse(f"its study {was} is not there any more; give the study file, and this folder with --out", folder)
    return found
