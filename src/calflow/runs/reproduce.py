"""Reproduction of a run from its own inputs, with a comparison of all files."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from calflow.files.deferred import pd
from calflow.files.deviations import Deviation, agreeing_digits, document_deviations, table_deviations
from calflow.files.problems import Problem, refuse, refuse_any
from calflow.files.tables import read_texts, to_frame, write_csv
from calflow.run_folder import Manifest, code_digest, damage, load_again, manifest_of, read_manifest, versions
from calflow.runs.cache_key import common_key, environment, machine, stage_key, version_changes
from calflow.runs.planning import differences
from calflow.runs.run import SILENT, Listener, run
from calflow.stages.catalogue import STAGES
from calflow.stages.stage import Stage
from calflow.study import Study

DIFFERENCES = "differences.csv"


@dataclass(frozen=True)
class Reproduction:
    """The result of reproducing a run.

    same, other: files, by path in the run folder, that are identical or differ; lacking: those among other that only
    one of both runs has; deviations: the differences in tables and summaries; changed: versions that differ;
    unfinished: stages without results.
    """

    same: tuple[str, ...]
    other: tuple[str, ...]
    lacking: tuple[str, ...]
    deviations: tuple[Deviation, ...]
    changed: tuple[str, ...]
    unfinished: tuple[str, ...]

    @property
    def digits(self) -> int | None:
        """Number of digits to which all differing tables and summaries agree; None if they do not, or none differs."""
        return None if self.lacking else agreeing_digits(self.deviations)

    @property
    def table(self) -> pd.DataFrame:
        """The deviations as a table: one row for each column of a table that differs."""
        return to_frame(self.deviations, Deviation)


def reproduce(folder: str | Path, out: str | Path | None = None, listener: Listener = SILENT) -> Reproduction:
    """Repeat a run from the inputs in its folder or recorded there, and compare every file.

    Args:
        folder: the run folder, or an unpacked archive of it.
        out: an empty folder in which to keep the study (`study`), its run (`run`) and the deviations; none by default.
        listener: receiver of the progress.

    Raises:
        InputError: an input has changed or is missing, the folder's results were changed, or the run was made by an
            earlier version of calflow, which did not record its inputs.
    """
    folder = Path(folder)
    manifest = checked_run(folder)
    if out is not None:
        return _reproduced(manifest, folder, _empty(Path(out)), listener, True)
    with tempfile.TemporaryDirectory() as made:
        return _reproduced(manifest, folder, Path(made), listener, False)


def checked_run(folder: Path) -> Manifest:
    """Return the manifest of a run folder, after checking that its results are unchanged and its inputs recorded.

    Raises:
        InputError: they are not.
    """
    manifest = manifest_of(folder)
    if not manifest.files:
        raise refuse(
            "an earlier version of calflow made this run, which did not say where its inputs lay; run the study again",
            folder,
        )
    if not finished(manifest):
        raise refuse("no stage of this run is done; run the study first", folder)
    damages = [damage(manifest.stages[name], folder) for name in finished(manifest)]
    refuse_any(Problem(f"{damage} since the run", folder) for damage in damages if damage)
    return manifest


def finished(manifest: Manifest) -> list[str]:
    """Return the names of the stages that are done."""
    return [name for name, entry in manifest.stages.items() if entry.status == "done"]


def _empty(out: Path) -> Path:
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise refuse("is not empty: expected a folder of its own for --out", out)
    return out


def _reproduced(manifest: Manifest, folder: Path, work: Path, listener: Listener, keep: bool) -> Reproduction:
    study = load_again(manifest, folder, work / "study")
    done = finished(manifest)
    stages = [STAGES[name] for name in dict.fromkeys((*study.stages, *STAGES)) if name in done]
    _check_inputs(manifest, study, stages)
    again = work / "run"
    if set(study.stages) <= set(done):
        run(study, again, listener=listener)
    made = read_manifest(again)
    for stage in stages:
        if made is None or stage.name not in made.stages:
            made = read_manifest(run(study, again, stage.name, listener=listener).folder)
    assert made is not None
    was = {name: digest for stage in stages for name, digest in manifest.outputs(stage.name).items()}
    now = {name: digest for stage in stages for name, digest in made.outputs(stage.name).items()}
    other = [name for name in dict.fromkeys((*was, *now)) if was.get(name) != now.get(name)]
    reproduction = Reproduction(
        tuple(name for name in was if name not in other),
        tuple(other),
        tuple(name for name in other if name not in was or name not in now),
        tuple(deviation for name in other for deviation in _deviations(name, folder, again)),
        tuple(_versions_changed(manifest)),
        tuple(name for name in manifest.stages if name not in done),
    )
    if keep:
        write_csv(work / DIFFERENCES, reproduction.table)
    return reproduction


def _check_inputs(manifest: Manifest, study: Study, stages: list[Stage]) -> None:
    """Check that each stage's results were made from the inputs now in the folder, whatever the versions.

    Raises:
        InputError: they were not, for example because an edited study was run again only in part.
    """
    common, keys, problems = common_key(study), dict[str, Mapping[str, str]](), []
    for stage in stages:
        keys[stage.name] = stage_key(study, stage, common, keys)
        changed = differences(_of_inputs(manifest.stages[stage.name].key), _of_inputs(keys[stage.name]))
        if changed:
            message = f"{stage.name} was made of other inputs than the run names now: {'; '.join(changed)}; run the study again"
            problems.append(Problem(message))
    refuse_any(problems)


def _of_inputs(key: Mapping[str, str]) -> dict[str, str]:
    """Return the entries of a cache key for inputs and settings."""
    elsewhere = ("code", "versions", "package ", "after ")
    return {name: value for name, value in key.items() if not name.startswith(elsewhere)}


def _versions_changed(manifest: Manifest) -> Iterator[str]:
    if manifest.code != code_digest():
        yield f"calflow's code {manifest.calflow} ({manifest.code}) → this one ({code_digest()})"
    yield from version_changes({**manifest.versions, **manifest.environment}, {**versions(), **environment()})
    yield from version_changes({"machine": manifest.machine}, {"machine": machine()})


def _deviations(name: str, was: Path, now: Path) -> list[Deviation]:
    """Return the differences in a table or summary; empty for other files, or if the file exists in one run only."""
    first, second = was / name, now / name
    tables = {path: kind for stage in STAGES.values() for path, kind in stage.tables.items()}
    if not (first.is_file() and second.is_file()):
        return []
    if name in tables:
        return table_deviations(name, read_texts(first), read_texts(second), tables[name])
    if name.endswith(".json"):
        return document_deviations(name, *(json.loads(path.read_text(encoding="utf-8")) for path in (first, second)))
    return []
