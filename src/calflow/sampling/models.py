"""The models that may be right: how probable each of them is, and each cause, by diagnose's evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calflow.estimation.calibrated_model import Change, ModelInReach
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame


def probabilities(models: Sequence[ModelInReach]) -> np.ndarray:
    """Return how probable each model is if one of them is right, (n_models,)."""
    return np.asarray(scipy.special.softmax([model.log_weight for model in models])) if models else np.zeros(0)


ONLY = "-"  # instead of the form of a cause that has no other


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """A model that may be right, by its causes, the likeliest first. No row: diagnose found nothing that may be something else."""

    model: int = column("its number in `diagnose/models_in_reach.csv`; 1 is what diagnose found")
    change: Change = column(
        "what makes it: as found, without a cause, with one instead of another, with one besides, or several of these"
    )
    causes: tuple[str, ...] = column("ids of its causes; empty: none")
    joints: tuple[int, ...] = column("the joint or link of each; 0: none")
    parts: tuple[str, ...] = column("the part of the robot that each is a cause of")
    details: tuple[str, ...] = column("the form of each, in words; -: it has only one", separator="; ")
    log_evidence: float = column("logarithm of the data's probability under it, over that of what diagnose found")
    log_prior: float = column("logarithm of its prior probability, over that of a model without causes")
    probability: float = column("that it is right, if one of these models is")


@dataclass(frozen=True, kw_only=True)
class CauseProbability:
    """A cause of any of these models, the likeliest first."""

    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none")
    part: str = column("the part of the robot")
    probability: float = column(
        "that it acts, in whatever form and beside whatever else, if one of these models is right"
    )
    found: bool = column("whether diagnose put it into the model")


def models_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `ModelRow`s of the models in reach, what was found first."""
    rows = [
        ModelRow(
            model=number, change=model.change, causes=tuple(cause.id for cause in model.causes),
            joints=tuple(cause.joint for cause in model.causes), parts=tuple(cause.part for cause in model.causes),
            details=tuple(cause.detail or ONLY for cause in model.causes),
            log_evidence=model.log_weight - model.log_prior + models[0].log_prior, log_prior=model.log_prior,
            probability=float(probability),
        )
        for number, (model, probability) in enumerate(zip(models, probabilities(models), strict=True), start=1)
    ]  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), ModelRow)


def cause_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `CauseProbability`s of the models in reach, what was found first."""
    acting = {cause.place: cause for model in reversed(models) for cause in reversed(model.causes)}
    rows = []
    for place, cause in reversed(acting.items()):
        having = np.array([any(other.place == place for other in model.causes) for model in models])
        rows.append(
            CauseProbability(
                cause=cause.id, joint=cause.joint or None, part=cause.part,
                probability=float(probabilities(models)[having].sum()), found=bool(having[0]),
            )
        )  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), CauseProbability)
