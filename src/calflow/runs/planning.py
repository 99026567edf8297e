"""Planning a run: which stages would run or be reused, and why; and whether a run folder belongs to the study."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calflow.files.problems import nearest, refuse, refuse_any
from calflow.files.toml import Origin
from calflow.measurements.source import sha256
from calflow.run_folder import Manifest, StageEntry, beside, damage, is_measured, read_manifest
from calflow.runs.cache_key import common_key, stage_key
from calflow.stages.catalogue import STAGES
from calflow.stages.demand import Demand
from calflow.stages.stage import Stage
from calflow.study import Study

UNCHANGED = "inputs, settings, upstream results and code are unchanged"
FORCED = "forced"
LONGEST_CHANGE = 200  # most characters of an old and a new value that are quoted in a reason


def check_same_study(study: Study, folder: Path, manifest: Manifest) -> None:
    """Check that a run folder belongs to this study.

    Raises:
        InputError: it belongs to another study, possibly of the same name.
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
    """Whether the study has the path, absolute or relative to its run folder, of the run: it may have been edited."""
    old, new = Path(manifest.study_file), study.path
    if old.resolve() == new.resolve():
        return True
    return bool(manifest.folder) and beside(Path(manifest.folder), old) == beside(folder, new)


def _of_the_same_content(study: Study, manifest: Manifest) -> bool:
    """Whether study, robot and any measurements have the content recorded in the run, so that the study is a copy."""
    recorded = set(manifest.inputs.values())
    paths = [study.path, *study.robot_paths]
    if any(map(is_measured, manifest.inputs)):
        paths += study.measurement_paths
    return all(sha256(path) in recorded for path in paths)


def reason(before: StageEntry | None, key: Mapping[str, str], folder: Path, run_again: Collection[str]) -> str | None:
    """Return why a stage must run; None if its results can be reused. run_again names earlier stages that will run."""
    if before is None:
        return "was never run"
    if before.status != "done":
        return f"did not finish last time ({before.status})"
    again = [name for name in run_again if f"after {name}" in key]
    if again:
        return f"{again[0]} runs before it"
    return "; ".join(differences(before.key, key)) or damage(before, folder)


