"""The sampled posterior: marginals, sensitivity to the prior, posterior predictive errors over rival causes, and convergence."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from calflow.estimation.accuracy import distances, errors, errors_of_draws, judged_unit
from calflow.estimation.calibrated_model import CalibratedModel, Quantity, offsets
from calflow.estimation.parameters import UNIT
from calflow.estimation.progress import Draws
from calflow.files.deferred import pd
from calflow.files.tables import column, typed
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.observations import leading_units
from calflow.sampling.chain import ChainLength

ALPHAS = (0.99, 1.01)  # powers to which a density is raised: near enough to 1 for importance weighting of the draws
# Threshold of sensitivity to a density; a normal posterior determined by that density alone has about 0.08.
SENSITIVE = 0.05
NOISE = "noise.factor"
NO_ARVIZ = "to_inference_data needs ArviZ: pip install 'calflow[arviz]' (or arviz-base)"
NEAR_BOUND, CUT = 0.1, 0.01  # a posterior is truncated if 1 % of it lies within a tenth of its sd from a bound
# Draws, and noise samples per draw: a single one would leave the lower 95 % limit of a distance uncertain by a tenth.
DRAWS_KEPT, NOISE_DRAWS = 500, 128
MOST_STEPS = 1e9  # stated as the required length if a walker never moves


@dataclass(frozen=True, kw_only=True)
class Cut:
    """A parameter whose posterior is truncated by its bounds, so that quantiles describe it better than mean and sd."""

    parameter: str = column("name of the parameter")
    unit: str = column("SI unit of the bounds")
    lower: float = column("lower bound")
    upper: float = column("upper bound")


@dataclass(frozen=True, kw_only=True)
class ChainSummary:
    """Length and convergence diagnostics of the chain."""

    steps: int = column("number of steps of each walker")
    burn_in_steps: int = column("steps discarded at the start")
    ensembles: int = column("number of independent ensembles of walkers")
    walkers: int = column("number of walkers in each ensemble")
    autocorrelation_steps: float | None = column("longest autocorrelation time; null: some walker never moved")
    acceptance_independent: float | None = column("acceptance rate of independence proposals; null: not used")
    worst_rhat: float = column("the largest R-hat of all parameters")
    smallest_ess: float = column("the smallest effective sample size")
    sd_over_laplace_least: float | None = column(
        "smallest ratio of sampled to fitted sd; null: every parameter is at a bound"
    )
    sd_over_laplace_most: float | None = column("largest such ratio")
    missing_steps: int = column("approximate number of further steps needed; 0: long enough")
    cut: tuple[Cut, ...] = column(
        "parameters whose posterior is truncated by bounds: parameter, unit, lower, upper", default=()
    )


def shifts(calibrated: CalibratedModel, acts: np.ndarray, quantity: Quantity) -> np.ndarray:
    """Return the change of a quantity of rows by the rivals that act, of `Posterior.drawn`, (n_draws, n_rows, 3)."""
    moved = offsets(calibrated.alternatives, calibrated.model, calibrated.estimate, quantity)
    return np.einsum("dk,rik->dri", acts.astype(float), moved)


def sensitivity(values: np.ndarray, log_density: np.ndarray) -> np.ndarray:
    """Return the power-scaling sensitivity of each parameter's posterior to one factor (Kallioinen et al. 2023, eq. 11).

    values are draws (n_chains, n_draws, n_parameters), log_density (n_chains, n_draws) is that factor's, up to a constant.
    """
    array_stats = _array_stats()
    lower, upper = (power_weights(log_density, alpha) for alpha in ALPHAS)
    return np.array(
        [float(array_stats.power_scale_sense(values[..., k], lower, upper, *ALPHAS)) for k in range(values.shape[-1])]
    )


def power_weights(log_density: np.ndarray, alpha: float) -> np.ndarray:
    """Return the normalised weights of draws for a factor of the posterior raised to the power alpha."""
    return np.asarray(scipy.special.softmax(_array_stats().power_scale_lw(log_density, alpha=alpha, axis=(0, 1))))


def told_by_prior(table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return which parameters (rows of `sample/posterior.csv`) the prior determines alone, and which prior and data together."""
    prior, likelihood = (table[f"{name}_sensitivity"].to_numpy(dtype=float) for name in ("prior", "likelihood"))
    assumed, measured = prior > SENSITIVE, likelihood > SENSITIVE
    return assumed & ~measured, assumed & measured


