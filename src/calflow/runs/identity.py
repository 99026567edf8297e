"""Identity: whether the study that is to run is the one whose run a folder holds."""

from __future__ import annotations

from pathlib import Path

from calflow.files.problems import refuse
from calflow.measurements.reading import sha256
from calflow.run_folder import Manifest, beside, is_measured
from calflow.study import Study


def check_same_study(study: Study, folder: Path, manifest: Manifest) -> None:
    """Check that a run folder is this study's.

    Raises:
        InputError: it is that of another study, be it of the same name.
    """
    if manifest.study != study.name:
        raise refuse(f"holds the run of another study, '{manifest.study}'; give another folder with --out", folder)
    if not (_at_the_same_place(study, folder, manifest) or _of_the_same_content(study, manifest)):
        raise refuse(
            f"holds the run of another study of the same name, {manifest.study_file}; to run {study.path.resolve()}, "
            "give another folder with --out, or the study another name",
            folder,
        )


def _at_the_same_place(study: Study, folder: Path, manifest: Manifest) -> bool:
    """Whether the study lies where it lay, by itself or beside its run folder: then it is the same one, edited."""
    old, new = Path(manifest.study_file), study.path
    if old.resolve() == new.resolve():
        return True
    return bool(manifest.folder) and beside(Path(manifest.folder), old) == beside(folder, new)


def _of_the_same_content(study: Study, manifest: Manifest) -> bool:
    """Whether study, robot and (where some were read) measurements are those of the run: then it is a copy."""
    known = set(manifest.inputs.values())
    own = [study.path, *study.robot_paths]
    if any(map(is_measured, manifest.inputs)):
        own += study.measurement_paths
    return all(sha256(path) in known for path in own)
