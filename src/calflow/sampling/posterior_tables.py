"""What a chain says: each parameter's posterior, each row's predicted error, and whether the chain is long enough.

The summary of sample: how long the chain is, and whether that is enough.
How much of a parameter's posterior is its prior, and how much the data: power scaling.
The mixture: predictions of all models that may be right, each as often as it is probable.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calflow.estimation.accuracy import distances, errors
from calflow.estimation.parameters import UNIT
from calflow.files.tables import column, typed
from calflow.measurements.measurements import Measurements
from calflow.sampling.sample import ENOUGH_TAU, ChainLength, Sampled


@dataclass(frozen=True, kw_only=True)
class Cut:
    """A parameter whose posterior its bounds cut, so that its quantiles say more than its mean and sd."""

    parameter: str = column("its name")
    unit: str = column("of the bounds (SI)")
    lower: float = column("the least that is allowed")
    upper: float = column("the most that is allowed")


@dataclass(frozen=True, kw_only=True)
class ChainSummary:
    """How sample ended: length and mixing of the chain."""

    steps: int = column("of each walker")
    burn_in_steps: int = column("of these, left out at the start")
    ensembles: int = column("independent ensembles of walkers")
    walkers: int = column("in each ensemble")
    autocorrelation_steps: float | None = column("steps until a walker forgets; null: some never moved")
    acceptance_independent: float | None = column("share of independent proposals that are accepted; null: not used")
    worst_rhat: float = column("the largest R-hat of all parameters")
    smallest_ess: float = column("the smallest effective sample size")
    sd_over_laplace_least: float | None = column(
        "sampled sd over the fit's, the least; null: every parameter is at a bound"
    )
    sd_over_laplace_most: float | None = column("the same, the most")
    missing_steps: int = column("about how many more are needed; 0: long enough")
    cut: tuple[Cut, ...] = column(
        "parameters whose posterior their bounds cut: parameter, unit, lower, upper", default=()
    )


@dataclass(frozen=True, eq=False)
class Mixture:
    """Draws of what may be predicted for some rows.

    errors (n_draws, n_rows, 3) [m] are predicted minus measured lengths, level (n_draws,) the factors on the noise, model
    (n_draws,) the number of the model, from 0, that a draw is of.
    """

    errors: np.ndarray
    level: np.ndarray
    model: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Mean of the errors, (n_rows, 3) [m]."""
        return np.asarray(self.errors.mean(axis=0))

    @property
    def covariance(self) -> np.ndarray:
        """Their covariance, (n_rows, 3, 3) [m²]: what is not known of the parameters, and which model is right."""
        off = self.errors - self.mean
        return np.asarray(np.einsum("dri,drj->rij", off, off) / max(len(off) - 1, 1))

    @property
    def of_choice(self) -> np.ndarray:
        """Share of the variance, over all axes, that is there because another model may be right, (n_rows,)."""
        off = self.errors - self.mean
        means = np.array([off[self.model == k].mean(axis=0) for k in self.model])
        between, whole = (np.nansum(part**2, axis=(0, 2)) for part in (means, off))
        return np.divide(between, whole, out=np.zeros_like(whole), where=whole > 0)


def mixture(sampled: Sampled, data: Measurements, number: int, rng: np.random.Generator) -> Mixture:
    """Draw a model, then its parameters, so many times, and predict the rows.

    Of what was found the chain's draws count, of the others those of their evidence. A cause that was held at its estimates gives
    way to its own rivals as often as these are right: its predictions are shifted as theirs are.
    """
    known, flat = sampled.known, sampled.values.reshape(-1, sampled.values.shape[-1])
    number = min(number, len(flat))
    models, probabilities = sampled.models.models, sampled.models.probabilities
    chosen = np.sort(rng.choice(len(models), size=number, p=probabilities)) if models else np.zeros(number, dtype=int)
    predicted, level = np.empty((number, len(data), 3)), np.empty(number)
    for k in np.unique(chosen):
        own = np.flatnonzero(chosen == k)
        model = models[k].model if k else known.model
        values = models[k].evidence.draws(len(own), rng) if k else flat[rng.choice(len(flat), len(own), replace=False)]
        predicted[own] = [errors(model, value[:-1], data) for value in values]
        level[own] = np.exp(values[:, -1])
    return Mixture(predicted + _shifts(sampled, data, number, rng), level, chosen)


def _shifts(sampled: Sampled, data: Measurements, number: int, rng: np.random.Generator) -> np.ndarray | float:
    """By how much the rivals of what was held shift the predictions, (n_draws, n_rows, 3) [m]; they do not exclude each other."""
    known = sampled.known
    if not known.alternatives:
        return 0.0
    here = errors(known.model, known.estimate, data)
    others = [replace(one.model, given=known.model.given) for one in known.alternatives]
    shifts = np.array(
        [errors(model, one.estimate, data) - here for model, one in zip(others, known.alternatives, strict=True)]
    )
    likely = [one.probability for one in known.alternatives]
    chosen = rng.random((number, len(shifts))) < likely
    return np.einsum("dk,kri->dri", chosen.astype(float), shifts)


