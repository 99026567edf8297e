"""Robots unlike their type: which parameter of which robot lies where its type's do not.

Each robot is held against the type as the others tell it. A parameter's score test asks whether a shift of it alone explains
the robot better than the type's spread does; the spread is known from as many robots as there are, so its statistic is
Student's. The most telling parameter of all is taken to be unlike, no longer tells of its type, and all is asked again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calflow.estimation.parameters import UNIT
from calflow.files.tables import column
from calflow.population.likelihood import ParameterLikelihood
from calflow.population.type_prior import FEWEST, NARROWEST, TypePrior, pooled_prior, type_prior, variances
from calflow.robot.parts import Parameter

FALSE_ALARM = 0.05  # chance that any robot of a type is named where none is unlike it
MOST = 0.2  # share of the robots' parameters that may be unlike, beyond which there is no type
UNSEEN = 1e-9  # information, in units of the prior's, below which a robot tells nothing of a parameter
CLOSELY = 8  # robots of which the others' spread is estimated anew
ALIKE = 6.0  # fall of chi² within which another parameter explains a robot about as well


@dataclass(frozen=True, kw_only=True)
class Unlike:
    """A parameter of a robot that is unlike its type's."""

    robot: str = column("its name")
    type: str = column("its type", default="")
    parameter: str = column("the parameter's name")
    unit: str = column("of the figures in this row (SI)")
    shift: float = column("how far it is from the type's mean", UNIT)
    sd: float = column("standard deviation of that", UNIT)
    spreads: float = column("the shift in the type's spreads")
    p: float = column("chance that any parameter of any robot of a type looks like this")
    instead: tuple[str, ...] = column("parameters whose shift would explain the robot about as well", default=())
    meaning: str = column("what the parameter is, in words", default="")


def unlike(
    parameters: Sequence[Parameter], likelihoods: Sequence[ParameterLikelihood], false_alarm: float = FALSE_ALARM
) -> tuple[TypePrior, list[Unlike]]:
    """Return the type's prior as the robots tell it that are like it, and what is unlike it, the surest first.

    Raises:
        ValueError: there are fewer than FEWEST robots.
    """
    if len(likelihoods) < FEWEST:
        raise ValueError(f"expected at least {FEWEST} robots, found {len(likelihoods)}")
    unlike: list[Unlike] = []
    own = np.zeros((len(likelihoods), len(parameters)), dtype=bool)
    while True:
        prior = type_prior(parameters, likelihoods, own)
        first = _most_telling(prior, false_alarm)
        if first is None or own.any(axis=1).sum() > MOST * len(likelihoods):
            return prior, unlike
        robot, k, row = first
        own[robot, k] = True
        unlike.append(row)


def _most_telling(prior: TypePrior, false_alarm: float) -> tuple[int, int, Unlike] | None:
    """Return the robot and parameter whose shift explains most, where chance seldom does; None where there is none."""
    tests = max(1, int((prior.determined > 0).sum())) * len(prior.likelihoods)
    first = np.argsort([shifts.chance.min() for shifts in _roughly(prior)])[:CLOSELY]
    exact = {int(robot): _shifts(prior, robot, _others(prior, robot)) for robot in first}
    robot = min(exact, key=lambda name: exact[name].chance.min())
    shifts = exact[robot]
    k = int(np.argmin(shifts.chance))
    p = min(1.0, float(shifts.chance[k]) * tests)
    if p > false_alarm:
        return None
    explained = (shifts.shift / shifts.sd) ** 2
    near = np.flatnonzero((explained > explained[k] - ALIKE) & ~prior.own[robot])
    parameter = prior.parameters[k]
    row = Unlike(
        robot=prior.likelihoods[robot].robot, parameter=parameter.name, unit=parameter.unit,
        shift=float(shifts.shift[k]) * parameter.prior_sd, sd=float(shifts.sd[k]) * parameter.prior_sd,
        spreads=float(shifts.shift[k] / shifts.spread[k]), p=p,
        instead=tuple(prior.parameters[j].name for j in near if j != k), meaning=parameter.meaning,
    )  # fmt: skip
    return robot, k, row


@dataclass(frozen=True, eq=False)
class _Shifts:
    """Of each parameter of a robot (n,): its shift from the type of the others, its sd, their spread, the chance of so much."""

    shift: np.ndarray
    sd: np.ndarray
    spread: np.ndarray
    chance: np.ndarray


def _roughly(prior: TypePrior) -> Iterator[_Shifts]:
    """Yield each robot's shifts, the others' spread being known as far as the robot's own squares tell."""
    weight, pull = pooled_prior(prior.likelihoods, variances(prior.spread, prior.own))
    whole, total = weight.sum(axis=0) + np.eye(len(prior.mean)), pull.sum(axis=0)
    for robot in range(len(prior.likelihoods)):
        covariance = np.linalg.inv(whole - weight[robot])
        mean, spread = covariance @ (total - pull[robot]), _spread_without(prior, robot)
        yield _shifts(prior, robot, replace(prior, mean=mean, covariance=covariance, spread=spread))


def _others(prior: TypePrior, robot: int) -> TypePrior:
    """The type as the others tell it, all estimated anew."""
    likelihoods = [likelihood for k, likelihood in enumerate(prior.likelihoods) if k != robot]
    own = np.delete(prior.own, robot, axis=0)
    return type_prior(prior.parameters, likelihoods, own, _spread_without(prior, robot))


def _spread_without(prior: TypePrior, robot: int) -> np.ndarray:
    left = np.delete(np.where(prior.own, 0.0, prior.squares), robot, axis=0).sum(axis=0)
    counted = np.maximum(1, (~np.delete(prior.own, robot, axis=0)).sum(axis=0))
    return np.asarray(np.maximum(np.sqrt(left / counted), NARROWEST))


def _shifts(prior: TypePrior, robot: int, others: TypePrior) -> _Shifts:
    """Hold a robot against the others by each parameter's score test."""
    variance = variances(others.spread, prior.own[robot : robot + 1])
    (information,), (pull,) = pooled_prior(prior.likelihoods[robot : robot + 1], variance)
    score = pull - information @ others.mean
    scatter = np.diag(information + information @ others.covariance @ information)
    slope = np.diag(information)
    seen = (slope > UNSEEN) & ~prior.own[robot]
    shift, sd, chance = np.zeros(len(slope)), np.ones(len(slope)), np.ones(len(slope))
    shift[seen], sd[seen] = score[seen] / slope[seen], np.sqrt(scatter[seen]) / slope[seen]
    freedom = np.maximum(1, (~prior.own).sum(axis=0) - 2)
    chance[seen] = 2 * scipy.stats.t.sf(np.abs(shift) / sd, freedom)[seen]
    return _Shifts(shift, sd, others.spread, chance)
