"""Running a study: its stages in order, reusing results where nothing changed, and resuming interrupted work.

Each stage writes into a work folder, from which complete files are moved into place; the manifest records all inputs.
"""

from __future__ import annotations

import json
import os
import posixpath
import shutil
import time
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import Any, Protocol

from calflow.deployment.run_outcome import RunOutcome
from calflow.estimation.progress import onward
from calflow.files.data_package import DATA_PACKAGE
from calflow.files.problems import InputError
from calflow.files.tables import Documents, Results, write_results
from calflow.files.writing import PART, inside, write_whole
from calflow.measurements.source import fetch, sha256
from calflow.run_folder import (
    INPUTS,
    NAME,
    KeptFile,
    StageEntry,
    default_folder,
    is_measured,
    manifest_of,
    read_manifest,
    read_results,
    write_manifest,
)
from calflow.runs.cache_key import environment, file_hashes, machine
from calflow.runs.kept import run_package
from calflow.runs.lock import NAME as LOCK
from calflow.runs.lock import locked
from calflow.runs.planning import FORCED, PlannedStage, foreseen, passed_over, plan
from calflow.stages.catalogue import STAGES
from calflow.stages.demand import memory_available, warned
from calflow.stages.stage import Context, Stage
from calflow.study import Study

PARTIAL = ".partial"
KEY = "key.json"  # file of a work folder with the cache key of its content


class Listener(Protocol):
    """A receiver of the progress of a run."""

    def start(self, stage: Stage, reason: str) -> None:
        """Announce that a stage begins, and why."""
        return

    def reuse(self, stage: Stage, reason: str) -> None:
        """Announce that a stage's results are reused, and why."""
        return

    def say(self, line: str) -> None:
        """Receive a message of a stage."""
        return

    def advance(self, share: float) -> None:
        """Receive the completed share of the stage's work, which never decreases."""
        return

    def stop(self, stage: Stage) -> None:
        """Announce that a stage has failed or was interrupted."""
        return

    def finish(self, stage: Stage, seconds: float) -> None:
        """Announce that a stage is done."""
        return


class Silent(Listener):
    """A listener that does nothing."""


SILENT = Silent()


def study_files(
    study: Study, stages: Collection[str], measured: bool, before: Mapping[str, KeptFile]
) -> dict[str, KeptFile]:
    """Return all files of a study except a built-in workflow, by path relative to the study's folder.

    stages are those whose settings may name files. Unless measured, the measurement files are those recorded in before.
    """
    measured_before = {name: kept for name, kept in before.items() if kept.measured}
    described = {name: _kept(path, False) for name, path in _described(study, {*study.stages, *stages})}
    return described | ({name: _kept(path, True) for name, path in _measured(study)} if measured else measured_before)


def _kept(path: Path, measured: bool) -> KeptFile:
    return KeptFile(sha256=sha256(path), path=str(path.resolve()), measured=measured)


def _described(study: Study, stages: Collection[str]) -> Iterable[tuple[str, Path]]:
    """Yield study, robot and workflow files, and files named by settings, each with its name."""
    folder, robot = study.path.parent, PurePath(study.file.robot)
    yield study.path.name, study.path
    yield from ((_named(robot.parent / path.name), path) for path in study.robot_paths)
    if study.file.workflow.endswith(".toml"):
        yield _named(PurePath(study.file.workflow)), study.workflow_path
    for name in sorted(STAGES.keys() & set(stages)):
        for path in file_hashes(study, STAGES[name]):
            yield _named(path.relative_to(folder) if path.is_relative_to(folder) else path), path


def _measured(study: Study) -> Iterable[tuple[str, Path]]:
    """Yield the measurement files and all files of the confirming study, each with its name."""
    for source, path in zip(study.file.sources, study.measurement_paths, strict=True):
        yield _named(PurePath(source.file)), path
    if (other := study.confirming) is not None:
        confirm = PurePath(study.file.confirm)
        above = confirm.parent if confirm.name == other.path.name else confirm  # a study may be named by its folder
        for name, path in (*_described(other, ()), *_measured(other)):
            yield _named(above / name), path


def _named(path: PurePath) -> str:
    return posixpath.normpath(path.as_posix())


