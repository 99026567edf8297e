"""Comparison of runs: what was asked and measured, what was found, and whether it differs by more than chance."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.stats import norm

from calflow.deployment.comparison import (
    TABLES,
    Comparison,
    ParameterDifference,
    RunAccuracy,
    RunCause,
    RunData,
    RunPair,
    Setting,
)
from calflow.diagnosis.findings.finding import Finding
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.difference import Difference
from calflow.estimation.fit_summary import IdentifySummary
from calflow.files.problems import refuse
from calflow.run_folder import is_measured, robot_digest
from calflow.runs.calibrated_run import CalibratedRun

DIFFERENT = 0.01  # chance below which a difference is told


def compare(*studies_or_runs: str | Path, out: str | Path | None = None) -> Comparison:
    """Compare two runs or more, each named by its folder or its study.

    Differences of parameters count as chance where both runs' covariances allow them. Runs of the same measurements share their
    errors, so that no such test holds: then the differences stand without one.

    Args:
        studies_or_runs: the runs.
        out: a folder for the tables and report.pdf; None writes nothing.

    Raises:
        InputError: there are fewer than two, or one has not identified yet.
    """
    if len(studies_or_runs) < 2:
        raise refuse("expected two runs or more to compare", key="runs")
    runs = [CalibratedRun.of(one) for one in studies_or_runs]
    names = run_names(runs)
    measured = [measured_files(run) for run in runs]
    same = {(a, b) for a, b in combinations(range(len(runs)), 2) if measured[a].keys() & measured[b].keys()}
    parameters, pairs = [], []
    for a, b in combinations(range(len(runs)), 2):
        rows, pair = _compared(runs[a], runs[b], (names[a], names[b]), (a, b) in same)
        parameters += rows
        pairs.append(pair)
    found = Comparison(
        _settings(runs, names), tuple(_data(run, k, names, measured, same) for k, run in enumerate(runs)),
        tuple(row for run, name in zip(runs, names, strict=True) for row in _accuracy(run, name)),
        tuple(parameters), tuple(pairs), _causes(runs, names),
    )  # fmt: skip
    if out is not None:
        from calflow.reporting.comparison_report import comparison_report
        from calflow.runs.kept import keep

        keep(Path(out), found.results, TABLES, "Comparison of runs", lambda: comparison_report(names, found))
    return found


def run_names(runs: Sequence[CalibratedRun]) -> list[str]:
    """Return the runs' folders, or with as many folders above as tell them apart."""
    parts = [run.folder.resolve().parts for run in runs]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(one[-depth:]) for one in parts]
        if len(set(names)) == len(names):
            return names
    raise refuse("the same run is named twice", runs[0].folder)


def measured_files(run: CalibratedRun) -> dict[str, str]:
    """Return the name of each measurement file, by its SHA-256."""
    return {digest: Path(path).name for path, digest in run.manifest.inputs.items() if is_measured(path)}


def _compared(
    first: CalibratedRun, second: CalibratedRun, names: tuple[str, str], same: bool
) -> tuple[list[ParameterDifference], RunPair]:
    one, other = first.known(()), second.known(())
    found = Difference.of(one, other)
    z = np.divide(np.abs(found.value), found.sd, out=np.zeros(len(found.value)), where=found.sd > 0)
    p = 2 * norm.sf(z)
    beyond = _holm(p)
    rows = []
    for k, (i, j) in enumerate(zip(found.first, found.second, strict=True)):
        parameter = one.model.parameters[i]
        rows.append(ParameterDifference(
            first=names[0], second=names[1], parameter=parameter.name, unit=parameter.unit,
            first_value=parameter.figure + float(one.estimate[i]), second_value=parameter.figure + float(other.estimate[j]),
            difference=float(found.value[k]), sd=None if same else float(found.sd[k]), p=None if same else float(p[k]),
            significant=None if same else bool(beyond[k]), meaning=parameter.meaning,
        ))  # fmt: skip
    squared, freedom, chance = found.joint
    told: dict[str, Any] = (
        {"chi2": None, "freedom": None, "p": None} if same else {"chi2": squared, "freedom": freedom, "p": chance}
    )
    robots = (first.robot.name, second.robot.name)
    pair = RunPair(
        first=names[0], second=names[1], robots=robots, robot=same_robot(first, second), shared=len(rows), **told
    )
    return rows, pair


