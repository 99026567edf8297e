"""The models that may be right: how probable each of them is, and each cause, by the evidence of the same data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import softmax

from calflow.effects.cause import Carried, Cause
from calflow.estimation.calibrated import Identified
from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.occam_window import ModelInReach
from calflow.estimation.progress import Advance, nobody
from calflow.model import Model
from calflow.sampling.evidence import BATCH, EXACT, Evidence, evidence
from calflow.sampling.posterior import Laplace, Posterior


@dataclass(frozen=True, eq=False)
class WeighedModel:
    """A model in reach, its graph, and its evidence."""

    reached: ModelInReach
    model: Model
    evidence: Evidence


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
        return _shares([one.evidence.log + one.reached.log_prior for one in self.models])

    @property
    def independent(self) -> bool:
        """Whether what the models leave counts as independent noise."""
        return all(one.reached.independent for one in self.models)

    @cached_property
    def by_tests(self) -> np.ndarray:
        """The same by the linear tests of diagnose (BIC), (n_models,)."""
        return _shares([one.reached.log_weight for one in self.models])

    @property
    def places(self) -> dict[tuple[str, str], Cause]:
        """A cause of each place that any of the models has one at, those found first."""
        found: dict[tuple[str, str], Cause] = {}
        for one in self.models:
            for cause in one.reached.causes:
                found.setdefault(cause.place, cause)
        return found

    def with_a_cause_at(self, place: tuple[str, str]) -> np.ndarray:
        """Whether each model has a cause at a place, (n_models,)."""
        return np.array([any(cause.place == place for cause in one.reached.causes) for one in self.models])


def weighed_models(
    known: Identified,
    problem: LeastSquares,
    rng: np.random.Generator,
    advance: Advance = nobody,
    exact: float = EXACT,
) -> WeighedModels:
    """Fit all models in reach to the problem's data, by its weights, and integrate over their parameters.

    advance is told the share of work done; exact is the relative error of each evidence that is good enough.
    """
    found, seed = [], int(rng.integers(2**63))
    for number, reached in enumerate(known.in_reach, start=1):
        posterior = _about_its_fit(problem.on(_with_causes(known, reached.causes)), known)
        same = np.random.default_rng(seed)  # the same draws for all: what errors they have in common does not count
        found.append(WeighedModel(reached, posterior.problem.model, evidence(posterior, same, exact)))
        advance(number / len(known.in_reach))
    return WeighedModels(tuple(found))


def _with_causes(known: Identified, causes: Sequence[Cause]) -> Model:
    """The model with these causes; those that are held at their estimates stay as they are."""
    plain = [effect for effect in known.model.effects if not isinstance(effect, Cause)]
    held = [effect.cause for effect in plain if isinstance(effect, Carried)]
    free = [cause for cause in causes if cause not in held]
    return replace(known.model, effects=(*plain, *free))


def _about_its_fit(problem: LeastSquares, known: Identified) -> Posterior:
    there = dict(zip((one.identity for one in known.model.parameters), known.estimate, strict=True))
    start = np.array([there.get(one.identity, one.nominal) for one in problem.model.parameters])
    found, _ = fit(problem, start[None])
    return Posterior.about(problem, Laplace.of(problem, found.estimate, found.at_bound), BATCH)


def _shares(logs: Sequence[float]) -> np.ndarray:
    return np.asarray(softmax(logs)) if logs else np.zeros(0)
