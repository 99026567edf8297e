"""Comparison of runs: of several calibrations, and of one robot's over time, with tests of significance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calflow.calibration import Calibration
from calflow.deployment.comparison import (
    Comparison,
    ParameterDifference,
    RunAccuracy,
    RunCause,
    RunData,
    RunPair,
    Setting,
)
from calflow.deployment.history import FALSE_ALARM, History, history
from calflow.diagnosis.fitted import Fitted
from calflow.effects.cause import Cause
from calflow.effects.wording import place_name
from calflow.estimation.accuracy import leading_errors
from calflow.estimation.difference import Difference
from calflow.estimation.noise import averaged, repeats_scatter
from calflow.files.problems import InputError, Problem, refuse, refuse_any
from calflow.files.words import listed
from calflow.run_folder import CalibratedFolder, is_measured, robot_digest

DIFFERENT = 0.01  # family-wise significance level of differences
MOST_NAMED = 6  # causes in a note


def compare_runs(*runs: Calibration) -> Comparison:
    """Return the comparison of two or more calibrations that were loaded from run folders.

    Differences of parameters are tested against the sum of both covariances, those of one robot in models with the causes of all
    (see `with_all_causes`). Runs of the same measurements share their errors, so that this test does not hold: their differences
    are reported without one, and as they are.

    Raises:
        InputError: there are fewer than two.
    """
    if len(runs) < 2:
        raise refuse("expected two runs or more to compare", key="runs")
    names = run_names(runs)
    measured = [measured_files(run) for run in runs]
    same = {(a, b) for a, b in combinations(range(len(runs)), 2) if measured[a].keys() & measured[b].keys()}
    every = list(combinations(range(len(runs)), 2))
    alike = all(same_robot(runs[a], runs[b]) != "another one" for a, b in every)
    models, notes = with_all_causes(runs, names) if alike and len(same) < len(every) else (runs, [])
    parameters, pairs = [], []
    for a, b in every:
        shown = runs if (a, b) in same else models
        rows, pair = _compared(shown[a], shown[b], (names[a], names[b]), (a, b) in same)
        parameters += rows
        pairs.append(pair)
    return Comparison(
        _settings(runs, names), tuple(_data(run, k, names, measured, same) for k, run in enumerate(runs)),
        tuple(RunAccuracy(**vars(row), run=name) for run, name in zip(runs, names, strict=True) for row in run.accuracy),
        tuple(parameters), tuple(pairs), _causes(runs, names), tuple(notes),
    )  # fmt: skip


def run_of(calibration: Calibration) -> CalibratedFolder:
    """Return the run from which a calibration was loaded.

    Raises:
        InputError: it was not loaded.
    """
    if calibration.folder is None:
        raise refuse("expected calibrations that were loaded from run folders", key="runs")
    return calibration.folder


def run_names(runs: Sequence[Calibration]) -> list[str]:
    """Return the names of the runs' folders, with as many parent folders as make them unique."""
    parts = [run_of(run).folder.resolve().parts for run in runs]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-depth:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    raise refuse("the same run is named twice", run_of(runs[0]).folder)


def measured_files(run: Calibration) -> dict[str, str]:
    """Return the names of a run's measurement files, by their SHA-256."""
    return {digest: Path(path).name for path, digest in run_of(run).manifest.inputs.items() if is_measured(path)}


def _compared(
    first: Calibration, second: Calibration, names: tuple[str, str], same: bool
) -> tuple[list[ParameterDifference], RunPair]:
    difference = Difference.of(first, second)
    curve = _curves(first, difference)
    p, beyond = difference.tested(curve, DIFFERENT)
    rows = []
    for k, (i, j) in enumerate(zip(difference.first, difference.second, strict=True)):
        parameter = first.model.parameters[i]
        rows.append(ParameterDifference(
            first=names[0], second=names[1], parameter=parameter.name, unit=parameter.unit,
            first_value=parameter.figure + float(first.estimate[i]), second_value=parameter.figure + float(second.estimate[j]),
            difference=float(difference.value[k]), sd=None if same else float(difference.sd[k]), p=None if same else float(p[k]),
            significant=None if same else bool(beyond[k]), curve=curve[k], meaning=parameter.meaning,
        ))  # fmt: skip
    squared, freedom, chance = difference.joint
    tested: dict[str, Any] = (
        {"chi2": None, "freedom": None, "p": None} if same else {"chi2": squared, "freedom": freedom, "p": chance}
    )
    robots = (first.robot.name, second.robot.name)
    pair = RunPair(
        first=names[0], second=names[1], robots=robots, robot=same_robot(first, second), shared=len(rows), **tested
    )
    return rows, pair


