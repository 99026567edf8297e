"""The status of a fleet: each robot's outcome so far, in figures and sentences, and the steps that remain."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any, Literal

from calflow.deployment.run_outcome import RunOutcome
from calflow.deployment.usability import is_useless, judgement
from calflow.files.problems import InputError, refuse
from calflow.files.tables import Results, checksum_matches, column, from_document, to_document, with_checksum
from calflow.files.units import METRE
from calflow.files.words import first_up, listed, mm, plural
from calflow.files.writing import inside, write_text
from calflow.fleet.engine import FOLDERS, FleetFolder
from calflow.fleet.fleet import Fleet, FleetRobot, write_robot_study
from calflow.reporting.advice import advice
from calflow.run_folder import NAME, read_manifest, read_results
from calflow.runs.lock import is_locked
from calflow.runs.planning import PlannedStage, plan
from calflow.study import MODELS, load_study

Status = Literal["calibrated", "failed", "running", "not run"]
OTHER_INPUTS = "its results are of other inputs or another version"
LOOK = 0.5  # s between polls for outcomes


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a robot of a fleet."""

    robot: str = column("name of the robot")
    type: str = column("its type")
    status: Status = column("whether its run finished, failed or is in progress; not run: there is no result yet")
    usable: bool | None = column("false: its report advises against using the model; empty: no report", default=None)
    verdict: str = column("its report's verdict, in words", default="")
    judged_by: Literal["holdout", "train", ""] = column("whether errors are at held-out or fitted poses", default="")
    points: int | None = column("number of measured points at these poses", default=None)
    before_mean_mm: float | None = column("mean position error of the robot as its maker states it", "mm", default=None)
    before_max_mm: float | None = column("largest such error", "mm", default=None)
    after_mean_mm: float | None = column("mean position error of the calibrated robot", "mm", default=None)
    after_max_mm: float | None = column("largest such error", "mm", default=None)
    unit: str = column(
        "unit of its errors: mm, mrad, px, …; unless it is mm, the columns in mm are empty", default=METRE.label
    )
    before_mean: float | None = column("mean error of the robot as its maker states it, in `unit`", default=None)
    before_max: float | None = column("largest such error, in `unit`", default=None)
    after_mean: float | None = column("mean error of the calibrated robot, in `unit`", default=None)
    after_max: float | None = column("largest such error, in `unit`", default=None)
    causes: tuple[str, ...] = column(
        "causes that diagnose found missing in the model, with their sizes", separator="; ", default=()
    )
    next_step: str = column("the first recommendation of its report", default="")
    failed_stage: str = column("the stage in which it failed; empty: before the first", default="")
    reason: str = column("why it failed or was not run, or the stage in progress", default="")


def calibrated_outcome(robot: str, type_: str, run: RunOutcome) -> Outcome:
    """Return the outcome of a robot from that of its run, which must contain the results of identify."""
    last, (before, now) = run.judged_steps[-1], run.errors_before_and_now
    figures: dict[str, Any] = {
        "before_mean": before[0],
        "before_max": before[2],
        "after_mean": now[0],
        "after_max": now[2],
    }
    lengths = {f"{name}_mm": size for name, size in figures.items()} if last.unit == METRE.label else {}
    return Outcome(
        robot=robot, type=type_, status="calibrated", usable=not is_useless(run), verdict=judgement(run),
        judged_by=last.split, points=last.n, unit=last.unit, **figures, **lengths,
        causes=tuple(finding.in_short for finding in run.findings),
        next_step=next((item.sentence for item in advice(run)), ""),
    )  # fmt: skip


def needs_look(outcome: Outcome, odd: Container[str] = ()) -> bool:
    """Whether a robot needs attention: it failed, its model is not to be used, or it deviates from its type."""
    return outcome.status == "failed" or outcome.usable is False or outcome.robot in odd


def worst_first(outcomes: Iterable[Outcome], odd: Container[str] = ()) -> list[Outcome]:
    """Return outcomes by need of attention: failed, unusable, deviating from their type, then by decreasing error.

    Errors of different units are not compared with each other: positions come first.
    """

    def rank(outcome: Outcome) -> tuple[bool, bool, bool, bool, str, float, str]:
        unit = (outcome.unit != METRE.label, outcome.unit)
        return (
            outcome.status == "calibrated",
            outcome.usable is not False,
            outcome.robot not in odd,
            *unit,
            -(outcome.after_mean or 0.0),
            outcome.robot,
        )

    return sorted(outcomes, key=rank)


