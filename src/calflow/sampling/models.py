"""The models that may be right: how probable each of them is, and each cause, by the evidence of the same data.

A model's evidence is the probability of the data under it, all its parameters integrated out, by importance sampling: draws of a
Student t in the coordinates in which the posterior is round and has no bounds, so that few are enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.special import logsumexp, softmax
from scipy.stats import norm

from calflow.effects.cause import Carried, Cause
from calflow.estimation.calibrated_model import CalibratedModel, Change, ModelInReach
from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.progress import Advance, nobody
from calflow.files.tables import column, to_frame
from calflow.model import Model
from calflow.sampling.log_posterior import LOG_NOISE_SD, Laplace, LogPosterior, drawn_student, log_student

BATCH, MOST_BATCHES = 1000, 8  # draws of a model
EXACT = 0.05  # of the evidence, relative: with less error no more draws are made


@dataclass(frozen=True, eq=False)
class ModelEvidence:
    """The logarithm of a model's evidence, its standard error, and weighted draws of its posterior.

    The evidence is up to a constant that is the same for all models of the same data and weights. values (n, n_parameters + 1)
    are parameters and the log of the noise, weights (n,) add up to 1.
    """

    log: float
    error: float
    values: np.ndarray
    weights: np.ndarray

    def draws(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Return so many draws of the posterior, (number, n_parameters + 1)."""
        return self.values[rng.choice(len(self.weights), size=number, p=self.weights)]


def integrated_evidence(posterior: LogPosterior, rng: np.random.Generator, exact: float = EXACT) -> ModelEvidence:
    """Integrate the posterior of a model over all its parameters and the noise level, until the relative error is below exact."""
    drawn, logs = [], np.zeros(0)
    for _ in range(MOST_BATCHES):
        u = drawn_student((BATCH, posterior.n_dimensions), rng)
        drawn.append(u)
        logs = np.append(logs, posterior.log_probability(u) - log_student(u))
        if _error(logs) < exact:
            break
    level = posterior.coordinates.log_scale - _log_mass(posterior.problem.model)
    weights = np.exp(logs - logsumexp(logs))
    values = posterior.parameters(np.concatenate(drawn))
    return ModelEvidence(float(logsumexp(logs) - np.log(len(logs)) + level), _error(logs), values, weights)


def _error(logs: np.ndarray) -> float:
    """Relative standard error of a mean of weights with these logarithms (n,)."""
    share = np.exp(logs - logsumexp(logs))
    return float(np.sqrt(max((share**2).sum() - 1 / len(share), 0.0)))


def _log_mass(model: Model) -> float:
    """Logarithm of what the prior densities, as the posterior has them, add up to within the bounds."""
    below, above = norm.cdf((model.bounds - model.nominal[:, None]) / model.prior_sd[:, None]).T
    return float(np.log(np.sqrt(2 * np.pi) * np.append(model.prior_sd * (above - below), LOG_NOISE_SD)).sum())


@dataclass(frozen=True, eq=False)
class WeighedModel:
    """A model in reach, its graph, and its evidence."""

    reached: ModelInReach
    model: Model
    evidence: ModelEvidence


@dataclass(frozen=True, eq=False)
class WeighedModels:
    """All models in reach, what was found first; none where nothing was found."""

    models: tuple[WeighedModel, ...] = ()

    @cached_property
    def probabilities(self) -> np.ndarray:
        """How probable each is, (n_models,): its evidence times its prior probability, over all in reach.

        Where errors are not independent, evidence that takes them for it would be sure of whatever wanders slowly, as a drift:
        there the tests of diagnose count, which hold causes against that.
        """
        if not self.independent:
            return self.by_tests
        return _shares([model.evidence.log + model.reached.log_prior for model in self.models])

    @property
    def independent(self) -> bool:
        """Whether what the models leave counts as independent noise."""
        return all(model.reached.independent for model in self.models)

    @cached_property
    def by_tests(self) -> np.ndarray:
        """The same by the linear tests of diagnose, (n_models,)."""
        return _shares([model.reached.log_weight for model in self.models])

    @property
    def places(self) -> dict[tuple[str, str], Cause]:
        """A cause of each place that any of the models has one at, those found first."""
        places: dict[tuple[str, str], Cause] = {}
        for model in self.models:
            for cause in model.reached.causes:
                places.setdefault(cause.place, cause)
        return places

    def with_a_cause_at(self, place: tuple[str, str]) -> np.ndarray:
        """Whether each model has a cause at a place, (n_models,)."""
        return np.array([any(cause.place == place for cause in model.reached.causes) for model in self.models])