def _curves(first: Calibration, difference: Difference) -> list[str]:
    """Return the name of the curve that each shared parameter is a figure of; empty: none."""
    shared = [(k, first.model.parameters[k]) for k in difference.first]
    waves = {int(k) for effect in first.model.effects if effect.is_curve for k in first.model.columns(effect)}
    return [place_name(p.effect, p.joint, p.part) if k in waves else "" for k, p in shared]


def same_robot(first: Calibration, second: Calibration) -> Literal["the same", "another file", "another one"]:
    """Return whether two runs are of one robot, according to their robot files."""
    if robot_digest(first.robot) == robot_digest(second.robot):
        return "the same"
    kinds = [(run.robot.name, [joint.kind for joint in run.robot.joints]) for run in (first, second)]
    return "another file" if kinds[0] == kinds[1] else "another one"


def _settings(runs: Sequence[Calibration], names: Sequence[str]) -> tuple[Setting, ...]:
    """Return the settings in which the studies, their robots, their stages or the versions differ."""
    flat = []
    for run in runs:
        settings = dict(_flat("", run.request.model_dump(mode="json", exclude_defaults=True)))
        settings |= {
            "robot file's content": f"{run.robot.name} ({robot_digest(run.robot)})",
            "workflow": run_of(run).manifest.workflow,
            "calflow": run_of(run).manifest.calflow,
        }
        settings |= {f"version of {name}": version for name, version in run_of(run).manifest.versions.items()}
        flat.append(settings)
    keys = dict.fromkeys(key for settings in flat for key in settings)
    every = {key: [settings.get(key, "") for settings in flat] for key in keys}
    return tuple(
        Setting(setting=key, of=dict(zip(names, values, strict=True)))
        for key, values in every.items()
        if len(set(values)) > 1
    )


def _flat(key: str, value: Any) -> list[tuple[str, str]]:
    """Return nested settings as pairs of dotted key and text."""
    if isinstance(value, dict):
        return [pair for name, inner in value.items() for pair in _flat(f"{key}.{name}" if key else str(name), inner)]
    return [(key, ", ".join(map(str, value)) if isinstance(value, list) else str(value))]


def _data(
    run: Calibration, k: int, names: Sequence[str], measured: Sequence[dict[str, str]], same: set[tuple[int, int]]
) -> RunData:
    summary = run.summary
    others = tuple(names[a + b - k] for a, b in sorted(same) if k in (a, b))
    return RunData(
        run=names[k], files=tuple(measured[k].values()), poses=summary.training_poses, held_out=summary.heldout_poses,
        noise_mm=np.nan if summary.sigma_mm is None else summary.sigma_mm, noise_from=summary.noise_sources,
        discrepancy_mm=summary.discrepancy_mm, same_data_as=others,
    )  # fmt: skip


def _causes(runs: Sequence[Calibration], names: Sequence[str]) -> tuple[RunCause, ...]:
    every = [list(run.findings) for run in runs]
    places = [{(finding.cause, finding.joint) for finding in findings} for findings in every]
    return tuple(
        RunCause(run=names[k], status=finding.status, cause=finding.cause, joint=finding.joint, estimate=finding.estimate,
                 sd=finding.sd, unit=finding.unit, probability=finding.probability,
                 also_in=tuple(n for m, n in enumerate(names) if m != k and (finding.cause, finding.joint) in places[m]))
        for k, findings in enumerate(every) for finding in findings
    )  # fmt: skip


