"""The extension of a model by the causes that explain what it leaves: forward with a gate, then backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.measurements import Measurements
from calflow.model import Model
from calflow.stages.causes import Catalogue, Cause
from calflow.stages.fit import Fit, Loss, Problem
from calflow.stages.identified import Identified
from calflow.stages.noise import LackOfFit, Noise
from calflow.stages.screening import Family, Regressors, Score, Screening
from calflow.stages.settle import fit_settled

FAR, MEDIAN_LENGTH = 4.5, 1.5382  # robust standard deviations; the median length of three unit normals
CLEAR = 1e-3  # share of the gate below which the cost of the tests need not be worked out anew
MATERIAL = 0.01  # share of chi² that a cause must explain: thousands of rows also show what is of no use to anybody
SETTLED = 0.1  # relative change of noise and weights below which a fit is not repeated
WEIGHINGS = 3  # fits in which the weights of rows far off settle


@dataclass(frozen=True)
class Fitted:
    """A fitted model with the training data and the noise it was fitted with.

    lack is the lack of fit against the noise alone, device the noise before rows far off were given less weight.
    """

    fit: Fit
    data: Measurements
    noise: Noise
    lack: LackOfFit
    loss: Loss
    device: Noise

    @property
    def model(self) -> Model:
        """The model."""
        return self.fit.model

    @property
    def poses(self) -> np.ndarray:
        """The rows' poses, numbered from 0, shape (n_rows,)."""
        return np.unique(self.data.table["pose"], return_inverse=True)[1]

    @property
    def far(self) -> np.ndarray:
        """By how much rows count less than the device's noise says, at least 1, shape (n_rows,)."""
        ratio = self.noise.sigma / self.device.sigma
        return np.asarray(ratio / ratio.min())

    @property
    def problem(self) -> Problem:
        """The problem that was solved, robust weights included."""
        return Problem.of(self.model, self.data, self.noise).reweighted(self.fit.estimate, self.loss)

    def columns(self, cause: Cause) -> np.ndarray:
        """Return the indices of a cause's parameters."""
        start = 0
        for effect in self.model.effects:
            size = len(effect.declared)
            if effect == cause:
                return np.arange(start, start + size)
            start += size
        raise ValueError("the cause is not in the model")

    def weighed(self, sigma: np.ndarray) -> Fitted:
        """Fit anew with other noise (n_rows,) [m]."""
        noise = replace(self.device, sigma=sigma, discrepancy=0.0)
        return _settled(self.model, self.data, noise, self.fit.estimate, self.loss)

    @staticmethod
    def of(known: Identified, data: Measurements, noise: Noise) -> Fitted:
        """Fit an identified model anew on training rows, from where identify left it."""
        bare = replace(noise, discrepancy=0.0, rotation_discrepancy=0.0)
        return _settled(known.model, data, bare, known.estimate, known.loss)

    def with_causes(self, base: int, causes: Sequence[Cause], start: np.ndarray, share: float = 0.0) -> Fitted:
        """Fit the first effects of the model with these causes, by IPOPT from a start that is moved inside the bounds.

        share is how much of chi² is expected to go: a noise that is not known starts smaller by it, and settles at once.
        """
        model = Model(self.model.robot, (*self.model.effects[:base], *causes), self.model.given)
        bare = replace(self.device, discrepancy=0.0, rotation_discrepancy=0.0)
        if not bare.known:
            bare = replace(bare, sigma=self.noise.sigma / self.far * np.sqrt(1 - share))
        return _settled(model, self.data, bare, start, self.loss, self.far)


def _settled(
    model: Model, data: Measurements, device: Noise, start: np.ndarray, loss: Loss, far: np.ndarray | None = None
) -> Fitted:
    """Fit from a start; rows far beyond the others count no more than one at FAR does (Huber 1964).

    far (n_rows,) is by how much rows were beyond that in the fit before.
    """
    far = np.ones(len(data)) if far is None else far
    for _ in range(WEIGHINGS):
        weighed = replace(device, sigma=device.sigma * far)
        fit, noise, lack, _ = fit_settled(model, data, weighed, start[None], loss, SETTLED)
        before, far, start = far, _excess(fit, far), fit.estimate
        if np.allclose(far, before, rtol=SETTLED):
            break
    return Fitted(fit, data, noise, lack, loss, device)


