"""Variance components: the sizes of random functions beside a linearised model, by restricted likelihood.

What the model leaves is white noise and functions of normal amplitudes, those of a part with one variance. The model's own
parameters are integrated out (Patterson and Thompson 1971), so that only what they cannot imitate counts. Variances grow and shrink
by the ratio of what is seen to what is expected; a part is taken in where that ratio is beyond chance (a score test) and the
likelihood gains by it. Of a part whose functions the parameters imitate but for a little the likelihood hardly limits the size: a
half-normal prior does (Gelman 2006), by which all functions of a part together are about of the usual size of one. What is promised
goes by mean variances, over all that the data allow: likeliest ones, taken for known, promise too much (Kass and Steffey 1989).

Evidence: how much more likely amplitudes make the data, whatever their size, in closed form on a linearised model. Before the data
they are normal about zero, and how large nobody knows: their standard deviations are those that a cause declares times one of
SIZES, the usual ones alike and larger ones the rarer the larger they are. Such a mixture has the tails of a Cauchy distribution
(as Jeffreys 1961 asks of a test), so that a catalogue's usual sizes may be ten times too wide and a file may hold a gross
mistake. Amplitudes are integrated out (Kass and Raftery 1995): neither the number of rows nor that of a cause's parameters counts
for itself, as they do in BIC, but how much the data narrow them down.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

SIZE_STEPS = 30  # of the sizes
SETTLED = 0.03  # relative change of the sizes' squares below which they stay
PROMISING = 1.0  # standard deviations beyond what is expected, from which a part is tried
GONE = 1e-6  # of a function's variance: nothing
NOTHING = 1e-12  # of what functions show: what is less is rounding
LEAST_LEFT = 1e-12  # of chi²
USUAL = 0.1  # variance of each function, over its usual one, by which some dozens together are as large as one
BELIEVED = 3.0  # in twice the logarithm of the likelihood: what a part must add to be kept
SIZES = 0.5 ** np.arange(-3.0, 6.0)  # over the usual size: from eight times to a thirtieth
LOG_PRIOR = np.log(np.minimum(1.0, 1 / SIZES)) - np.log(np.minimum(1.0, 1 / SIZES).sum())
HALF_NORMAL = np.exp(-(SIZES**2) / 2)
PRIOR = HALF_NORMAL / HALF_NORMAL.sum()  # of SIZES, over USUAL's: alike, but for that


@dataclass(frozen=True, eq=False)
class VarianceComponents:
    """The likelihood of the variances of random functions, over the noise's, beside a linearised model.

    part (n_functions,) is the number of each function's part, of n_parts. gram (n_functions, n_functions) is what functions show of
    each other beside the model's own parameters, score (n_functions,) what the residual shows of them; chi2 is what the model
    leaves, with total degrees of freedom. The noise's variance is at least floor, over what the residuals were whitened by.
    """

    part: np.ndarray
    n_parts: int
    gram: np.ndarray
    score: np.ndarray
    chi2: float
    total: float
    floor: float = 0.0

    def beside(self, variance: np.ndarray) -> FunctionsBeside:
        """Put functions of these variances (n_parts,) beside the model, by those that act alone (Woodbury 1950)."""
        here = np.flatnonzero(variance[self.part] > 0)
        size = np.sqrt(variance[self.part[here]])
        whole = self.gram[np.ix_(here, here)]
        whole *= size[:, None]
        whole *= size
        whole[np.diag_indices(len(here))] += 1.0
        factor = _factor(whole)
        along = scipy.linalg.solve_triangular(factor, size * self.score[here], lower=True)
        return FunctionsBeside(here, size, factor, along, max(self.chi2 - float(along @ along), LEAST_LEFT))

    def level(self, variance: np.ndarray) -> float:
        """Return the variance of the white noise that is left, over what the residuals were whitened by."""
        return float(self.level_of(self.beside(variance).chi2))

    def level_of(self, chi2: np.ndarray | float) -> np.ndarray:
        """The same where so much of chi² is left."""
        return np.maximum(np.maximum(chi2, LEAST_LEFT) / self.total, self.floor)

    def cost(self, variance: np.ndarray) -> float:
        """Twice minus the logarithm of the restricted likelihood and of the prior, the noise's level at its best."""
        beside = self.beside(variance)
        return float(self.cost_of_noise(beside.chi2) + beside.log_determinant + variance.sum() / USUAL)

    def cost_of_noise(self, chi2: np.ndarray | float) -> np.ndarray:
        """The part of that which white noise alone has, where so much of chi² is left."""
        level = self.level_of(chi2)
        return np.asarray(self.total * np.log(level) + chi2 / level - self.total)

    def most_likely(self, variance: np.ndarray) -> np.ndarray:
        """Return the variances (n_parts,) of the greatest posterior density, from these; zero stays zero."""
        for _ in range(SIZE_STEPS):
            beside = self.beside(variance)
            seen = self._by_part(beside.mean**2, beside.here) / self.level_of(beside.chi2)
            expected = self._by_part(beside.told, beside.here)
            grown = variance * seen / np.maximum(expected + variance / USUAL, 1e-300)
            settled = np.allclose(grown, variance, rtol=SETTLED, atol=GONE)
            variance = np.where(grown < GONE, 0.0, grown)
            if settled:
                break
        return variance

    def believed(self, without: np.ndarray | None = None) -> np.ndarray:
        """Return the most likely variances (n_parts,), part by part while one adds enough to be believed.

        Some parts (n_parts,) may be left out.
        """
        variance = np.zeros(self.n_parts)
        left_out = np.zeros(self.n_parts, dtype=bool) if without is None else without
        untried = {k for k in range(self.n_parts) if not left_out[k]}
        cost, apart = self.cost(variance), self._apart(variance, untried)
        # Once each: parts much alike would come and go.
        while untried and apart[best := max(untried, key=lambda k: apart[k].beyond)].beyond >= PROMISING:
            untried.remove(best)
            larger = variance.copy()
            larger[best] = apart[best].growth
            larger = self.most_likely(larger)
            if cost - (less := self.cost(larger)) >= BELIEVED:
                variance, cost, apart = larger, less, self._apart(larger, untried)
        for k in np.flatnonzero(variance > 0):
            fewer = np.where(np.arange(len(variance)) == k, 0.0, variance)
            if self.cost(fewer) - cost < BELIEVED:
                variance = self.most_likely(fewer)
                cost = self.cost(variance)
        return variance

    def expected(self, variance: np.ndarray) -> np.ndarray:
        """Return each part's mean variance (n_parts,) over all that the data allow, beside the others of these variances.

        That there is any part is as likely before the data as not, each part alike, and each size but for the half-normal. Beside
        functions of mean variances, not of the likeliest ones, standard deviations are those of everything together: of a Student t
        about 95 % lie within 1.96 of its own, were it of three degrees of freedom or of very many.
        """
        parts = self._apart(variance, range(self.n_parts))
        for k in map(int, np.flatnonzero(variance > 0)):
            parts |= self._apart(np.where(np.arange(self.n_parts) == k, 0.0, variance), [k])
        return np.array([parts[k].mean for k in range(self.n_parts)])

    def degrees_of_freedom(self, variance: np.ndarray) -> np.ndarray:
        """Return how well each part's variance is known, shape (n_parts,): that of as many squares of normals."""
        beside = self.beside(variance)
        part = self.part[beside.here]
        projector = np.eye(len(part)) - beside.root.T @ beside.root
        determined = np.where(part[:, None] == part, projector, 0.0) ** 2
        return np.maximum(self._by_part(determined.sum(axis=1), beside.here), 1.0)

    def _by_part(self, values: np.ndarray, here: np.ndarray) -> np.ndarray:
        """Sums over the functions of each part (n_parts,) of values (n,), those of the functions of these numbers."""
        return np.bincount(self.part[here], values, self.n_parts)

    def _apart(self, variance: np.ndarray, parts: Iterable[int]) -> dict[int, _Apart]:
        """Return what is seen of each of some parts beside functions of these variances (n_parts,)."""
        beside, apart = self.beside(variance), dict[int, _Apart]()
        for k in parts:
            i = np.flatnonzero(self.part == k)
            taken = scipy.linalg.solve_triangular(
                beside.factor, beside.size[:, None] * self.gram[np.ix_(beside.here, i)], lower=True
            )
            gram, score = self.gram[np.ix_(i, i)] - taken.T @ taken, self.score[i] - taken.T @ beside.along
            apart[k] = _Apart(gram, score, beside.chi2, self)
        return apart


