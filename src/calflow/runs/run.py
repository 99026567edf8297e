"""The run folder: stages in order, results reused where nothing changed, interrupted work resumed, and a manifest."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol

import pandas as pd

from calflow.files.documents import Documents
from calflow.files.plugins import packages
from calflow.files.problems import InputError, nearest, refuse, together
from calflow.files.results import Results
from calflow.files.tables import Tables, schema
from calflow.files.toml import Origin
from calflow.measurements.reading import sha256
from calflow.robot.robot import Robot
from calflow.stages import STAGES
from calflow.stages.stage import Context, Stage
from calflow.study import Study

NUMERICAL = ("arviz-stats", "casadi", "emcee", "h5py", "matplotlib", "numpy", "pandas", "scipy", "typst")
FLOATS = "%.10g"  # of a CSV: more than any measurement supports, fewer than rounding disturbs
# pandas before 3.1 reads the last bit of a number as it likes unless told so; later ones warn of being told.
EXACT: dict[str, Any] = {"float_precision": "round_trip"} if pd.__version__.split(".")[:2] < ["3", "1"] else {}
PARTIAL = ".partial"
FORCED = "forced"
LONGEST_CHANGE = 200  # characters of an old and a new value that a reason still shows


class Listener(Protocol):
    """Who is told how a run goes on."""

    def start(self, stage: Stage, reason: str) -> None:
        """A stage begins, and why."""

    def reuse(self, stage: Stage, reason: str) -> None:
        """A stage's results are reused, and why."""

    def say(self, line: str) -> None:
        """A stage has something to tell."""

    def advance(self, share: float) -> None:
        """This share of the stage's work is done."""

    def finish(self, stage: Stage, seconds: float) -> None:
        """A stage is done."""


class Silent:
    """A listener that does nothing."""

    def start(self, stage: Stage, reason: str) -> None:
        """Do nothing."""

    def reuse(self, stage: Stage, reason: str) -> None:
        """Do nothing."""

    def say(self, line: str) -> None:
        """Do nothing."""

    def advance(self, share: float) -> None:
        """Do nothing."""

    def finish(self, stage: Stage, seconds: float) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class PlannedStage:
    """What would be done with a stage, and why; key holds what its results depend on, by name."""

    stage: Stage
    reuse: bool
    reason: str
    key: dict[str, str]


@dataclass(frozen=True)
class Run:
    """A finished run: its folder, and every table and document by its path in it."""

    folder: Path
    results: Results = field(repr=False)

    @property
    def tables(self) -> Tables:
        """Every table by its path."""
        return self.results.tables

    @property
    def documents(self) -> Documents:
        """Every document (JSON) by its path."""
        return self.results.documents


def stages_of(study: Study) -> list[Stage]:
    """Return the stages of a study's workflow, in order.

    Raises:
        InputError: the workflow or the study names a stage that does not exist or lacks what it needs, or has wrong settings.
    """
    known, names = STAGES, study.workflow.stages
    workflow, own = Origin.of(study.workflow_path), Origin.of(study.path)
    problems = []
    for name in names:
        if name not in known:
            problems.append(workflow.problem(f"unknown stage '{name}'{nearest(name, known)}", "stages"))
    for origin, key, tables in ((workflow, "settings", study.workflow.settings), (own, "stages", study.file.stages)):
        for name in tables:
            if name not in known:
                problems.append(origin.problem(f"unknown stage{nearest(name, known)}", key, name))
    if all(name in known for name in names):
        for i, name in enumerate(names):
            late = [need for need in (*known[name].needs, *known[name].uses) if need in names[i:]]
            absent = [need for need in known[name].needs if need not in names]
            problems += [
                workflow.problem(f"stage '{name}' comes before '{need}', which it needs", "stages") for need in late
            ]
            problems += [
                workflow.problem(f"stage '{name}' needs '{need}', which is not there", "stages") for need in absent
            ]
    if problems:
        raise InputError(problems)
    set_ = dict.fromkeys((*names, *study.workflow.settings, *study.file.stages))
    together(*(partial(study.validated_settings, name, known[name].settings) for name in set_))
    return [known[name] for name in names]