@dataclass(frozen=True, kw_only=True)
class PosteriorRow:
    """The sampled marginal posterior of a parameter; `noise.factor` is the noise relative to that used by the fit."""

    parameter: str = column("name of the parameter")
    unit: str = column("SI unit of the figures in this row")
    mean: float = column("posterior mean", UNIT, sd="sd")
    sd: float = column("posterior standard deviation", UNIT)
    q025: float = column("2.5 % quantile", UNIT, sd="sd")
    q500: float = column("median", UNIT, sd="sd")
    q975: float = column("97.5 % quantile", UNIT, sd="sd")
    rhat: float = column("R-hat over the ensembles: near 1 at convergence")
    ess: float = column("effective sample size")
    prior_sensitivity: float = column(
        "power-scaling sensitivity to the prior; above 0.05 the prior matters; empty: all draws are equal"
    )
    likelihood_sensitivity: float = column(
        "the same for the likelihood; below 0.05, with the prior's above it: the prior, not the data, determines the parameter"
    )


@dataclass(frozen=True, kw_only=True)
class PredictedError:
    """A measured row's error with its posterior predictive interval."""

    pose: str = column("as in the measurements")
    repeat: str = column("as in the measurements")
    marker: str = column("as in the measurements")
    split: str = column("train, holdout")
    error_mm: float = column(
        "distance of the measured position from the posterior mean prediction, averaged over rival causes too", "mm"
    )
    expected_mm: float = column("predictive median of the error", "mm")
    low_mm: float = column("lower end of its 95 % predictive interval", "mm")
    high_mm: float = column("upper end of that interval", "mm")
    covered: bool = column("whether the error lies inside the interval")
    heldout_coverage: float = column("share of the held-out rows whose error lies inside; empty: none held out")
    difference: Mapping[str, float] = column(
        "mean prediction minus measured position, along the measuring frame's axes; empty: not measured",
        "mm",
        name="d{x|y|z}_mm",
    )
    covariance: Mapping[str, float] = column(
        "covariance of the prediction along two axes, or variance along one, by the uncertainty of parameters and of causes",
        "mm2",
        name="covariance_{xx|xy|xz|yy|yz|zz}_mm2",
    )
    choice_share: float = column("share of these variances due to the uncertainty of causes (rivals)")
    unit: str = column("unit of the model's errors: mm, or where no lengths were measured mrad, px, …")
    error: float = column("as error_mm, in `unit`; the table has rows of that unit alone")
    expected: float = column("as expected_mm, in `unit`")
    low: float = column("as low_mm, in `unit`")
    high: float = column("as high_mm, in `unit`")


def effective_samples(values: np.ndarray) -> np.ndarray:
    """Return effective sample sizes of values (n_ensembles, n_steps, n_walkers, n), each walker a chain (Vehtari et al. 2021)."""
    return np.asarray(_array_stats().ess(_by_walker(values), chain_axis=0, draw_axis=1))


def _by_walker(values: np.ndarray) -> np.ndarray:
    """Return draws (n_ensembles, n_steps, n_walkers, ...) with one chain per walker, (n_chains, n_steps, ...)."""
    return np.concatenate(values.swapaxes(1, 2))


