"""Variance components: the variances of random functions beside a linearised model, by restricted likelihood.

The residual is white noise plus basis functions with normal amplitudes, one variance per part. The model's parameters are
integrated out (Patterson and Thompson 1971). A part is accepted if a score test is significant and the likelihood gains by it.
Where the parameters almost imitate it, the likelihood hardly limits its variance, but a half-normal prior does (Gelman 2006).
Predictions use posterior mean variances: the likeliest make intervals too narrow (Kass and Steffey 1989).

Evidence: the marginal likelihood of amplitudes of unknown size, in closed form on a linearised model. A priori they are normal
about zero with the standard deviations that a cause declares times one of SIZES, up to the usual size with equal probability and
beyond with a probability that falls with size. This mixture has the tails of a Cauchy distribution (as Jeffreys 1961 asks of a
test), so that a catalogue's usual sizes may be ten times too wide and a file may hold a gross mistake. Amplitudes are integrated
out (Kass and Raftery 1995): what counts is how far the data narrow them down, not, as in BIC, the numbers of rows and parameters.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from calflow.estimation.forward_substitution import forward
from calflow.model import side_by_side

SIZE_STEPS = 30  # iterations of the variances
SETTLED = 0.03  # relative change of the variances below which they have converged
PROMISING = 1.0  # score in standard deviations, from which a part is tried
GONE = 1e-6  # variance of a function below which it is zero
ROUNDING = 1e-12  # information below which it is rounding
LEAST_LEFT = 1e-12  # of chi²
USUAL = 0.1  # variance of each function, over its usual one, at which some dozens together are as large as one
ACCEPTED_GAIN = 3.0  # least gain of twice the log-likelihood for a part to be accepted
SIZES = 0.5 ** np.arange(-3.0, 6.0)  # over the usual size: from eight times to a thirtieth
LOG_PRIOR = np.log(np.minimum(1.0, 1 / SIZES)) - np.log(np.minimum(1.0, 1 / SIZES).sum())
HALF_NORMAL = np.exp(-(SIZES**2) / 2)
# Exponent of the evidence for an unnamed error, whose form is itself a guess (tempered likelihood, Grünwald and van Ommen 2017).
TEMPERED = 0.5
PRIOR = HALF_NORMAL / HALF_NORMAL.sum()  # of SIZES, over USUAL's, for the posterior mean of a variance


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The normal equations of residuals r + A x that are linear in coefficients x (n,).

    products (n + 1, n + 1): inner products of the columns of A, and of r as the last; number: of residuals.
    """

    products: np.ndarray
    number: int

    @property
    def gram(self) -> np.ndarray:
        """Gram matrix AᵀA of the coefficients, (n, n)."""
        return self.products[:-1, :-1]

    @property
    def score(self) -> np.ndarray:
        """Gradient Aᵀr of half chi², (n,)."""
        return self.products[:-1, -1]

    @property
    def chi2(self) -> float:
        """Sum of squares rᵀr where all coefficients are zero."""
        return float(self.products[-1, -1])

    def only(self, kept: np.ndarray) -> NormalEquations:
        """Return those of some coefficients, given by indices, the others being zero."""
        kept = np.append(kept, len(self.gram))
        return replace(self, products=self.products[np.ix_(kept, kept)])

    def scaled(self, unit: np.ndarray) -> NormalEquations:
        """Return those of the coefficients in other units (n,)."""
        unit = np.append(unit, 1.0)
        return replace(self, products=unit[:, None] * self.products * unit)

    def over(self, level: float) -> NormalEquations:
        """Return those of residuals whose variance is the level."""
        return replace(self, products=self.products / level)

    def about(self, origin: np.ndarray) -> NormalEquations:
        """Return those of the coefficients less an origin (n,)."""
        products = self.products.copy()
        products[:, -1] += products[:, :-1] @ origin
        products[-1] += origin @ products[:-1]
        return replace(self, products=products)

    def with_prior(self, offset: np.ndarray, precision: np.ndarray) -> NormalEquations:
        """Return those with independent normal priors, offset (n,) being the zero of the coefficients less their prior means."""
        prior = np.diag(np.append(precision, precision @ offset**2))
        prior[:-1, -1] = prior[-1, :-1] = precision * offset
        return replace(self, products=self.products + prior)

    def beside(self, others: np.ndarray) -> NormalEquations:
        """Return those of the remaining coefficients beside others, given by indices, at their best values or integrated out."""
        left = np.setdiff1d(np.arange(len(self.products)), others)
        factor = np.linalg.cholesky(self.products[np.ix_(others, others)])
        imitated = forward(factor, self.products[np.ix_(others, left)])
        return replace(self, products=self.products[np.ix_(left, left)] - imitated.T @ imitated)

    def restricted_likelihood(self, freedom: float) -> tuple[float, float]:
        """Return the likeliest variance of residuals of so much freedom, and minus twice their restricted log-likelihood at it."""
        factor = np.linalg.cholesky(self.gram)
        settled = forward(factor, self.score)
        variance = max(self.chi2 - float(settled @ settled), np.finfo(float).tiny) / freedom
        return variance, float(freedom * np.log(variance) + 2 * np.log(factor.diagonal()).sum())


