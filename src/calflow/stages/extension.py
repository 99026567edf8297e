"""The extension of a model by the causes that explain what it leaves: forward with a gate, then backward."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from calflow.model import Model
from calflow.stages.causes import Catalogue, Cause
from calflow.stages.exchange import COLUMNS, Exchange
from calflow.stages.fitted import Fitted
from calflow.stages.look import Finding, Look, Screened
from calflow.stages.screening import MATERIAL, Family, Regressors, Score, Screening, by_place, prior_cost
from calflow.stages.verdict import WITHIN
from calflow.stages.verification import corrected, doubtful

CLEAR = 1e-3  # share of the gate below which the cost of the tests need not be worked out anew
CLEARLY_FINER = 2.0  # of BIC: by how much a variant must be better than its neighbour for another fit
ENTANGLED = 3  # causes, the last found, that are exchanged by two


@dataclass(frozen=True)
class Gate:
    """What a cause must pass: the chance of a false alarm in the whole family, and how many causes there may be."""

    false_alarm: float
    most: int


@dataclass(frozen=True)
class Extended:
    """The extended model, its findings, the models on the way (one a finding), and the first screening."""

    fitted: Fitted
    findings: tuple[Finding, ...]
    path: tuple[Fitted, ...]
    first: Screened


@dataclass(frozen=True)
class Step:
    """What to try next: the causes, where their fit starts, the share of chi² that is to go, and why in words."""

    causes: list[Cause]
    start: np.ndarray
    share: float
    words: str


@dataclass(frozen=True)
class Trial:
    """A model that was tried, and how to look at it: the catalogue, and the first screening's cost of the tests."""

    fitted: Fitted
    causes: list[Cause]
    catalogue: Catalogue
    family: Family

    @cached_property
    def look(self) -> Look:
        """The linearised model."""
        return Look.at(self.fitted, self.causes, self.catalogue)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Its causes, each weighed against all candidates in its place."""
        return tuple(self.look.findings(self.family)) if self.causes else ()

    @property
    def bic(self) -> float:
        """What it costs, to be compared with other trials': misfit, parameters, and the variants that were tried."""
        fitted = self.fitted
        n = fitted.fit.residual.size
        scale = float(np.median(np.hypot(fitted.noise.sigma / fitted.far, fitted.noise.discrepancy)))
        scans = sum(np.log(self.catalogue.variants.get(cause.place, 1)) for cause in self.causes)
        misfit = (fitted.misfit - sum(map(self._relief, self.causes))) * scale**2
        parameters = fitted.fit.effective_parameters + sum(map(self._at_bound, self.causes))
        return float(n * np.log(misfit) + parameters * np.log(n) + 2 * scans)

    def _at_bound(self, cause: Cause) -> int:
        """How many of a cause's parameters have no effect: they were there to be fitted, and count like the others."""
        return int(self.fitted.fit.at_bound[self.fitted.model.columns(cause)].sum())

    def _relief(self, cause: Cause) -> float:
        """By how much a cause's parameters pull at their priors beyond what that costs."""
        model = self.fitted.model
        own = model.columns(cause)
        offset = self.fitted.fit.estimate[own] - model.nominal[own]
        pulled = float(((offset / model.prior_sd[own]) ** 2).sum())
        return pulled - float(prior_cost(np.array(pulled), len(own)))