def _array_stats() -> Any:
    """Return ArviZ's array functions, imported without their warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats.base import array_stats

    return array_stats


def predictive_table(posterior: Posterior, rng: np.random.Generator) -> pd.DataFrame:
    """Return the error and predictive interval of each row in use, over draws of parameters, causes found and their rivals."""
    data = posterior.data.only(posterior.data.train | posterior.data.held_out)
    units = leading_units(data)
    unit = judged_unit(units)
    data = data.only(np.array([other == unit for other in units])[data.series_number])
    lengths = 1.0 if unit == METRE else np.nan
    calibrated, (values, acts) = posterior.calibrated, posterior.drawn(DRAWS_KEPT, rng)
    by_choice = shifts(calibrated, acts, lambda model, estimate: errors(model, estimate, data))
    by_parameters = errors_of_draws(calibrated.model, values[:, :-1], data)
    centre = (by_parameters + by_choice).mean(axis=0)
    deviation = by_parameters + by_choice - centre
    covariance = np.einsum("dri,drj->rij", deviation, deviation) / max(len(deviation) - 1, 1)
    of_choice, of_parameters = (np.nansum(part.var(axis=0), axis=1) for part in (by_choice, by_parameters))
    total = of_choice + of_parameters
    error = unit.shown(distances(centre))
    low, median, high = unit.scale * _quantiles(
        deviation, np.exp(values[:, -1]), _remaining_sd(calibrated, data, unit), rng
    )
    table = data.table[["pose", "repeat", "marker", "split"]].assign(
        error_mm=lengths * error, expected_mm=lengths * median, low_mm=lengths * low, high_mm=lengths * high,
        covered=(error >= low) & (error <= high),
        **{f"d{axis}_mm": 1e3 * lengths * centre[:, i] for i, axis in enumerate("xyz")},
        **{f"covariance_{'xyz'[i]}{'xyz'[j]}_mm2": 1e6 * lengths * covariance[:, i, j] for i in range(3) for j in range(i, 3)},
        choice_share=np.divide(of_choice, total, out=np.zeros_like(total), where=total > 0),
        unit=unit.label, error=error, expected=median, low=low, high=high,
    )  # fmt: skip
    coverage = table.loc[table["split"] == "holdout", "covered"].mean()
    return typed(table.assign(heldout_coverage=coverage), PredictedError)


def _quantiles(deviation: np.ndarray, level: np.ndarray, sigma: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the 2.5, 50 and 97.5 % quantiles of each row's distance from the mean prediction, (3, n_rows) in the unit judged.

    deviation (n_draws, n_rows, 3): of draws from the mean; level (n_draws,), sigma (n_rows, 3): of the noise.
    """
    points = scipy.stats.qmc.Halton(3, rng=rng).random(len(level) * NOISE_DRAWS)
    noise = level[:, None] * scipy.special.ndtri(points).T.reshape(3, -1, NOISE_DRAWS)
    axes = deviation.transpose(1, 2, 0)[..., None]
    away = (each + sd * noise for each, sd in zip(axes, sigma[..., None, None], strict=True))
    return np.sqrt([np.quantile(np.nansum(each**2, axis=0), [0.025, 0.5, 0.975]) for each in away]).T