def history_of_runs(*runs: Calibration, false_alarm: float = FALSE_ALARM) -> History:
    """Return which parameters of one robot changed between its loaded calibrations (see `deployment.history`).

    Args:
        runs: the calibrations in the order in which they were measured.
        false_alarm: probability of reporting any change where there is none.

    Raises:
        InputError: there are fewer than two, two are of the same measurements or of different robots, or the dates
            stated in their studies are not in order.
    """
    if len(runs) < 2:
        raise refuse("expected two runs or more, in order of time", key="runs")
    if not 1e-3 <= false_alarm <= 0.5:  # a lower rate would need more random draws
        raise refuse(f"expected 0.001 to 0.5, found {false_alarm:g}", key="false_alarm")
    names = run_names(runs)
    dates = [run.request.acceptance.date if run.request.acceptance else None for run in runs]
    problems = [
        Problem(f"is of the same measurements as {names[a]}: its errors are the same, and tell nothing of time",
                run_of(runs[b]).folder)
        for a, b in combinations(range(len(runs)), 2) if measured_files(runs[a]).keys() & measured_files(runs[b]).keys()
    ] + [
        Problem(f"is of another robot than {names[0]}", run_of(run).folder)
        for run in runs[1:] if same_robot(runs[0], run) == "another one"
    ]  # fmt: skip
    stated = [(date, run) for date, run in zip(dates, runs, strict=True) if date is not None]
    problems += [
        Problem(
            f"was measured on {later[0]}, before the run that is named before it ({earlier[0]})",
            run_of(later[1]).folder,
        )
        for earlier, later in pairwise(stated)
        if later[0] < earlier[0]
    ]
    refuse_any(problems)
    rng = np.random.default_rng(runs[0].seed)
    models, notes = with_all_causes(runs, names)
    result = history(names, dates, models, false_alarm, rng)
    return replace(result, notes=(*notes, *result.notes, *_doubts(runs, names)))


def with_all_causes(runs: Sequence[Calibration], names: Sequence[str]) -> tuple[Sequence[Calibration], list[str]]:
    """Return the runs' models, each with the causes of all: those that lack some are fitted again. With notes on that.

    What a joint's figures are depends on what else it does in a model. Of each cause the first run's form is taken; causes of the
    measuring, and those that began at some row, remain those of each run.
    """
    every: dict[tuple[str, ...], Cause] = {}
    for cause in (cause for run in runs for cause in run.model.causes if _stays(cause)):
        every.setdefault((*cause.place, cause.variant if cause.effect.side_by_side else ""), cause)
    models: list[Calibration] = []
    changed = []
    for run, name in zip(runs, names, strict=True):
        wanted = [cause.on(run.model.robot) for cause in every.values()]
        if set(wanted) == {cause for cause in run.model.causes if _stays(cause)}:
            models.append(run)
            continue
        try:
            models.append(_refitted(run, wanted))
        except InputError as error:
            missing = f"with the causes of all runs, {name} cannot be fitted again: {error.problems[0]}"
            return runs, [f"{missing}. Joints with different causes are not compared"]
        changed.append(name)
    words = listed([place_name(cause.id, cause.joint, cause.part) for cause in every.values()], MOST_NAMED)
    told = f"with the causes of all runs ({words}), {listed(changed)} {'was' if len(changed) == 1 else 'were'} fitted again"
    return models, [told] if changed else []


def _stays(cause: Cause) -> bool:
    """Whether a cause is the robot's own, in all its runs, and not of the measuring or of a moment."""
    return not (cause.effect.of_measuring() or cause.effect.dated)


def _refitted(run: Calibration, causes: Sequence[Cause]) -> Calibration:
    """Return a run with its model fitted again with these causes of the robot, as far as its rows can show them.

    Raises:
        InputError: its measurements are not there any more.
    """
    train = run.data.only(run.data.train)
    plain = [effect for effect in run.model.effects if not (isinstance(effect, Cause) and _stays(effect))]
    shown = [cause for cause in causes if not type(cause.effect).lacking(run.model.robot, train)]
    model = replace(run.model, effects=(*plain, *shown))
    started = replace(run, model=model, estimate=run.model.handed_on(run.estimate, model))
    scattered = repeats_scatter(train, leading_errors(run.model, run.estimate, train))
    train, noise = averaged(train, replace(run.noise(train), scatter=scattered))
    fitted = Fitted.of(started, train, noise).sharing()
    return replace(
        started, model=fitted.model, estimate=fitted.fit.estimate, covariance=fitted.covariance,
        at_bound=fitted.fit.at_bound, errors=fitted.errors,
    )  # fmt: skip


def _doubts(runs: Sequence[Calibration], names: Sequence[str]) -> Iterator[str]:
    """Yield a warning if errors that the models leave out may be mistaken for changes."""
    doubtful = [
        name for name, run in zip(names, runs, strict=True) if not run.diagnosed or run.summary.discrepancy_mm > 0
    ]
    if doubtful:
        yield (
            f"the model of {listed(doubtful)} leaves errors beyond the noise, or was not diagnosed: where runs were measured at "
            "different poses such errors pass for movements; measure the same poses, and run diagnose"
        )