def weighed_models(
    calibrated: CalibratedModel,
    problem: LeastSquares,
    rng: np.random.Generator,
    advance: Advance = nobody,
    exact: float = EXACT,
) -> WeighedModels:
    """Fit all models in reach to the problem's data, by its weights, and integrate over their parameters.

    advance gets the share of work done; exact is the relative error of each evidence that is good enough.
    """
    weighed, seed = [], int(rng.integers(2**63))
    for number, reached in enumerate(calibrated.in_reach, start=1):
        posterior = _about_its_fit(problem.on(_with_causes(calibrated, reached.causes)), calibrated)
        same = np.random.default_rng(seed)  # the same draws for all: what errors they have in common does not count
        weighed.append(WeighedModel(reached, posterior.problem.model, integrated_evidence(posterior, same, exact)))
        advance(number / len(calibrated.in_reach))
    return WeighedModels(tuple(weighed))


def _with_causes(calibrated: CalibratedModel, causes: Sequence[Cause]) -> Model:
    """The model with these causes; those that are held at their estimates stay as they are."""
    plain = [effect for effect in calibrated.model.effects if not isinstance(effect, Cause)]
    held = [effect.cause for effect in plain if isinstance(effect, Carried)]
    free = [cause for cause in causes if cause not in held]
    return replace(calibrated.model, effects=(*plain, *free))


def _about_its_fit(problem: LeastSquares, calibrated: CalibratedModel) -> LogPosterior:
    there = dict(zip((p.identity for p in calibrated.model.parameters), calibrated.estimate, strict=True))
    start = np.array([there.get(p.identity, p.nominal) for p in problem.model.parameters])
    fitted, _ = fit(problem, start[None])
    return LogPosterior.about(problem, Laplace.of(problem, fitted.estimate, fitted.at_bound), BATCH)


def _shares(logs: Sequence[float]) -> np.ndarray:
    return np.asarray(softmax(logs)) if logs else np.zeros(0)


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
    by_tests: float = column("the same by the evidence of diagnose's linear tests")


@dataclass(frozen=True, kw_only=True)
class CauseProbability:
    """A cause of any of these models, the likeliest first."""

    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none")
    part: str = column("the part of the robot")
    probability: float = column(
        "that it acts, in whatever form and beside whatever else, if one of these models is right"
    )
    by_tests: float = column("the same by the evidence of diagnose's linear tests")
    found: bool = column("whether diagnose put it into the model")


def models_table(weighed: WeighedModels) -> pd.DataFrame:
    """Return the table of `ModelRow`s."""
    rows = [
        ModelRow(
            model=number, change=model.reached.change, causes=tuple(cause.id for cause in model.reached.causes),
            joints=tuple(cause.joint for cause in model.reached.causes), parts=tuple(cause.part for cause in model.reached.causes),
            details=tuple(cause.detail or ONLY for cause in model.reached.causes),
            log_evidence=model.evidence.log - weighed.models[0].evidence.log if weighed.independent else np.nan,
            error=model.evidence.error if weighed.independent else np.nan,
            log_prior=model.reached.log_prior, probability=float(probability), by_tests=float(by_tests),
        )
        for number, (model, probability, by_tests) in enumerate(
            zip(weighed.models, weighed.probabilities, weighed.by_tests, strict=True), start=1
        )
    ]  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), ModelRow)


def cause_table(weighed: WeighedModels) -> pd.DataFrame:
    """Return the table of `CauseProbability`s."""
    rows = []
    for place, cause in weighed.places.items():
        having = weighed.with_a_cause_at(place)
        rows.append(
            CauseProbability(
                cause=cause.id, joint=cause.joint or None, part=cause.part, probability=float(weighed.probabilities[having].sum()),
                by_tests=float(weighed.by_tests[having].sum()), found=bool(having[0]),
            )
        )  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), CauseProbability)
