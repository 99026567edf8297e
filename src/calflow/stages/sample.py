"""The stage sample: how sure every parameter is, by emcee in coordinates that Laplace's approximation makes round."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import emcee
import numpy as np
import pandas as pd
from pydantic import Field

from calflow.estimation.accuracy import distances, errors
from calflow.estimation.calibrated import Identified, calibrated, with_maps_held
from calflow.estimation.parameters import UNIT
from calflow.faults import corrected
from calflow.files.documents import to_document
from calflow.files.problems import Problem, refuse
from calflow.files.results import Results
from calflow.files.tables import column, typed
from calflow.files.toml import FileModel
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.sampling.backend import BlockBackend, joined, open_ensembles
from calflow.sampling.chain_summary import ChainSummary, Cut
from calflow.sampling.posterior import Laplace, Posterior, moves, posterior_of
from calflow.stages.stage import Context, Stage
from calflow.study import Study

ENOUGH_TAU = 50  # autocorrelation times that a chain must be long
LOW_ACCEPTANCE = 0.1  # below this the independent proposal only wastes evaluations
NEAR_BOUND, CUT = 0.1, 0.01  # a posterior is cut where 1 % of it lies within a tenth of its sd from a bound
DRAWS = 500  # for predictions


@dataclass(frozen=True, kw_only=True)
class PosteriorRow:
    """The sampled posterior of a parameter; `noise.factor` is the noise over that which the fit used."""

    parameter: str = column("its name")
    unit: str = column("of the figures in this row (SI)")
    mean: float = column("of all draws", UNIT)
    sd: float = column("their standard deviation", UNIT)
    q025: float = column("their 2.5 % quantile", UNIT)
    q500: float = column("their median", UNIT)
    q975: float = column("their 97.5 % quantile", UNIT)
    rhat: float = column("whether the ensembles agree: near 1")
    ess: float = column("effective number of independent draws")


@dataclass(frozen=True, kw_only=True)
class PredictedError:
    """A measured row's error, and the interval in which the posterior and the noise say it should be."""

    pose: str = column("as in the measurements")
    repeat: str = column("as in the measurements")
    marker: str = column("as in the measurements")
    split: str = column("train, holdout")
    error_mm: float = column("distance from the posterior's mean prediction to the measured position", "mm")
    expected_mm: float = column("median of what was expected", "mm")
    low_mm: float = column("lower end of its 95 % interval", "mm")
    high_mm: float = column("upper end of it", "mm")
    covered: bool = column("whether the error lies inside")
    heldout_coverage: float = column("share of the held-out rows whose error lies inside; empty: none held out")


class SampleSettings(FileModel):
    """Settings of sample: length and mixture of the chain. independent is the share of the independence proposal."""

    ensembles: int = Field(default=4, ge=4)
    walkers: int | None = Field(default=None, ge=4)
    block: int = Field(default=50, ge=10)
    max_steps: int = Field(default=2000, ge=50)
    ess: int = Field(default=4000, ge=100)
    independent: float = Field(default=0.8, ge=0, le=1)