@dataclass(frozen=True, eq=False)
class FunctionsBeside:
    """Functions of some variances beside a model.

    here (n,) are their numbers, size (n,) their sizes, factor (n, n) the lower triangular factor of I + what they show of each
    other at these sizes, along (n,) what the residual shows of them, in its coordinates; chi2 is what is left.
    """

    here: np.ndarray
    size: np.ndarray
    factor: np.ndarray
    along: np.ndarray
    chi2: float

    @property
    def log_determinant(self) -> float:
        """That of I + what they show of each other."""
        return 2 * float(np.log(self.factor.diagonal()).sum())

    @cached_property
    def root(self) -> np.ndarray:
        """A root (n, n) of their amplitudes' covariance: its transpose times itself."""
        return np.asarray(scipy.linalg.lapack.dtrtri(self.factor, lower=1)[0]) if len(self.here) else self.factor

    @property
    def mean(self) -> np.ndarray:
        """What the residual says of their amplitudes, over their sizes, (n,)."""
        return np.asarray(self.root.T @ self.along)

    @property
    def told(self) -> np.ndarray:
        """What the data take of each amplitude's variance, over what it was before, (n,)."""
        return np.asarray(1 - np.einsum("ij,ij->j", self.root, self.root))


def _factor(positive: np.ndarray) -> np.ndarray:
    """Return the lower triangular factor of a matrix (n, n) that is not less than I, but for rounding."""
    factor, failed = scipy.linalg.lapack.dpotrf(positive.T, lower=1) if len(positive) else (positive, 0)
    if failed:
        value, axes = np.linalg.eigh(positive)
        factor = np.linalg.cholesky((axes * np.maximum(value, 1.0)) @ axes.T)
    return np.asarray(factor)


