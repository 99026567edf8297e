"""The extension of a model by the causes that explain what it leaves: forward with a gate, then backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.measurements import Measurements
from calflow.model import Model
from calflow.stages.causes import Catalogue, Cause
from calflow.stages.fit import Fit, Loss, Problem
from calflow.stages.noise import LackOfFit, Noise, averaged
from calflow.stages.screening import Regressors, Score, Screening, p_family
from calflow.stages.settle import fit_settled

ROUNDS = 3  # of second thoughts about all causes found
SETTLED = 0.1  # relative change of the noise below which an intermediate fit is not repeated


@dataclass(frozen=True)
class Fitted:
    """A fitted model with the training data and the noise it was fitted with; lack is that against the noise alone."""

    fit: Fit
    data: Measurements
    noise: Noise
    lack: LackOfFit
    loss: Loss

    @property
    def model(self) -> Model:
        """The model."""
        return self.fit.model

    @property
    def problem(self) -> Problem:
        """The problem that was solved, robust weights included."""
        return Problem.of(self.model, self.data, self.noise).reweighted(self.fit.estimate, self.loss)

    def with_causes(self, base: int, causes: Sequence[Cause], start: np.ndarray) -> Fitted:
        """Fit the first effects of the model with these causes, by IPOPT from a start that is moved inside the bounds."""
        model = Model(self.model.robot, (*self.model.effects[:base], *causes), self.model.given)
        bare = replace(self.noise, discrepancy=0.0, rotation_discrepancy=0.0)
        fit, noise, lack, _ = fit_settled(model, self.data, bare, start[None], self.loss, SETTLED)
        return Fitted(fit, self.data, noise, lack, self.loss)


@dataclass(frozen=True)
class Gate:
    """What a cause must pass: the chance of a false alarm in the whole family, and how many causes there may be."""

    false_alarm: float
    most: int


@dataclass(frozen=True)
class Finding:
    """A cause in the extended model, with all candidates' scores where it is taken out and the others stay.

    tests is how many independent tests the family of candidates is worth.
    """

    cause: Cause
    scores: tuple[Score, ...]
    tests: float

    @property
    def own(self) -> Score:
        """The cause's own score."""
        return next(score for score in self.scores if score.cause == self.cause)

    @property
    def p(self) -> float:
        """The chance that anything in the family looks like this where nothing is hidden."""
        return p_family(self.own.p, self.tests)


@dataclass(frozen=True)
class Extended:
    """The extended model, its findings in the order of importance, and the first and the last screening's scores."""

    fitted: Fitted
    findings: tuple[Finding, ...]
    first: tuple[Score, ...]
    first_tests: float
    last: tuple[Score, ...]
    last_tests: float


def extend(
    start: Fitted, catalogue: Catalogue, gate: Gate, rng: np.random.Generator, say: Callable[[str], None]
) -> Extended:
    """Add causes while one passes the gate, then drop those that the others make needless and swap mistaken ones."""
    base, now, causes = len(start.model.effects), start, list[Cause]()
    first: tuple[tuple[Score, ...], float] | None = None
    while True:
        screening = Screening(Regressors.of(now.fit, now.problem, catalogue.effects))
        scores, tests = screening.scores, screening.family(rng)
        first = first or (tuple(scores), tests)
        passed = [s for s in scores if s.cause not in causes and _passes(s, tests, gate)]
        if not passed or len(causes) == gate.most:
            break
        best = _refined(passed[0], now)
        say(f"{words(best.cause)}: chi2 falls by {best.drop:.4g}, p = {p_family(best.p, tests):.2g}")
        causes.append(best.cause)
        now = now.with_causes(base, causes, np.concatenate([now.fit.estimate, best.estimate]))
    last = (tuple(scores), tests)
    findings: list[Finding] = []
    for _ in range(ROUNDS if causes else 0):
        findings = _conditional(now, base, causes, catalogue, tests)
        better = _second_thoughts(findings, now, gate)
        if better == causes:
            break
        for old, new in zip(findings, better, strict=False):
            if old.cause != new:
                say(f"{words(old.cause)} gives way to {words(new)}")
        causes = better
        now = now.with_causes(base, causes, _start(now, base, causes))
        findings = _conditional(now, base, causes, catalogue, tests)
        screening = Screening(Regressors.of(now.fit, now.problem, catalogue.effects))
        last = (tuple(screening.scores), screening.family(rng))
    findings.sort(key=lambda finding: finding.own.delta_bic)
    return Extended(now, tuple(findings), *first, *last)


def words(cause: Cause) -> str:
    """Name a cause for a log line."""
    return " ".join(filter(None, (cause.id, cause.part, f"({cause.detail})" if cause.detail else "")))


def _passes(score: Score, tests: float, gate: Gate) -> bool:
    return score.delta_bic < 0 and p_family(score.p, tests) < gate.false_alarm


def _refined(score: Score, now: Fitted) -> Score:
    """Return the best variant of a cause between its neighbours in the scan."""
    finer = [Cause(c.robot, c, score.cause.part) for c in score.cause.effect.finer(now.data)]
    if not finer:
        return score
    scores = Screening(Regressors.of(now.fit, now.problem, finer)).scores
    best = max(scores, key=lambda s: s.drop, default=score)
    return best if best.drop > score.drop else score


def _conditional(
    now: Fitted, base: int, causes: Sequence[Cause], catalogue: Catalogue, tests: float
) -> list[Finding]:
    """Score all candidates in each cause's place, the others staying in the model; linear, without a refit."""
    whole = Regressors.of(now.fit, now.problem, (*catalogue.effects, *causes))
    free = np.flatnonzero(~now.fit.at_bound)
    found, end = [], len(now.fit.estimate) - sum(len(cause.declared) for cause in causes)
    for cause in causes:
        own = np.arange(end, end + len(cause.declared))
        end = own[-1] + 1
        columns = np.flatnonzero(np.isin(free, own))
        value = now.fit.estimate[free[columns]]
        apart = whole.without(columns, whole.jacobian[:, columns] @ value, value * np.sqrt(whole.precision[columns]))
        others = tuple(c for c in apart.candidates if c.cause == cause or c.cause not in causes)
        found.append(Finding(cause, tuple(Screening(replace(apart, candidates=others)).scores), tests))
    return found


def _second_thoughts(findings: Sequence[Finding], now: Fitted, gate: Gate) -> list[Cause]:
    """Return the causes that stay, a rival in the place of the one it explains better; one change at a time."""
    causes = [finding.cause for finding in findings]
    weakest = sorted(findings, key=lambda finding: -_own_bic(finding))
    for finding in weakest:
        own = [score for score in finding.scores if score.cause == finding.cause]
        if not own or not _passes(own[0], finding.tests, gate):
            return [cause for cause in causes if cause != finding.cause]
    for finding in weakest:
        best = finding.scores[0]
        if best.cause.place != finding.cause.place and best.delta_bic < finding.own.delta_bic:
            rival = best.cause
            return [rival if cause == finding.cause else cause for cause in causes]
    return causes


def _own_bic(finding: Finding) -> float:
    return next((score.delta_bic for score in finding.scores if score.cause == finding.cause), 0.0)


def _start(now: Fitted, base: int, causes: Sequence[Cause]) -> np.ndarray:
    """Start from the estimates there are; what is new starts at nothing."""
    known = dict(zip(((p.effect, p.name) for p in now.model.parameters), now.fit.estimate, strict=True))
    model = Model(now.model.robot, (*now.model.effects[:base], *causes), now.model.given)
    return np.array([known.get((p.effect, p.name), p.nominal) for p in model.parameters])