def plan(study: Study, folder: Path, only: str | None = None, force: bool = False) -> list[PlannedStage]:
    """Return what a run would do, stage by stage; only names a single stage (with what it needs)."""
    stages, known = stages_of(study), STAGES
    wanted = [stage.name for stage in stages]
    if only is not None:
        if only not in known:
            raise refuse(f"unknown stage '{only}'; there are {', '.join(known)}{nearest(only, known)}")
        wanted = _with_needs(only)
        early = [known[name] for name in wanted if known[name] not in stages and name != only]
        stages = list(dict.fromkeys((*early, *stages, known[only])))
    if folder.exists() and not folder.is_dir():
        raise refuse("is a file; expected a run folder, which may not exist yet", folder)
    manifest = read_manifest(folder)
    if manifest.get("study", study.name) != study.name:
        raise refuse(f"holds the run of another study, '{manifest['study']}'; give another folder with --out", folder)
    before = manifest.get("stages", {})
    common = _common_key(study)
    steps: list[PlannedStage] = []
    for stage in stages:
        used = only is not None and stage.name in known[only].uses and stage.name in before
        if stage.name not in wanted and not used:
            continue
        key = _key(study, stage, common, {step.stage.name: step for step in steps})
        forced = force and (only is None or stage.name == only)
        reason = FORCED if forced else _reason(before.get(stage.name), key, folder, steps)
        if used and reason and stage.name not in wanted:
            continue  # it takes its results into account where they are there; it does not ask for them
        step = PlannedStage(
            stage, reason is None, reason or "inputs, settings, upstream results and code are unchanged", key
        )
        steps.append(step)
    return steps


def run(
    study: Study,
    folder: str | Path | None = None,
    stage: str | None = None,
    force: bool = False,
    listener: Listener | None = None,
) -> Run:
    """Run a study's stages, reusing what did not change, and return all tables.

    Args:
        study: see `load_study`.
        folder: the run folder; `runs/<study name>` by default.
        stage: run this stage alone (and what it needs, where that is not there yet).
        force: do not reuse.
        listener: is told how it goes on.

    Raises:
        InputError: the study's input is at fault.
    """
    folder = Path(folder) if folder is not None else default_folder(study)
    listener = listener or Silent()
    steps = plan(study, folder, stage, force)
    if any(step.stage.measured and not step.reuse for step in steps):
        study.measurements()  # what is wrong with them is told before any work is done
    settings = {step.stage.name: study.validated_settings(step.stage.name, step.stage.settings) for step in steps}
    folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder):
        _keep_inputs(study, folder)
        results = Results()
        for step in steps:
            if step.reuse:
                listener.reuse(step.stage, step.reason)
                _record(study, folder, step, {"reason": f"reused: {step.reason}"})
            else:
                listener.start(step.stage, step.reason)
                started = time.monotonic()
                _execute(study, folder, step, settings[step.stage.name], results, listener)
                listener.finish(step.stage, time.monotonic() - started)
            results |= read_results(folder, step.stage.name)
    return Run(folder, results)


def default_folder(study: Study) -> Path:
    """Return where a study's run goes unless said otherwise."""
    return Path("runs") / study.name


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return a run folder's manifest; an empty one where there is none.

    Raises:
        InputError: it is not what a run writes.
    """
    path = folder / "manifest.json"
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError) as error:
        raise refuse(f"cannot be read ({error}); delete it to run everything anew", path) from None
    stages = manifest.get("stages") if isinstance(manifest, dict) else None
    entries = list(stages.values()) if isinstance(stages, dict) else [None]
    whole = all(isinstance(entry, dict) and {"status", "reason", "key"} <= set(entry) for entry in entries)
    if not whole or not {"study", "workflow", "calflow"} <= set(manifest):
        raise refuse("is not what a run writes; delete it to run everything anew", path)
    return dict(manifest)


def read_results(folder: Path, stage: str) -> Results:
    """Return a stage's tables and documents by their path in the run folder."""
    outputs = read_manifest(folder).get("stages", {}).get(stage, {}).get("outputs", {})
    tables = {name: pd.read_csv(folder / name, **EXACT) for name in outputs if name.endswith(".csv")}
    names = [name for name in outputs if name in STAGES[stage].documents]
    documents = {name: json.loads((folder / name).read_text(encoding="utf-8")) for name in names}
    return Results(tables, documents)


def outdated(folder: Path, stage: str, robot: Robot) -> str | None:
    """Why a stage's results do not hold for a robot; None where they do."""
    entry = read_manifest(folder).get("stages", {}).get(stage)
    if entry is None:
        return f"{stage} was never run"
    if entry["status"] != "done":
        return f"{stage} did not finish ({entry['status']})"
    if _digest(robot.canonical()) not in entry["key"].values():
        return f"the robot file changed after {stage} ran"
    return _damage(entry, folder)


