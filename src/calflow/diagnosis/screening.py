"""Screening: score tests of all causes of a catalogue against the residual of a fitted model, from one Jacobian.

A linear model is swept for tests beside it without some of its parameters, and with candidates as further ones (Goodnight 1979).
Nothing is factored again. With C the covariance RᵀR of the parameters that leave, W = R⁻ᵀ times their response to the candidates,
and h likewise of the way from where they would be to zero, S grows by WᵀW, u by Wᵀh and chi² by hᵀh. Parameters that come lower
them in the same manner.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic

import numpy as np
import scipy

from calflow.diagnosis.linear_model import DRAWN_AT_ONCE, LinearModel, Stack
from calflow.diagnosis.regressors import Candidate, H, Place, Regressors
from calflow.effects import Effect, catalogue, effect_class
from calflow.estimation.forward_substitution import forward
from calflow.estimation.prior_scale import on_likeliest_scale
from calflow.estimation.variance_components import explained, log_likelihood, mixed
from calflow.measurements.measurements import Measurements

# Level of the smallest p-value at which the bootstrap determines the equivalent number of tests.
BOOTSTRAP_SIGNIFICANCE = 0.05
MATERIAL = 0.01  # share of chi² that a cause must explain: thousands of poses also show effects too small to matter
INVISIBLE = 0.25  # least chi² of a direction at one prior standard deviation for it to be testable
DRAWS = 1000  # bootstrap draws


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
        return self.candidate.cause


def f_threshold(
    false_alarm: float, tests: float | np.ndarray, degrees_of_freedom: int | np.ndarray, left: float | np.ndarray
) -> np.ndarray:
    """Return the ratios (…) beyond which F tests, of equivalent numbers (…), are significant at the family's false_alarm."""
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