def differences(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """Return descriptions of the entries in which two keys differ."""
    return [
        _difference(name, old.get(name), new.get(name)) for name in {**old, **new} if old.get(name) != new.get(name)
    ]


def _difference(name: str, old: str | None, new: str | None) -> str:
    if name.startswith(("setting ", "study's ")) and len(f"{old}{new}") < LONGEST_CHANGE:
        return f"{name} changed from {old} to {new}"
    return f"{name.removeprefix('file ').removeprefix('after ')} changed"


@dataclass(frozen=True)
class PlannedStage:
    """The plan for a stage: whether its results are reused, why, and its cache key."""

    stage: Stage
    reuse: bool
    reason: str
    key: dict[str, str]


def stages_of(study: Study, ran: Collection[str] = ()) -> list[Stage]:
    """Return the stages of a study, in order, with the residual field if requested; ran are stages that have results.

    Raises:
        InputError: the workflow lacks a stage that another one needs, or has it later.
    """
    bases, names, workflow = based(study, ran), study.stages, Origin.of(study.workflow_path)
    problems = []
    for i, name in enumerate(names):
        stage = bases[name]
        wrong = [f"comes before '{need}', which it needs" for need in (*stage.needs, *stage.uses) if need in names[i:]]
        wrong += [f"needs '{need}', which is not there" for need in stage.needs if need not in names]
        problems += [workflow.problem(f"stage '{name}' {what}", "stages") for what in wrong]
    refuse_any(problems)
    return [bases[name] for name in names]


def based(study: Study, ran: Collection[str] = ()) -> dict[str, Stage]:
    """Return all stages by name, each on its base: one that has run, else one in the workflow, else its first."""

    def on(stage: Stage) -> Stage:
        if not stage.bases:
            return stage
        bases = (name for there in (ran, study.stages, stage.bases) for name in stage.bases if name in there)
        return stage.on(STAGES[next(bases)])

    return {name: on(stage) for name, stage in STAGES.items()}


def plan(study: Study, folder: Path, only: str | None = None, force: bool = False) -> list[PlannedStage]:
    """Return the plan of a run, stage by stage; only names a single stage to run (with those it needs).

    Raises:
        InputError: there is no such stage, or the folder does not belong to this study.
    """
    if folder.exists() and not folder.is_dir():
        raise refuse("is a file; expected a run folder, which may not exist yet", folder)
    if folder.resolve() == study.path.parent.resolve():
        raise refuse("is the study's own folder; expected another for the run, such as one in it", folder)
    manifest = read_manifest(folder)
    before = manifest.stages if manifest else {}
    stages, optional = _planned_stages(study, before, only)
    if manifest:
        check_same_study(study, folder, manifest)
    common = common_key(study)
    steps: list[PlannedStage] = []
    for stage in stages:
        key = stage_key(study, stage, common, {step.stage.name: step.key for step in steps})
        forced = force and only in (None, stage.name)
        run_again = [step.stage.name for step in steps if not step.reuse]
        why = FORCED if forced else reason(before.get(stage.name), key, folder, run_again)
        if not (why and stage.name in optional):
            steps.append(PlannedStage(stage, why is None, why or UNCHANGED, key))
    return steps


def _planned_stages(
    study: Study, before: Mapping[str, StageEntry], only: str | None
) -> tuple[list[Stage], frozenset[str]]:
    """Return the stages of a plan in order, and the names of those that a single stage takes only where up to date."""
    if only is None:
        return stages_of(study), frozenset()
    ran = [name for name, entry in before.items() if entry.status == "done"]
    stages, bases = stages_of(study, ran), based(study, ran)
    if only not in bases:
        raise refuse(f"unknown stage '{only}'; there are {', '.join(bases)}{nearest(only, bases)}")
    needed = _with_needs(only, bases)
    optional = {*bases[only].uses} & {*before} - {*needed}
    early = [bases[name] for name in needed if bases[name] not in stages and name != only]
    # A stage beside the workflow's that this one takes, as sample, comes before it.
    beside = [] if bases[only] in stages else [bases[name] for name in bases if name in optional]
    every = dict.fromkeys((*early, *stages, *beside, bases[only]))
    return [stage for stage in every if stage.name in optional.union(needed)], frozenset(optional)


def foreseen(study: Study, stages: Iterable[Stage]) -> dict[str, Demand]:
    """Return the estimated memory and time of stages that read the measurements, by name, where these can be estimated.

    Raises:
        InputError: the measurements have errors.
    """
    records = {}
    for stage in stages:
        if stage.measured:
            settings = study.validated_settings(stage.name, stage.settings)
            records[stage.name] = stage.demand(study, settings, study.measurements())
    return {name: demand for name, demand in records.items() if demand.rows}


def passed_over(folder: Path, only: str | None, steps: Sequence[PlannedStage]) -> dict[str, str]:
    """Return the optional upstream stages of a single stage that are left out, each with the reason in words."""
    manifest = read_manifest(folder)
    if only is None or manifest is None:
        return {}
    left = {*STAGES[only].uses} & {*manifest.stages} - {step.stage.name for step in steps}
    outdated = "its results are of other inputs, settings or versions, or were changed since"
    stopped = {name: manifest.stages[name].stopped for name in STAGES[only].uses if name in left}
    return {name: f"it {how}" if how else outdated for name, how in stopped.items()}


def _with_needs(stage: str, stages: Mapping[str, Stage]) -> list[str]:
    names: list[str] = []
    for need in stages[stage].needs:
        names += _with_needs(need, stages)
    return list(dict.fromkeys([*names, stage]))
