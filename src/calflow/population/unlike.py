"""Robots that deviate from their type: outlier detection among the parameters of a type's robots.

Each robot is compared with the type estimated from the others. A score test asks whether a shift of one parameter explains the
robot better than the type's spread does; since the spread is estimated from the robots, its statistic is Student's t. The most
significant parameter is marked as deviating and excluded from the type's estimate, and the test is repeated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calflow.estimation.parameters import UNIT
from calflow.files.tables import column
from calflow.population.likelihood import ParameterLikelihood
from calflow.population.type_prior import FEWEST_ROBOTS, NARROWEST, TypePrior, pooled_prior, type_prior, variances
from calflow.robot.parts import Parameter

FALSE_ALARM = 0.05  # false-alarm rate per type: chance of any report where no robot deviates
MOST_UNLIKE = 0.2  # largest share of deviating robots; beyond it they are no single type
UNSEEN = 1e-9  # information, relative to the prior's, below which a parameter is undetermined
CLOSELY = 8  # candidate robots for which the type is re-estimated from the others
ALIKE = 6.0  # difference of chi² within which another parameter explains a robot about as well


@dataclass(frozen=True, kw_only=True)
class Unlike:
    """A parameter in which a robot deviates from its type."""

    robot: str = column("name of the robot")
    type: str = column("its type", default="")
    parameter: str = column("the parameter's name")
    unit: str = column("SI unit of the figures in this row")
    shift: float = column("deviation from the type's mean", UNIT)
    sd: float = column("standard deviation of the shift", UNIT)
    spreads: float = column("the shift in units of the type's spread")
    p: float = column("p-value, corrected for the number of parameters and robots of the type")
    instead: tuple[str, ...] = column("parameters whose shift would explain the robot about as well", default=())
    meaning: str = column("the parameter in words", default="")


def unlike(
    parameters: Sequence[Parameter], likelihoods: Sequence[ParameterLikelihood], false_alarm: float = FALSE_ALARM
) -> tuple[TypePrior, list[Unlike]]:
    """Return the type's prior, estimated without deviating parameters, and those parameters, the most significant first.

    Raises:
        ValueError: there are fewer than FEWEST_ROBOTS robots.
    """
    if len(likelihoods) < FEWEST_ROBOTS:
        raise ValueError(f"expected at least {FEWEST_ROBOTS} robots, found {len(likelihoods)}")
    unlike: list[Unlike] = []
    own = np.zeros((len(likelihoods), len(parameters)), dtype=bool)
    while True:
        prior = type_prior(parameters, likelihoods, own)
        first = _most_significant(prior, false_alarm)
        if first is None or own.any(axis=1).sum() > MOST_UNLIKE * len(likelihoods):
            return prior, unlike
        robot, k, row = first
        own[robot, k] = True
        unlike.append(row)


def _most_significant(prior: TypePrior, false_alarm: float) -> tuple[int, int, Unlike] | None:
    """Return the robot and parameter with the most significant shift; None where none is significant."""
    tests = max(1, int((prior.determined > 0).sum())) * len(prior.likelihoods)
    first = np.argsort([shifts.chance.min() for shifts in _approximate_shifts(prior)])[:CLOSELY]
    exact = {int(robot): _shifts(prior, robot, _without(prior, robot)) for robot in first}
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
    """For each parameter (n,) of a robot: its shift from the other robots' mean, the shift's sd, their spread, and p-value."""

    shift: np.ndarray
    sd: np.ndarray
    spread: np.ndarray
    chance: np.ndarray


def _approximate_shifts(prior: TypePrior) -> Iterator[_Shifts]:
    """Yield each robot's shifts, with the spread of the others approximated by leaving out the robot's squares."""
    weight, pull = pooled_prior(prior.likelihoods, variances(prior.spread, prior.own))
    whole, total = weight.sum(axis=0) + np.eye(len(prior.mean)), pull.sum(axis=0)
    for robot in range(len(prior.likelihoods)):
        covariance = np.linalg.inv(whole - weight[robot])
        mean, spread = covariance @ (total - pull[robot]), _spread_without(prior, robot)
        yield _shifts(prior, robot, replace(prior, mean=mean, covariance=covariance, spread=spread))


def _without(prior: TypePrior, robot: int) -> TypePrior:
    """Return the type's prior re-estimated from the other robots."""
    likelihoods = [likelihood for k, likelihood in enumerate(prior.likelihoods) if k != robot]
    own = np.delete(prior.own, robot, axis=0)
    return type_prior(prior.parameters, likelihoods, own, _spread_without(prior, robot))


def _spread_without(prior: TypePrior, robot: int) -> np.ndarray:
    left = np.delete(np.where(prior.own, 0.0, prior.squares), robot, axis=0).sum(axis=0)
    counted = np.maximum(1, (~np.delete(prior.own, robot, axis=0)).sum(axis=0))
    return np.asarray(np.maximum(np.sqrt(left / counted), NARROWEST))


def _shifts(prior: TypePrior, robot: int, others: TypePrior) -> _Shifts:
    """Return a robot's shifts relative to the other robots, by a score test of each parameter."""
    variance = variances(others.spread, prior.own[robot : robot + 1])
    (information,), (pull,) = pooled_prior(prior.likelihoods[robot : robot + 1], variance)
    score = pull - information @ others.mean
    scatter = np.diag(information + information @ others.covariance @ information)
    slope = np.diag(information)
    tested = (slope > UNSEEN) & ~prior.own[robot]
    shift, sd, chance = np.zeros(len(slope)), np.ones(len(slope)), np.ones(len(slope))
    shift[tested], sd[tested] = score[tested] / slope[tested], np.sqrt(scatter[tested]) / slope[tested]
    freedom = np.maximum(1, (~prior.own).sum(axis=0) - 2)
    chance[tested] = 2 * scipy.stats.t.sf(np.abs(shift) / sd, freedom)[tested]
    return _Shifts(shift, sd, others.spread, chance)