ALPHAS = (0.99, 1.01)  # powers to which a density is raised: near enough to 1 that the draws need no new sampling
SENSITIVE = (
    0.05  # from here on the posterior changes with a density; a normal that is this density alone has about 0.08
)


def sensitivity(values: np.ndarray, log_density: np.ndarray) -> np.ndarray:
    """Return how much each parameter's posterior changes when one of its factors is raised to a power near 1.

    The cumulative Jensen-Shannon distance per log2 of the power, by importance weights density^(alpha - 1), Pareto-smoothed
    (Kallioinen et al. 2023, eq. 11).

    Args:
        values: the draws, shape (n_chains, n_draws, n_parameters).
        log_density: of each draw the log of the prior, or of the likelihood, up to a constant, shape (n_chains, n_draws).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats.base import array_stats

    lower, upper = (power_weights(log_density, alpha) for alpha in ALPHAS)
    return np.array([float(array_stats.power_scale_sense(values[..., k], lower, upper, *ALPHAS))
                     for k in range(values.shape[-1])])  # fmt: skip


def power_weights(log_density: np.ndarray, alpha: float) -> np.ndarray:
    """Return each draw's weight where a factor of the posterior is raised to the power alpha; they add up to 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats.base import array_stats

    log_weights = array_stats.power_scale_lw(log_density, alpha=alpha, axis=(0, 1))
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def prior_dominates(posterior: pd.DataFrame) -> np.ndarray:
    """Return of which rows of `sample/posterior.csv` the prior says where they lie, and the data hardly anything."""
    prior, likelihood = _sensitive(posterior)
    return prior & ~likelihood


def shared(posterior: pd.DataFrame) -> np.ndarray:
    """Return of which rows of `sample/posterior.csv` both the prior and the data say where they lie."""
    prior, likelihood = _sensitive(posterior)
    return prior & likelihood