def write_outcome(path: Path, outcome: Outcome) -> None:
    """Write an outcome to a JSON file, atomically and with a checksum."""
    write_text(path, json.dumps(with_checksum(to_document(outcome)), indent=2, ensure_ascii=False) + "\n")


def read_outcome(path: Path) -> Outcome | None:
    """Return the outcome in a file; None where there is none.

    Raises:
        InputError: it was changed, or another version of calflow wrote it.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict) or not checksum_matches(content):
            raise ValueError("it was changed since it was written")
        return from_document(content, Outcome)
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise refuse(f"cannot be read ({error}); delete it and run the fleet again", path) from None


def failure_reason(error: Exception, home: Path) -> str:
    """Return why a robot failed, with file names relative to home, the fleet file's folder."""
    if not isinstance(error, InputError):
        return repr(error)
    plain = (
        problem if problem.file is None else replace(problem, file=Path(os.path.relpath(problem.file, home)))
        for problem in error.problems
    )
    return "; ".join(map(str, plain))


def planned(fleet: Fleet, folder: FleetFolder) -> Iterator[str]:
    """Yield one line per robot on what a run would do; writes each robot's study, for `calflow check` and others."""
    width = max(len(robot.name) for robot in fleet.robots)
    wide = max(len(type.name) for type in fleet.types)
    told: dict[object, str] = {}  # the first robot with these mistakes in its files
    for robot in fleet.robots:
        try:
            words = _planned_words(robot, folder)
        except InputError as error:
            first = told.setdefault(tuple((each.line, each.key, each.message) for each in error.problems), robot.name)
            words = f"would fail: {failure_reason(error, robot.home) if first == robot.name else f'as {first}'}"
        yield f"{robot.name:{width}}  {robot.type.name:{wide}}  {words}"


def steps_of(robot: FleetRobot, folder: FleetFolder) -> list[PlannedStage]:
    """Return the stages that a run of a robot would do or reuse; writes its study.

    Raises:
        InputError: its files are at fault.
    """
    write_robot_study(robot, folder.study(robot.name))
    return plan(load_study(folder.study(robot.name)), folder.run(robot.name))


def _planned_words(robot: FleetRobot, folder: FleetFolder) -> str:
    planned_steps = steps_of(robot, folder)
    again = [step for step in planned_steps if not step.reuse]
    if not again:
        return f"reuse  {planned_steps[0].reason}"
    load_study(folder.study(robot.name)).measurements()  # reports faulty rows before a long run
    return f"run    {', '.join(step.stage.name for step in again)}: {again[0].reason}"


def fleet_folder(fleet: Fleet, out: Path | None) -> FleetFolder:
    """Return the folder of a fleet, by default `runs/` and its name; it may not exist yet.

    Raises:
        InputError: it is a file or a study's run folder, or one of its subfolders is a link that leads out of it.
    """
    folder = out or Path("runs") / fleet.name
    if folder.exists() and not folder.is_dir():
        raise refuse("is a file; expected a fleet's folder, which may not exist yet", folder)
    if (folder / NAME).exists():
        raise refuse("is the run folder of a study; give the fleet another with --out, or another name", folder)
    for part in FOLDERS:
        inside(folder, part)
    return FleetFolder(folder.resolve())


def outcomes(fleet: Fleet, folder: FleetFolder) -> list[Outcome]:
    """Return the outcome of every robot of a fleet so far, in the order of their names."""
    return [read_outcome(folder.outcome(robot.name)) or _unknown(robot, folder) for robot in fleet.robots]


def forget_stale(fleet: Fleet, folder: FleetFolder) -> None:
    """Delete the outcomes of robots to be run again: those that failed, or whose run is out of date.

    Snakemake decides by the dates of files, which copying preserves and a clock set back falsifies.
    """
    for robot in fleet.robots:
        stands = False
        with suppress(InputError):
            outcome = read_outcome(folder.outcome(robot.name))
            stands = outcome is not None and outcome.status == "calibrated" and _is_complete(robot, folder)
        if not stands:
            folder.outcome(robot.name).unlink(missing_ok=True)