@dataclass(frozen=True)
class _Search:
    """What every step of the search needs."""

    catalogue: Catalogue
    gate: Gate
    base: int
    first: Screened
    rng: np.random.Generator
    say: Callable[[str], None]

    def settled(self, tried: list[Trial]) -> Trial:
        """Add causes while one passes, drop or swap those that prove mistaken; return the best model whose causes all stand.

        tried grows by the models on the way.
        """
        begin = len(tried) - 1
        while step := next((step for step in self._steps(tried[-1]) if _is_new(step.causes, tried)), None):
            self.say(step.words)
            tried.append(self.trial(tried[-1], step))
        best_first = sorted([tried[0], *tried[begin:]], key=lambda trial: trial.bic)
        return next(trial for trial in best_first if self._stand(trial))

    def trial(self, before: Trial, step: Step) -> Trial:
        """Fit what a step asks for."""
        fitted = before.fitted.with_causes(self.base, step.causes, step.start, step.share)
        return Trial(fitted, step.causes, self.catalogue, self.first.family)

    def improved(self, best: Trial, tried: list[Trial]) -> Trial | None:
        """Return a better model that an exchange leads to, or a rival in the place of a large cause, if there is one."""
        doubted = (self._replaced(best, causes) for causes in _doubted(best))
        return self._led_to(best, tried, self.exchanges(best), lambda _: False) or self._led_to(
            best, tried, doubted, lambda trial: trial.bic < best.bic + WITHIN and not self._stand(trial)
        )

    def _led_to(
        self, best: Trial, tried: list[Trial], steps: Iterable[Step], promising: Callable[[Trial], bool]
    ) -> Trial | None:
        """Return the first better model that one of the steps leads to; what is promising need not be better at once."""
        for step in steps:
            if not _is_new(step.causes, tried):
                continue
            tried.append(self.trial(best, step))
            if tried[-1].bic < best.bic or promising(tried[-1]):
                self.say(step.words)
                if (other := self.settled(tried)).bic < best.bic:
                    return other
                self.say("that is no better")
        return None

    def _stand(self, trial: Trial) -> bool:
        return all(_stands(finding, self.gate) for finding in trial.findings)

    def exchanges(self, trial: Trial) -> Iterator[Step]:
        """Yield the causes with one or two in the place of two, or two in that of one, where that explains the data better."""
        small = [cause for cause in trial.causes if len(cause.declared) <= COLUMNS][-ENTANGLED:]
        for gone in (*combinations(small, 2), *combinations(small, 1)):
            exchange = Exchange.of(trial.look.apart(gone), trial.family, gone)
            stay = [cause for cause in trial.causes if cause not in gone]
            if (one := exchange.alone()) and _passes(one, trial.family, self.gate):
                yield self._replaced(trial, [*stay, one.cause])
            pairs = exchange.better()
            if pair := next((pair for pair in pairs if pair.p < self.gate.false_alarm), None):
                yield self._replaced(trial, [*stay, pair.first.cause, pair.second.cause])

    def _steps(self, trial: Trial) -> Iterator[Step]:
        yield from (self._replaced(trial, causes) for causes in _refined(trial))
        if len(trial.causes) < self.gate.most:
            yield from _added(trial, self.first, self.gate, self.rng)
        yield self._replaced(trial, second_thoughts(trial.findings, self.gate))

    def _replaced(self, trial: Trial, causes: list[Cause]) -> Step:
        said = _difference(trial.causes, causes)
        return Step(causes, _start(trial.fitted, self.base, causes), 0.0, said)


def extend(
    start: Fitted, catalogue: Catalogue, gate: Gate, rng: np.random.Generator, say: Callable[[str], None]
) -> Extended:
    """Add causes while one passes the gate, and drop, swap and exchange those that prove mistaken, until nothing changes."""
    base = len(start.model.effects)
    look = Look.at(start, [], catalogue)
    search = _Search(catalogue, gate, base, look.screened(rng), rng, say)
    tried = [Trial(start, [], catalogue, search.first.family)]
    best = search.settled(tried)
    while better := search.improved(best, tried):
        best = better
    trail = [trial.fitted for trial in tried]
    path = tuple(_fitted(trail, base, best.causes[: k + 1]) for k in range(len(best.causes)))
    return Extended(best.fitted, _as_fitted(best, tried), path, search.first)


def _doubted(best: Trial) -> Iterator[list[Cause]]:
    """The causes with a rival of a large one in its place, or without one that has another at its joint."""
    small = [finding for finding in best.findings if len(finding.cause.declared) <= COLUMNS]
    for finding in small:
        cause = finding.cause
        yield from (_swapped(best.causes, cause, score.cause) for score in doubtful(finding))
        if cause.joint and any(other.cause != cause and other.cause.joint == cause.joint for other in small):
            yield [other for other in best.causes if other != cause]


