"""Sampling of the posterior with emcee: independent ensembles of walkers, extended in blocks until they have converged."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.progress import SAME, Advance, Draws, Say, nobody
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.sampling.chain import BLOBS, Chain, ChainLength
from calflow.sampling.log_posterior import LogPosterior, log_posterior_of, move_mixture, propose_student
from calflow.sampling.posterior import Posterior, effective_samples

WINDOW = 5.0  # window of the autocorrelation sum, in autocorrelation times (Sokal 1997)
LOW_ACCEPTANCE = 0.1  # acceptance below which independence proposals waste evaluations
GROWN = 1.2  # growth after which a chain is written again: writing a long one after every block took most of the time

STANDARD = ChainLength()


def sample(
    calibrated: CalibratedModel,
    data: Measurements,
    path: Path,
    length: ChainLength = STANDARD,
    *,
    rng: Draws = SAME,
    say: Say = nobody,
    advance: Advance = nobody,
) -> Posterior:
    """Return the posterior, sampled with independent ensembles until they are long enough or reach the maximum length.

    Args:
        calibrated: the model to sample; causes with very many parameters are held at their estimates.
        data: the rows it was identified from, with gross mistakes corrected.
        path: the chain's file; an existing chain is continued.
        length: required length of the chain.
        rng: random numbers for starts and moves.
        say: receives messages on held causes and acceptance.
        advance: receives the share of work done.

    Raises:
        InputError: there are too few walkers.
    """
    calibrated, held = calibrated.with_maps_held()
    if held:
        say(f"held at their estimates, too many to sample: {', '.join(f'{c.id} {c.part}' for c in held)}")
    data = data.on(calibrated.model.robot)
    log_posterior, laplace = log_posterior_of(calibrated, data)
    n = log_posterior.n_dimensions
    walkers = length.walkers or 2 * n
    if message := too_few_walkers(length.walkers, n):
        raise refuse(message, key="walkers")
    # A walker beyond a bound, at zero density, takes the first proposal within.
    starts = [rng(f"ensemble{i}").standard_normal((walkers, n)) for i in range(length.ensembles)]
    accepted = _acceptance(log_posterior, starts[0], rng("pilot"))
    independent = length.independent if accepted > LOW_ACCEPTANCE else 0.0
    say(
        f"{accepted:.0%} of draws from the normal approximation would be accepted: "
        + ("used" if independent else "too few, not used")
    )

    chain = Chain.open(path, length.ensembles, (walkers, n), independent, say)
    seeds = [int(rng(f"moves{i}").integers(2**31)) for i in range(length.ensembles)]
    steps, tau, ess = _lengthen(log_posterior, chain, starts, seeds, length, advance)
    discard = _burn_in(steps, tau)
    points = log_posterior.parameters(chain.walkers(discard, steps))
    return Posterior(
        calibrated, data, points, chain.densities(discard, steps), laplace.sd, ess, steps, discard, tau,
        accepted if independent else None, length, rng,
    )  # fmt: skip


def too_few_walkers(walkers: int | None, n_dimensions: int) -> str:
    """Return a message if an ensemble has too few walkers; empty if it has enough, or None for the default number."""
    if walkers is None or walkers >= 2 * n_dimensions:
        return ""
    return f"{walkers} walkers are too few for {n_dimensions} dimensions: expected at least {2 * n_dimensions}"


def _burn_in(steps: int, tau: float) -> int:
    return min(steps // 4, int(min(5 * tau, steps)))


def _acceptance(log_posterior: LogPosterior, walkers: np.ndarray, rng: np.random.Generator) -> float:
    """Return the mean acceptance probability of one independence proposal from each start."""
    proposed, log_ratio = propose_student(walkers, np.random.RandomState(rng.integers(2**31)))
    gain = log_posterior.densities(proposed)[0] - log_posterior.densities(walkers)[0] + log_ratio
    return float(np.exp(np.minimum(gain, 0)).mean())


def _lengthen(
    log_posterior: LogPosterior, chain: Chain, starts: Sequence[np.ndarray], seeds: Sequence[int], length: ChainLength,
    advance: Advance,
) -> tuple[int, float, np.ndarray]:  # fmt: skip
    """Extend all ensembles in blocks until they are long enough; return steps, autocorrelation time, and sample sizes (n,).

    Of a continued chain only as many steps count as a fresh run would have made.
    """
    steps, kept = 0, min(ensemble.iteration for ensemble in chain.ensembles)
    while True:
        steps = min(steps + length.block, length.max_steps)
        for number, (start, seed) in enumerate(zip(starts, seeds, strict=True)):
            _extend(chain, number, log_posterior, start, seed, steps)
        tau, rough_ess = _mixing(chain, steps)
        progress = length.share(steps, tau, rough_ess)
        ended = steps >= length.max_steps
        if progress >= 1 or ended:  # the exact effective sample size decides; it costs as much as some steps
            ess = effective_samples(log_posterior.parameters(chain.walkers(_burn_in(steps, tau), steps)))
            progress = min(progress, length.share(steps, tau, ess.min()))
            ended |= progress >= 1
        if steps > kept and (ended or steps >= GROWN * kept):
            chain.save()
            kept = steps
        advance(progress)
        if ended:
            return steps, tau, ess


def _extend(chain: Chain, number: int, log_posterior: LogPosterior, start: np.ndarray, seed: int, steps: int) -> None:
    def densities(u: np.ndarray) -> list[tuple[float, float, float]]:
        return list(zip(*log_posterior.densities(u), strict=True))

    import emcee

    ensemble = chain.ensembles[number]
    missing = steps - ensemble.iteration
    if missing <= 0:
        return
    if ensemble.iteration:
        state = ensemble.get_last_sample()
    else:
        state = emcee.State(start, random_state=np.random.RandomState(seed).get_state())
    sampler = emcee.EnsembleSampler(
        *start.shape, densities, vectorize=True, backend=ensemble, blobs_dtype=BLOBS, moves=move_mixture(chain.independent)
    )  # fmt: skip
    sampler.log_prob_fn = densities  # emcee's wrapper would print a traceback on interruption
    sampler.run_mcmc(state, missing, skip_initial_state_check=True)


def _mixing(chain: Chain, steps: int) -> tuple[float, float]:
    """Return the longest autocorrelation time of the first steps, and the effective sample size by it."""
    walkers = chain.walkers(steps // 4, steps)
    moved = np.ptp(walkers, axis=1).all(axis=2)  # a walker that never moved has no autocorrelation
    if not moved.any(axis=1).all():
        return np.inf, 0.0
    moving = walkers.swapaxes(1, 2)[moved]
    tau = max(1.0, *(_autocorrelation_time(moving[..., k].T) for k in range(moving.shape[-1])))
    return tau, walkers.shape[0] * walkers.shape[1] * walkers.shape[2] / tau


def _autocorrelation_time(values: np.ndarray) -> float:
    """Return emcee's integrated autocorrelation time of values (n_steps, n_walkers), by one transform for all walkers: quicker."""
    from emcee.autocorr import auto_window

    centred = (values - values.mean(axis=0)).T
    power = np.abs(np.fft.rfft(centred, n=2 * len(values))) ** 2
    correlation = np.fft.irfft(power, n=2 * len(values))[:, : len(values)]
    taus = 2 * np.cumsum((correlation / correlation[:, :1]).mean(axis=0)) - 1
    return float(taus[auto_window(taus, WINDOW)])