def execute(
    study: Study, folder: Path, step: PlannedStage, settings: Any, results: Results, listener: Listener
) -> None:
    """Run one stage, move its files into place and record it; an interruption leaves its work folder to be resumed."""
    stage = step.stage
    manifest = read_manifest(folder)
    before = manifest.stages.get(stage.name) if manifest else None
    work = _work_folder(folder, step, before)
    running = StageEntry(
        status="running",
        reason=step.reason,
        key=before.key if before else {},
        outputs=before.outputs if before else None,
    )
    record(study, folder, stage, running)
    upstream = results.of({*stage.needs, *stage.uses})
    started = time.monotonic()
    context = Context(study, settings, upstream, work, folder, listener.say, onward(listener.advance))
    try:
        made = stage.run(context)
    except BaseException as error:
        listener.stop(stage)
        converted = isinstance(error.__cause__, KeyboardInterrupt)  # CasADi makes a SystemError of Ctrl-C
        status = "interrupted" if converted or isinstance(error, KeyboardInterrupt) else "failed"
        record(study, folder, stage, running.model_copy(update={"status": status}))
        if isinstance(error, InputError) and not any((work / name).exists() for name in stage.resumes):
            _remove_work(work)
        if converted:
            raise KeyboardInterrupt from error
        raise
    write_results(work, made)
    files = [path for path in work.rglob("*") if path.is_file() and path.suffix != PART]
    outputs = sorted(path.relative_to(work).as_posix() for path in files if path != work / KEY)
    for name in set(running.outputs or {}) - set(outputs):
        inside(folder, name).unlink(missing_ok=True)
    hashes = {name: sha256(work / name) for name in outputs}
    others = {name: (folder / name, digest) for name, digest in _other_outputs(folder, stage).items()}
    made_here = {name: (work / name, digest) for name, digest in hashes.items()}
    write_results(work, Results(documents={DATA_PACKAGE: run_package(study.name, others | made_here)}))
    for name in sorted(outputs, key=lambda name: name in stage.resumes):  # costly files last: see _work_folder
        target = inside(folder, name)
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(work / name, target)
    os.replace(work / DATA_PACKAGE, inside(folder, DATA_PACKAGE))
    _remove_work(work)
    seconds = round(time.monotonic() - started, 3)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    done = StageEntry(status="done", reason=step.reason, key=step.key, seconds=seconds, finished=now, outputs=hashes)
    record(study, folder, stage, done)


def record_reuse(study: Study, folder: Path, step: PlannedStage) -> None:
    """Record that a stage's results were reused, and why; the reason of its last execution stays."""
    entry = manifest_of(folder).stages[step.stage.name]
    record(study, folder, step.stage, entry.model_copy(update={"reused": step.reason, "key": step.key}))


def record(study: Study, folder: Path, stage: Stage, entry: StageEntry) -> None:
    """Write a stage's entry into the manifest; entries of other stages stay."""
    before = read_manifest(folder)
    stages = {**(before.stages if before else {}), stage.name: entry}
    write_manifest(
        folder, machine=machine(), environment=environment(), study=study.name, study_file=str(study.path.resolve()),
        workflow=study.workflow.name, seed=study.file.seed,
        inputs=_input_hashes(study, stage, before.inputs if before else {}),
        files=study_files(study, stages, stage.measured, before.files if before else {}), stages=stages,
    )  # fmt: skip


def _other_outputs(folder: Path, stage: Stage) -> dict[str, str]:
    """Return the SHA-256 of the files of a run's other stages, by path."""
    manifest = manifest_of(folder)  # it exists, since the stage is recorded as running
    others = (name for name in manifest.stages if name != stage.name)
    return {path: digest for name in others for path, digest in manifest.outputs(name).items()}


def _input_hashes(study: Study, stage: Stage, before: dict[str, str]) -> dict[str, str]:
    """Return the SHA-256 of every input by path; a stage that does not read the measurements keeps their entries."""
    hashes = {str(path): sha256(path) for path in (study.path, *study.robot_paths, study.workflow_path)}
    hashes |= {str(path): digest for path, digest in file_hashes(study, stage).items()}
    if stage.measured:
        return hashes | {str(path): sha256(path) for path in study.measurement_paths}
    return hashes | {path: digest for path, digest in before.items() if is_measured(path)}


