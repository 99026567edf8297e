"""Execution: one stage in a folder of its own, whose files move into place when all are whole."""

from __future__ import annotations

import json
import os
import shutil
import time
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from calflow.files.data_package import DATA_PACKAGE
from calflow.files.plugins import packages
from calflow.files.results import Results, write_results
from calflow.files.writing import PART, inside, write_whole
from calflow.measurements.reading import sha256
from calflow.run_folder import (
    Manifest,
    StageEntry,
    code_digest,
    is_measured,
    read_manifest,
    versions,
    write_manifest,
)
from calflow.runs.cache_key import file_hashes
from calflow.runs.environment import environment, machine
from calflow.runs.kept import run_package
from calflow.runs.listener import Listener, onward
from calflow.runs.planning import PlannedStage
from calflow.runs.reasons import FORCED
from calflow.runs.study_files import study_files
from calflow.stages.stage import Context, Stage
from calflow.study import Study

PARTIAL = ".partial"
KEY = "key.json"  # in a work folder: what its content was made of


def execute(
    study: Study, folder: Path, step: PlannedStage, settings: Any, results: Results, listener: Listener
) -> None:
    """Run one stage, move its files into place and record it; an interruption leaves its work folder to go on from."""
    stage = step.stage
    before = _entry(folder, stage)
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
        status = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
        record(study, folder, stage, running.model_copy(update={"status": status}))
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
    for name in sorted(outputs, key=lambda name: name in stage.resumes):  # what is dear to make last: see _work_folder
        target = inside(folder, name)
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(work / name, target)
    os.replace(work / DATA_PACKAGE, inside(folder, DATA_PACKAGE))
    shutil.rmtree(work)
    if not any((folder / PARTIAL).iterdir()):
        (folder / PARTIAL).rmdir()
    seconds = round(time.monotonic() - started, 3)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    done = StageEntry(status="done", reason=step.reason, key=step.key, seconds=seconds, finished=now, outputs=hashes)
    record(study, folder, stage, done)


def record_reuse(study: Study, folder: Path, step: PlannedStage) -> None:
    """Record that a stage's results were reused, and why; why it last ran stays."""
    entry = _entry(folder, step.stage)
    assert entry is not None
    record(study, folder, step.stage, entry.model_copy(update={"reused": step.reason, "key": step.key}))


def record(study: Study, folder: Path, stage: Stage, entry: StageEntry) -> None:
    """Write a stage's entry into the manifest; those of other stages stay."""
    before = read_manifest(folder)
    stages = {**(before.stages if before else {}), stage.name: entry}
    manifest = Manifest(
        calflow=metadata.version("calflow"),
        versions=versions(),
        packages=packages(),
        code=code_digest(),
        machine=machine(),
        environment=environment(),
        study=study.name,
        study_file=str(study.path.resolve()),
        folder=str(folder.resolve()),
        workflow=study.workflow.name,
        seed=study.file.seed,
        inputs=_input_hashes(study, stage, before.inputs if before else {}),
        files=study_files(study, stages, stage.measured, before.files if before else {}),
        stages=stages,
    )
    write_manifest(folder, manifest)


def _other_outputs(folder: Path, stage: Stage) -> dict[str, str]:
    """The files of a run's other stages, with their SHA-256."""
    manifest = read_manifest(folder)
    assert manifest is not None  # which says that the stage is running
    others = (name for name in manifest.stages if name != stage.name)
    return {path: digest for name in others for path, digest in manifest.outputs(name).items()}


def _entry(folder: Path, stage: Stage) -> StageEntry | None:
    manifest = read_manifest(folder)
    return manifest.stages.get(stage.name) if manifest else None


def _input_hashes(study: Study, stage: Stage, before: dict[str, str]) -> dict[str, str]:
    """SHA-256 of every input; a stage that does not read the measurements leaves their entry as it is."""
    hashes = {str(path): sha256(path) for path in (study.path, *study.robot_paths, study.workflow_path)}
    hashes |= {str(path): said for path, said in file_hashes(study, stage).items()}
    if stage.measured:
        return hashes | {str(path): sha256(path) for path in study.measurement_paths}
    return hashes | {path: digest for path, digest in before.items() if is_measured(path)}


def _work_folder(folder: Path, step: PlannedStage, before: StageEntry | None) -> Path:
    """Return the stage's work folder: the one an interruption left where only settings differ, else a fresh one."""
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


def _clear(work: Path, kept: set[str]) -> None:
    """Remove what an interrupted stage left but for these files: what it goes on from, and nothing that it had begun to write.

    A link goes whatever its name: what is gone on with is written to.
    """
    for path in sorted(work.rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):  # it holds something that is kept
                path.rmdir()
        elif path.is_symlink() or path.relative_to(work).as_posix() not in kept:
            path.unlink()


def _holds(path: Path, key: dict[str, str]) -> bool:
    try:
        return bool(json.loads(path.read_text(encoding="utf-8")) == key)
    except (OSError, ValueError, RecursionError):
        return False