def _execute(
    study: Study, folder: Path, step: PlannedStage, settings: Any, results: Results, listener: Listener
) -> None:
    """Run one stage in a folder of its own and move its files into place when all are whole."""
    stage = step.stage
    work = _work_folder(folder, step)
    _record(study, folder, step, {"status": "running", "reason": step.reason})
    upstream = results.of({*stage.needs, *stage.uses})
    started = time.monotonic()
    context = Context(study, settings, upstream, work, folder, listener.say, listener.advance)
    try:
        made = stage.run(context)
    except BaseException as error:
        status = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
        _record(study, folder, step, {"status": status, "reason": step.reason})
        raise
    _write_results(work, stage, made)
    files = [path for path in work.rglob("*") if path.is_file() and path.suffix != ".part"]
    outputs = sorted(path.relative_to(work).as_posix() for path in files if path != work / "key.json")
    _forget(folder, read_manifest(folder).get("stages", {}).get(stage.name, {}).get("outputs", {}), outputs)
    hashes = {name: sha256(work / name) for name in outputs}
    for name in sorted(outputs, key=lambda name: name in stage.resumes):  # what is dear to make last: see _work_folder
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(work / name, folder / name)
    shutil.rmtree(work)
    if not any((folder / PARTIAL).iterdir()):
        (folder / PARTIAL).rmdir()
    seconds = round(time.monotonic() - started, 3)
    _record(study, folder, step, {"status": "done", "reason": step.reason, "seconds": seconds, "outputs": hashes})