def arriving(fleet: Fleet, folder: FleetFolder, ended: Callable[[], bool]) -> Iterator[Outcome]:
    """Yield each outcome as it is written from now on, until ended() is true."""
    began, reported, last = time.time_ns(), set[str](), False
    while not last:
        last = ended()
        for robot in fleet.robots:
            path = folder.outcome(robot.name)
            if robot.name not in reported and path.is_file() and path.stat().st_mtime_ns > began:
                reported.add(robot.name)
                if outcome := read_outcome(path):
                    yield outcome
        time.sleep(0 if last else LOOK)


def _unknown(robot: FleetRobot, folder: FleetFolder) -> Outcome:
    """Return the outcome of a robot without an outcome file: from its run if complete, else the state of the run."""
    manifest = read_manifest(folder.run(robot.name))
    if manifest and _is_complete(robot, folder):
        stages = (stage for stage in MODELS if stage in manifest.stages)
        results = Results()
        for stage in stages:
            results = results | read_results(manifest, folder.run(robot.name), stage)
        return calibrated_outcome(robot.name, robot.type.name, RunOutcome(results))
    begun = [name for name, entry in manifest.stages.items() if entry.status != "done"] if manifest else []
    running = folder.run(robot.name).is_dir() and is_locked(folder.run(robot.name))
    if running:
        state = f"at work on {begun[0] if begun else 'its first stage'}"
    else:
        state = f"stopped in {begun[0]}" if begun else OTHER_INPUTS if manifest else "not begun"
    return Outcome(robot=robot.name, type=robot.type.name, status="running" if running else "not run", reason=state)


def _is_complete(robot: FleetRobot, folder: FleetFolder) -> bool:
    """Return whether a robot's run has nothing left to do, although the engine deleted the outcome of a stopped job."""
    with suppress(InputError):
        return all(step.reuse for step in steps_of(robot, folder))
    return False


def fleet_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the status of a fleet in sentences."""
    lines = [f"{_count(outcomes)}."]
    judged = [outcome for outcome in outcomes if outcome.after_mean is not None]
    units = list(dict.fromkeys(outcome.unit for outcome in judged))
    for unit in units:
        after = {outcome.robot: outcome.after_mean or 0.0 for outcome in judged if outcome.unit == unit}
        before = [outcome.before_mean or 0.0 for outcome in judged if outcome.unit == unit]
        worst = max(after, key=lambda robot: after[robot])
        those = "them" if len(units) == 1 else f"those that are judged in {unit}"
        lines.append(
            f"Half of {those} have {'a mean position' if unit == METRE.label else 'a mean'} error of {mm(median(after.values()))} "
            f"{unit} or less (before: {mm(median(before))} {unit}); the worst one, {worst}, is left with {mm(after[worst])} {unit}."
        )
    if fitted := [outcome.robot for outcome in judged if outcome.judged_by == "train"]:
        of = "All errors" if len(fitted) == len(judged) else f"Errors of {listed(fitted, 6)}"
        lines.append(f"{of} are at the poses that were fitted, smaller than at others: hold out three poses in ten.")
    return lines


def _count(outcomes: Sequence[Outcome]) -> str:
    """Return the numbers of robots by status, in words."""
    useless = [outcome.robot for outcome in outcomes if outcome.usable is False]
    parts = [
        f"{sum(outcome.status == 'calibrated' for outcome in outcomes)} of {plural(len(outcomes), 'robot')} calibrated"
    ]
    status = {
        name: [outcome.robot for outcome in outcomes if outcome.status == name]
        for name in ("failed", "running", "not run")
    }
    kinds = (*status.items(), ("with a model that is not to be used", useless))
    return "; ".join([*parts, *(f"{len(those)} {what} ({listed(those, 6)})" for what, those in kinds if those)])


def uncalibrated_lines(outcomes: Iterable[Outcome]) -> list[str]:
    """Return the robots that are not calibrated, each reason once."""
    alike: dict[tuple[str, str], list[str]] = {}
    for outcome in outcomes:
        if outcome.status != "calibrated":
            alike.setdefault((outcome.type, why(outcome)), []).append(outcome.robot)
    return [f"! {listed(robots, 6)} ({type_}): {reason}" for (type_, reason), robots in alike.items()]


def why(outcome: Outcome) -> str:
    """Return, in words, why a robot is not calibrated."""
    where = f" in {outcome.failed_stage}" if outcome.failed_stage else ""
    return f"{first_up(outcome.status)}{where}: {outcome.reason}"


def error(value: float | None) -> str:
    """Return an error [mm or other unit] formatted for a table."""
    return "–" if value is None else mm(value)