@dataclass(frozen=True, eq=False)
class _Apart:
    """What a part's functions (n,) show beside all else: of each other, gram (n, n), and the residual of them.

    chi2 is what is left without them, of all that the components are of.
    """

    gram: np.ndarray
    score: np.ndarray
    chi2: float
    of: VarianceComponents

    @property
    def _information(self) -> float:
        """Twice what the data know of the variance, about none."""
        return float(max(np.vdot(self.gram, self.gram), NOTHING))

    @cached_property
    def growth(self) -> float:
        """By how much its variance is to grow, by what is seen more than is expected and the prior asks for less."""
        seen = float(self.score @ self.score / self.of.level_of(self.chi2))
        return (seen - float(np.trace(self.gram)) - 1 / USUAL) / self._information

    @cached_property
    def beyond(self) -> float:
        """That in standard deviations of it."""
        return self.growth / float(np.sqrt(2 / self._information))

    @property
    def mean(self) -> float:
        """The mean variance of its functions, over the usual one, over all of SIZES and none."""
        fallen, narrowed = explained(*directions(USUAL * self.gram, np.sqrt(USUAL) * self.score))
        cost = self.of.cost_of_noise(self.chi2 - fallen) + narrowed
        likelier = np.clip((self.of.cost_of_noise(self.chi2) - cost) / 2, -700, 300)  # than none
        weight = PRIOR * np.exp(likelier) / self.of.n_parts
        return float(weight @ (USUAL * SIZES**2) / (1 + weight.sum()))


def directions(information: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what `explained` asks of amplitudes: squared and value, both (…, n), along the principal axes.

    Args:
        information: what the data know of the amplitudes, in units of their usual sizes, (…, n, n).
        score: the slope of half chi² by them, likewise, (…, n).
    """
    value, axes = np.linalg.eigh(information)
    value = np.maximum(value, np.finfo(float).tiny)
    return np.einsum("...ab,...a->...b", axes, score) ** 2 / value, value


def explained(squared: np.ndarray, value: np.ndarray, sizes: np.ndarray = SIZES) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much chi² falls with amplitudes of each size, and what narrowing them down costs, both (n_sizes, …).

    Args:
        squared: the fall of chi² along each direction of the amplitudes without any prior, (…, n_directions).
        value: what the data know of each direction at the usual size, over the prior, of a shape that spreads over squared.
        sizes: over the usual one, (n_sizes,).
    """
    shrunk = sizes.reshape(-1, *[1] * squared.ndim) ** 2 * value.reshape(
        *[1] * (squared.ndim - value.ndim), *value.shape
    )
    fallen = np.einsum("...d,...d->...", squared, shrunk / (1 + shrunk))  # value is often one of many squared
    return fallen, np.broadcast_to(np.log1p(shrunk).sum(axis=-1), fallen.shape)


def log_likelihood(share: np.ndarray, narrowed: np.ndarray, degrees_of_freedom: float) -> np.ndarray:
    """Return the logarithm of the likelihood with amplitudes over that without them, the noise's level integrated out.

    The noise is told by what the model leaves, which has lost the degrees of freedom of the model's own parameters (O'Hagan and
    Forster 2004): counted are these, not the residuals.

    Args:
        share: by how much of chi² it falls.
        narrowed: what narrowing the amplitudes down costs.
        degrees_of_freedom: of what the model without the amplitudes leaves.
    """
    return np.asarray(-(degrees_of_freedom * np.log1p(-np.minimum(share, 1 - 1e-12)) + narrowed) / 2)


def mixed(logs: np.ndarray) -> np.ndarray:
    """Return the logarithm of a mean over sizes of what has logarithms (n_sizes, …), by what they are before the data."""
    logs = logs + LOG_PRIOR.reshape(-1, *[1] * (logs.ndim - 1))
    most = logs.max(axis=0)
    return np.asarray(most + np.log(np.exp(logs - most).sum(axis=0)))


def size_cost(pulled: float, number: int) -> float:
    """Return -2 log of the prior density at estimates, over that of a standard normal's peak.

    Args:
        pulled: the sum of the squares of the estimates over their usual sizes.
        number: how many there are.
    """
    return float(-2 * mixed(-pulled / SIZES**2 / 2 - number * np.log(SIZES)))
