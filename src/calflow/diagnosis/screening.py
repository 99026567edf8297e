"""Screening: score tests of all causes of a catalogue against the residual of a fitted model, from one Jacobian.

The whitened residual e is that at the minimum of the fit's objective. For a candidate with whitened regressors X, the fit's
Jacobian J and the priors' precision P about an offset δ, the information is the Schur complement S = XᵀX - XᵀJ (JᵀJ + P)⁻¹ JᵀX and
the score u = Xᵀe - XᵀJ (JᵀJ + P)⁻¹ (Jᵀe + P δ): uᵀ(S + prior)⁻¹u is the reduction of chi² in a refit.

Candidates are also tested against many simulated residuals at once (`trials`). p-values are corrected for the number of tests
(`Family`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic

import numpy as np
import scipy

from calflow.diagnosis.regressors import Candidate, H, Place, Regressors, side_by_side
from calflow.effects import Effect, catalogue, effect_class
from calflow.estimation.prior_scale import on_likeliest_scale
from calflow.estimation.variance_components import LOG_PRIOR, SIZES, directions, explained, log_likelihood, mixed
from calflow.measurements.measurements import Measurements

# Level of the smallest p-value at which the bootstrap determines the equivalent number of tests.
BOOTSTRAP_SIGNIFICANCE = 0.05
MATERIAL = 0.01  # share of chi² that a cause must explain: thousands of poses also show effects too small to matter
INVISIBLE = 0.25  # least chi² of a direction at one prior standard deviation for it to be testable
DRAWS, DRAWN_AT_ONCE = 1000, 250  # bootstrap draws


@dataclass(frozen=True)
class Catalogue:
    """The effects to test on some data, in every variant, and why others are not tested.

    lacking: what the data lack to test an effect, by id; superseded: why an effect is not needed for this robot, by id.
    """

    effects: tuple[Effect, ...]
    lacking: dict[str, str]
    superseded: dict[str, str] = field(default_factory=dict)

    @cached_property
    def variants(self) -> dict[Place, int]:
        """Number of forms of each place."""
        return dict(Counter((effect.id, part) for effect in self.effects for part in effect.parts))

    def untestable(self, cause: str) -> dict[str, str]:
        """Return the ids of effects that may underlie a cause (id) that was found but could not be tested, with what each needs."""
        kind = effect_class(cause)
        alike = kind.alike if kind else ()
        lacking = ((name, effect_class(name), why) for name, why in self.lacking.items())
        return {name: why for name, other, why in lacking if name in alike or (other and cause in other.taken_for)}

    @staticmethod
    def of(data: Measurements, have: Sequence[str], only: Sequence[str] = (), without: Sequence[str] = ()) -> Catalogue:
        """Return the testable effects on these training data, all or only some, without those that the model has."""
        effects: list[Effect] = []
        lacking, superseded = {}, {}
        named = {name: kind for name in only if (kind := effect_class(name))}
        for name, kind in sorted((catalogue() | named).items()):
            if name in have or name in without or (only and name not in only):
                continue
            if reason := kind.superseded(data.robot, data):
                superseded[name] = reason
            elif reason := kind.lacking(data.robot, data):
                lacking[name] = reason
            elif not kind.is_noise():
                effects += kind.variants(data.robot, data)
        return Catalogue(tuple(effects), lacking, superseded)


@dataclass(frozen=True)
class Score(Generic[H]):
    """The score test of one candidate, without a refit.

    drop: reduction of chi²; share: its share of chi²; p: p-value of this test alone; cost: minus twice the log evidence, negative
    where the candidate is favoured; visible_share: share of the effect that neither the model's parameters nor a background
    imitate; estimate, covariance: of its parameters; information: S; shown: number of its directions that the data show; left:
    degrees of freedom of the denominator.
    """

    candidate: Candidate[H]
    drop: float
    share: float
    p: float
    cost: float
    visible_share: float
    estimate: np.ndarray
    covariance: np.ndarray
    information: np.ndarray
    shown: int
    left: float

    @property
    def explained(self) -> float:
        """Share of chi² that is removed, without the cause's own prior term."""
        precision = np.linalg.inv(self.covariance)
        fallen = self.estimate @ (2 * precision - self.information) @ self.estimate
        return float(np.clip(fallen * self.share / max(self.drop, 1e-12), 0.0, 1 - 1e-6))

    @property
    def likeliest(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimate and covariance with the priors on their likeliest scale; as they are where a bound holds the estimate."""
        if (self.estimate == self.cause.bounds).any():
            return self.estimate, self.covariance
        usual = np.diag(np.linalg.inv(self.covariance) - self.information) ** -0.5
        return on_likeliest_scale(self.estimate, self.covariance, (np.zeros(len(usual)), usual))[1:]

    @property
    def cause(self) -> H:
        """The candidate's cause."""
        return self.candidate.cause


def f_threshold(
    false_alarm: float, tests: float | np.ndarray, degrees_of_freedom: int | np.ndarray, left: float | np.ndarray
) -> np.ndarray:
    """Return the ratios (…) beyond which F tests are significant at the family's false_alarm.

    tests (…) are the equivalent numbers of tests, degrees_of_freedom and left (…) those of each test.
    """
    return np.asarray(scipy.special.fdtri(degrees_of_freedom, left, 1 + np.expm1(np.log1p(-false_alarm) / tests)))


@dataclass(frozen=True)
class Family:
    """Correction for multiple tests: equivalent number of independent tests of each place's variants, scans, and of all places.

    Each place is corrected for its own scan first, so that a cause without variants is not corrected for those of others. material
    is the share of chi² that a cause must explain, smaller with many points per pose, whose noise is unrelated to the robot.
    """

    scans: dict[Place, float]
    places: float
    material: float = MATERIAL

    def tests(self, score: Score) -> float:
        """Return the equivalent number of tests of a candidate: that of its place's scan times that of all places."""
        return self.scans.get(score.cause.place, 1.0) * self.places

    def p(self, score: Score) -> float:
        """Return the family-wise p-value of a candidate (Šidák)."""
        return float(-np.expm1(self.tests(score) * np.log1p(-min(score.p, 1 - 1e-16))))


def worth(smallest: np.ndarray) -> float:
    """Return the number of independent tests whose smallest p-value has this distribution, with an allowance for few draws."""
    error = float(np.sqrt(BOOTSTRAP_SIGNIFICANCE * (1 - BOOTSTRAP_SIGNIFICANCE) / len(smallest)))
    quantile = float(np.quantile(smallest, BOOTSTRAP_SIGNIFICANCE - error))
    return float(max(1.0, np.log1p(-BOOTSTRAP_SIGNIFICANCE) / np.log1p(-min(quantile, BOOTSTRAP_SIGNIFICANCE))))


@dataclass(frozen=True)
class RegressorProducts:
    """Products of regressors over all rows that tests need.

    own (n_columns, widest): each regressor with those of its candidate; projected (n_free, n_columns): with a root of the
    covariance of the predicted residuals; score (n_columns,): with the residual after a Newton step.
    """

    own: np.ndarray
    projected: np.ndarray
    score: np.ndarray

    @staticmethod
    def of(regressors: Regressors, root: np.ndarray, residual: np.ndarray) -> RegressorProducts:
        """Return the products with the root (n_free, n) and the residual (n,)."""
        own = np.zeros((regressors.matrix.shape[1], max((len(c.columns) for c in regressors.candidates), default=0)))
        projected, score = np.zeros((len(root), len(own))), np.zeros(len(own))
        for rows, values in regressors.matrix.blocks():
            for candidate in regressors.candidates:
                columns = side_by_side(candidate.columns)
                x = values[:, columns]
                own[columns, : len(candidate.columns)] += x.T @ x
            projected += root[:, rows] @ values
            score += values.T @ residual[rows]
        return RegressorProducts(own, projected, score)


@dataclass(frozen=True)
class Stack:
    """Candidates with equal numbers of columns d, stacked, as they are beside a whole model.

    members (n_members,): indices of the candidates; columns (n_members, d): of their regressors; sd (n_members, d): of their
    priors; moved (n_members,): their squared effect at one sd; information (n_members, d, d): S; bounds (n_members, 2, d): of the
    parameters.
    """

    members: np.ndarray
    columns: np.ndarray
    sd: np.ndarray
    moved: np.ndarray
    information: np.ndarray
    bounds: np.ndarray


@dataclass(frozen=True)
class _Block:
    """Candidates with equal numbers of columns d, stacked.

    roots (n_members, d, d): whitening of scores to independent standard normals, zero in directions that the data cannot show;
    value (n_members, d): information of these directions over the prior's, zero likewise; degrees_of_freedom (n_members,): their
    number; information (n_members, d, d): S; share (n_members,): visible share of each candidate;
    precision (n_members, d): of the priors; bounds (n_members, 2, d): of the parameters; scans (n_members,): variants of its place.
    """

    members: tuple[int, ...]
    columns: np.ndarray
    roots: np.ndarray
    value: np.ndarray
    degrees_of_freedom: np.ndarray
    information: np.ndarray
    share: np.ndarray
    precision: np.ndarray
    bounds: np.ndarray
    scans: np.ndarray

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (n_members, d, d) of the parameters, priors included."""
        prior = np.eye(self.precision.shape[1]) * self.precision[:, None, :]
        return np.asarray(np.linalg.inv(self.information + prior))


@dataclass(frozen=True, eq=False)
class _Evaluated:
    """A block's candidates evaluated for draws of their scores, (n_members, n_draws) each.

    squared: reduction of chi² without priors and bounds; drops: the same with them; cost: minus twice the log evidence; estimate
    (n_members, d, n_draws): of the parameters.
    """

    squared: np.ndarray
    drops: np.ndarray
    cost: np.ndarray
    estimate: np.ndarray


class ScoreTests(ABC, Generic[H]):
    """Score tests of some candidates against a model's residual."""

    @property
    @abstractmethod
    def model(self) -> Screening[H]:
        """The model with all its parameters, linearised."""

    @property
    @abstractmethod
    def tested(self) -> np.ndarray:
        """The indices of the candidates that are tested."""

    @property
    @abstractmethod
    def linear(self) -> Regressors[H]:
        """The linearised model of the stacks."""

    @property
    @abstractmethod
    def stacks(self) -> Sequence[Stack]:
        """All candidates, by their numbers of columns."""

    @abstractmethod
    def changed(self, columns: np.ndarray) -> np.ndarray | float:
        """Return by how much S (n_members, d, d) of candidates with columns (n_members, d) is larger than in the stacks."""

    @abstractmethod
    def score_of(self, columns: np.ndarray) -> np.ndarray:
        """Return the score u of columns (n_members, d)."""

    @property
    @abstractmethod
    def chi2(self) -> float:
        """Chi² of the model, priors included, after a Newton step of its parameters."""

    @property
    @abstractmethod
    def degrees_of_freedom(self) -> float:
        """Residual degrees of freedom: number of residuals less that of the effective parameters, a background's left out."""

    @cached_property
    def variants(self) -> dict[Place, int]:
        """Number of tested candidates of each place."""
        return dict(Counter(self._candidates[k].cause.place for k in self.tested.tolist()))

    @property
    def _candidates(self) -> tuple[Candidate[H], ...]:
        return self.linear.candidates

    @cached_property
    def _blocks(self) -> list[_Block]:
        blocks = []
        for stack in self.stacks:
            here = np.isin(stack.members, self.tested)
            members, columns, sd = stack.members[here], stack.columns[here], stack.sd[here]
            s = stack.information[here] + self.changed(columns)
            values, vectors = np.linalg.eigh(s * sd[:, :, None] * sd[:, None, :])
            shown = values > INVISIBLE
            normal = vectors * np.where(shown, np.abs(values) + 1e-300, np.inf)[:, None, :] ** -0.5
            value = np.where(shown, values, 0.0)
            some = shown.any(axis=1)
            roots = normal.transpose(0, 2, 1) * sd[:, None, :]
            share = np.sqrt(np.maximum(np.einsum("mii,mi->m", s, sd**2), 0.0) / stack.moved[here])
            scans = np.array([self.variants[self._candidates[m].cause.place] for m in members], dtype=int)
            parts = (columns, roots, value, shown.sum(axis=1), s, share, sd**-2.0, stack.bounds[here], scans)
            blocks.append(_Block(tuple(members[some].tolist()), *(part[some] for part in parts)))
        return [block for block in blocks if block.members]

    @cached_property
    def scores(self) -> list[Score[H]]:
        """Every visible candidate's score, best first."""
        scores = []
        for block in self._blocks:
            left = self.degrees_of_freedom - block.degrees_of_freedom
            if (freedom := self.linear.amplitude_freedom) is not None:
                # The median serves few columns, which are alike, and many, of which no single one matters.
                left = np.minimum(np.median(freedom[block.columns], axis=1), left)
            left = np.maximum(left, 1.0)
            weighed = self._weighed(block, self.score_of(block.columns)[:, :, None], np.array([self.chi2]))
            p = f_test(weighed.squared[:, 0], self.chi2, block.degrees_of_freedom, self.degrees_of_freedom, left)
            drops, cost = weighed.drops[:, 0], weighed.cost[:, 0]
            scores += [
                Score(self._candidates[member], float(drops[k]), float(drops[k] / self.chi2),
                      float(p[k]), float(cost[k]), float(block.share[k]), weighed.estimate[k, :, 0], block.covariance[k],
                      block.information[k], int(block.degrees_of_freedom[k]), float(left[k]))
                for k, member in enumerate(block.members)
            ]  # fmt: skip
        return sorted(scores, key=lambda score: score.cost)

    def _weighed(self, block: _Block, score: np.ndarray, chi2: np.ndarray) -> _Evaluated:
        """Evaluate a block's candidates for scores (n_members, d, n_draws), given the model's chi² (n_draws,)."""
        squared = (block.roots @ score) ** 2
        estimate = -block.covariance @ score
        inside = np.clip(estimate, block.bounds[:, 0, :, None], block.bounds[:, 1, :, None])
        beyond = estimate - inside
        against_priors = (block.precision[..., None] * beyond**2).sum(axis=1)
        lost = (beyond * (block.information @ beyond)).sum(axis=1) + against_priors
        shrunk = block.value / (block.value + 1)
        drops = np.maximum((squared * shrunk[..., None]).sum(axis=1) - lost, 0.0)
        fallen, narrowed = explained(squared.transpose(0, 2, 1), block.value[:, None, :])
        logs = log_likelihood((fallen - lost) / chi2, narrowed, self.degrees_of_freedom)
        cost = -2 * mixed(logs) + 2 * np.log(block.scans)[:, None]
        # Evidence uses the same degrees of freedom for all rivals; those of each enter its p-value.
        return _Evaluated(squared.sum(axis=1), drops, cost, inside)

    def trials(
        self, score: np.ndarray, chi2: np.ndarray, family: Family, false_alarm: float
    ) -> dict[Place, tuple[np.ndarray, np.ndarray]]:
        """Test all visible candidates at once for scores (n_columns, n_draws), given the model's chi² (n_draws,).

        Return each place's cost (n_draws,), its variants' evidence averaged, and whether any variant passes (n_draws,).
        """
        variants: dict[Place, list[tuple[np.ndarray, np.ndarray]]] = {}
        for block in self._blocks:
            weighed, spent = self._weighed(block, score[block.columns], chi2), block.degrees_of_freedom
            places = [self._candidates[member].cause.place for member in block.members]
            tests = np.array([family.scans.get(place, 1.0) for place in places]) * family.places
            left = np.maximum(self.degrees_of_freedom - spent, 1.0)
            threshold = f_threshold(false_alarm, tests, spent, left)
            ratio = weighed.squared / np.maximum(chi2 - weighed.squared, 1e-12 * chi2) * (left / spent)[:, None]
            passed = (ratio > threshold[:, None]) & (weighed.cost < 0) & (weighed.drops > family.material * chi2)
            for place, cost, passes in zip(places, weighed.cost, passed, strict=True):
                variants.setdefault(place, []).append((cost, passes))
        every = {place: map(np.array, zip(*members, strict=True)) for place, members in variants.items()}
        return {
            place: (-2 * np.logaddexp.reduce(-cost / 2, axis=0), np.asarray(passes.any(axis=0)))
            for place, (cost, passes) in every.items()
        }

    def family(self, rng: np.random.Generator) -> Family:
        """Return the equivalent numbers of independent tests of each place's scan and of all places, by a bootstrap.

        Each residual keeps its size and gets a random sign (wild bootstrap: Liu 1988), so that the null distribution has the heavy
        tails of the data, and noise that differs from row to row.
        """
        model, r = self.model, self.model.regressors
        n = len(r.residual)
        leverage = (model.prediction_root**2).sum(axis=0)
        size = model.settled_residual / np.sqrt(np.maximum(1 - leverage, 0.05))
        places = list(dict.fromkeys(r.candidates[m].cause.place for block in self._blocks for m in block.members))
        number = {place: k for k, place in enumerate(places)}
        drawn = [_drawn(rng, n, r.precision, count) for count in np.diff([*range(0, DRAWS, DRAWN_AT_ONCE), DRAWS])]
        signs, pseudo = (np.hstack(part) for part in zip(*drawn, strict=True))
        score, chi2 = model.settled(signs, pseudo, size)
        smallest = np.ones((len(places), DRAWS))
        for block in self._blocks:
            # Of a place's variants with equal degrees of freedom, the one with the largest drop has the smallest p-value.
            keys = np.array([[number[r.candidates[m].cause.place] for m in block.members], block.degrees_of_freedom])
            order = np.lexsort(keys)
            first = np.flatnonzero(np.diff(keys[:, order], axis=1, prepend=-1).any(axis=0))
            place, spent = keys[:, order[first]]
            for start in range(0, DRAWS, DRAWN_AT_ONCE):
                part = slice(start, start + DRAWN_AT_ONCE)
                whitened = block.roots @ score[block.columns, part]
                largest = np.maximum.reduceat((whitened**2).sum(axis=1)[order], first, axis=0)
                p = f_test(largest, chi2[part], spent, n)  # priors are drawn too: nothing is lost
                np.minimum.at(smallest[:, part], place, p)
        scans = np.array([worth(row) for row in smallest])
        adjusted = -np.expm1(scans[:, None] * np.log1p(-np.minimum(smallest, 1 - 1e-16)))
        tests = worth(adjusted.min(axis=0)) if places else 1.0
        return Family(dict(zip(places, scans, strict=True)), tests, MATERIAL * r.posed)


@dataclass(frozen=True)
class Screening(ScoreTests[H]):
    """Score tests of all candidates against a model's residual."""

    regressors: Regressors[H]

    @property
    def model(self) -> Screening[H]:
        """The model itself."""
        return self

    @cached_property
    def tested(self) -> np.ndarray:
        """The indices of all candidates."""
        return np.arange(len(self.regressors.candidates))

    @property
    def linear(self) -> Regressors[H]:
        """The model's own regressors."""
        return self.regressors

    @cached_property
    def stacks(self) -> list[Stack]:
        """All candidates, by their numbers of columns."""
        r, stacks = self.regressors, []
        sizes = np.array([len(candidate.columns) for candidate in r.candidates])
        for d in np.unique(sizes):
            members = np.flatnonzero(sizes == d)
            columns = np.array([r.candidates[m].columns for m in members])
            whole, imitated = self._products.own[columns, :d], self.projected[:, columns].transpose(1, 0, 2)
            sd = r.prior_sd[columns]
            moved = np.maximum(np.einsum("mii,mi->m", whole, sd**2), np.finfo(float).tiny)
            bounds = np.array([r.candidates[m].cause.bounds for m in members])
            s = whole - imitated.transpose(0, 2, 1) @ imitated
            stacks.append(Stack(members, columns, sd, moved, s, bounds))
        return stacks

    def changed(self, columns: np.ndarray) -> float:
        """Return zero: the stacks are its own."""
        return 0.0

    def score_of(self, columns: np.ndarray) -> np.ndarray:
        """Return the score u of columns (n_members, d)."""
        return np.asarray(self.score[columns])

    @cached_property
    def _factor(self) -> np.ndarray:
        """Cholesky factor of the model's information, priors included."""
        r = self.regressors
        return np.linalg.cholesky(r.jacobian.T @ r.jacobian + np.diag(r.precision))

    @cached_property
    def _products(self) -> RegressorProducts:
        """The products of the regressors that tests need."""
        return RegressorProducts.of(self.regressors, self.prediction_root, self.settled_residual)

    @property
    def projected(self) -> np.ndarray:
        """Projection of the regressors on the model's Jacobian, in whitened coordinates (n_free, n_columns)."""
        return self._products.projected

    @cached_property
    def _gradient(self) -> np.ndarray:
        """Gradient of the fit's objective in the same coordinates; zero at an optimum."""
        r = self.regressors
        return np.asarray(scipy.linalg.solve_triangular(self._factor, r.jacobian.T @ r.residual + r.pull, lower=True))

    @cached_property
    def step(self) -> np.ndarray:
        """Newton step of the free parameters, a background's amplitudes among them, (n_free,)."""
        return np.asarray(-scipy.linalg.solve_triangular(self._factor.T, self._gradient, lower=False))

    @property
    def change(self) -> np.ndarray:
        """Newton step of the model's free parameters."""
        return np.delete(self.step, self.regressors.random)

    @cached_property
    def settled_residual(self) -> np.ndarray:
        """Residual after the Newton step, (n,)."""
        return np.asarray(self.regressors.residual + self.regressors.jacobian @ self.step)

    @cached_property
    def prediction_root(self) -> np.ndarray:
        """A root R (n_free, n) of the covariance RᵀR of the predicted residuals."""
        return np.asarray(scipy.linalg.solve_triangular(self._factor, self.regressors.jacobian.T, lower=True))

    def root_covariance(self, parameters: np.ndarray) -> np.ndarray:
        """Return a root R (n_free, n) of the covariance RᵀR of some free parameters, given by indices."""
        picked = np.eye(len(self._factor))[:, parameters]
        return np.asarray(scipy.linalg.solve_triangular(self._factor, picked, lower=True))

    @property
    def score(self) -> np.ndarray:
        """Score u of all columns, (n_columns,)."""
        return self._products.score

    @cached_property
    def chi2(self) -> float:
        """Chi² of the model, priors included, after a Newton step of its parameters."""
        r = self.regressors
        return float(r.residual @ r.residual + r.prior_rss - self._gradient @ self._gradient)

    def information(self, columns: np.ndarray) -> np.ndarray:
        """Return S between some columns, shape (n_columns, n_columns)."""
        imitated = self.projected[:, columns]
        return np.asarray(self.regressors.matrix.products(columns) - imitated.T @ imitated)

    def response(self, columns: np.ndarray) -> np.ndarray:
        """Return S between all columns and some, the change of u by their amplitudes, shape (n_columns, n_own)."""
        shown = self.regressors.matrix.response(columns)
        return np.asarray(shown - self.projected.T @ self.projected[:, columns])

    def settled(
        self, residual: np.ndarray, pull: np.ndarray, size: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return u (n_columns, n_draws) and chi² (n_draws,) of residuals (n, n_draws) with the priors' pull (n_free, n_draws).

        If size (n,) is given residuals are multiplied by it, so that draws can be signs, which take little memory.
        """
        r, size = self.regressors, np.ones(len(residual)) if size is None else size
        steps = [slice(start, start + DRAWN_AT_ONCE) for start in range(0, residual.shape[1], DRAWN_AT_ONCE)]
        score, chi2 = np.zeros((r.matrix.shape[1], residual.shape[1])), (pull**2 / r.precision[:, None]).sum(axis=0)
        gradient = np.asarray(scipy.linalg.solve_triangular(self._factor, pull, lower=True))
        for draws in steps:
            drawn = size[:, None] * residual[:, draws]
            gradient[:, draws] += self.prediction_root @ drawn
            chi2[draws] += (drawn**2).sum(axis=0)
        for rows, x in r.matrix.blocks():
            predicts = self.prediction_root[:, rows].T
            for draws in steps:
                score[:, draws] += x.T @ (size[rows, None] * residual[rows, draws] - predicts @ gradient[:, draws])
        return score, chi2 - (gradient**2).sum(axis=0)

    def imitation(self, columns: np.ndarray) -> np.ndarray:
        """Return the change of the model's free parameters by a unit of some columns, (n, n_columns)."""
        change = -scipy.linalg.solve_triangular(self._factor.T, self.projected[:, columns], lower=False)
        return np.delete(change, self.regressors.random, axis=0)

    def amplitudes(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the posterior probabilities of SIZES (n_sizes,) of some columns, if they act, and for each their amplitudes.

        Means are of shape (n_sizes, n), covariances (n_sizes, n, n).
        """
        sd = self.regressors.prior_sd[columns]
        shown, score = self.information(columns) * np.outer(sd, sd), sd * self.score[columns]
        fallen, narrowed = explained(*directions(shown, score))
        logs = log_likelihood(fallen / self.chi2, narrowed, self.degrees_of_freedom) + LOG_PRIOR
        covariance = np.linalg.inv(shown + np.eye(len(columns)) / SIZES[:, None, None] ** 2)
        return scipy.special.softmax(logs), -sd * (covariance @ score), covariance * np.outer(sd, sd)

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Residual degrees of freedom: number of residuals less that of the effective parameters, a background's left out."""
        r, fixed = self.regressors, self.fixed
        of_priors = self.fixed_root * np.sqrt(r.precision[fixed])
        return float(len(r.residual) - len(fixed) + (of_priors**2).sum())

    @cached_property
    def fixed(self) -> np.ndarray:
        """The indices of the free parameters that are no amplitudes of a background."""
        return np.setdiff1d(np.arange(len(self.regressors.precision)), self.regressors.random)

    @cached_property
    def fixed_root(self) -> np.ndarray:
        """A root R (n_free, n_fixed) of their covariance RᵀR."""
        return self.root_covariance(self.fixed)

    @property
    def narrowed(self) -> float:
        """Log-determinant of the model's information over its priors': the parameters' Occam factor, minus twice its log."""
        return float(2 * np.log(self._factor.diagonal()).sum() - np.log(self.regressors.precision).sum())


def f_test(
    drops: np.ndarray, chi2: float | np.ndarray, spent: np.ndarray, total: float, freedom: np.ndarray | None = None
) -> np.ndarray:
    """Return the p-values of F tests of drops (n_members, …) of chi² (…), which has total degrees of freedom.

    spent (n_members,) are each member's degrees of freedom, freedom (n_members,) those of the denominator's variance, by default
    all that are left.
    """
    degrees_of_freedom = spent.reshape(-1, *[1] * (drops.ndim - 1))
    left = np.maximum(total - degrees_of_freedom, 1.0)
    ratio = drops / degrees_of_freedom / (np.maximum(chi2 - drops, 1e-12 * chi2) / left)
    return np.asarray(scipy.special.fdtrc(degrees_of_freedom, left if freedom is None else freedom, ratio))


def _drawn(rng: np.random.Generator, n: int, precision: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random signs (n, count) of n residuals, and the pull (n_free, count) of priors of a precision (n_free,)."""
    signs = rng.choice(np.array([-1, 1], dtype=np.int8), (n, count))
    return signs, np.sqrt(precision)[:, None] * rng.standard_normal((len(precision), count))


def by_place(scores: Sequence[Score[H]]) -> dict[Place, tuple[float, Score[H]]]:
    """Return each place's cost, its variants' evidence averaged, and its best score."""
    groups: dict[Place, list[Score[H]]] = {}
    for score in scores:
        groups.setdefault(score.cause.place, []).append(score)
    return {
        place: (-2 * float(np.logaddexp.reduce([-score.cost / 2 for score in members])), min(members, key=lambda one: one.cost))
        for place, members in groups.items()
    }  # fmt: skip


def place_probabilities(places: Mapping[Place, tuple[float, Score]]) -> dict[Place, float]:
    """Return each place's probability against the others and none, which is a priori as probable as all places together."""
    logs = [-cost / 2 for cost, _ in places.values()]
    return dict(zip(places, scipy.special.softmax([*logs, np.log(max(len(places), 1))]).tolist(), strict=False))
