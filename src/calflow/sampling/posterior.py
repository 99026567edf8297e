"""The sampled posterior: each parameter's, how much of it is its prior's, each row's predicted error, and the chain's length.

Predictions are of what was found and of the rivals in its place, each as often as it is probable; prior and data are told apart by
power scaling.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from calflow.estimation.accuracy import distances, errors, judged_unit
from calflow.estimation.calibrated_model import CalibratedModel, left_variance
from calflow.estimation.parameters import UNIT
from calflow.estimation.progress import Draws
from calflow.files.deferred import pd
from calflow.files.tables import column, typed
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import leading_units
from calflow.sampling.chain import ENOUGH_TAU, ChainLength
from calflow.sampling.log_posterior import Laplace, LogPosterior


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


Quantity = Callable[[Model, np.ndarray], np.ndarray]  # of rows (n_rows, 3), by a model at an estimate


@dataclass(frozen=True, eq=False)
class PosteriorDraws:
    """Draws of what may be true of a calibrated robot.

    values (n_draws, n_parameters + 1) are of the chain, the last of them the log of the noise's factor. A rival of what was found
    acts in its place in as many of the draws as it is probable: acts (n_draws, n_alternatives); they do not exclude each other.
    """

    calibrated: CalibratedModel
    values: np.ndarray
    acts: np.ndarray

    @staticmethod
    def of(posterior: Posterior, number: int, rng: np.random.Generator) -> PosteriorDraws:
        """Take so many of a posterior's draws, or all there are."""
        calibrated, flat = posterior.calibrated, posterior.points.reshape(-1, posterior.points.shape[-1])
        values = flat[rng.choice(len(flat), size=min(number, len(flat)), replace=False)]
        probable = [other.probability for other in calibrated.alternatives]
        return PosteriorDraws(calibrated, values, rng.random((len(values), len(probable))) < probable)

    def shifts(self, quantity: Quantity) -> np.ndarray:
        """Return by how much the rivals that act change a quantity of rows, (n_draws, n_rows, 3)."""
        model, alternatives = self.calibrated.model, self.calibrated.alternatives
        here = quantity(model, self.calibrated.estimate)
        there = [quantity(replace(other.model, given=model.given), other.estimate) for other in alternatives]
        return np.einsum("dk,kri->dri", self.acts.astype(float), np.reshape(there, (-1, *here.shape)) - here)


ALPHAS = (0.99, 1.01)  # powers to which a density is raised: near enough to 1 that the draws need no new sampling
# From here on the posterior changes with a density; a normal that is this density alone has about 0.08.
SENSITIVE = 0.05


def sensitivity(values: np.ndarray, log_density: np.ndarray) -> np.ndarray:
    """Return how much each parameter's posterior changes when one of its factors is raised to a power near 1.

    The cumulative Jensen-Shannon distance per log2 of the power, by importance weights density^(alpha - 1), Pareto-smoothed
    (Kallioinen et al. 2023, eq. 11).

    Args:
        values: the draws, shape (n_chains, n_draws, n_parameters).
        log_density: of each draw the log of the prior, or of the likelihood, up to a constant, shape (n_chains, n_draws).
    """
    array_stats = _array_stats()
    lower, upper = (power_weights(log_density, alpha) for alpha in ALPHAS)
    return np.array(
        [float(array_stats.power_scale_sense(values[..., k], lower, upper, *ALPHAS)) for k in range(values.shape[-1])]
    )


