"""The Gaussian likelihood of parameters by one robot's measurements: its posterior with the prior divided out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.robot.parts import Parameter

OF_LINKS = ("loop", "links")  # parts of the robot that are no joint's


@dataclass(frozen=True, eq=False)
class ParameterEstimates:
    """A robot's fitted parameters (n,): estimate (n,), covariance (n, n), and which are at a bound (n,)."""

    parameters: tuple[Parameter, ...]
    estimate: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray

    @staticmethod
    def of(calibrated: CalibratedModel) -> ParameterEstimates:
        """Return the parameter estimates of a fitted model."""
        parameters = calibrated.model.parameters
        return ParameterEstimates(parameters, calibrated.estimate, calibrated.covariance, calibrated.at_bound)


@dataclass(frozen=True, eq=False)
class ParameterLikelihood:
    """The log-likelihood of parameters (n,) up to a constant: pull @ x - x @ information @ x / 2, x in prior sds.

    information (n, n) is the information matrix; parameters at a bound have none.
    """

    robot: str
    information: np.ndarray
    pull: np.ndarray

    @staticmethod
    def of(robot: str, estimates: ParameterEstimates, parameters: Sequence[Parameter]) -> ParameterLikelihood:
        """Return the likelihood of some of a fit's parameters, marginalised over its other parameters."""
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
    """Return the parameters of joints and links that all fits share, of effects without variants, in the first one's order.

    Base, markers, loads and devices describe an individual set-up, not the type.
    """
    common = set.intersection(*({parameter.identity for parameter in estimates.parameters} for estimates in fits))
    return tuple(
        parameter
        for parameter in fits[0].parameters
        if parameter.identity in common and not parameter.variant and (parameter.joint or parameter.part in OF_LINKS)
    )
