"""What one robot's measurements tell of parameters, its own prior taken out of its estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.robot.parts import Parameter


@dataclass(frozen=True, eq=False)
class ParameterEstimates:
    """A robot's fitted parameters (n,): their estimate (n,) with covariance (n, n), and which sit on a bound (n,).

    placed names the parts that say where the robot stands and what it holds.
    """

    parameters: tuple[Parameter, ...]
    estimate: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray
    placed: frozenset[str]

    @staticmethod
    def of(calibrated: CalibratedModel) -> ParameterEstimates:
        """Return the parameters of a fitted model."""
        model, placed = calibrated.model, frozenset({"base", *calibrated.model.robot.markers})
        return ParameterEstimates(
            model.parameters, calibrated.estimate, calibrated.covariance, calibrated.at_bound, placed
        )


@dataclass(frozen=True, eq=False)
class ParameterLikelihood:
    """The log likelihood of parameters (n,) up to a constant: pull @ x - x @ information @ x / 2, x in standard deviations.

    These are the parameters' priors'. A parameter that sits on a bound is told nothing of.
    """

    robot: str
    information: np.ndarray
    pull: np.ndarray

    @staticmethod
    def of(robot: str, estimates: ParameterEstimates, parameters: Sequence[Parameter]) -> ParameterLikelihood:
        """Return what a fit tells of parameters of its model, whatever its others are."""
        where = {parameter.identity: k for k, parameter in enumerate(estimates.parameters)}
        places = np.array([where[parameter.identity] for parameter in parameters], dtype=int)
        free = np.flatnonzero(~estimates.at_bound[places])
        chosen = places[free]
        sd = np.array([estimates.parameters[int(k)].prior_sd for k in chosen])
        mean = np.array([estimates.parameters[int(k)].prior_mean for k in chosen])
        unit = np.array([parameters[int(k)].prior_sd for k in free])
        precise = np.linalg.inv(estimates.covariance[np.ix_(chosen, chosen)] / np.outer(unit, unit))
        prior = (unit / sd) ** 2
        share, directions = np.linalg.eigh(precise - np.diag(prior))
        information, pull = np.zeros((len(places), len(places))), np.zeros(len(places))
        information[np.ix_(free, free)] = directions * np.maximum(share, 0.0) @ directions.T
        shift = precise @ (estimates.estimate[chosen] / unit) - prior * mean / unit
        pull[free] = directions @ np.where(share > 0, directions.T @ shift, 0.0)
        return ParameterLikelihood(robot, information, pull)


def shared_parameters(fits: Sequence[ParameterEstimates]) -> tuple[Parameter, ...]:
    """Return the parameters that all fits have, of effects without variants, in the first one's order.

    Where a robot stands and what it holds while it is measured is its own, and tells nothing of its type.
    """
    common = set.intersection(*({parameter.identity for parameter in estimates.parameters} for estimates in fits))
    placed = frozenset.union(*(estimates.placed for estimates in fits))
    return tuple(
        parameter
        for parameter in fits[0].parameters
        if parameter.identity in common and not parameter.variant and parameter.part not in placed and parameter.effect
    )