def power_weights(log_density: np.ndarray, alpha: float) -> np.ndarray:
    """Return each draw's weight where a factor of the posterior is raised to the power alpha; they add up to 1."""
    array_stats = _array_stats()
    log_weights = array_stats.power_scale_lw(log_density, alpha=alpha, axis=(0, 1))
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def told_by_prior(table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return of which rows of `sample/posterior.csv` the prior, not the data, says where they lie; and of which both say it."""
    prior, likelihood = (table[f"{name}_sensitivity"].to_numpy(dtype=float) for name in ("prior", "likelihood"))
    assumed, measured = prior > SENSITIVE, likelihood > SENSITIVE
    return assumed & ~measured, assumed & measured


NOISE = "noise.factor"
NO_ARVIZ = "to_inference_data needs ArviZ: pip install 'calflow[arviz]' (or arviz-base)"
NEAR_BOUND, CUT = 0.1, 0.01  # a posterior is cut where 1 % of it lies within a tenth of its sd from a bound
# Predictions, and noise for each of them: one alone would leave the lower end of 95 % of a distance uncertain by a tenth.
DRAWS, NOISE_DRAWS = 500, 128


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
    error_mm: float = column(
        "distance from the mean prediction of all draws, with the rivals of what was found, to the measured position",
        "mm",
    )
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
    unit: str = column("the unit by which the model is judged: mm, or where no lengths were measured mrad, px, …")
    error: float = column("as error_mm, in `unit`; its rows alone are told of")
    expected: float = column("as expected_mm, in `unit`")
    low: float = column("as low_mm, in `unit`")
    high: float = column("as high_mm, in `unit`")


def effective_samples(values: np.ndarray) -> np.ndarray:
    """Return the effective number of draws (n_parameters,) of values (n_ensembles, n_steps, n_walkers, n_parameters).

    Each walker is a chain of its own (Vehtari et al. 2021).
    """
    ess, chains = _array_stats().ess, _by_walker(values)
    return np.array([float(ess(chains[:, :, k])) for k in range(chains.shape[-1])])


def _by_walker(values: np.ndarray) -> np.ndarray:
    """Return draws (n_ensembles, n_steps, n_walkers, ...) with a chain a walker, (n_chains, n_steps, ...)."""
    return np.concatenate(values.swapaxes(1, 2))


def _array_stats() -> Any:
    """ArviZ's functions of arrays, which warn when they are loaded."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats.base import array_stats

    return array_stats


def predictive_table(posterior: Posterior, rng: np.random.Generator) -> pd.DataFrame:
    """Return each row's error and the interval in which posterior and noise say it should be, without rows left out.

    Draws are of what was found and of the rivals in its place, each as often as it is probable.
    """
    data = posterior.data.only(posterior.data.train | posterior.data.held_out)
    units = leading_units(data)
    unit = judged_unit(units)
    data = data.only(np.array([other == unit for other in units])[data.series_number])
    lengths = 1.0 if unit == METRE else np.nan
    drawn = PosteriorDraws.of(posterior, DRAWS, rng)
    model, level = drawn.calibrated.model, np.exp(drawn.values[:, -1])
    shifts = drawn.shifts(lambda model, estimate: errors(model, estimate, data))
    alone = np.array([errors(model, values, data) for values in drawn.values[:, :-1]])
    centre = (alone + shifts).mean(axis=0)
    off = alone + shifts - centre
    covariance = np.einsum("dri,drj->rij", off, off) / max(len(off) - 1, 1)
    of_choice, of_parameters = (np.nansum(part.var(axis=0), axis=1) for part in (shifts, alone))
    whole = of_choice + of_parameters
    error = unit.shown(distances(centre))
    low, middle, high = unit.scale * _expected(off, level, _beside(drawn.calibrated, data, unit), rng)
    table = data.table[["pose", "repeat", "marker", "split"]].assign(
        error_mm=lengths * error, expected_mm=lengths * middle, low_mm=lengths * low, high_mm=lengths * high,
        covered=(error >= low) & (error <= high),
        **{f"d{axis}_mm": 1e3 * lengths * centre[:, i] for i, axis in enumerate("xyz")},
        **{f"covariance_{'xyz'[i]}{'xyz'[j]}_mm2": 1e6 * lengths * covariance[:, i, j] for i in range(3) for j in range(i, 3)},
        choice_share=np.divide(of_choice, whole, out=np.zeros_like(whole), where=whole > 0),
        unit=unit.label, error=error, expected=middle, low=low, high=high,
    )  # fmt: skip
    coverage = table.loc[table["split"] == "holdout", "covered"].mean()
    return typed(table.assign(heldout_coverage=coverage), PredictedError)


def _expected(off: np.ndarray, level: np.ndarray, sigma: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the 2.5, 50 and 97.5 % quantiles of each row's distance from the mean prediction, (3, n_rows) in the unit judged.

    off (n_draws, n_rows, 3) is what draws are from that, level (n_draws,) their noise over that of the fit, sigma (n_rows, 3).
    """
    points = scipy.stats.qmc.Halton(3, rng=rng).random(len(level) * NOISE_DRAWS)
    noise = level[:, None] * scipy.special.ndtri(points).T.reshape(3, -1, NOISE_DRAWS)
    axes = off.transpose(1, 2, 0)[..., None]
    away = (each + sd * noise for each, sd in zip(axes, sigma[..., None, None], strict=True))
    return np.sqrt([np.quantile(np.nansum(each**2, axis=0), [0.025, 0.5, 0.975]) for each in away]).T


def _beside(calibrated: CalibratedModel, data: Measurements, unit: MeasurementUnit) -> np.ndarray:
    """Return the sd of what rows err by beside parameters and choice of model, noise in it, (n_rows, 3) in the unit judged."""
    noise = calibrated.noise(data)
    fitted = np.tile(noise.total[:, None], 3)
    if unit != METRE:
        return fitted
    device = noise.sigma[:, None] if calibrated.noise_known else 0.0
    left = left_variance(replace(calibrated, field=None), data.conditions)
    return np.where(data.held_out[:, None], np.sqrt(device**2 + left), fitted)


def _missing_steps(steps: int, tau: float, ess: float, length: ChainLength) -> int:
    """About how many more steps are needed for enough autocorrelation times and samples; 0 where there are enough."""
    missing = int(np.ceil(min(ENOUGH_TAU * tau, 1e9))) - steps
    if missing <= 0 and ess >= length.ess:
        return 0
    return max(missing, int(np.ceil(steps * (length.ess / ess - 1))))


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """A sampled posterior; its tables are those of a run's folder `sample`.

    calibrated is the model without what was held, data the rows (all of them), walkers (n_ensembles, n_steps, n_walkers,
    n_dimensions) those after the burn-in in the coordinates of log_posterior, log_prior and log_likelihood (n_ensembles, n_steps,
    n_walkers) theirs, up to a constant; ess (n_dimensions,) are the effective samples of each parameter; steps, discard and tau
    [steps] are those made, left out at the start, and until a walker forgets; accepted is the share of independent proposals that
    are, None where there are none. rng draws predictions.
    """

    calibrated: CalibratedModel
    data: Measurements
    log_posterior: LogPosterior
    laplace: Laplace
    walkers: np.ndarray
    log_prior: np.ndarray
    log_likelihood: np.ndarray
    ess: np.ndarray
    steps: int
    discard: int
    tau: float
    accepted: float | None
    length: ChainLength
    rng: Draws

    @cached_property
    def points(self) -> np.ndarray:
        """The walkers in the parameters' units [SI], the last of them the log of the noise's factor; shape as walkers."""
        return self.log_posterior.parameters(self.walkers)

    @cached_property
    def values(self) -> np.ndarray:
        """All draws [SI], the last of them the noise's factor, shape (n_ensembles, n_steps, n_walkers, n_names)."""
        return np.concatenate([self.points[..., :-1], np.exp(self.points[..., -1:])], axis=-1)

    @property
    def names(self) -> list[str]:
        """The parameters' names, the noise's factor last."""
        return [*(parameter.name for parameter in self.calibrated.model.parameters), NOISE]

    @cached_property
    def draws(self) -> pd.DataFrame:
        """All draws [SI], a row a draw: ensemble, walker and step, and a column a parameter."""
        n_ensembles, n_steps, n_walkers, n = self.values.shape
        index = pd.MultiIndex.from_product(
            [range(n_ensembles), range(n_steps), range(n_walkers)], names=["ensemble", "step", "walker"]
        )
        return pd.DataFrame(self.values.reshape(-1, n), columns=self.names, index=index).reset_index()

    @cached_property
    def table(self) -> pd.DataFrame:
        """A summary of each parameter (see `sample/posterior.csv`); the noise level as a factor on the noise that identify used.

        R-hat compares the ensembles, each flattened, since only they are independent; the effective sample size counts the
        autocorrelation of each walker (both rank-normalised, Vehtari et al. 2021). Sensitivities are to prior and likelihood.
        """
        array_stats = _array_stats()
        values = self.values
        n_ensembles, n_steps, n_walkers, n = values.shape
        flat = values.reshape(-1, n)
        by_ensemble = values.reshape(n_ensembles, n_steps * n_walkers, n)
        by_walker = _by_walker(values)
        prior, likelihood = (_by_walker(density) for density in (self.log_prior, self.log_likelihood))
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
                "rhat": [float(array_stats.rhat(by_ensemble[:, :, k])) for k in range(n)],
                "ess": self.ess,
                "prior_sensitivity": sensitivity(by_walker, prior),
                "likelihood_sensitivity": sensitivity(by_walker, likelihood),
            }
        )
        return typed(table, PosteriorRow)

    @cached_property
    def predictive(self) -> pd.DataFrame:
        """Each row's error, and the interval in which it should be (see `sample/predictive.csv`)."""
        return predictive_table(self, self.rng("predictive"))

    @cached_property
    def summary(self) -> ChainSummary:
        """How long the chain is and how it mixes, and whether that is enough."""
        values, calibrated, laplace, table = self.points, self.calibrated, self.laplace, self.table
        ratio = (table["sd"].to_numpy()[:-1][~calibrated.at_bound]) / laplace.sd[~calibrated.at_bound]
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
            missing_steps=_missing_steps(self.steps, self.tau, table["ess"].min(), self.length),
            cut=tuple(
                Cut(parameter=p.name, unit=p.unit, lower=p.lower, upper=p.upper)
                for p, sample in zip(calibrated.model.parameters, np.moveaxis(values[..., :-1], -1, 0), strict=True)
                if (np.minimum(sample - p.lower, p.upper - sample) < NEAR_BOUND * sample.std()).mean() > CUT
            ),
        )

    def to_inference_data(self) -> Any:
        """Return the draws as ArviZ takes them; each walker is a chain.

        The groups are `posterior`, and `log_prior` and `log_likelihood` of all parameters and of all rows together, as ArviZ's
        `psense` wants them; `loo` would want them row by row.

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
                    "log_prior": {"parameters": _by_walker(self.log_prior)},
                    "log_likelihood": {"measurements": _by_walker(self.log_likelihood)},
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