def _work_folder(folder: Path, step: PlannedStage, before: StageEntry | None) -> Path:
    """Return the stage's work folder: one left by an interruption if at most settings differ, else a new one."""
    work = inside(folder, f"{PARTIAL}/{step.stage.name}")
    key = {name: value for name, value in step.key.items() if not name.startswith("setting ")}
    forced = step.reason == FORCED
    if forced or not _holds(work / KEY, key):
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        write_whole(work / KEY, json.dumps(key).encode())
    _clear(work, {KEY, *step.stage.resumes})
    if before and not forced and all(before.key.get(name) == value for name, value in key.items()):
        for name in step.stage.resumes:
            here, digest = inside(folder, name), (before.outputs or {}).get(name)
            if here.is_file() and not (work / name).exists() and sha256(here) == digest:
                (work / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(here, work / name)
    return work


def _remove_work(work: Path) -> None:
    """Remove a stage's work folder, and that of all stages if it was the last."""
    shutil.rmtree(work)
    with suppress(OSError):  # it holds that of another stage
        work.parent.rmdir()


def _clear(work: Path, kept: set[str]) -> None:
    """Remove the files that an interrupted stage left, except those to be kept, from which it resumes.

    Links are removed whatever their name, since files from which a stage resumes are written to.
    """
    for path in sorted(work.rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):  # it contains files to be kept
                path.rmdir()
        elif path.is_symlink() or path.relative_to(work).as_posix() not in kept:
            path.unlink()


def _holds(path: Path, key: dict[str, str]) -> bool:
    try:
        return bool(json.loads(path.read_text(encoding="utf-8")) == key)
    except (OSError, ValueError, RecursionError):
        return False


@dataclass(frozen=True)
class Run(RunOutcome):
    """A finished run: its folder, and its tables and documents by path in the folder."""

    folder: Path

    @property
    def documents(self) -> Documents:
        """The documents (JSON) by path."""
        return self.results.documents


def run(
    study: Study,
    folder: str | Path | None = None,
    stage: str | None = None,
    force: bool = False,
    listener: Listener = SILENT,
) -> Run:
    """Run a study's stages, reusing unchanged results, and return all tables.

    Args:
        study: see `load_study`.
        folder: the run folder; `runs/<study name>` by default.
        stage: the only stage to run (with stages that it needs, if these have no results yet).
        force: whether to run without reusing results.
        listener: receiver of the progress.

    Raises:
        InputError: the study's input has errors, or a file cannot be downloaded from its url.
    """
    folder = Path(folder) if folder is not None else default_folder(study)
    if stage is None or (stage in STAGES and STAGES[stage].measured):
        for source in study.all_to_fetch:
            listener.say(f"fetching {source.file} from {source.url}; expecting SHA-256 {source.sha256}")
            fetch(source)
    steps = plan(study, folder, stage, force)
    if any(step.stage.measured and not step.reuse for step in steps):
        study.measurements()  # so that their errors are reported before any work is done
    settings = {step.stage.name: study.validated_settings(step.stage.name, step.stage.settings) for step in steps}
    for name, demand in foreseen(study, [step.stage for step in steps if not step.reuse]).items():
        if warning := warned(name, demand, memory_available()):
            listener.say(warning)
    planned, made = read_manifest(folder), [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        if read_manifest(folder) != planned:  # another run has changed the folder in the meantime
            steps = plan(study, folder, stage, force)
        _keep_inputs(study, folder)
        results = Results()
        for name, why in passed_over(folder, stage, steps).items():
            listener.say(f"{name} is left out: {why}; run the study to renew its results")
        for step in steps:
            if step.reuse:
                listener.reuse(step.stage, step.reason)
                record_reuse(study, folder, step)
            else:
                listener.start(step.stage, step.reason)
                started = time.monotonic()
                try:
                    execute(study, folder, step, settings[step.stage.name], results, listener)
                except InputError:
                    if planned is None and step is steps[0]:
                        _clear_of_refused(study, folder, made)
                    raise
                listener.finish(step.stage, time.monotonic() - started)
            results |= read_results(manifest_of(folder), folder, step.stage.name)
    return Run(results, folder)


def _clear_of_refused(study: Study, folder: Path, made: Iterable[Path]) -> None:
    """Remove what a run wrote whose first stage refused its input: nothing was made of the study that it would document.

    made are the folders that were not there before, the run's first.
    """
    shutil.rmtree(inside(folder, PARTIAL), ignore_errors=True)
    for name in (NAME, *_kept_inputs(study)):
        inside(folder, name).unlink()
    with suppress(OSError):  # it holds other files
        inside(folder, INPUTS).rmdir()
    with suppress(OSError):
        inside(folder, LOCK).unlink()
        for path in made:
            path.rmdir()


def _keep_inputs(study: Study, folder: Path) -> None:
    """Copy study, robot and workflow files, so that the run folder alone documents the run and can predict."""
    for part in (*folder.glob(f".*{PART}"), *inside(folder, INPUTS).glob(f".*{PART}")):  # left by a killed run
        part.unlink()
    for name, path in _kept_inputs(study).items():
        write_whole(inside(folder, name), path.read_bytes())


def _kept_inputs(study: Study) -> dict[str, Path]:
    """Return the files that a run folder keeps, by path in it."""
    robot, *described = study.robot_paths
    beside = {path.name: path for path in described}  # the robot file, which names them so
    kept = {"study.toml": study.path, "robot.toml": robot, **beside, "workflow.toml": study.workflow_path}
    return {f"{INPUTS}/{name}": path for name, path in kept.items()}