def _as_fitted(best: Trial, tried: Sequence[Trial]) -> tuple[Finding, ...]:
    """The findings, with the rivals' evidence from the fits that there were with one of them in a cause's place."""
    found = []
    for finding in best.findings:
        above = {
            score.cause.place: other.bic - best.bic
            for score in doubtful(finding)
            for other in tried if _same(other.causes, _swapped(best.causes, finding.cause, score.cause))
        }  # fmt: skip
        found.append(corrected(finding, above, best.fitted.fit.residual.size))
    return tuple(found)


def _swapped(causes: Sequence[Cause], gone: Cause, come: Cause) -> list[Cause]:
    return [come if cause == gone else cause for cause in causes]


def _same(causes: Sequence[Cause], others: Sequence[Cause]) -> bool:
    return len(causes) == len(others) and all(cause in others for cause in causes)


def _is_new(causes: Sequence[Cause], tried: Sequence[Trial]) -> bool:
    return not any(_same(causes, trial.causes) for trial in tried)


def _added(trial: Trial, first: Screened, gate: Gate, rng: np.random.Generator) -> Iterator[Step]:
    """The causes with the best one that passes the gate."""
    now = trial.look.screened(rng, first.family) if trial.causes else first
    passed = [score for score in now.scores if _passes(score, now.family, gate)]
    if trial.causes and not (passed and now.family.p(passed[0]) < CLEAR * gate.false_alarm):
        now = trial.look.screened(rng)  # what the tests cost depends on what is left, where it matters
        passed = [score for score in now.scores if _passes(score, now.family, gate)]
    if not passed:
        return
    best = finest(min(passed, key=lambda score: score.delta_bic + score.unusual), trial.fitted)  # usual sizes first
    said = f"{words(best.cause)}: chi2 falls by {best.drop:.4g}, p = {now.family.p(best):.2g}"
    yield Step(
        [*trial.causes, best.cause], np.concatenate([trial.fitted.fit.estimate, best.estimate]), best.explained, said
    )


def _difference(before: Sequence[Cause], after: Sequence[Cause]) -> str:
    gone, come = ([c for c in these if c not in those] for these, those in ((before, after), (after, before)))
    if not gone:
        return f"{' and '.join(map(words, come))} besides"
    give = "give" if len(gone) > 1 else "gives"
    return f"{' and '.join(map(words, gone))} {give} way to {' and '.join(map(words, come)) or 'nothing'}"


def narrowed(start: Fitted, extended: Extended, decoys: Sequence[Cause], catalogue: Catalogue, gate: Gate) -> Extended:
    """Drop the causes whose evidence goes as soon as what nobody can name is in the model too, and weigh the others anew."""
    base, causes = len(start.model.effects), [finding.cause for finding in extended.findings]
    now = extended.fitted
    fuller = now.with_causes(base, [*causes, *decoys], _start(now, base, [*causes, *decoys]))
    seen = Look.at(fuller, [*causes, *decoys], Catalogue((), {})).findings(extended.first.family)
    kept = [finding.cause for finding in seen if finding.cause in causes and _stands(finding, gate)]
    if kept == causes:
        return extended
    alone = now.with_causes(base, [*kept, *decoys], _start(now, base, [*kept, *decoys]))
    model, other = (Trial(fitted, list(found), catalogue, extended.first.family)
                    for fitted, found in ((now, causes), (alone, [*kept, *decoys])))  # fmt: skip
    if model.bic < other.bic:
        return extended  # what cannot be named explains them no better than they explain themselves
    trail = [start, *extended.path]
    tried = [Trial(_fitted(trail, base, kept), kept, catalogue, extended.first.family)]
    while _is_new(better := second_thoughts(tried[-1].findings, gate), tried):
        fitted = _fitted([tried[-1].fitted], base, better)
        tried.append(Trial(fitted, better, catalogue, extended.first.family))
    last = tried[-1]
    trail += [trial.fitted for trial in tried]
    path = tuple(_fitted(trail, base, last.causes[: k + 1]) for k in range(len(last.causes)))
    return Extended(last.fitted, last.findings, path, extended.first)


