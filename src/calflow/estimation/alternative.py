"""Alternatives: other models that explain the data about as well, and what their predictions differ by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.files.tables import column
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
    alternatives: Sequence[Alternative], model: Model, estimate: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """Return the variance of each row's position (n_rows, 3) [m²] because another model may be the right one.

    The mean square distance of their predictions from this model's (Hoeting et al. 1999, Bayesian model averaging).
    """
    if not alternatives:
        return np.zeros((rows.shape[1], 3))
    here = model.point(estimate, rows)
    others = [replace(one.model, given=model.given).point(one.estimate, rows) for one in alternatives]
    return np.asarray(
        sum(one.probability * (there - here) ** 2 for one, there in zip(alternatives, others, strict=True))
    )