def same_robot(first: CalibratedRun, second: CalibratedRun) -> Literal["the same", "another file", "another one"]:
    """Return whether two runs are of one robot, as far as their robot files say."""
    if robot_digest(first.robot) == robot_digest(second.robot):
        return "the same"
    kinds = [(run.robot.name, [joint.kind for joint in run.robot.joints]) for run in (first, second)]
    return "another file" if kinds[0] == kinds[1] else "another one"


def _holm(p: np.ndarray) -> np.ndarray:
    """Which p-values are beyond chance, as many as there are counted (Holm 1979)."""
    order = np.argsort(p)
    passed = (
        np.cumprod(p[order] <= DIFFERENT / (len(p) - np.arange(len(p)))).astype(bool)
        if len(p)
        else np.zeros(0, dtype=bool)
    )
    found = np.zeros(len(p), dtype=bool)
    found[order] = passed
    return found


def _settings(runs: Sequence[CalibratedRun], names: Sequence[str]) -> tuple[Setting, ...]:
    """Keys in which the studies, their robots, their stages' settings or the versions differ."""
    flat = []
    for run in runs:
        own = dict(_flat("", run.file.model_dump(mode="json", exclude_defaults=True)))
        own |= {
            "robot file's content": f"{run.robot.name} ({robot_digest(run.robot)})",
            "workflow": run.manifest.workflow,
            "calflow": run.manifest.calflow,
        }
        own |= {f"version of {name}": version for name, version in run.manifest.versions.items()}
        flat.append(own)
    keys = dict.fromkeys(key for own in flat for key in own)
    every = {key: [own.get(key, "") for own in flat] for key in keys}
    return tuple(
        Setting(setting=key, of=dict(zip(names, values, strict=True)))
        for key, values in every.items()
        if len(set(values)) > 1
    )


def _flat(key: str, value: Any) -> list[tuple[str, str]]:
    """Nested settings by their dotted keys."""
    if isinstance(value, dict):
        return [pair for name, inner in value.items() for pair in _flat(f"{key}.{name}" if key else str(name), inner)]
    return [(key, ", ".join(map(str, value)) if isinstance(value, list) else str(value))]


def _data(
    run: CalibratedRun, k: int, names: Sequence[str], measured: Sequence[dict[str, str]], same: set[tuple[int, int]]
) -> RunData:
    summary = run.results.document("identify/summary.json", IdentifySummary)
    others = tuple(names[a + b - k] for a, b in sorted(same) if k in (a, b))
    return RunData(
        run=names[k], files=tuple(measured[k].values()), poses=summary.training_poses, held_out=summary.heldout_poses,
        noise_mm=np.nan if summary.sigma_mm is None else summary.sigma_mm, noise_from=summary.noise_sources,
        discrepancy_mm=summary.discrepancy_mm, same_data_as=others,
    )  # fmt: skip


def _accuracy(run: CalibratedRun, name: str) -> list[RunAccuracy]:
    return [RunAccuracy(**vars(row), run=name) for row in run.results.rows(f"{run.stage}/accuracy.csv", Accuracy)]


def _causes(runs: Sequence[CalibratedRun], names: Sequence[str]) -> tuple[RunCause, ...]:
    every = [
        run.results.rows("diagnose/findings.csv", Finding) if run.stage == "diagnose" else list[Finding]()
        for run in runs
    ]
    places = [{(one.cause, one.joint) for one in own} for own in every]
    return tuple(
        RunCause(run=names[k], status=one.status, cause=one.cause, joint=one.joint, estimate=one.estimate, sd=one.sd, unit=one.unit,
                 probability=one.probability,
                 also_in=tuple(n for m, n in enumerate(names) if m != k and (one.cause, one.joint) in places[m]))
        for k, own in enumerate(every) for one in own
    )  # fmt: skip
