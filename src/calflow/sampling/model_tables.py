"""What the weighed models say: each model's probability, and each cause's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.estimation.occam_window import Change
from calflow.files.tables import column, to_frame
from calflow.sampling.models import WeighedModels

ONLY = "-"  # instead of the form of a cause that has no other


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """A model that may be right, by its causes, the likeliest first. No row: diagnose found nothing that may be something else."""

    model: int = column("its number in `diagnose/models_in_reach.csv`; 1 is what diagnose found")
    change: Change = column(
        "what makes it: as found, without a cause, with one instead of another, or with one besides"
    )
    causes: tuple[str, ...] = column("ids of its causes; empty: none")
    joints: tuple[int, ...] = column("the joint or link of each; 0: none")
    parts: tuple[str, ...] = column("the part of the robot that each is a cause of")
    details: tuple[str, ...] = column("the form of each, in words; -: it has only one", separator="; ")
    log_evidence: float = column(
        "logarithm of the data's probability under it, over that of what diagnose found; empty: errors are not independent"
    )
    error: float = column("standard error of the logarithm of its evidence; empty with it")
    log_prior: float = column("logarithm of its prior probability, over that of a model without causes")
    probability: float = column(
        "that it is right, if one of these models is: by its evidence, or where errors are not independent by the tests of diagnose"
    )
    by_tests: float = column("the same by the linear tests of diagnose (BIC)")


@dataclass(frozen=True, kw_only=True)
class CauseProbability:
    """A cause of any of these models, the likeliest first."""

    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none")
    part: str = column("the part of the robot")
    probability: float = column(
        "that it acts, in whatever form and beside whatever else, if one of these models is right"
    )
    by_tests: float = column("the same by the linear tests of diagnose (BIC)")
    found: bool = column("whether diagnose put it into the model")


def models_table(weighed: WeighedModels) -> pd.DataFrame:
    """Return the table of `ModelRow`s."""
    rows = [
        ModelRow(
            model=number, change=one.reached.change, causes=tuple(cause.id for cause in one.reached.causes),
            joints=tuple(cause.joint for cause in one.reached.causes), parts=tuple(cause.part for cause in one.reached.causes),
            details=tuple(cause.detail or ONLY for cause in one.reached.causes),
            log_evidence=one.evidence.log - weighed.models[0].evidence.log if weighed.independent else np.nan,
            error=one.evidence.error if weighed.independent else np.nan,
            log_prior=one.reached.log_prior, probability=float(probability), by_tests=float(by_tests),
        )
        for number, (one, probability, by_tests) in enumerate(
            zip(weighed.models, weighed.probabilities, weighed.by_tests, strict=True), start=1
        )
    ]  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), ModelRow)


def cause_table(weighed: WeighedModels) -> pd.DataFrame:
    """Return the table of `CauseProbability`s."""
    rows = []
    for place, cause in weighed.places.items():
        own = weighed.with_a_cause_at(place)
        rows.append(
            CauseProbability(
                cause=cause.id, joint=cause.joint or None, part=cause.part, probability=float(weighed.probabilities[own].sum()),
                by_tests=float(weighed.by_tests[own].sum()), found=bool(own[0]),
            )
        )  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), CauseProbability)