def weighed_against(extended: Extended, catalogue: Catalogue) -> Extended:
    """Score a wider catalogue's candidates in each cause's place: what was left out of the search can still be the truth."""
    causes = [finding.cause for finding in extended.findings]
    if not causes:
        return extended
    return replace(
        extended, findings=tuple(Look.at(extended.fitted, causes, catalogue).findings(extended.first.family))
    )


def _stands(finding: Finding, gate: Gate) -> bool:
    own = [score for score in finding.scores if score.cause == finding.cause]
    return bool(own) and _passes(own[0], finding.family, gate)


def _fitted(trail: Sequence[Fitted], base: int, causes: Sequence[Cause]) -> Fitted:
    """Return the model with these causes from the models fitted on the way, or fit it from the one most like it."""

    def differing(fitted: Fitted) -> int:
        have = fitted.model.effects[base:]
        return sum(cause not in have for cause in causes) + sum(cause not in causes for cause in have)

    near = min(reversed(trail), key=differing)
    if list(near.model.effects[base:]) == list(causes):
        return near
    return near.with_causes(base, causes, _start(near, base, causes))


def words(cause: Cause) -> str:
    """Name a cause for a log line."""
    return " ".join(filter(None, (cause.id, cause.part, f"({cause.detail})" if cause.detail else "")))


def _passes(score: Score, family: Family, gate: Gate) -> bool:
    return score.delta_bic < 0 and score.share > MATERIAL and family.p(score) < gate.false_alarm


def finest(score: Score, now: Fitted) -> Score:
    """Return the best variant of a cause between its neighbours in the scan."""
    finer = [Cause(c.robot, c, score.cause.part) for c in score.cause.effect.finer(now.data)]
    if not finer:
        return score
    scores = Screening(Regressors.of(now.fit, now.problem, finer, now.poses)).scores
    best = max(scores, key=lambda s: s.drop, default=score)
    return best if best.drop > score.drop else score


def _refined(trial: Trial) -> Iterator[list[Cause]]:
    """Yield the causes with one in a finer variant that is clearly better, now that the others are in the model."""
    data = trial.fitted.data
    scanned = [cause for cause in trial.causes if cause.effect.finer(data)]
    if not scanned:
        return
    finer = tuple(Cause(cause.robot, effect, cause.part) for cause in scanned for effect in cause.effect.finer(data))
    look = Look.at(trial.fitted, trial.causes, Catalogue(finer, {}))
    for cause in scanned:
        near = [score for score in look.apart([cause]).scores if score.cause.place == cause.place]
        own = next((score.delta_bic for score in near if score.cause == cause), np.inf)
        if near and near[0].delta_bic < own - CLEARLY_FINER:
            yield _swapped(trial.causes, cause, near[0].cause)


def second_thoughts(findings: Sequence[Finding], gate: Gate) -> list[Cause]:
    """Return the causes that stay, a more probable rival in the place of one; one change at a time."""
    causes = [finding.cause for finding in findings]
    weakest = sorted(findings, key=lambda finding: -_own_bic(finding))
    for finding in weakest:
        if not _stands(finding, gate):
            return [cause for cause in causes if cause != finding.cause]
    for finding in weakest:
        places = by_place(finding.scores)
        usual = {place: evidence + score.unusual for place, (evidence, score) in places.items()}
        best = places[min(usual, key=lambda place: usual[place])][1]
        if usual[best.cause.place] < usual[finding.cause.place] and _passes(best, finding.family, gate):
            return _swapped(causes, finding.cause, best.cause)
    return causes


def _own_bic(finding: Finding) -> float:
    return next((score.delta_bic for score in finding.scores if score.cause == finding.cause), 0.0)


def _start(now: Fitted, base: int, causes: Sequence[Cause]) -> np.ndarray:
    """Start from the estimates there are; what is new starts at nothing."""
    known = dict(zip(((p.effect, p.name) for p in now.model.parameters), now.fit.estimate, strict=True))
    model = Model(now.model.robot, (*now.model.effects[:base], *causes), now.model.given)
    return np.array([known.get((p.effect, p.name), p.nominal) for p in model.parameters])