@dataclass(frozen=True, eq=False)
class VarianceComponents:
    """Restricted likelihood of the variances of random functions, over the noise's, beside a linearised model.

    part (n_functions,): index of each function's part, of n_parts; gram (n_functions, n_functions): Gram matrix of the functions
    projected off the model's Jacobian; score (n_functions,): their products with the residual, likewise; chi2: that of the model,
    with total degrees of freedom; floor: lower bound of the noise's variance, over that by which residuals were whitened.
    """

    part: np.ndarray
    n_parts: int
    gram: np.ndarray
    score: np.ndarray
    chi2: float
    total: float
    floor: float = 0.0

    def posterior(self, variance: np.ndarray) -> FunctionPosterior:
        """Return the posterior of functions with these variances (n_parts,), in those of non-zero variance (Woodbury 1950)."""
        here = np.flatnonzero(variance[self.part] > 0)
        size = np.sqrt(variance[self.part[here]])
        kept = side_by_side(here)
        whole = self.gram[kept][:, kept] * size[:, None]  # rows, then columns: several times as fast as both at once
        whole *= size
        whole[np.diag_indices(len(here))] += 1.0
        factor = _factor(whole)
        along = forward(factor, size * self.score[here])
        return FunctionPosterior(here, size, factor, along, max(self.chi2 - float(along @ along), LEAST_LEFT))

    def level(self, variance: np.ndarray) -> float:
        """Return the variance of the white noise beside the functions, over that by which residuals were whitened."""
        return float(self.level_of(self.posterior(variance).chi2))

    def level_of(self, chi2: np.ndarray | float) -> np.ndarray:
        """Return that variance for a given chi²."""
        return np.maximum(np.maximum(chi2, LEAST_LEFT) / self.total, self.floor)

    def cost(self, variance: np.ndarray) -> float:
        """Return minus twice the log posterior density of the variances, maximised over the noise's level."""
        posterior = self.posterior(variance)
        return float(self.cost_of_noise(posterior.chi2) + posterior.log_determinant + variance.sum() / USUAL)

    def cost_of_noise(self, chi2: np.ndarray | float) -> np.ndarray:
        """Return the white noise's part of it for a given chi²."""
        level = self.level_of(chi2)
        return np.asarray(self.total * np.log(level) + chi2 / level - self.total)

    def most_likely(self, variance: np.ndarray) -> np.ndarray:
        """Return the variances (n_parts,) of maximum posterior density, started from these; zero stays zero."""
        for _ in range(SIZE_STEPS):
            posterior = self.posterior(variance)
            seen = self._by_part(posterior.mean**2, posterior.here) / self.level_of(posterior.chi2)
            expected = self._by_part(posterior.told, posterior.here)
            grown = variance * seen / np.maximum(expected + variance / USUAL, 1e-300)
            settled = np.allclose(grown, variance, rtol=SETTLED, atol=GONE)
            variance = np.where(grown < GONE, 0.0, grown)
            if settled:
                break
        return variance

    def accepted(self, without: Collection[int] = ()) -> np.ndarray:
        """Return the accepted variances (n_parts,) by forward and backward selection of parts, of which some are left out."""
        variance, untried = np.zeros(self.n_parts), set(range(self.n_parts)).difference(without)
        cost, steps = self.cost(variance), self._scoring_steps(variance, untried)
        # Each part is tried once: similar parts would alternate for ever.
        while untried and steps[best := max(untried, key=lambda k: steps[k])][0] >= PROMISING:
            untried.remove(best)
            larger = variance.copy()
            larger[best] = steps[best][1]
            larger = self.most_likely(larger)
            if cost - (less := self.cost(larger)) >= ACCEPTED_GAIN:
                variance, cost, steps = larger, less, self._scoring_steps(larger, untried)
        for k in np.flatnonzero(variance > 0):
            fewer = np.where(np.arange(len(variance)) == k, 0.0, variance)
            if self.cost(fewer) - cost < ACCEPTED_GAIN:
                variance = self.most_likely(fewer)
                cost = self.cost(variance)
        return variance

    def expected(self, variance: np.ndarray) -> np.ndarray:
        """Return each part's posterior mean variance (n_parts,), beside the others at these variances.

        With mean variances instead of the likeliest, standard deviations include the variances' uncertainty: of a Student t about
        95 % lies within 1.96 of its standard deviations, from three degrees of freedom to very many.
        """
        return np.asarray(self.probabilities(variance) @ (USUAL * SIZES**2))

    def drawn(self, variance: np.ndarray, number: int, rng: np.random.Generator) -> np.ndarray:
        """Draw variances (number, n_parts) from the posterior whose mean is `expected`; most are zero where nothing shows."""
        sizes = np.append(USUAL * SIZES**2, 0.0)
        every = (np.append(likely, max(1 - likely.sum(), 0.0)) for likely in self.probabilities(variance))
        return np.array([rng.choice(sizes, number, p=likely) for likely in every]).reshape(self.n_parts, number).T

    def probabilities(self, variance: np.ndarray) -> np.ndarray:
        """Return the posterior probabilities (n_parts, n_sizes) of each part's SIZES over USUAL's; the rest is that of none."""
        parts = self._beside(variance, range(self.n_parts))
        for k in map(int, np.flatnonzero(variance > 0)):
            parts |= self._beside(np.where(np.arange(self.n_parts) == k, 0.0, variance), [k])
        probabilities = np.empty((self.n_parts, len(SIZES)))
        for k, (gram, score, chi2) in parts.items():
            fallen, narrowed = explained(*directions(USUAL * gram, np.sqrt(USUAL) * score))
            likelier = (self.cost_of_noise(chi2) - self.cost_of_noise(chi2 - fallen) - narrowed) / 2  # than none
            # A priori any number of parts is as likely as any other: those found make others likelier (Scott and Berger 2010).
            found = np.count_nonzero(np.delete(variance, k))
            weight = PRIOR * np.exp(np.clip(likelier, -700, 300)) * (1 + found) / (self.n_parts - found)
            probabilities[k] = weight / (1 + weight.sum())
        return probabilities

    def _scoring_steps(self, variance: np.ndarray, parts: Iterable[int]) -> dict[int, tuple[float, float]]:
        """Return the scoring step of some parts' variances from zero, over its standard deviation and as it is.

        It is observed less expected squares and the prior's slope, over twice the Fisher information.
        """
        steps = {}
        for k, (gram, score, chi2) in self._beside(variance, parts).items():
            information = float(max(np.vdot(gram, gram), ROUNDING))
            seen = float(score @ score / self.level_of(chi2))
            step = (seen - float(np.trace(gram)) - 1 / USUAL) / information
            steps[k] = step * float(np.sqrt(information / 2)), step
        return steps

    def degrees_of_freedom(self, variance: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom of each part's variance, shape (n_parts,), as of a mean of squares of normals."""
        posterior = self.posterior(variance)
        part = self.part[posterior.here]
        projector = np.eye(len(part)) - posterior.root.T @ posterior.root
        determined = np.where(part[:, None] == part, projector, 0.0) ** 2
        return np.maximum(self._by_part(determined.sum(axis=1), posterior.here), 1.0)

    def _by_part(self, values: np.ndarray, here: np.ndarray) -> np.ndarray:
        return np.bincount(self.part[here], values, self.n_parts)

    def _beside(self, variance: np.ndarray, parts: Iterable[int]) -> dict[int, tuple[np.ndarray, np.ndarray, float]]:
        """Return Gram matrix (n, n), score (n,), and chi² without it, of parts beside functions of these variances (n_parts,)."""
        posterior, beside = self.posterior(variance), {}
        for k in parts:
            i = np.flatnonzero(self.part == k)
            own = self.gram[i]
            along = (posterior.size * own[:, posterior.here]).T
            taken = forward(posterior.factor, along)
            gram, score = own[:, i] - taken.T @ taken, self.score[i] - taken.T @ posterior.along
            beside[k] = gram, score, posterior.chi2
        return beside


@dataclass(frozen=True, eq=False)
class FunctionPosterior:
    """The posterior of random functions with given variances beside a model.

    here (n,): indices of the functions; size (n,): their standard deviations; factor (n, n): Cholesky factor of I + their Gram
    matrix at these sizes; along (n,): their scaled scores in its coordinates; chi2: what remains beside them.
    """

    here: np.ndarray
    size: np.ndarray
    factor: np.ndarray
    along: np.ndarray
    chi2: float

    @property
    def log_determinant(self) -> float:
        """Log-determinant of I + their Gram matrix."""
        return 2 * float(np.log(self.factor.diagonal()).sum())

    @cached_property
    def root(self) -> np.ndarray:
        """A root R (n, n) of their amplitudes' posterior covariance RᵀR, over the prior variances."""
        return np.asarray(scipy.linalg.lapack.dtrtri(self.factor, lower=1)[0]) if len(self.here) else self.factor

    @property
    def mean(self) -> np.ndarray:
        """Minus the posterior mean of their amplitudes, over their sizes, (n,)."""
        return np.asarray(self.root.T @ self.along)

    @property
    def told(self) -> np.ndarray:
        """Reduction of each amplitude's variance by the data, over the prior variance, (n,)."""
        return np.asarray(1 - np.einsum("ij,ij->j", self.root, self.root))


def _factor(positive: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor of a matrix (n, n) whose eigenvalues are at least 1, but for rounding."""
    factor, failed = scipy.linalg.lapack.dpotrf(positive.T, lower=1) if len(positive) else (positive, 0)
    if failed:
        value, axes = np.linalg.eigh(positive)
        factor = np.linalg.cholesky((axes * np.maximum(value, 1.0)) @ axes.T)
    return np.asarray(factor)


def directions(information: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return squared and value of `explained`, (…, n), of amplitudes' information (…, n, n), in usual sizes, and score (…, n)."""
    value, axes = np.linalg.eigh(information)
    value = np.maximum(value, np.finfo(float).tiny)
    return np.einsum("...ab,...a->...b", axes, score) ** 2 / value, value


def explained(squared: np.ndarray, value: np.ndarray, sizes: np.ndarray = SIZES) -> tuple[np.ndarray, np.ndarray]:
    """Return the reduction of chi² by amplitudes of each of sizes, and the log-determinant of their narrowing, (n_sizes, …).

    squared (…, n_directions) is the reduction along each direction without a prior; value, of a shape that broadcasts to it, the
    information on each at the usual size, over the prior's.
    """
    shrunk = sizes.reshape(-1, *[1] * squared.ndim) ** 2 * value.reshape(
        *[1] * (squared.ndim - value.ndim), *value.shape
    )
    fallen = np.einsum("...d,...d->...", squared, shrunk / (1 + shrunk))  # value is often one of many squared
    return fallen, np.broadcast_to(np.log1p(shrunk).sum(axis=-1), fallen.shape)


def log_likelihood(share: np.ndarray, narrowed: np.ndarray, degrees_of_freedom: float) -> np.ndarray:
    """Return the log Bayes factor of amplitudes that reduce chi² by a share, against none; narrowed as of `explained`.

    The noise's level, of the residual degrees of freedom of the model without them, is integrated out (O'Hagan and Forster 2004).
    """
    return np.asarray(-(degrees_of_freedom * np.log1p(-np.minimum(share, 1 - 1e-12)) + narrowed) / 2)


def mixed(logs: np.ndarray) -> np.ndarray:
    """Return the log of the mean of exp(logs) (n_sizes, …) over SIZES, weighted by their prior."""
    logs = logs + LOG_PRIOR.reshape(-1, *[1] * (logs.ndim - 1))
    most = logs.max(axis=0)
    return np.asarray(most + np.log(np.exp(logs - most).sum(axis=0)))


def spent(amplitudes: np.ndarray, variants: int, scale: float = 1.0) -> float:
    """Return minus twice the log prior of a cause's amplitudes by a refit, beyond that of the normal prior of the fit.

    The prior is over a standard normal's at its peak, and shared by the cause's variants. amplitudes are over the standard
    deviations of the fit's priors, nan at a bound; scale is these over the usual sizes.
    """
    pulled, number, sizes = np.nansum(amplitudes**2), np.isfinite(amplitudes).sum(), SIZES / scale
    of_sizes = -pulled / sizes**2 / 2 - number * np.log(sizes)
    return float(-2 * mixed(of_sizes) - pulled + 2 * np.log(variants))


def refitted_cost(
    chi2: float,
    level: float,
    degrees_of_freedom: float,
    fitted: Sequence[tuple[np.ndarray, int, float]],
    log_determinant: float,
) -> float:
    """Return minus twice the log evidence of a refitted model, comparable with others of the same data.

    The causes' amplitudes are integrated out by Laplace's approximation; one at a bound counts as by BIC (Schwarz 1978).

    Args:
        chi2: that of the model, with the causes' prior terms.
        level: standard deviation by which residuals were divided.
        degrees_of_freedom: residual ones of the model without causes, as in `log_likelihood`.
        fitted: each cause's amplitudes, number of variants and scale, as for `spent`.
        log_determinant: that of the covariance of the amplitudes off their bounds, over the fit's prior variances.
    """
    every = np.concatenate([np.zeros(0), *(amplitudes for amplitudes, *_ in fitted)])
    pulled, held = float(np.nansum(every**2)), np.isnan(every).sum()
    by_prior = sum(spent(*cause) for cause in fitted) + pulled + held * float(np.log(degrees_of_freedom))
    return degrees_of_freedom * float(np.log((chi2 - pulled) * level**2)) + by_prior - log_determinant
