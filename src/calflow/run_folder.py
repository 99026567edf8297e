"""The run folder: results of a run, and a manifest that records its inputs, versions, and the state of each stage."""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import posixpath
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from importlib import metadata
from operator import or_
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from calflow.files.data_package import DATA_PACKAGE, data_package
from calflow.files.plugins import packages
from calflow.files.problems import InputError, Problem, nearest_file, refuse, refuse_any
from calflow.files.tables import SUM, DeferredTables, Results, checksum_matches, read_csv, with_checksum, write_results
from calflow.files.toml import read_toml
from calflow.files.writing import contained, write_text, write_whole
from calflow.measurements.source import sha256
from calflow.robot.robot import Robot
from calflow.study import FIELD, Study, StudyFile, WorkflowFile, load_study

NAME = "manifest.json"
REMEDY = "delete it to run everything anew"
INPUTS = "inputs"  # subfolder of a run folder with copies of study, robot and workflow files
LAID_OUT = f"{INPUTS}/files"  # subfolder of a packed run with all files of the study
ABOVE = "above"  # name of the folder that replaces one above the study's where files are laid out again
NUMERICAL = ("arviz-stats", "casadi", "emcee", "h5py", "matplotlib", "numpy", "pandas", "scipy", "typst")
SAVED = "saved from Python"  # reason recorded for the stages of a calibration saved from Python
DESCRIBING = (".toml", ".urdf")  # endings of inputs that hold no measurements


def _without_zero(text: str) -> str:
    if "\0" in text:
        raise ValueError("a zero ends a file's name, for the system")
    return text


Text = Annotated[str, AfterValidator(_without_zero)]  # other than this, a file's name may be any text


