"""The files of a study: all that a run is made of, by their names as seen from the study's folder, kept and laid out again."""

from __future__ import annotations

import posixpath
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path, PurePath

from calflow.measurements.reading import sha256
from calflow.run_folder import KeptFile
from calflow.runs.cache_key import file_hashes
from calflow.stages import STAGES
from calflow.study import Study


def study_files(
    study: Study, stages: Collection[str], measured: bool, before: Mapping[str, KeptFile]
) -> dict[str, KeptFile]:
    """Return every file but the workflow that a study consists of, itself included, by its name as seen from its folder.

    stages are those whose settings count; where none of them was measured yet, what was known of the measurements stays.
    """
    known = {name: one for name, one in before.items() if one.measured}
    found = {name: _kept(path, False) for name, path in _described(study, {*study.stages, *stages})}
    return found | ({name: _kept(path, True) for name, path in _measured(study)} if measured else known)


def _kept(path: Path, measured: bool) -> KeptFile:
    return KeptFile(sha256=sha256(path), path=str(path.resolve()), measured=measured)


def _described(study: Study, stages: Collection[str]) -> Iterable[tuple[str, Path]]:
    """The files that say what was asked, each with its name."""
    folder, robot = study.path.parent, PurePath(study.file.robot)
    yield study.path.name, study.path
    yield from ((_named(robot.parent / path.name), path) for path in study.robot_paths)
    if study.file.workflow.endswith(".toml"):
        yield _named(PurePath(study.file.workflow)), study.workflow_path
    for name in sorted(STAGES.keys() & set(stages)):
        for path in file_hashes(study, STAGES[name]):
            yield _named(path.relative_to(folder) if path.is_relative_to(folder) else path), path


def _measured(study: Study) -> Iterable[tuple[str, Path]]:
    """The measurements, and all of the study that confirms, each with its name."""
    for source, path in zip(study.file.sources, study.measurement_paths, strict=True):
        yield _named(PurePath(source.file)), path
    if (other := study.confirming) is not None:
        confirm = PurePath(study.file.confirm)
        above = confirm.parent if confirm.name == other.path.name else confirm  # a study is named by its folder too
        for name, path in (*_described(other, ()), *_measured(other)):
            yield _named(above / name), path


def _named(path: PurePath) -> str:
    return posixpath.normpath(path.as_posix())
