"""What one robot's measurements tell of parameters, its own prior taken out of its estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calflow.estimation.calibrated import Identified
from calflow.robot.parameter import Parameter


@dataclass(frozen=True, eq=False)
class Told:
    """The log likelihood of parameters (n,) up to a constant: pull @ x - x @ information @ x / 2, x in standard deviations.

    These are the parameters' priors'. A parameter that sits on a bound is told nothing of.
    """

    robot: str
    information: np.ndarray
    pull: np.ndarray

    @staticmethod
    def of(robot: str, known: Identified, parameters: Sequence[Parameter]) -> Told:
        """Return what a fit tells of parameters of its model, whatever its others are."""
        where = {parameter.identity: k for k, parameter in enumerate(known.model.parameters)}
        own = np.array([where[parameter.identity] for parameter in parameters], dtype=int)
        free = np.flatnonzero(~known.at_bound[own])
        chosen = own[free]
        sd, mean = known.model.prior_sd[chosen], known.model.prior_mean[chosen]
        unit = np.array([parameters[int(k)].prior_sd for k in free])
        precise = np.linalg.inv(known.covariance[np.ix_(chosen, chosen)] / np.outer(unit, unit))
        prior = (unit / sd) ** 2
        share, directions = np.linalg.eigh(precise - np.diag(prior))
        information, pull = np.zeros((len(own), len(own))), np.zeros(len(own))
        information[np.ix_(free, free)] = directions * np.maximum(share, 0.0) @ directions.T
        told = precise @ (known.estimate[chosen] / unit) - prior * mean / unit
        pull[free] = directions @ np.where(share > 0, directions.T @ told, 0.0)
        return Told(robot, information, pull)


def shared_parameters(fits: Sequence[Identified]) -> tuple[Parameter, ...]:
    """Return the parameters that all fits have, of effects without variants, in the first one's order.

    Where a robot stands and what it holds while it is measured is its own, and tells nothing of its type.
    """
    common = set.intersection(*({one.identity for one in known.model.parameters} for known in fits))
    placed = {"base", *(name for known in fits for name in known.model.robot.markers)}
    return tuple(
        one for one in fits[0].model.parameters
        if one.identity in common and not one.variant and one.part not in placed and one.effect
    )  # fmt: skip