def run(context: Context) -> Results:
    """Sample the posterior with independent ensembles until it is long enough, and say so if it is not."""
    study, settings = context.study, context.settings
    data = corrected(study.measurements(), context.tables["identify/faults.csv"])
    known, held = with_maps_held(calibrated(study.robot, context.results, data.given))
    if held:
        context.say(f"held at their estimates, too many to sample: {', '.join(f'{c.id} {c.part}' for c in held)}")
    data = data.on(known.model.robot)
    posterior, laplace = posterior_of(known, data)
    n = posterior.n_dimensions
    walkers = settings.walkers or 2 * n
    if walkers < 2 * n:
        raise refuse(
            f"{walkers} walkers are too few for {n} dimensions: expected at least {2 * n}",
            study.path,
            key="stages.sample.walkers",
        )
    starts = [posterior.start(walkers, context.rng(f"ensemble{i}")) for i in range(settings.ensembles)]
    accepted = _acceptance(posterior, starts[0], context.rng("pilot"))
    independent = settings.independent if accepted > LOW_ACCEPTANCE else 0.0
    context.say(
        f"independence proposal accepted {accepted:.0%}" + ("" if independent else ": differential evolution alone")
    )

    path = context.folder / "sample" / "chain.h5"
    path.parent.mkdir(parents=True, exist_ok=True)
    backends = open_ensembles(path, settings.ensembles, (walkers, n), independent, context.say)
    steps, tau = _sample(context, posterior, backends, starts, independent)

    discard = min(steps // 4, int(min(5 * tau, steps)))
    chain = joined(backends, discard, steps)
    values = posterior.parameters(chain)
    table = _posterior(values, chain, known)
    tables = {
        "sample/posterior.csv": table,
        "sample/predictive.csv": _predictive(values, known, data, context.rng("predictive")),
    }
    summary = _summary(table, values, known, laplace, steps, discard, tau, accepted if independent else None, settings)
    return Results(tables, {"sample/summary.json": to_document(summary)})


def problems(study: Study, settings: SampleSettings, data: Measurements | None) -> list[Problem]:
    """Find fewer walkers than the study's own effects need; causes that are found may need more."""
    least = 2 * (len(build(study.robot, study.file.effects).parameters) + 1)
    if settings.walkers is None or settings.walkers >= least:
        return []
    message = f"{settings.walkers} walkers are too few for {least // 2} dimensions: expected at least {least}"
    return [study.setting_problem("sample", message, "walkers")]


def _acceptance(posterior: Posterior, walkers: np.ndarray, rng: np.random.Generator) -> float:
    """Mean acceptance of one independent proposal from each start."""
    move = moves(posterior.folded, 1.0)[0][0]
    proposed, log_ratio = move.get_proposal(walkers, np.random.RandomState(rng.integers(2**31)))
    gain = posterior.log_probability(proposed) - posterior.log_probability(walkers) + log_ratio
    return float(np.exp(np.minimum(gain, 0)).mean())


def _sample(
    context: Context, posterior: Posterior, backends: list[BlockBackend], starts: list[np.ndarray], independent: float
) -> tuple[int, float]:
    """Lengthen all ensembles block by block until they are long enough; return the steps and the autocorrelation time.

    Only as many steps count as a fresh run would have made, however long the chain is already.
    """
    settings = context.settings
    seeds = [context.rng(f"moves{i}").integers(2**31) for i in range(len(backends))]
    steps = 0
    while True:
        steps = min(steps + settings.block, settings.max_steps)
        for backend, start, seed in zip(backends, starts, seeds, strict=True):
            if backend.iteration < steps:
                _extend(backend, posterior, start, int(seed), independent, steps - backend.iteration)
        tau, ess = _mixing(backends, steps)
        progress = min(1.0, steps / (ENOUGH_TAU * tau), ess / settings.ess)
        context.advance(progress)
        if progress >= 1 or steps >= settings.max_steps:
            return steps, tau


def _extend(
    backend: BlockBackend, posterior: Posterior, start: np.ndarray, seed: int, independent: float, steps: int
) -> None:
    block = emcee.backends.Backend()
    sampler = emcee.EnsembleSampler(
        *start.shape,
        posterior.log_probability,
        vectorize=True,
        backend=block,
        moves=moves(posterior.folded, independent),
    )
    if backend.iteration:
        state = backend.get_last_sample()
    else:
        state = emcee.State(start, random_state=np.random.RandomState(seed).get_state())
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    backend.append(block, sampler.random_state)


def _mixing(backends: list[BlockBackend], steps: int) -> tuple[float, float]:
    """Longest autocorrelation time of the first steps, and the effective sample size that goes with it."""
    chain = joined(backends, steps // 4, steps)
    moved = np.ptp(chain, axis=1).all(axis=2)  # a walker that never moved has no autocorrelation
    if not moved.any(axis=1).all():
        return np.inf, 0.0
    taus = [emcee.autocorr.integrated_time(ensemble[:, own], tol=0) for ensemble, own in zip(chain, moved, strict=True)]
    tau = max(1.0, float(np.max(taus)))
    return tau, chain.shape[0] * chain.shape[1] * chain.shape[2] / tau


def _posterior(values: np.ndarray, chain: np.ndarray, known: Identified) -> pd.DataFrame:
    """Summary of each parameter; the noise level as a factor on the noise that identify used.

    R-hat compares the ensembles, each flattened, since only they are independent; the effective sample size counts the
    autocorrelation of each walker (both rank-normalised, Vehtari et al. 2021).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats.base import array_stats

    n_ensembles, n_steps, n_walkers, n = values.shape
    values = np.concatenate([values[..., :-1], np.exp(values[..., -1:])], axis=-1)
    flat = values.reshape(-1, n)
    by_ensemble = values.reshape(n_ensembles, n_steps * n_walkers, n)
    by_walker = values.transpose(0, 2, 1, 3).reshape(n_ensembles * n_walkers, n_steps, n)
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
        }
    )
    return typed(made, PosteriorRow)


def _predictive(values: np.ndarray, known: Identified, data: Measurements, rng: np.random.Generator) -> pd.DataFrame:
    """Each row's error against the interval in which the posterior and the noise say it should be; rows left out are not in it."""
    data = data.only(data.train | data.held_out)
    flat = values.reshape(-1, values.shape[-1])
    draws = flat[rng.choice(len(flat), size=min(DRAWS, len(flat)), replace=False)]
    sigma = known.noise(data).total
    centre = errors(known.model, flat[:, :-1].mean(axis=0), data)
    error = 1e3 * distances(centre)
    expected = np.empty((len(draws), len(data)))
    for k, draw in enumerate(draws):
        noise = (np.exp(draw[-1]) * sigma)[:, None] * rng.standard_normal(centre.shape)
        expected[k] = 1e3 * distances(errors(known.model, draw[:-1], data) + noise - centre)
    low, middle, high = np.quantile(expected, [0.025, 0.5, 0.975], axis=0)
    table = data.table[["pose", "repeat", "marker", "split"]].assign(
        error_mm=error, expected_mm=middle, low_mm=low, high_mm=high, covered=(error >= low) & (error <= high)
    )
    heldout = table[table["split"] == "holdout"]
    coverage = heldout["covered"].mean() if len(heldout) else np.nan
    return typed(table.assign(heldout_coverage=coverage), PredictedError)


def _summary(
    table: pd.DataFrame, values: np.ndarray, known: Identified, laplace: Laplace, steps: int, discard: int, tau: float,
    accepted: float | None, settings: SampleSettings,
) -> ChainSummary:  # fmt: skip
    ratio = (table["sd"].to_numpy()[:-1] / np.sqrt(np.diag(laplace.covariance)))[~known.at_bound]
    cut = []
    for i, parameter in enumerate(known.model.parameters):
        sample = values[..., i].ravel()
        near = NEAR_BOUND * sample.std()
        if ((sample - parameter.lower < near) | (parameter.upper - sample < near)).mean() > CUT:
            cut.append(Cut(parameter=parameter.name, unit=parameter.unit, lower=parameter.lower, upper=parameter.upper))
    return ChainSummary(
        steps=steps,
        burn_in_steps=discard,
        ensembles=values.shape[0],
        walkers=values.shape[2],
        autocorrelation_steps=tau,
        acceptance_independent=accepted,
        worst_rhat=table["rhat"].max(),
        smallest_ess=table["ess"].min(),
        sd_over_laplace_least=ratio.min() if len(ratio) else None,
        sd_over_laplace_most=ratio.max() if len(ratio) else None,
        missing_steps=_missing_steps(steps, tau, table["ess"].min(), settings),
        cut=tuple(cut),
    )


def _missing_steps(steps: int, tau: float, ess: float, settings: SampleSettings) -> int:
    """About how many more steps are needed for enough autocorrelation times and samples; 0 where there are enough."""
    missing = int(np.ceil(min(ENOUGH_TAU * tau, 1e9))) - steps
    if missing <= 0 and ess >= settings.ess:
        return 0
    return max(missing, int(np.ceil(steps * (settings.ess / ess - 1))))


STAGE = Stage(
    "sample",
    "sample the posterior",
    SampleSettings,
    run,
    needs=("identify",),
    uses=("diagnose",),
    resumes=("sample/chain.h5",),
    tables={"sample/posterior.csv": PosteriorRow, "sample/predictive.csv": PredictedError},
    documents={"sample/summary.json": ChainSummary},
    problems=problems,
)
