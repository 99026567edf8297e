"""The exchange: two causes at once in the place of others, where one at a time leads astray.

Causes that resemble each other hide each other: the one that explains most of both is found first, and no swap of a single
cause leads back. All pairs are scored from the same linearisation as single causes are (see `screening`).

Verification: rivals of a large cause are fitted in its place, where one linearisation is not exact enough to exclude them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic

import numpy as np
from scipy.special import fdtrc

from calflow.diagnosis.findings.verdict import WITHIN
from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import INVISIBLE, MATERIAL, Family, Screening, by_place
from calflow.diagnosis.search.linearisation import Detection
from calflow.diagnosis.search.trial import Trial, swapped

COLUMNS = 4  # of a candidate at most: error maps have rivals of their own
VARIANTS = 8  # of one place, the best
SPLIT = 10.0  # of BIC: by how much two must explain the data better than one (Kass and Raftery 1995: "very strong")


@dataclass(frozen=True)
class Pair(Generic[H]):
    """Two candidates together; p is the larger of their family-wise p-values, each beside the other."""

    first: Score[H]
    second: Score[H]
    delta_bic: float
    p: float


@dataclass(frozen=True)
class Exchange(Generic[H]):
    """All pairs of candidates in the place of one cause or two, small ones only.

    information (m, m, COLUMNS, COLUMNS) is S between candidates in units of the priors and score (m, COLUMNS) their u, filled
    up with zeros, which explain nothing and cost nothing.
    """

    screening: Screening[H]
    family: Family
    gone: Sequence[H]
    scores: tuple[Score[H], ...]
    information: np.ndarray
    score: np.ndarray

    @staticmethod
    def of(screening: Screening[H], family: Family, gone: Sequence[H]) -> Exchange[H]:
        """Take the best variants of every place, and the causes that are gone."""
        seen: Counter[tuple[str, str]] = Counter()
        few = []
        for score in screening.scores:
            seen[score.cause.place] += 1
            best = seen[score.cause.place] <= VARIANTS and len(score.candidate.columns) <= COLUMNS
            if best or score.cause in gone:
                few.append(score)
        columns = np.zeros((len(few), COLUMNS), dtype=int)
        sd = np.zeros(columns.shape)
        for k, score in enumerate(few):
            span = score.candidate.columns
            columns[k, : len(span)] = span
            sd[k, : len(span)] = screening.regressors.prior_sd[span]
        used, which = np.unique(columns, return_inverse=True)
        which = which.ravel()
        information = screening.information(used)[np.ix_(which, which)] * sd.ravel()[:, None] * sd.ravel()
        shape = (len(few), COLUMNS, len(few), COLUMNS)
        return Exchange(
            screening, family, gone, tuple(few), information.reshape(shape).transpose(0, 2, 1, 3),
            screening.score[columns] * sd,
        )  # fmt: skip

    def alone(self) -> Score[H] | None:
        """Return the best candidate that explains the data better than the two that are gone do together."""
        at = [k for k, score in enumerate(self.scores) if score.cause in self.gone]
        best = min(self.scores, key=lambda score: score.delta_bic, default=None)
        if len(at) < 2 or best is None or not best.delta_bic < self._bic[at[0], at[1]]:
            return None
        return best

    def better(self) -> Iterator[Pair[H]]:
        """Yield the pairs of different places that explain the data better than what they replace, best first."""
        at = [k for k, score in enumerate(self.scores) if score.cause in self.gone]
        if len(at) < len(self.gone):
            return  # what is gone does not show here
        every = self._bic
        now = every[at[0], at[1]] if len(at) == 2 else self.scores[at[0]].delta_bic - SPLIT
        limit = now - MATERIAL * len(self.screening.regressors.residual)
        bic = np.where(self._of_different_places, every, np.inf)
        for k in np.argsort(bic, axis=None, kind="stable"):
            i, j = (int(x) for x in np.unravel_index(k, bic.shape))
            if not bic[i, j] < limit:
                return
            yield Pair(self.scores[i], self.scores[j], float(bic[i, j]), max(self._p(i, j), self._p(j, i)))

    @property
    def _of_different_places(self) -> np.ndarray:
        """Which pairs are of two places, each pair once, shape (m, m)."""
        places = [score.cause.place for score in self.scores]
        number = {place: k for k, place in enumerate(dict.fromkeys(places))}
        where = np.array([number[place] for place in places])
        return np.triu(where[:, None] != where, 1)

    @cached_property
    def _bic(self) -> np.ndarray:
        """Return delta BIC of every pair, shape (m, m)."""
        identity = np.eye(COLUMNS)
        m = len(self.scores)
        diagonal = self.information[np.arange(m), np.arange(m)]
        alone = np.linalg.inv(diagonal + identity)
        drop_alone = np.einsum("ma,mab,mb->m", self.score, alone, self.score)
        # What j shows beside i, and what is left for it to explain.
        taken = np.einsum("ijab,iac->ijbc", self.information, alone, optimize=True)
        beside = diagonal + identity - np.einsum("ijbc,ijcd->ijbd", taken, self.information, optimize=True)
        beside[np.arange(m), np.arange(m)] = identity
        left = self.score - np.einsum("ijbc,ic->ijb", taken, self.score, optimize=True)
        inverse = np.linalg.inv(beside)
        drop = drop_alone[:, None] + np.einsum("ijb,ijbc,ijc->ij", left, inverse, left, optimize=True)
        kept = np.trace(inverse, axis1=2, axis2=3)
        spent = 2 * COLUMNS - kept - kept.T
        scans = np.log([self.screening.variants[score.cause.place] for score in self.scores])
        n = len(self.screening.regressors.residual)
        share = np.minimum(drop / self.screening.chi2, 1 - 1e-12)
        return np.asarray(n * np.log1p(-share) + spent * np.log(n) + 2 * (scans[:, None] + scans))

    def _p(self, i: int, j: int) -> float:
        """Return the family-wise p-value of candidate j where i is in the model."""
        identity = np.eye(COLUMNS)
        taken = self.information[j, i] @ np.linalg.inv(self.information[i, i] + identity)
        values, vectors = np.linalg.eigh(self.information[j, j] - taken @ self.information[i, j])
        shown = values > INVISIBLE
        if not shown.any():
            return 1.0
        left = self.score[j] - taken @ self.score[i]
        drop = float((((vectors.T @ left)[shown]) ** 2 / values[shown]).sum())
        degrees_of_freedom = int(shown.sum())
        rest = max(self.screening.degrees_of_freedom - degrees_of_freedom, 1.0)
        chi2 = max(self.screening.chi2 - self.scores[i].drop - drop, 1e-12 * self.screening.chi2)
        single = float(fdtrc(degrees_of_freedom, rest, drop / degrees_of_freedom / (chi2 / rest)))
        return self.family.p(replace(self.scores[j], p=single))


DOUBT = 0.05  # share of a cause's evidence by which the linear comparison with a rival may err
WORTH = WITHIN  # of BIC: smaller doubts do not decide anything

Place = tuple[str, str]


def doubtful(finding: Detection[H]) -> list[Score[H]]:
    """Return the best variants of the rivals that might explain the data as well, the nearest first; none of a small cause."""
    doubt = -DOUBT * finding.own.delta_bic
    if doubt < WORTH:
        return []
    places = by_place(finding.scores)
    named_bic = places.pop(finding.cause.place)[0]
    near = [(bic, score) for bic, score in places.values() if bic - named_bic < WITHIN + doubt]
    return [score for _, score in sorted(near, key=lambda scored: scored[0])]


def doubted(best: Trial[H]) -> Iterator[list[H]]:
    """Yield the causes with a rival of a large one in its place, or without one that has another at its joint.

    Rivals, and what is left at a joint, are taken in the form that is best there.
    """
    small = [finding for finding in best.findings if finding.cause.n_parameters <= COLUMNS]
    for finding in small:
        cause = finding.cause
        for score in doubtful(finding):
            yield swapped(best.causes, cause, best.in_place([cause], score.cause))
        for other in (
            rival.cause for rival in small if rival.cause != cause and cause.joint and rival.cause.joint == cause.joint
        ):
            stay = [rival for rival in best.causes if rival != cause]
            yield stay
            yield swapped(stay, other, best.in_place([cause, other], other))


def verified(best: Trial[H], tried: Sequence[Trial[H]]) -> tuple[Detection[H], ...]:
    """Return the findings, with the rivals' evidence from the fits that there were with one of them in a cause's place."""
    detections = []
    for finding in best.findings:
        stay = [cause for cause in best.causes if cause != finding.cause]
        above = {
            score.cause.place: min(fitted)
            for score in doubtful(finding)
            if (fitted := [other.bic - best.bic for other in tried if _has(other, stay, score.cause)])
        }
        detections.append(corrected_rivals(finding, above, best.n_residuals))
    return tuple(detections)


def _has(trial: Trial[H], stay: Sequence[H], rival: H) -> bool:
    """Whether a trial had these causes and a rival besides, in any form."""
    others = [cause for cause in trial.causes if cause not in stay]
    return len(trial.causes) == len(stay) + 1 and [cause.place for cause in others] == [rival.place]


def corrected_rivals(finding: Detection[H], above: Mapping[Place, float], n: int) -> Detection[H]:
    """Return the finding with some places' BICs as they were fitted, above that of the cause; n is the number of residuals."""
    places = by_place(finding.scores)
    own_bic = places[finding.cause.place][0]
    shift = {place: bic + own_bic - places[place][0] for place, bic in above.items()}

    def moved(score: Score[H]) -> Score[H]:
        if score.cause.place not in shift:
            return score
        change = shift[score.cause.place]
        share = 1 - (1 - score.share) * float(np.exp(change / n))
        return replace(
            score, delta_bic=score.delta_bic + change, share=share, drop=share * score.drop / max(score.share, 1e-12)
        )

    scores = sorted(map(moved, finding.scores), key=lambda score: score.delta_bic)
    return replace(finding, scores=tuple(scores))