def _remaining_sd(calibrated: CalibratedModel, data: Measurements, unit: MeasurementUnit) -> np.ndarray:
    """Return the sd of errors not due to parameters or choice of model, noise included, (n_rows, 3) in the unit judged."""
    held = np.sqrt(calibrated.device_sigma(data)[:, None] ** 2 + calibrated.errors_in_unit(data, unit).left)
    return np.where(data.held_out[:, None], held, calibrated.noise(data).total[:, None])


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """A sampled posterior; its tables are those of a run's folder `sample`.

    calibrated: the model, without causes held at their estimates; data: all rows. points (n_ensembles, n_steps, n_walkers,
    n_dimensions): draws of the parameters [SI] after the burn-in, the last entry the log of the noise's factor; densities
    (n_ensembles, n_steps, n_walkers): see `Chain.densities`. fitted_sd (n_parameters,): standard deviations by the fit. ess
    (n_dimensions,): effective sample size of each parameter. steps, discard: steps made and burn-in; tau [steps]: autocorrelation
    time. accepted: acceptance rate of independence proposals, None without any. rng: random numbers for predictions.
    """

    calibrated: CalibratedModel
    data: Measurements
    points: np.ndarray
    densities: np.ndarray
    fitted_sd: np.ndarray
    ess: np.ndarray
    steps: int
    discard: int
    tau: float
    accepted: float | None
    length: ChainLength
    rng: Draws

    def drawn(self, number: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return draws, at most all: points (n_draws, n_parameters + 1), and which rivals act (n_draws, n_alternatives)."""
        flat = self.points.reshape(-1, self.points.shape[-1])
        points = flat[rng.choice(len(flat), size=min(number, len(flat)), replace=False)]
        probable = [other.probability for other in self.calibrated.alternatives]
        return points, rng.random((len(points), len(probable))) < probable

    @cached_property
    def values(self) -> np.ndarray:
        """The draws of the parameters [SI], the last entry the noise's factor, (n_ensembles, n_steps, n_walkers, n_names)."""
        return np.concatenate([self.points[..., :-1], np.exp(self.points[..., -1:])], axis=-1)

    @property
    def names(self) -> list[str]:
        """The parameters' names, the noise's factor last."""
        return [*(parameter.name for parameter in self.calibrated.model.parameters), NOISE]

    @cached_property
    def draws(self) -> pd.DataFrame:
        """All draws [SI], one per row: ensemble, step and walker, and one column per parameter."""
        n_ensembles, n_steps, n_walkers, n = self.values.shape
        index = pd.MultiIndex.from_product(
            [range(n_ensembles), range(n_steps), range(n_walkers)], names=["ensemble", "step", "walker"]
        )
        return pd.DataFrame(self.values.reshape(-1, n), columns=self.names, index=index).reset_index()

    @cached_property
    def table(self) -> pd.DataFrame:
        """A summary of each parameter (see `sample/posterior.csv`); the noise level is a factor on the noise used by identify.

        R-hat compares the ensembles, each flattened, since only they are independent (Vehtari et al. 2021).
        """
        n_ensembles, *_, n = self.values.shape
        flat, by_ensemble = self.values.reshape(-1, n), self.values.reshape(n_ensembles, -1, n)
        by_walker = _by_walker(self.values)
        prior, likelihood = (_by_walker(self.densities[name]) for name in ("log_prior", "log_likelihood"))
        quantiles = np.quantile(flat, [0.025, 0.5, 0.975], axis=0)
        table = pd.DataFrame(
            {
                "parameter": self.names,
                "unit": [*(p.unit for p in self.calibrated.model.parameters), "1"],
                "mean": flat.mean(axis=0),
                "sd": flat.std(axis=0, ddof=1),
                "q025": quantiles[0],
                "q500": quantiles[1],
                "q975": quantiles[2],
                "rhat": _array_stats().rhat(by_ensemble, chain_axis=0, draw_axis=1),
                "ess": self.ess,
                "prior_sensitivity": sensitivity(by_walker, prior),
                "likelihood_sensitivity": sensitivity(by_walker, likelihood),
            }
        )
        return typed(table, PosteriorRow)

    @cached_property
    def predictive(self) -> pd.DataFrame:
        """Each row's error with its predictive interval (see `sample/predictive.csv`)."""
        return predictive_table(self, self.rng("predictive"))

    @cached_property
    def summary(self) -> ChainSummary:
        """Length and convergence diagnostics of the chain, and whether it is long enough."""
        values, calibrated, table = self.points, self.calibrated, self.table
        share = max(self.length.share(self.steps, self.tau, table["ess"].min()), self.steps / MOST_STEPS)
        ratio = (table["sd"].to_numpy()[:-1][~calibrated.at_bound]) / self.fitted_sd[~calibrated.at_bound]
        return ChainSummary(
            steps=self.steps,
            burn_in_steps=self.discard,
            ensembles=values.shape[0],
            walkers=values.shape[2],
            autocorrelation_steps=self.tau,
            acceptance_independent=self.accepted,
            worst_rhat=table["rhat"].max(),
            smallest_ess=table["ess"].min(),
            sd_over_laplace_least=ratio.min() if len(ratio) else None,
            sd_over_laplace_most=ratio.max() if len(ratio) else None,
            missing_steps=int(np.ceil(self.steps * (1 / share - 1))),
            cut=tuple(
                Cut(parameter=p.name, unit=p.unit, lower=p.lower, upper=p.upper)
                for p, sample in zip(calibrated.model.parameters, np.moveaxis(values[..., :-1], -1, 0), strict=True)
                if (np.minimum(sample - p.lower, p.upper - sample) < NEAR_BOUND * sample.std()).mean() > CUT
            ),
        )

    def to_inference_data(self) -> Any:
        """Return the draws as ArviZ's inference data, with one chain per walker.

        The groups are `posterior`, and `log_prior` and `log_likelihood` summed over all parameters and rows, as ArviZ's
        `psense` requires; `loo` would require them row by row.

        Raises:
            ImportError: ArviZ is not installed.
        """
        try:
            from arviz_base import from_dict
        except ImportError:
            raise ImportError(NO_ARVIZ) from None

        chains = _by_walker(self.values)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Found chain dimension")  # more walkers than draws of each is usual
            return from_dict(
                {
                    "posterior": {name: chains[..., k] for k, name in enumerate(self.names)},
                    "log_prior": {"parameters": _by_walker(self.densities["log_prior"])},
                    "log_likelihood": {"measurements": _by_walker(self.densities["log_likelihood"])},
                }
            )

    def __repr__(self) -> str:
        summary = self.summary
        short = f"; about {summary.missing_steps} more steps are needed" if summary.missing_steps else ""
        return (
            f"Posterior of {len(self.names)} parameters: {summary.ensembles} ensembles of {summary.walkers} walkers, "
            f"{summary.steps} steps, worst R-hat {summary.worst_rhat:.3f}{short}"
        )

    def _repr_html_(self) -> str:
        return f"<p>{self!r}</p>{self.table.to_html(index=False, float_format='{:.3g}'.format)}"