def _sensitive(posterior: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    prior, likelihood = (posterior[f"{name}_sensitivity"].to_numpy(dtype=float) for name in ("prior", "likelihood"))
    return prior > SENSITIVE, likelihood > SENSITIVE


NEAR_BOUND, CUT = 0.1, 0.01  # a posterior is cut where 1 % of it lies within a tenth of its sd from a bound
DRAWS = 500  # for predictions


@dataclass(frozen=True, kw_only=True)
class PosteriorRow:
    """The sampled posterior of a parameter; `noise.factor` is the noise over that which the fit used."""

    parameter: str = column("its name")
    unit: str = column("of the figures in this row (SI)")
    mean: float = column("of all draws", UNIT, sd="sd")
    sd: float = column("their standard deviation", UNIT)
    q025: float = column("their 2.5 % quantile", UNIT, sd="sd")
    q500: float = column("their median", UNIT, sd="sd")
    q975: float = column("their 97.5 % quantile", UNIT, sd="sd")
    rhat: float = column("whether the ensembles agree: near 1")
    ess: float = column("effective number of independent draws")
    prior_sensitivity: float = column(
        "how much the posterior changes with the prior (power scaling); above 0.05: it counts; empty: "
        "all draws are alike"
    )
    likelihood_sensitivity: float = column(
        "the same with the likelihood; below 0.05 where the prior's is above: the prior, not the data, says where it lies"
    )


@dataclass(frozen=True, kw_only=True)
class PredictedError:
    """A measured row's error, and the interval in which the posterior and the noise say it should be."""

    pose: str = column("as in the measurements")
    repeat: str = column("as in the measurements")
    marker: str = column("as in the measurements")
    split: str = column("train, holdout")
    error_mm: float = column("distance from the mean prediction of all draws and models to the measured position", "mm")
    expected_mm: float = column("median of what was expected", "mm")
    low_mm: float = column("lower end of its 95 % interval", "mm")
    high_mm: float = column("upper end of it", "mm")
    covered: bool = column("whether the error lies inside")
    heldout_coverage: float = column("share of the held-out rows whose error lies inside; empty: none held out")
    dx_mm: float = column(
        "mean prediction minus measured position, along the measuring frame's x; empty: not measured", "mm"
    )
    dy_mm: float = column("the same along y", "mm")
    dz_mm: float = column("the same along z", "mm")
    covariance_xx_mm2: float = column(
        "variance of the prediction along x: of parameters, and of which model is right", "mm2"
    )
    covariance_xy_mm2: float = column("covariance of x and y", "mm2")
    covariance_xz_mm2: float = column("covariance of x and z", "mm2")
    covariance_yy_mm2: float = column("variance along y", "mm2")
    covariance_yz_mm2: float = column("covariance of y and z", "mm2")
    covariance_zz_mm2: float = column("variance along z", "mm2")
    choice_share: float = column("share of these variances because another model than the one found may be right")


def posterior_table(sampled: Sampled) -> pd.DataFrame:
    """Return a summary of each parameter; the noise level as a factor on the noise that identify used.

    R-hat compares the ensembles, each flattened, since only they are independent; the effective sample size counts the
    autocorrelation of each walker (both rank-normalised, Vehtari et al. 2021). Sensitivities are to prior and likelihood.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats.base import array_stats

    values, known = sampled.values, sampled.known
    n_ensembles, n_steps, n_walkers, n = values.shape
    values = np.concatenate([values[..., :-1], np.exp(values[..., -1:])], axis=-1)
    flat = values.reshape(-1, n)
    by_ensemble = values.reshape(n_ensembles, n_steps * n_walkers, n)
    by_walker = values.transpose(0, 2, 1, 3).reshape(n_ensembles * n_walkers, n_steps, n)
    prior, likelihood = (
        density.transpose(0, 2, 1).reshape(n_ensembles * n_walkers, n_steps)
        for density in (sampled.log_prior, sampled.log_likelihood)
    )
    quantiles = np.quantile(flat, [0.025, 0.5, 0.975], axis=0)
    parameters = known.model.parameters
    made = pd.DataFrame(
        {
            "parameter": [*(p.name for p in parameters), "noise.factor"],
            "unit": [*(p.unit for p in parameters), "1"],
            "mean": flat.mean(axis=0),
            "sd": flat.std(axis=0, ddof=1),
            "q025": quantiles[0],
            "q500": quantiles[1],
            "q975": quantiles[2],
            "rhat": [float(array_stats.rhat(by_ensemble[:, :, k])) for k in range(n)],
            "ess": [float(array_stats.ess(by_walker[:, :, k])) for k in range(n)],
            "prior_sensitivity": sensitivity(by_walker, prior),
            "likelihood_sensitivity": sensitivity(by_walker, likelihood),
        }
    )
    return typed(made, PosteriorRow)


def predictive_table(sampled: Sampled, rng: np.random.Generator) -> pd.DataFrame:
    """Return each row's error and the interval in which posterior and noise say it should be, without rows left out.

    Draws are of all models that may be right, each as often as it is probable.
    """
    known = sampled.known
    data = sampled.data.only(sampled.data.train | sampled.data.held_out)
    sigma = np.hypot(known.noise(data).total, np.where(data.held_out, known.elsewhere, 0.0))
    drawn = mixture(sampled, data, DRAWS, rng)
    centre, covariance = drawn.mean, drawn.covariance
    error = 1e3 * distances(centre)
    expected = np.empty((len(drawn.level), len(data)))
    for k, level in enumerate(drawn.level):
        noise = (level * sigma)[:, None] * rng.standard_normal(centre.shape)
        expected[k] = 1e3 * distances(drawn.errors[k] + noise - centre)
    low, middle, high = np.quantile(expected, [0.025, 0.5, 0.975], axis=0)
    table = data.table[["pose", "repeat", "marker", "split"]].assign(
        error_mm=error, expected_mm=middle, low_mm=low, high_mm=high, covered=(error >= low) & (error <= high),
        **{f"d{axis}_mm": 1e3 * centre[:, i] for i, axis in enumerate("xyz")},
        **{f"covariance_{'xyz'[i]}{'xyz'[j]}_mm2": 1e6 * covariance[:, i, j] for i in range(3) for j in range(i, 3)},
        choice_share=drawn.of_choice,
    )  # fmt: skip
    heldout = table[table["split"] == "holdout"]
    coverage = heldout["covered"].mean() if len(heldout) else np.nan
    return typed(table.assign(heldout_coverage=coverage), PredictedError)


def chain_summary(sampled: Sampled, table: pd.DataFrame) -> ChainSummary:
    """Say how long the chain is, and whether that is enough; table is its posterior's."""
    values, known, laplace = sampled.values, sampled.known, sampled.laplace
    ratio = (table["sd"].to_numpy()[:-1][~known.at_bound]) / laplace.sd[~known.at_bound]
    cut = []
    for i, parameter in enumerate(known.model.parameters):
        sample = values[..., i].ravel()
        near = NEAR_BOUND * sample.std()
        if ((sample - parameter.lower < near) | (parameter.upper - sample < near)).mean() > CUT:
            cut.append(Cut(parameter=parameter.name, unit=parameter.unit, lower=parameter.lower, upper=parameter.upper))
    return ChainSummary(
        steps=sampled.steps,
        burn_in_steps=sampled.discard,
        ensembles=values.shape[0],
        walkers=values.shape[2],
        autocorrelation_steps=sampled.tau,
        acceptance_independent=sampled.accepted,
        worst_rhat=table["rhat"].max(),
        smallest_ess=table["ess"].min(),
        sd_over_laplace_least=ratio.min() if len(ratio) else None,
        sd_over_laplace_most=ratio.max() if len(ratio) else None,
        missing_steps=_missing_steps(sampled.steps, sampled.tau, table["ess"].min(), sampled.length),
        cut=tuple(cut),
    )


def _missing_steps(steps: int, tau: float, ess: float, length: ChainLength) -> int:
    """About how many more steps are needed for enough autocorrelation times and samples; 0 where there are enough."""
    missing = int(np.ceil(min(ENOUGH_TAU * tau, 1e9))) - steps
    if missing <= 0 and ess >= length.ess:
        return 0
    return max(missing, int(np.ceil(steps * (length.ess / ess - 1))))