class _Kept(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class StageEntry(_Kept):
    """A stage in the manifest: its state, the reason of its last execution, and the reason of a later reuse.

    outputs: SHA-256 of each file it wrote, by path in the run folder; key: the cache key of these; finished: time of
    completion, in UTC.
    """

    status: Literal["running", "interrupted", "failed", "done"]
    reason: Text
    key: dict[Text, Text]
    reused: Text | None = None
    seconds: float | None = Field(default=None, ge=0)
    finished: Text = ""
    outputs: dict[Text, Text] | None = None

    @property
    def stopped(self) -> str:
        """How its last execution ended before it was done; empty where it was."""
        return {"done": "", "failed": "failed"}.get(self.status, "was interrupted")

    @model_validator(mode="after")
    def _tells_what_was_done(self) -> StageEntry:
        if self.status == "done" and (self.outputs is None or self.seconds is None):
            raise ValueError("a stage that is done has outputs and seconds")
        return self


class KeptFile(_Kept):
    """A file on which results depend: its SHA-256, its absolute path, and whether it belongs to the measurements."""

    sha256: Text
    path: Text
    measured: bool = False


class Manifest(_Kept):
    """The record of a run; study_file and folder are the absolute paths of the study and the run folder when it ran.

    files: every input except the built-in workflow, by path relative to the study's folder (or absolute, as stated);
    environment: version of every installed package that calflow needs; code: hash of calflow's source code.
    """

    calflow: Text
    versions: dict[Text, Text]
    packages: dict[Text, Text] = {}
    code: Text = ""
    machine: Text = ""
    environment: dict[Text, Text] = {}
    study: Text
    study_file: Text
    folder: Text = ""
    workflow: Text
    seed: int
    inputs: dict[Text, Text]
    files: dict[Text, KeptFile] = {}
    stages: dict[Text, StageEntry]

    @model_validator(mode="after")
    def _names_files(self) -> Manifest:
        if odd := [name for name in self.files if Path(name).name in ("", "..") or posixpath.normpath(name) != name]:
            raise ValueError(f"{odd[0]!r} is no file's name")
        if self.files and not any(
            kept.path == self.study_file and "/" not in name for name, kept in self.files.items()
        ):
            raise ValueError("its files do not have the study")
        return self

    def outputs(self, stage: str) -> dict[str, str]:
        """Return the SHA-256 of a stage's files, by path in the run folder; empty if it never finished."""
        return (self.stages[stage].outputs or {}) if stage in self.stages else {}


def is_measured(path: str) -> bool:
    """Whether an input of a manifest holds measurements, rather than a study, a robot or a workflow."""
    return not path.lower().endswith(DESCRIBING)


def read_manifest(folder: Path) -> Manifest | None:
    """Return a run folder's manifest; None if there is none.

    Raises:
        InputError: it is malformed, was changed, or names files outside the folder.
    """
    path = folder / NAME
    if path.exists() and not path.is_file():
        raise refuse(f"is no file; {REMEDY}", path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        whole = not isinstance(content, dict) or checksum_matches(content)
        if isinstance(content, dict):
            content.pop(SUM, None)
        manifest = Manifest.model_validate(content)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the whole"
        raise refuse(f"is not what a run writes ({where}: {first['msg']}); {REMEDY}", path) from None
    except (OSError, ValueError, RecursionError) as error:
        raise refuse(f"cannot be read ({error}); {REMEDY}", path) from None
    refuse_any(
        Problem(f"names {name!r}, which is no file inside the run folder; {REMEDY}", path)
        for stage in manifest.stages
        for name in manifest.outputs(stage)
        if contained(folder, name) is None
    )
    if not whole:
        raise refuse(f"was changed since a run wrote it; {REMEDY}", path)
    return manifest


def manifest_of(folder: Path) -> Manifest:
    """Return the manifest of a run folder.

    Raises:
        InputError: the folder holds no run, or as for `read_manifest`.
    """
    if (manifest := read_manifest(folder)) is None:
        raise _no_run(folder, "expected a folder that 'calflow run' has filled")
    return manifest


def write_manifest(folder: Path, **made: Any) -> None:
    """Write a run folder's manifest with the current versions, and a checksum that reveals corruption."""
    manifest = Manifest(
        calflow=metadata.version("calflow"), versions=versions(), packages=packages(), code=code_digest(),
        folder=str(folder.resolve()), **made,
    )  # fmt: skip
    write_text(folder / NAME, json.dumps(with_checksum(manifest.model_dump(exclude_none=True)), indent=2) + "\n")


def default_folder(study: Study) -> Path:
    """Return the default run folder of a study."""
    return Path("runs") / study.name


def _no_run(folder: Path, expected: str) -> InputError:
    """Return the error for a folder that holds no run, or is not there."""
    found = f"holds no run: {expected}" if folder.exists() else f"no such folder: {expected}{nearest_file(folder)}"
    return refuse(found, folder)


def run_folder(study_or_run: Path) -> Path:
    """Return the run folder, given itself, its study file or that file's folder; it may not exist yet.

    Raises:
        InputError: the path is none of these, or the study's files have errors.
    """
    if (study_or_run / NAME).exists():
        return study_or_run
    is_study = study_or_run.suffix == ".toml" or study_or_run.is_file() or (study_or_run / "study.toml").exists()
    if not is_study:
        raise _no_run(study_or_run, "expected a folder that 'calflow run' has filled, or a study")
    return default_folder(load_study(study_or_run))


def study_and_folder(study_or_run: Path, out: Path | None) -> tuple[Study, Path]:
    """Return the study and the run folder, given a run folder, a study file or its folder, and --out.

    Raises:
        InputError: a run folder's study is no longer there, or the study's files have errors.
    """
    if not (study_or_run / NAME).exists():
        study = load_study(study_or_run)
        return study, out or default_folder(study)
    if out is not None and out.resolve() != study_or_run.resolve():
        raise refuse(f"is a run folder: --out {out} goes with a study, not with a run", study_or_run)
    return load_study(_study_file(manifest_of(study_or_run), study_or_run)), study_or_run


def read_results(manifest: Manifest, folder: Path, stage: str) -> Results:
    """Return a stage's tables and documents by their path in the run folder, as they are now."""
    outputs = manifest.outputs(stage)
    texts = {name: (folder / name).read_bytes() for name in outputs if name.endswith(".csv")}
    tables = DeferredTables(tuple(texts), lambda name: read_csv(io.BytesIO(texts[name])))
    names = [name for name in outputs if name.endswith(".json")]
    return Results(tables, {name: json.loads((folder / name).read_text(encoding="utf-8")) for name in names})


def _study_file(manifest: Manifest, folder: Path) -> Path:
    """Return the path of a run's study file: relative to the run folder, with which it may have moved, or as recorded."""
    was = Path(manifest.study_file)
    moved = folder / beside(Path(manifest.folder), was) if manifest.folder else was
    path = next((path for path in (moved, was) if path.is_file()), None)
    if path is None:
        raise refuse(f"its study {was} is not there any more; give the study file, and this folder with --out", folder)
    return path


def beside(folder: Path, path: Path) -> str:
    """Return a path relative to a folder, or the absolute path if they are on different drives."""
    try:
        return os.path.relpath(path.resolve(), folder.resolve())
    except ValueError:  # another drive
        return str(path.resolve())


def after(upstream: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the entries of a stage's cache key that stand for the keys of its upstream stages."""
    return {f"after {name}": digest(json.dumps(key, sort_keys=True)) for name, key in upstream.items()}


def robot_digest(robot: Robot) -> str:
    """Return a hash of a robot's content, independent of how its file is written."""
    return digest(robot.canonical())


def digest(text: str) -> str:
    """Return a short hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def damage(entry: StageEntry, folder: Path) -> str | None:
    """Return the first change found in a stage's files since it wrote them; None if they are unchanged."""
    for name, digest in (entry.outputs or {}).items():
        if not (folder / name).is_file():
            return f"{name} is missing"
        if sha256(folder / name) != digest:
            return f"{name} was changed by hand"
    return None


def outdated(manifest: Manifest, folder: Path, stage: str, robot: Robot) -> str | None:
    """Return the reason why a stage's results do not hold for a robot; None if they do."""
    entry = manifest.stages.get(stage)
    if entry is None:
        return f"{stage} was never run"
    if entry.status != "done":
        return f"{stage} did not finish ({entry.status})"
    if robot_digest(robot) not in entry.key.values():
        return f"the robot file changed after {stage} ran"
    return damage(entry, folder)


def of_others(manifest: Manifest, stage: str, bases: Collection[str]) -> str | None:
    """Return a message if a stage was not made from the present results of its bases; None if it was."""
    made = {name: key for name, key in manifest.stages[stage].key.items() if name.startswith("after ")}
    same = made == after({name: manifest.stages[name].key for name in bases})
    return None if same else f"{stage} was made of other results"


def check_inputs(folder: Path, manifest: Manifest) -> None:
    """Check that the copies of study, robot and workflow files are those from which the results were made.

    Raises:
        InputError: a copy was changed, or is missing.
    """
    named = set(manifest.inputs.values())
    copies = [folder / "inputs" / f"{name}.toml" for name in ("study", "robot", "workflow")]
    copies += [path for path in sorted((folder / "inputs").glob("*")) if path not in copies and path.is_file()]
    wrong = {path: "is missing" for path in copies if not path.is_file()}
    wrong |= {path: "is not what the run read" for path in copies if path not in wrong and sha256(path) not in named}
    refuse_any(Problem(f"{message}; run the study again", path) for path, message in wrong.items())


def laid_out(names: Iterable[str]) -> dict[str, str]:
    """Return the path of each file in a folder, with the study so deep that all relative names stay inside the folder.

    Absolute names, which need no copy, are left out.
    """
    relative = [name for name in names if not PurePosixPath(name).is_absolute() and not Path(name).is_absolute()]
    depth = max((PurePosixPath(name).parts.count("..") for name in relative), default=0)
    study = "/".join([ABOVE] * depth)
    return {name: posixpath.normpath(f"{study}/{name}" if study else name) for name in relative}


def lay_out(manifest: Manifest, run_folder: Path, root: Path) -> Path:
    """Copy a run's inputs into a folder so that its study can be loaded there; return the study's path.

    Each is searched by its SHA-256: in the run folder, at its path relative to this, and at the recorded path.

    Raises:
        InputError: with every input that has changed or is missing.
    """
    places = laid_out(manifest.files)
    problems, contents = [], {}
    copies = [path for path in sorted((run_folder / INPUTS).glob("*")) if path.is_file()]
    for name, kept in manifest.files.items():
        there = [path for path in _places(name, kept, manifest, run_folder, places) if os.path.isfile(path)]
        copy = next((path for path in (*there, *copies) if sha256(path) == kept.sha256), None)
        if copy is None:
            what = f"has changed since the run, at {there[0]}" if there else f"is missing: it was {kept.path}"
            problems.append(Problem(f"{what}; expected the file of SHA-256 {kept.sha256}", run_folder, key=name))
        elif name in places:
            contents[places[name]] = copy.read_bytes()
    refuse_any(problems)
    for place, content in contents.items():
        write_whole(root / place, content)
    return root / next(places[name] for name, kept in manifest.files.items() if kept.path == manifest.study_file)


def load_again(manifest: Manifest, run_folder: Path, root: Path) -> Study:
    """Return a run's study, loaded from copies of its inputs in a folder, with the workflow that the run had.

    Raises:
        InputError: an input has changed or is missing, or this version of calflow refuses it.
    """
    study = replace(load_study(lay_out(manifest, run_folder, root)), data=None)
    path = run_folder / INPUTS / "workflow.toml"
    if not path.is_file() or sha256(path) not in manifest.inputs.values():
        raise refuse("is missing, or has changed since the run", path)
    return replace(study, workflow=read_toml(path, WorkflowFile), workflow_path=path)


def _places(name: str, kept: KeptFile, manifest: Manifest, run_folder: Path, places: Mapping[str, str]) -> list[Path]:
    """Return the possible paths of a file: in a packed run, relative to the run folder, and the recorded one."""
    was = Path(kept.path)
    packed = [run_folder / LAID_OUT / places[name]] if name in places else []
    return [*packed, run_folder / beside(Path(manifest.folder), was), was]


@dataclass(frozen=True)
class CalibratedFolder:
    """The parts of a run folder that make up a calibration: robot, study file, and results of the stages that made it.

    without lists the results of the run, or requested by its study, that the model lacks, with the reasons.
    """

    folder: Path
    manifest: Manifest
    robot: Robot
    file: StudyFile
    results: Results
    without: tuple[str, ...] = ()


def read_calibrated(study_or_run: str | Path) -> CalibratedFolder:
    """Return the calibration in a run folder, given the folder or the study.

    Raises:
        InputError: identify has not finished yet, or its results or inputs were changed since.
    """
    folder = run_folder(Path(study_or_run))
    manifest = manifest_of(folder)
    check_inputs(folder, manifest)
    file = read_toml(folder / INPUTS / "study.toml", StudyFile)
    robot = file.on(Robot.from_toml(folder / INPUTS / "robot.toml"))
    reason = outdated(manifest, folder, "identify", robot)
    if reason:
        raise refuse(f"holds no identified robot: {reason}; run the study again", folder)
    further = {"diagnose": "what diagnose found"} if "diagnose" in manifest.stages else {}
    if file.residual_field or FIELD in read_toml(folder / INPUTS / "workflow.toml", WorkflowFile).stages:
        further[FIELD] = "the residual field that the study asks for"
    made, without = ["identify"], list[str]()
    for stage, what in further.items():
        reason = outdated(manifest, folder, stage, robot) or of_others(manifest, stage, made)
        if reason is None:
            made.append(stage)
        elif stage == "diagnose" and reason == damage(manifest.stages[stage], folder):  # the model would be another
            raise refuse(f"holds no diagnosed robot any more: {reason}; run the study again", folder)
        else:
            without.append(f"{what}: {reason}")
    results = reduce(or_, (read_results(manifest, folder, stage) for stage in made))
    return CalibratedFolder(folder, manifest, robot, file, results, tuple(without))


@lru_cache
def code_digest() -> str:
    """Return a hash of all files of the calflow package: its code, and the templates of its reports."""
    root = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


@lru_cache
def versions() -> dict[str, str]:
    """Return the versions of Python and the packages on which results depend numerically."""
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in NUMERICAL}}


def check_free(folder: Path) -> None:
    """Check that a calibration can be saved in a folder: that it is empty, or holds one saved before.

    Raises:
        InputError: it holds the run of a study, or other files.
    """
    manifest = read_manifest(folder) if folder.is_dir() else None
    if manifest is not None and any(entry.reason != SAVED for entry in manifest.stages.values()):
        raise refuse("holds what 'calflow run' made, which would be written over; save in another folder", folder)
    if manifest is None and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise refuse("is not empty: expected a folder of its own", folder)


def record_saved(
    folder: Path, robot: Robot, request: StudyFile, made: Mapping[str, Results], tables: Mapping[str, type]
) -> None:
    """Write the manifest and the data package of a folder in which a calibration was saved.

    made are the results by stage, in order; tables are the row types of their tables.
    """
    inputs = {path.name: path for path in sorted((folder / INPUTS).iterdir())}
    hashes = {str(path.resolve()): sha256(path) for path in inputs.values()}
    entries: dict[str, StageEntry] = {}
    for stage, results in made.items():
        outputs = {name: sha256(folder / name) for name in (*results.tables, *results.documents)}
        key = {"robot": robot_digest(robot)} | after({name: entry.key for name, entry in entries.items()})
        entries[stage] = StageEntry(status="done", reason=SAVED, key=key, seconds=0.0, outputs=outputs)
    digests = {name: digest for entry in entries.values() for name, digest in (entry.outputs or {}).items()}
    package = data_package(request.name, {name: (folder / name, digest) for name, digest in digests.items()}, tables)
    write_results(folder, Results(documents={DATA_PACKAGE: package}))
    files = {
        name: KeptFile(sha256=hashes[str(path.resolve())], path=str(path.resolve()), measured=is_measured(name))
        for name, path in inputs.items()
    }
    write_manifest(
        folder, study=request.name, study_file=files["study.toml"].path, workflow=request.name, seed=request.seed,
        inputs=hashes, stages=entries, files=files,
    )  # fmt: skip