def _excess(fit: Fit, far: np.ndarray) -> np.ndarray:
    """By how much each row's error exceeds FAR robust standard deviations, at least 1, shape (n_rows,)."""
    size = np.linalg.norm(fit.residual[:, :3], axis=1) * far
    scale = float(np.median(size)) / MEDIAN_LENGTH
    return np.asarray(np.maximum(1.0, size / (FAR * scale)))


@dataclass(frozen=True)
class Gate:
    """What a cause must pass: the chance of a false alarm in the whole family, and how many causes there may be."""

    false_alarm: float
    most: int


@dataclass(frozen=True)
class Finding:
    """A cause in the extended model, with all candidates' scores where it is taken out and the others stay."""

    cause: Cause
    scores: tuple[Score, ...]
    family: Family

    @property
    def own(self) -> Score:
        """The cause's own score."""
        return next(score for score in self.scores if score.cause == self.cause)

    @property
    def p(self) -> float:
        """The chance that anything in the family looks like this where nothing is hidden."""
        return self.family.p(self.own)


@dataclass(frozen=True)
class Extended:
    """The extended model, its findings, the models on the way (one a finding), and the first screening."""

    fitted: Fitted
    findings: tuple[Finding, ...]
    path: tuple[Fitted, ...]
    first: Screened


@dataclass(frozen=True)
class Screened:
    """All candidates' scores against one model, best first, what their number costs, and which places cannot be seen."""

    scores: tuple[Score, ...]
    family: Family
    hidden: tuple[Cause, ...]


@dataclass(frozen=True)
class Look:
    """One model with causes, and all candidates' regressors there, from one Jacobian."""

    fitted: Fitted
    causes: tuple[Cause, ...]
    regressors: Regressors

    @staticmethod
    def at(fitted: Fitted, causes: Sequence[Cause], catalogue: Catalogue) -> Look:
        """Linearise a fitted model; its own causes are among the candidates, for when they are taken out."""
        effects = (*catalogue.effects, *causes)
        return Look(fitted, tuple(causes), Regressors.of(fitted.fit, fitted.problem, effects, fitted.poses))

    def screened(self, rng: np.random.Generator, known: Family | None = None) -> Screened:
        """Test what the model does not have yet; known is what the number of tests costs, if that is known."""
        others = tuple(candidate for candidate in self.regressors.candidates if candidate.cause not in self.causes)
        screening = Screening(replace(self.regressors, candidates=others))
        shown = {score.cause.place for score in screening.scores}
        every = {candidate.cause.place: candidate.cause for candidate in others}
        hidden = tuple(cause for place, cause in every.items() if place not in shown)
        return Screened(tuple(screening.scores), known or screening.family(rng), hidden)

    def findings(self, family: Family) -> list[Finding]:
        """Score all candidates in each cause's place, the others staying in the model; linear, without a refit."""
        whole, estimate = self.regressors, self.fitted.fit.estimate
        free = np.flatnonzero(~self.fitted.fit.at_bound)
        found = []
        for cause in self.causes:
            columns = np.flatnonzero(np.isin(free, self.fitted.columns(cause)))
            value = estimate[free[columns]]
            apart = whole.without(
                columns, whole.jacobian[:, columns] @ value, value * np.sqrt(whole.precision[columns])
            )
            others = tuple(c for c in apart.candidates if c.cause == cause or c.cause not in self.causes)
            found.append(Finding(cause, tuple(Screening(replace(apart, candidates=others)).scores), family))
        return found