@dataclass(frozen=True, eq=False)
class _Tested(Stack):
    """Candidates of a stack beside the model that they are tested beside; information (n_members, d, d) is S beside that.

    roots (n_members, d, d): whitening of scores to independent standard normals, zero in directions that the data cannot show;
    value (n_members, d): information of these directions over the prior's, zero likewise.
    """

    roots: np.ndarray
    value: np.ndarray

    @staticmethod
    def of(stack: Stack) -> _Tested:
        """Return those candidates of a stack that the data show."""
        values, vectors = np.linalg.eigh(stack.information * stack.sd[:, :, None] * stack.sd[:, None, :])
        shown = values > INVISIBLE
        normal = vectors * np.where(shown, np.abs(values) + 1e-300, np.inf)[:, None, :] ** -0.5
        roots = normal.transpose(0, 2, 1) * stack.sd[:, None, :]
        return _Tested(**vars(stack), roots=roots, value=np.where(shown, values, 0.0)).only(
            np.flatnonzero(shown.any(axis=1))
        )

    @cached_property
    def degrees_of_freedom(self) -> np.ndarray:
        return np.asarray(np.count_nonzero(self.value, axis=1))

    @cached_property
    def share(self) -> np.ndarray:
        """Visible share of each candidate, (n_members,)."""
        return np.sqrt(np.maximum(np.einsum("mii,mi->m", self.information, self.sd**2), 0.0) / self.moved)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (n_members, d, d) of the parameters, priors included."""
        prior = np.eye(self.sd.shape[1]) * self.sd[:, None, :] ** -2.0
        return np.asarray(np.linalg.inv(self.information + prior))


@dataclass(frozen=True, eq=False)
class _Evaluated:
    """A stack's candidates evaluated for draws of their scores, (n_members, n_draws) each.

    squared: reduction of chi² without priors and bounds; drops: the same with them; cost: minus twice the log evidence; estimate
    (n_members, d, n_draws): of the parameters.
    """

    squared: np.ndarray
    drops: np.ndarray
    cost: np.ndarray
    estimate: np.ndarray


@dataclass(frozen=True, eq=False)
class Screening(Generic[H]):
    """Score tests of some candidates against the residual of a linear model that is swept.

    some: indices of the candidates; gone: of the whole model's free parameters that leave it, with their estimates value; come:
    columns of the regressors that become parameters.
    """

    whole: LinearModel[H]
    some: np.ndarray
    gone: np.ndarray
    value: np.ndarray
    come: np.ndarray

    @staticmethod
    def of(regressors: Regressors[H]) -> Screening[H]:
        """Return the tests of all candidates beside a model as it is."""
        none = np.zeros(0, dtype=int)
        return Screening(LinearModel(regressors), np.arange(len(regressors.candidates)), none, np.zeros(0), none)

    @cached_property
    def model(self) -> LinearModel[H]:
        """The swept model, factored anew."""
        if not len(self._sign):
            return self.whole
        whole = self.whole.regressors
        columns = whole.matrix.only(self.come).times(np.eye(len(self.come)))
        less = whole.without(self.gone, self.value)
        return LinearModel(less.with_parameters(columns, whole.prior_sd[self.come] ** -2.0))

    @property
    def _candidates(self) -> tuple[Candidate[H], ...]:
        return self.whole.regressors.candidates

    @cached_property
    def variants(self) -> dict[Place, int]:
        return dict(Counter(self._candidates[k].cause.place for k in self.some.tolist()))

    @cached_property
    def _stacks(self) -> list[_Tested]:
        beside = []
        for stack in self.whole.stacks:
            there = stack.only(np.flatnonzero(np.isin(stack.members, self.some)))
            rows = self._rows[:, there.columns - self._span.start].transpose(1, 2, 0)
            swept = rows @ (self._sign[:, None] * rows.transpose(0, 2, 1))
            beside.append(_Tested.of(replace(there, information=there.information + swept)))
        return [stack for stack in beside if len(stack.members)]

    def _score_of(self, columns: np.ndarray) -> np.ndarray:
        """Return the score u of columns (n_members, d)."""
        moved = np.tensordot(self._sign * self._way, self._rows[:, columns - self._span.start], 1)
        return np.asarray(self.whole.score[columns] + moved)

    def _places(self, stack: Stack) -> list[Place]:
        return [self._candidates[member].cause.place for member in stack.members]

    @cached_property
    def scores(self) -> list[Score[H]]:
        """Every visible candidate's score, best first."""
        scores = list[Score[H]]()
        for stack in self._stacks:
            left = self.degrees_of_freedom - stack.degrees_of_freedom
            if (freedom := self.whole.regressors.amplitude_freedom) is not None:
                # The median serves few columns, which are alike, and many, of which no single one matters.
                left = np.minimum(np.median(freedom[stack.columns], axis=1), left)
            left = np.maximum(left, 1.0)
            weighed = self._weighed(stack, self._score_of(stack.columns)[:, :, None], np.array([self.chi2]))
            p = f_test(weighed.squared[:, 0], self.chi2, stack.degrees_of_freedom, self.degrees_of_freedom, left)
            drops = weighed.drops[:, 0]
            columns = (
                [self._candidates[member] for member in stack.members],
                *(figure.tolist() for figure in (drops, drops / self.chi2, p, weighed.cost[:, 0], stack.share)),
                weighed.estimate[:, :, 0],
                stack.covariance,
                stack.information,
                *(number.tolist() for number in (stack.degrees_of_freedom, left)),
            )
            scores += map(Score, *columns)
        return sorted(scores, key=lambda score: score.cost)

    def _weighed(self, stack: _Tested, score: np.ndarray, chi2: np.ndarray) -> _Evaluated:
        """Evaluate a stack's candidates for scores (n_members, d, n_draws), given the model's chi² (n_draws,)."""
        squared = (stack.roots @ score) ** 2
        estimate = -stack.covariance @ score
        inside = np.clip(estimate, stack.bounds[:, 0, :, None], stack.bounds[:, 1, :, None])
        beyond = estimate - inside
        against_priors = (stack.sd[..., None] ** -2.0 * beyond**2).sum(axis=1)
        lost = (beyond * (stack.information @ beyond)).sum(axis=1) + against_priors
        shrunk = stack.value / (stack.value + 1)
        drops = np.maximum((squared * shrunk[..., None]).sum(axis=1) - lost, 0.0)
        fallen, narrowed = explained(squared.transpose(0, 2, 1), stack.value[:, None, :])
        logs = log_likelihood((fallen - lost) / chi2, narrowed, self.degrees_of_freedom)
        cost = -2 * mixed(logs) + 2 * np.log([self.variants[place] for place in self._places(stack)])[:, None]
        # Evidence uses the same degrees of freedom for all rivals; those of each enter its p-value.
        return _Evaluated(squared.sum(axis=1), drops, cost, inside)

    def trials(
        self, score: np.ndarray, chi2: np.ndarray, family: Family, false_alarm: float
    ) -> dict[Place, tuple[np.ndarray, np.ndarray]]:
        """Test all visible candidates at once for scores (n_columns, n_draws), given the model's chi² (n_draws,).

        Return each place's cost (n_draws,), its variants' evidence averaged, and whether any variant passes (n_draws,).
        """
        variants: dict[Place, list[tuple[np.ndarray, np.ndarray]]] = {}
        for stack in self._stacks:
            weighed, spent = self._weighed(stack, score[stack.columns], chi2), stack.degrees_of_freedom
            places = self._places(stack)
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
        places = list(dict.fromkeys(place for stack in self._stacks for place in self._places(stack)))
        number = {place: k for k, place in enumerate(places)}
        drawn = [_drawn(rng, n, r.precision, count) for count in np.diff([*range(0, DRAWS, DRAWN_AT_ONCE), DRAWS])]
        signs, pseudo = (np.hstack(part) for part in zip(*drawn, strict=True))
        score, chi2 = model.settled(signs, pseudo, size)
        smallest = np.ones((len(places), DRAWS))
        for stack in self._stacks:
            # Of a place's variants with equal degrees of freedom, the one with the largest drop has the smallest p-value.
            keys = np.array([[number[place] for place in self._places(stack)], stack.degrees_of_freedom])
            order = np.lexsort(keys)
            first = np.flatnonzero(np.diff(keys[:, order], axis=1, prepend=-1).any(axis=0))
            place, spent = keys[:, order[first]]
            for start in range(0, DRAWS, DRAWN_AT_ONCE):
                part = slice(start, start + DRAWN_AT_ONCE)
                whitened = stack.roots @ score[stack.columns, part]
                largest = np.maximum.reduceat((whitened**2).sum(axis=1)[order], first, axis=0)
                p = f_test(largest, chi2[part], spent, n)  # priors are drawn too: nothing is lost
                np.minimum.at(smallest[:, part], place, p)
        scans = np.array([worth(row) for row in smallest])
        adjusted = -np.expm1(scans[:, None] * np.log1p(-np.minimum(smallest, 1 - 1e-16)))
        tests = worth(adjusted.min(axis=0)) if places else 1.0
        return Family(dict(zip(places, scans, strict=True)), tests, MATERIAL * r.posed)

    @cached_property
    def chi2(self) -> float:
        return self.whole.chi2 + float(self._sign @ self._way**2)

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Residual degrees of freedom of the swept model."""
        whole = self.whole
        stay = np.flatnonzero(~np.isin(whole.fixed, self.gone))
        root, precision = whole.fixed_root[:, stay], whole.regressors.precision[whole.fixed[stay]]
        # A covariance is minus what S is of a parameter, of which no residuals tell beside itself.
        variance = (root**2).sum(axis=0) - self._sign @ self._swept(root, np.zeros((len(self.come), len(stay)))) ** 2
        inverse = forward(self._factor, np.eye(len(self.come)))
        of_come = (inverse**2).sum(axis=0) @ self.whole.regressors.prior_sd[self.come] ** -2.0
        return float(len(whole.regressors.residual) - len(stay) - len(self.come) + precision @ variance + of_come)

    @cached_property
    def _root(self) -> np.ndarray:
        """R⁻ᵀ times a root of the covariance of the parameters that leave, orthonormal rows (n_gone, n_free)."""
        return np.asarray(np.linalg.qr(self.whole.root_covariance(self.gone))[0].T)

    @cached_property
    def _taken(self) -> np.ndarray:
        """What these rows are of the columns that come, (n_gone, n_come)."""
        return np.asarray(self._root @ self.whole.projected[:, self.come])

    @cached_property
    def _factor(self) -> np.ndarray:
        """Cholesky factor of the information, priors included, on the parameters that come."""
        prior = np.diag(self.whole.regressors.prior_sd[self.come] ** -2.0)
        return np.linalg.cholesky(self.whole.information(self.come) + self._taken.T @ self._taken + prior)

    def _swept(self, projected: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """Return the rows W of columns, of parameters that leave and that come, (n_gone + n_come, n).

        projected (n_free, n): their projections on the whole model; shown (n_come, n): their products with the columns that come.
        """
        out = self._root @ projected
        beside = shown - self.whole.projected[:, self.come].T @ projected + self._taken.T @ out
        return np.vstack([out, forward(self._factor, beside)])

    @cached_property
    def _span(self) -> slice:
        """The columns from the first to the last that are tested."""
        columns = [self.whole.regressors.candidates[k].columns for k in self.some]
        return slice(min((c[0] for c in columns), default=0), max((c[-1] + 1 for c in columns), default=0))

    @cached_property
    def _rows(self) -> np.ndarray:
        """The rows W of these columns."""
        shown = self.whole.regressors.matrix.response(self.come) if len(self.come) else np.zeros((self._span.stop, 0))
        return self._swept(self.whole.projected[:, self._span], shown[self._span].T)

    @cached_property
    def _sign(self) -> np.ndarray:
        """1 for each parameter that leaves, -1 for each that comes."""
        return np.repeat([1.0, -1.0], [len(self.gone), len(self.come)])

    @cached_property
    def _way(self) -> np.ndarray:
        """The same of the residual, h."""
        triangle = np.linalg.qr(self.whole.root_covariance(self.gone))[1]
        out = forward(triangle.T, -self.value - self.whole.step[self.gone])
        score = self.whole.score[self.come] + self._taken.T @ out
        return np.concatenate([out, forward(self._factor, score)])


def f_test(
    drops: np.ndarray, chi2: float | np.ndarray, spent: np.ndarray, total: float, freedom: np.ndarray | None = None
) -> np.ndarray:
    """Return the p-values of F tests of drops (n_members, …) of chi² (…) of total freedom, of which each spent some (n_members,).

    freedom (n_members,) is that of the denominator's variance, by default all that is left.
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