def _write_results(folder: Path, stage: Stage, made: Results) -> None:
    """Write a stage's tables, each with its schema beside it, and its documents."""
    for name, table in made.tables.items():
        write_csv(folder / name, table)
        described = schema(table, stage.tables[name])
        _write_whole(
            (folder / name).with_suffix(".schema.json"), json.dumps(described, indent=2, ensure_ascii=False) + "\n"
        )
    for name, document in made.documents.items():
        _write_whole(folder / name, json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _work_folder(folder: Path, step: PlannedStage) -> Path:
    """Return the stage's work folder: the one an interruption left where only settings differ, else a fresh one."""
    work = folder / PARTIAL / step.stage.name
    key = {name: value for name, value in step.key.items() if not name.startswith("setting ")}
    left = work / "key.json"
    forced = step.reason == FORCED
    if forced or not _holds(left, key):
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        _write_whole(left, json.dumps(key))
    before = read_manifest(folder).get("stages", {}).get(step.stage.name, {})
    if not forced and all(before.get("key", {}).get(name) == value for name, value in key.items()):
        for name in step.stage.resumes:
            here, digest = folder / name, before.get("outputs", {}).get(name)
            if here.is_file() and not (work / name).exists() and sha256(here) == digest:
                (work / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(here, work / name)
    return work


def _holds(path: Path, key: dict[str, str]) -> bool:
    try:
        return bool(json.loads(path.read_text(encoding="utf-8")) == key)
    except (OSError, ValueError):
        return False


def _forget(folder: Path, old: dict[str, str], new: list[str]) -> None:
    for name in set(old) - set(new):
        (folder / name).unlink(missing_ok=True)


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write a table whole or not at all."""
    _write_whole(path, csv_text(table))


def csv_text(table: pd.DataFrame) -> str:
    """Return a table as every CSV of calflow is written."""
    return str(table.to_csv(index=False, float_format=FLOATS, lineterminator="\n"))


def _write_whole(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def _keep_inputs(study: Study, folder: Path) -> None:
    """Copy the files that were asked, so that the run folder alone tells what was done and can predict."""
    for name, path in (
        ("study.toml", study.path),
        ("robot.toml", study.robot_path),
        ("workflow.toml", study.workflow_path),
    ):
        _write_whole(folder / "inputs" / name, path.read_text(encoding="utf-8"))


def _record(study: Study, folder: Path, step: PlannedStage, entry: dict[str, Any]) -> None:
    """Update a stage's entry in the manifest; the rest stays. Its key is that of its outputs, so it changes when they do."""
    manifest = read_manifest(folder)
    stages = manifest.get("stages", {})
    old = stages.get(step.stage.name, {})
    if entry.get("status") == "running":
        old = {name: old[name] for name in ("outputs", "key") if name in old}
    key = step.key if "outputs" in entry or step.reuse else old.get("key", {})
    stages[step.stage.name] = {**old, **entry, "key": key}
    manifest = {
        "calflow": metadata.version("calflow"),
        "versions": versions(),
        "packages": packages(),
        "study": study.name,
        "study_file": str(study.path),
        "workflow": study.workflow.name,
        "seed": study.file.seed,
        "inputs": _input_hashes(study, step.stage, manifest.get("inputs", {})),
        "stages": stages,
    }
    _write_whole(folder / "manifest.json", json.dumps(manifest, indent=2) + "\n")


def _input_hashes(study: Study, stage: Stage, before: dict[str, str]) -> dict[str, str]:
    """SHA-256 of every input; a stage that does not read the measurements leaves their entry as it is."""
    hashes = {str(path): sha256(path) for path in (study.path, study.robot_path, study.workflow_path)}
    if stage.measured:
        return hashes | {str(study.measurement_path): sha256(study.measurement_path)}
    return hashes | {path: digest for path, digest in before.items() if not path.endswith(".toml")}


def _with_needs(stage: str) -> list[str]:
    names: list[str] = []
    for need in STAGES[stage].needs:
        names += _with_needs(need)
    return list(dict.fromkeys([*names, stage]))


def _reason(
    before: dict[str, Any] | None, key: dict[str, str], folder: Path, upstream: list[PlannedStage]
) -> str | None:
    """Why a stage must run; None where its results can be reused."""
    if before is None:
        return "was never run"
    if before.get("status") != "done":
        return f"did not finish last time ({before.get('status')})"
    old = before.get("key", {})
    again = [step.stage.name for step in upstream if not step.reuse and f"after {step.stage.name}" in key]
    if again:
        return f"{again[0]} runs again"
    changed = [name for name in {**old, **key} if old.get(name) != key.get(name)]
    if changed:
        return "; ".join(_difference(name, old.get(name), key.get(name)) for name in changed)
    return _damage(before, folder)


def _damage(entry: dict[str, Any], folder: Path) -> str | None:
    """What happened to a stage's files since it wrote them; None where they are as they were."""
    for name, digest in entry.get("outputs", {}).items():
        if not (folder / name).is_file():
            return f"{name} is missing"
        if sha256(folder / name) != digest:
            return f"{name} was changed by hand"
    return None


def _difference(name: str, old: str | None, new: str | None) -> str:
    if name.startswith(("setting ", "study's ")) and len(f"{old}{new}") < LONGEST_CHANGE:
        return f"{name} changed from {old} to {new}"
    return f"{name.removeprefix('file ').removeprefix('after ')} changed"


def _key(study: Study, stage: Stage, common: dict[str, str], upstream: dict[str, PlannedStage]) -> dict[str, str]:
    """What a stage's results depend on, by name, so that a miss can be explained."""
    key = dict(common)
    if stage.measured:
        path = study.measurement_path
        key[f"file {path.name}"] = sha256(path)
        if confirming := study.confirming:
            key[f"file {confirming.measurement_path.name}"] = sha256(confirming.measurement_path)
    settings = study.validated_settings(stage.name, stage.settings).model_dump(mode="json")
    key |= {f"setting {name}": json.dumps(value) for name, value in settings.items()}
    for name in (*stage.needs, *stage.uses):
        if name in upstream:
            key[f"after {name}"] = _digest(json.dumps(upstream[name].key, sort_keys=True))
    return key


def _common_key(study: Study) -> dict[str, str]:
    asked = study.file.model_dump(mode="json", exclude={"stages", "workflow"})
    return {
        "code": code_digest(),
        "versions": _digest(json.dumps(versions(), sort_keys=True)),
        **{f"package {name}": said for name, said in packages().items()},
        **{f"study's {name}": json.dumps(value, ensure_ascii=False) for name, value in asked.items()},
        f"file {study.robot_path.name}": _digest(study.robot.canonical()),
    }


@lru_cache
def code_digest() -> str:
    """Return a hash of all that calflow is made of: its code, and what it writes reports with."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


@lru_cache
def _versions() -> tuple[tuple[str, str], ...]:
    return (("python", platform.python_version()), *((name, metadata.version(name)) for name in NUMERICAL))


def versions() -> dict[str, str]:
    """Return the versions that results depend on."""
    return dict(_versions())


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep a second run out of the folder; the lock of a process that is gone does not count."""
    import fcntl

    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise refuse(
                "another run is at work in this folder; wait for it, or give another with --out", folder
            ) from None
        yield