def extend(
    start: Fitted, catalogue: Catalogue, gate: Gate, rng: np.random.Generator, say: Callable[[str], None]
) -> Extended:
    """Add causes while one passes the gate, then drop those that the others make needless and swap mistaken ones."""
    base, now, causes = len(start.model.effects), start, list[Cause]()
    look = Look.at(now, causes, catalogue)
    first = last = look.screened(rng)
    trail = [now]
    while len(causes) < gate.most:
        passed = [score for score in last.scores if _passes(score, last.family, gate)]
        if (
            last.family is first.family
            and causes
            and not (passed and last.family.p(passed[0]) < CLEAR * gate.false_alarm)
        ):
            last = look.screened(rng)  # what the tests cost depends on what is left, where it matters
            passed = [score for score in last.scores if _passes(score, last.family, gate)]
        if not passed:
            break
        best = _refined(passed[0], now)
        say(f"{words(best.cause)}: chi2 falls by {best.drop:.4g}, p = {last.family.p(best):.2g}")
        causes.append(best.cause)
        now = now.with_causes(base, causes, np.concatenate([now.fit.estimate, best.estimate]), best.share)
        trail.append(now)
        look = Look.at(now, causes, catalogue)
        last = look.screened(rng, first.family)
    findings = look.findings(first.family)
    tried = [causes]
    while (better := second_thoughts(findings, gate)) not in tried:
        gone, come = ([c for c in these if c not in those] for these, those in ((causes, better), (better, causes)))
        say(f"{' and '.join(map(words, gone))} gives way to {' and '.join(map(words, come)) or 'nothing'}")
        causes = better
        tried.append(causes)
        now = now.with_causes(base, causes, _start(now, base, causes))
        trail.append(now)
        look = Look.at(now, causes, catalogue)
        findings = look.findings(first.family)
    path = tuple(_fitted(trail, start, base, causes[: k + 1]) for k in range(len(causes)))
    return Extended(now, tuple(findings), path, first)


def narrowed(start: Fitted, extended: Extended, decoys: Sequence[Cause], catalogue: Catalogue, gate: Gate) -> Extended:
    """Drop the causes whose evidence goes as soon as what nobody can name is in the model too."""
    base, causes = len(start.model.effects), [finding.cause for finding in extended.findings]
    now = extended.fitted
    fuller = now.with_causes(base, [*causes, *decoys], _start(now, base, [*causes, *decoys]))
    seen = Look.at(fuller, [*causes, *decoys], Catalogue((), {})).findings(extended.first.family)
    kept = [finding.cause for finding in seen if finding.cause in causes and _stands(finding, gate)]
    if kept == causes:
        return extended
    trail = [start, *extended.path]
    path = tuple(_fitted(trail, start, base, kept[: k + 1]) for k in range(len(kept)))
    now = path[-1] if path else start
    findings = Look.at(now, kept, catalogue).findings(extended.first.family)
    standing = [finding for finding in findings if any(score.cause == finding.cause for score in finding.scores)]
    return Extended(now, tuple(standing), path, extended.first)


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


def _fitted(trail: Sequence[Fitted], start: Fitted, base: int, causes: Sequence[Cause]) -> Fitted:
    """Return the model with these causes from the models fitted on the way, or fit it."""
    for fitted in trail:
        if list(fitted.model.effects[base:]) == list(causes):
            return fitted
    return start.with_causes(base, causes, _start(trail[-1], base, causes))


def words(cause: Cause) -> str:
    """Name a cause for a log line."""
    return " ".join(filter(None, (cause.id, cause.part, f"({cause.detail})" if cause.detail else "")))


def _passes(score: Score, family: Family, gate: Gate) -> bool:
    return score.delta_bic < 0 and score.share > MATERIAL and family.p(score) < gate.false_alarm


def _refined(score: Score, now: Fitted) -> Score:
    """Return the best variant of a cause between its neighbours in the scan."""
    finer = [Cause(c.robot, c, score.cause.part) for c in score.cause.effect.finer(now.data)]
    if not finer:
        return score
    scores = Screening(Regressors.of(now.fit, now.problem, finer, now.poses)).scores
    best = max(scores, key=lambda s: s.drop, default=score)
    return best if best.drop > score.drop else score


def second_thoughts(findings: Sequence[Finding], gate: Gate) -> list[Cause]:
    """Return the causes that stay, a rival in the place of the one it explains better; one change at a time."""
    causes = [finding.cause for finding in findings]
    weakest = sorted(findings, key=lambda finding: -_own_bic(finding))
    for finding in weakest:
        if not _stands(finding, gate):
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
