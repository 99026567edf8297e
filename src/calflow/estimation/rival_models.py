"""Alternatives: other models that explain the data about as well, and what their predictions differ by.

Occam's window: the models that the data may be of as well, each a set of causes with its prior probability.

Models far less likely than the best are left out, so that those few can be weighed in full (Madigan and Raftery 1994).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd

from calflow.effects.cause import Cause
from calflow.files.tables import column, to_frame
from calflow.model import Model


@dataclass(frozen=True, kw_only=True)
class AlternativeParameter:
    """A parameter of a model that explains the data about as well: one cause gives way to a rival, or to nothing."""

    alternative: int = column("number of the model")
    probability: float = column("that it is this one, as far as the data tell")
    instead_of: int = column("which of the causes in effects.csv is not in it, in their order")
    effect: str = column("id of the rival in its place; empty: none")
    part: str = column("the part of the robot that the rival is a cause of")
    variant: str = column("the figures that make its variant, as JSON")
    parameter: str = column("the parameter's name")
    estimate: float = column("what the fit found, in the parameter's SI unit")


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another model of the same robot, its estimate (n_parameters,) in SI, and how probable it is."""

    model: Model
    estimate: np.ndarray
    probability: float


def choice_variance(
    alternatives: Sequence[Alternative], model: Model, estimate: np.ndarray, conditions: np.ndarray
) -> np.ndarray:
    """Return the variance of each row's position (n_rows, 3) [m²] because another model may be the right one.

    The mean square distance of their predictions from this model's (Hoeting et al. 1999, Bayesian model averaging).
    """
    if not alternatives:
        return np.zeros((conditions.shape[1], 3))
    here = model.point(estimate, conditions)
    others = [replace(one.model, given=model.given).point(one.estimate, conditions) for one in alternatives]
    return np.asarray(
        sum(one.probability * (there - here) ** 2 for one, there in zip(alternatives, others, strict=True))
    )


Change = Literal["found", "without", "instead", "besides"]


@dataclass(frozen=True, kw_only=True)
class CauseInReach:
    """A cause of a model in reach: what was found, less one cause, with another in the place of one, or with one more."""

    model: int = column("number of the model; the first is what was found")
    change: Change = column(
        "what makes it: as found, without a cause, with one instead of another, or with one besides"
    )
    log_prior: float = column("logarithm of its prior probability, over that of a model without causes")
    log_weight: float = column(
        "the same of how likely diagnose's linear tests make it (BIC), prior included, over what was found"
    )
    independent: bool = column(
        "whether what is left counts as independent noise: no background (see method), nothing that the rows of a pose share"
    )
    effect: str = column("id of the cause; empty: the model has none")
    part: str = column("the part of the robot that it is a cause of")
    variant: str = column("the figures that make its variant, as JSON")


@dataclass(frozen=True)
class ModelInReach:
    """A model in reach by its causes; the logarithms are as in `CauseInReach`."""

    causes: tuple[Cause, ...]
    change: Change
    log_prior: float
    log_weight: float
    independent: bool = True


def in_reach_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `CauseInReach`s."""
    rows = []
    for number, one in enumerate(models, start=1):
        named = [(cause.effect.id, cause.part, json.dumps(cause.effect.figures)) for cause in one.causes]
        rows += [
            CauseInReach(
                model=number, change=one.change, log_prior=one.log_prior, log_weight=one.log_weight,
                independent=one.independent, effect=effect, part=part, variant=variant,
            )
            for effect, part, variant in named or [("", "", "")]
        ]  # fmt: skip
    return to_frame(rows, CauseInReach)
