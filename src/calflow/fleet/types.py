"""Findings on the types of a fleet: each type's prior, robots that deviate from it, and causes common to its robots.

They follow from every robot's parameter estimates with covariance, and from the causes diagnosed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calflow.design.candidates import candidates
from calflow.diagnosis.findings import Finding
from calflow.effects.wording import amount, cause_name
from calflow.estimation.parameters import UNIT, FittedParameter
from calflow.files.problems import refuse
from calflow.files.tables import column, from_frame, read_csv, to_frame
from calflow.files.words import listed, mm, plural, quantity
from calflow.fleet.engine import FleetFolder
from calflow.fleet.fleet import FleetRobot
from calflow.model import build
from calflow.population.common_causes import CommonCause, Shown, common_causes
from calflow.population.likelihood import ParameterEstimates, ParameterLikelihood, shared_parameters
from calflow.population.type_prior import FEWEST_ROBOTS, TypePrior
from calflow.population.unlike import Unlike, unlike
from calflow.robot.robot import Robot
from calflow.run_folder import damage, of_others, read_manifest
from calflow.study import Study

DEVIATION_POSES = 200  # random poses over which a deviation's displacement of the tool is averaged


@dataclass(frozen=True, eq=False)
class Collected:
    """A calibrated robot of a type: the parameter estimates of its latest valid model, and the causes diagnosed."""

    robot: str
    type: str
    calibration: ParameterEstimates
    causes: tuple[Shown, ...]


def collected(robot: FleetRobot, folder: FleetFolder) -> Collected:
    """Return the results of a calibrated robot, read from three tables alone since a fleet has hundreds of robots.

    Raises:
        InputError: its run folder was changed since.
    """
    run = folder.run(robot.name)
    manifest = read_manifest(run)
    if manifest is None:
        raise refuse("holds no run any more", run)
    diagnosed = manifest.stages.get("diagnose")
    stands = diagnosed and diagnosed.status == "done" and not of_others(manifest, "diagnose", ["identify"])
    stage = "diagnose" if stands else "identify"  # whose model is the latest valid one
    entry = manifest.stages.get(stage)
    wrong = damage(entry, run) if entry else f"{stage} was never run"
    if wrong:
        raise refuse(f"holds no identified robot: {wrong}; run the fleet again", run)
    findings = read_csv(run / "diagnose/findings.csv") if stage == "diagnose" else to_frame((), Finding)
    causes = tuple(
        Shown(
            row.cause,
            row.joint or 0,
            row.detail,
            row.estimate,
            row.sd,
            row.unit,
            tuple(zip(row.rival_causes, row.rival_joints, strict=True)),
        )
        for row in from_frame(findings, Finding, "diagnose/findings.csv")
        if row.is_cause
    )
    return Collected(robot.name, robot.type.name, _calibration(run / stage), causes)


def _calibration(made: Path) -> ParameterEstimates:
    """Return the parameter estimates in a stage's folder."""
    every = from_frame(read_csv(made / "parameters.csv"), FittedParameter, f"{made.name}/parameters.csv")
    rows = [row for row in every if not row.fixed]
    covariance = read_csv(made / "covariance.csv")
    return ParameterEstimates(
        tuple(row.as_parameter() for row in rows),
        np.array([row.estimate for row in rows]),
        covariance[[row.parameter for row in rows]].to_numpy(dtype=float),
        np.array([row.at_bound for row in rows], dtype=bool),
    )


@dataclass(frozen=True, kw_only=True)
class TypeParameter:
    """A parameter of a type of robots, by partial pooling over the calibrated ones."""

    type: str = column("the type's name")
    effect: str = column("id of the parameter's effect")
    part: str = column("the part of the robot that it belongs to")
    symbol: str = column("the parameter's symbol within that part")
    unit: str = column("SI unit of the figures in this row")
    mean: float = column("the type's mean, relative to the maker's figure", UNIT)
    mean_sd: float = column("standard deviation of that mean", UNIT)
    spread: float = column("standard deviation of the robots' true values about the mean", UNIT)
    expected_sd: float = column("predictive standard deviation of a further robot's value about the mean", UNIT)
    robots: int = column("number of robots whose measurements determine it at least as well as the type does")
    study_sd: float = column(
        "prior standard deviation of the study's effect, which applies to a robot without a fleet", UNIT
    )


