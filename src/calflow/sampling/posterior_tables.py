"""What a chain says: each parameter's posterior, each row's predicted error, and whether the chain is long enough."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.estimation.accuracy import distances
from calflow.estimation.parameters import UNIT
from calflow.files.tables import column, typed
from calflow.sampling.chain_summary import ChainSummary, Cut
from calflow.sampling.mixture import mixture
from calflow.sampling.sample import ENOUGH_TAU, ChainLength, Sampled
from calflow.sampling.sensitivity import sensitivity

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
