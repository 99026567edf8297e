"""The files of a study: all that a run is made of, by their names as seen from the study's folder, kept and laid out again."""

from __future__ import annotations

import posixpath
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path, PurePath, PurePosixPath

from calflow.files.problems import InputError, Problem
from calflow.files.toml import read_toml
from calflow.files.writing import write_whole
from calflow.measurements.reading import sha256
from calflow.runs.cache_key import file_hashes
from calflow.runs.identity import beside
from calflow.runs.manifest import KeptFile, Manifest
from calflow.stages import STAGES
from calflow.study import Study, load_study
from calflow.study_file import WorkflowFile

INPUTS = "inputs"  # of a run folder: the files that were asked
LAID_OUT = f"{INPUTS}/files"  # in it, of a packed run: all files of the study
ABOVE = "above"  # stands for a folder above the study's, where files are laid out again


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


def laid_out(names: Iterable[str]) -> dict[str, str]:
    """Return where in a folder each file goes so that all find each other: the study as deep as names lead above it.

    Absolute names, which lead to their own place, are left out.
    """
    own = [name for name in names if not PurePosixPath(name).is_absolute() and not Path(name).is_absolute()]
    depth = max((PurePosixPath(name).parts.count("..") for name in own), default=0)
    study = "/".join([ABOVE] * depth)
    return {name: posixpath.normpath(f"{study}/{name}" if study else name) for name in own}


def lay_out(manifest: Manifest, run_folder: Path, root: Path) -> Path:
    """Copy a run's inputs into a folder so that its study can be loaded there; return the study's path.

    Each is looked for by its SHA-256: in the run folder, beside it as it lay, and where it was.

    Raises:
        InputError: with every input that has changed or is missing.
    """
    places = laid_out(manifest.files)
    problems, contents = [], {}
    copies = [path for path in sorted((run_folder / INPUTS).glob("*")) if path.is_file()]
    for name, kept in manifest.files.items():
        there = [path for path in _places(name, kept, manifest, run_folder, places) if path.is_file()]
        found = next((path for path in (*there, *copies) if sha256(path) == kept.sha256), None)
        if found is None:
            what = f"has changed since the run, at {there[0]}" if there else f"is missing: it was {kept.path}"
            problems.append(Problem(f"{what}; expected the file of SHA-256 {kept.sha256}", run_folder, key=name))
        elif name in places:
            contents[places[name]] = found.read_bytes()
    if problems:
        raise InputError(problems)
    for place, content in contents.items():
        write_whole(root / place, content)
    return root / next(places[name] for name, kept in manifest.files.items() if kept.path == manifest.study_file)


def check_inputs(folder: Path, manifest: Manifest) -> None:
    """Check that the copies of the files that were asked are those that the results are of.

    Raises:
        InputError: one was changed, or is not there.
    """
    known = set(manifest.inputs.values())
    copies = [folder / "inputs" / f"{name}.toml" for name in ("study", "robot", "workflow")]
    copies += [path for path in sorted((folder / "inputs").iterdir()) if path not in copies and path.is_file()]
    wrong = {path: "is missing" for path in copies if not path.is_file()}
    wrong |= {path: "is not what the run read" for path in copies if path not in wrong and sha256(path) not in known}
    if wrong:
        raise InputError(Problem(f"{said}; run the study again", path) for path, said in wrong.items())


def load_again(manifest: Manifest, run_folder: Path, root: Path) -> Study:
    """Lay a run's inputs out in a folder and load the study there, with the workflow that the run had.

    Raises:
        InputError: an input has changed or is missing, or this version of calflow refuses it.
    """
    study = replace(load_study(lay_out(manifest, run_folder, root)), data=None)
    path = run_folder / INPUTS / "workflow.toml"
    if not path.is_file() or sha256(path) not in manifest.inputs.values():
        raise InputError([Problem("is missing, or has changed since the run", path)])
    return replace(study, workflow=read_toml(path, WorkflowFile), workflow_path=path)


def _places(name: str, kept: KeptFile, manifest: Manifest, run_folder: Path, places: Mapping[str, str]) -> list[Path]:
    """Where a file may be: in a packed run, beside the run folder as it lay, and where it was."""
    was = Path(kept.path)
    packed = [run_folder / LAID_OUT / places[name]] if name in places else []
    return [*packed, run_folder / beside(Path(manifest.folder), was), was]