@dataclass(frozen=True, eq=False)
class TypeFindings:
    """The findings on one type of robots; prior is None where there are too few."""

    type: str
    robots: int
    prior: TypePrior | None
    unlike: tuple[Unlike, ...]
    causes: tuple[CommonCause, ...]

    @staticmethod
    def of(type_: str, robots: Sequence[Collected]) -> TypeFindings:
        """Return the findings by pooling the robots of a type."""
        shown = {robot.robot: robot.causes for robot in robots}
        causes = tuple(replace(common_cause, type=type_) for common_cause in common_causes(shown))
        if len(robots) < FEWEST_ROBOTS:
            return TypeFindings(type_, len(robots), None, (), causes)
        parameters = shared_parameters([robot.calibration for robot in robots])
        prior, odd = unlike(
            parameters, [ParameterLikelihood.of(robot.robot, robot.calibration, parameters) for robot in robots]
        )
        return TypeFindings(type_, len(robots), prior, tuple(replace(row, type=type_) for row in odd), causes)

    def expecting(self, robot: Robot) -> Robot | None:
        """Return the type's robot with the pooled priors of a further one; None where the robots are too few."""
        by_name = (expected for expected in robot.expected if expected.name)
        return replace(robot, expected=(*self.prior.expected(), *by_name)) if self.prior else None

    def parameters(self) -> Iterator[TypeParameter]:
        """Yield the rows of the type's parameters."""
        prior = self.prior
        if prior is None:
            return
        for k, parameter in enumerate(prior.parameters):
            yield TypeParameter(
                type=self.type, effect=parameter.effect, part=parameter.part, symbol=parameter.symbol, unit=parameter.unit,
                mean=float(prior.mean[k]) * parameter.prior_sd, mean_sd=float(prior.covariance[k, k]) ** 0.5 * parameter.prior_sd,
                spread=float(prior.spread[k]) * parameter.prior_sd, expected_sd=float(prior.sd[k]) * parameter.prior_sd,
                robots=int(prior.determined[k]), study_sd=parameter.prior_sd,
            )  # fmt: skip


def by_type(robots: Iterable[Collected]) -> list[TypeFindings]:
    """Return the findings on each type of robots, sorted by type."""
    types: dict[str, list[Collected]] = {}
    for robot in robots:
        types.setdefault(robot.type, []).append(robot)
    return [TypeFindings.of(name, types[name]) for name in sorted(types)]


def unlike_parameters(types: Iterable[TypeFindings], moved_mm: Mapping[Unlike, float] = {}) -> dict[str, list[str]]:
    """Return each robot's deviations from its type in words; moved_mm is how far each deviation moves the tool."""
    odd: dict[str, list[str]] = {}
    for deviation in (deviation for type_ in types for deviation in type_.unlike):
        at_tool = f", {mm(moved_mm[deviation])} mm at the tool" if deviation in moved_mm else ""
        odd.setdefault(deviation.robot, []).append(f"{_shifted(deviation)}{at_tool}")
    return odd


def _shifted(deviation: Unlike) -> str:
    """Return the deviating parameter and its shift in words."""
    size = quantity(deviation.shift, deviation.sd, deviation.unit)
    return f"{deviation.meaning or deviation.parameter} by {size}"


def moved_at_tool(study: Study, deviations: Sequence[Unlike]) -> dict[Unlike, float]:
    """Return each deviation's displacement of the nominal tool, root mean square over random poses [mm].

    Deviations in parameters of diagnosed causes, which the study's effects do not have, are left out.
    """
    robot = study.robot
    model = build(robot, study.file.effects)
    number = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    numbered = [deviation for deviation in deviations if deviation.parameter in number]
    if not numbered:
        return {}
    payload = next(iter(robot.payloads), "")
    _, conditions = candidates(
        model, DEVIATION_POSES, payload, next(iter(robot.markers)), None, np.random.default_rng(0)
    )
    slopes = np.sqrt((model.point_jacobian(model.nominal, conditions) ** 2).sum(axis=1).mean(axis=0))
    return {
        deviation: 1e3 * abs(deviation.shift) * float(slopes[number[deviation.parameter]]) for deviation in numbered
    }


def type_lines(types: Sequence[TypeFindings], most: int) -> list[str]:
    """Return the findings on types as sentences, at most so many, those that need attention first."""
    lines = [line for kind in (_odd_line, _common_line) for type_ in types for line in kind(type_)]
    left = len(lines) - most
    return (
        lines if left <= 0 else [*lines[: most - 1], f"{left + 1} further statements on the types are in report.html."]
    )


def _odd_line(type_: TypeFindings) -> Iterator[str]:
    """Yield a sentence on the robots that deviate from their type."""
    robots: Mapping[str, Unlike] = {unlike.robot: unlike for unlike in reversed(type_.unlike)}
    if robots:
        named = [
            f"{name} ({_shifted(unlike)}{', or another figure' if unlike.instead else ''})"
            for name, unlike in robots.items()
        ]
        yield f"Unlike the other {type_.robots - len(robots)} of type {type_.type}: {listed(named, 4)}."


def _common_line(type_: TypeFindings) -> Iterator[str]:
    """Yield a sentence on each cause common to the type."""
    for cause in type_.causes:
        if cause.whose == "type":
            name = cause_name(cause.cause, cause.joint or 0)
            detail = f" ({cause.detail})" if cause.detail else ""
            size = amount(cause.cause, cause.size, cause.spread, cause.unit)
            yield (
                f"{len(cause.robots)} of {plural(cause.of, 'robot')} of type {type_.type} show {name}{detail}, {size}: it is "
                "the type's."
            )
