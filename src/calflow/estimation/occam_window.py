"""Occam's window: the models that the data may be of as well, each a set of causes with its prior probability.

Models far less likely than the best are left out, so that those few can be weighed in full (Madigan and Raftery 1994).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from calflow.effects.cause import Cause
from calflow.files.tables import column, to_frame

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
