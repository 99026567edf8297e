"""The sample: independent ensembles of walkers, lengthened block by block until they are long enough."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import emcee
import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel, with_maps_held
from calflow.estimation.progress import SAME, Advance, Draws, Say, nobody
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.sampling.backend import KEPT, BlockBackend, joined, joined_kept, open_ensembles
from calflow.sampling.models import WeighedModels, weighed_models
from calflow.sampling.posterior import Laplace, Posterior, moves, posterior_of

ENOUGH_TAU = 50  # autocorrelation times that a chain must be long
CHAIN = 0.7  # share of the work where models are weighed after it
LOW_ACCEPTANCE = 0.1  # below this the independent proposal only wastes evaluations


@dataclass(frozen=True)
class ChainLength:
    """How long a chain is to be, and its mixture of moves.

    Each of the ensembles has so many walkers (None: twice the dimensions); they are lengthened by block steps until there are
    ess effective samples, max_steps at most. independent is the share of the independence proposal.
    """

    ensembles: int = 4
    walkers: int | None = None
    block: int = 50
    max_steps: int = 2000
    ess: int = 4000
    independent: float = 0.8


@dataclass(frozen=True, eq=False)
class Sampled:
    """A sampled posterior.

    known is the model without what was held, data the rows (all of them), chain (n_ensembles, n_steps, n_walkers, n_dimensions)
    the walkers after the burn-in in scaled coordinates, log_prior and log_likelihood (n_ensembles, n_steps, n_walkers) theirs, up
    to a constant; steps, discard and tau [steps] are those made, left out at the start, and until a walker forgets; accepted is
    the share of independent proposals that are, None where there are none. models are those that may be right as well.
    """

    known: CalibratedModel
    data: Measurements
    posterior: Posterior
    laplace: Laplace
    chain: np.ndarray
    log_prior: np.ndarray
    log_likelihood: np.ndarray
    steps: int
    discard: int
    tau: float
    accepted: float | None
    length: ChainLength
    models: WeighedModels

    @cached_property
    def values(self) -> np.ndarray:
        """The walkers in the parameters' units [SI], the last of them the log of the noise's factor; shape as chain."""
        return self.posterior.parameters(self.chain)


def sample(
    known: CalibratedModel,
    data: Measurements,
    path: Path,
    length: ChainLength = ChainLength(),
    *,
    rng: Draws = SAME,
    say: Say = nobody,
    advance: Advance = nobody,
) -> Sampled:
    """Sample the posterior with independent ensembles until it is long enough, or as long as it may be.

    Args:
        known: the model to sample; causes of very many parameters are held at their estimates.
        data: the rows it was identified from, gross mistakes put right.
        path: the chain's file, which is gone on from where it ends.
        length: how long it is to be.
        rng: draws starts and moves.
        say: is told what is held, and what is accepted.
        advance: is told the share of work done.

    Raises:
        InputError: the walkers are too few.
    """
    known, held = with_maps_held(known)
    if held:
        say(f"held at their estimates, too many to sample: {', '.join(f'{c.id} {c.part}' for c in held)}")
    data = data.on(known.model.robot)
    posterior, laplace = posterior_of(known, data)
    n = posterior.n_dimensions
    walkers = length.walkers or 2 * n
    if wrong := too_few_walkers(length.walkers, n):
        raise refuse(wrong, key="walkers")
    starts = [posterior.start(walkers, rng(f"ensemble{i}")) for i in range(length.ensembles)]
    accepted = _acceptance(posterior, starts[0], rng("pilot"))
    independent = length.independent if accepted > LOW_ACCEPTANCE else 0.0
    say(f"independence proposal accepted {accepted:.0%}" + ("" if independent else ": differential evolution alone"))

    path.parent.mkdir(parents=True, exist_ok=True)
    backends = open_ensembles(path, length.ensembles, (walkers, n), independent, say)
    seeds = [int(rng(f"moves{i}").integers(2**31)) for i in range(len(backends))]
    share = CHAIN if known.in_reach else 1.0
    steps, tau = _lengthen(posterior, backends, starts, seeds, independent, length, lambda done: advance(share * done))
    discard = min(steps // 4, int(min(5 * tau, steps)))
    chain, kept = joined(backends, discard, steps), joined_kept(backends, discard, steps)
    models = weighed_models(known, posterior.problem, rng("models"), lambda done: advance(share + (1 - share) * done))
    prior, likelihood = kept["log_prior"], kept["log_likelihood"]
    return Sampled(
        known, data, posterior, laplace, chain, prior, likelihood, steps, discard, tau, accepted if independent else None,
        length, models,
    )  # fmt: skip


def too_few_walkers(walkers: int | None, n_dimensions: int) -> str:
    """Say that an ensemble has too few walkers; empty where it has enough, or as many as are needed (None)."""
    if walkers is None or walkers >= 2 * n_dimensions:
        return ""
    return f"{walkers} walkers are too few for {n_dimensions} dimensions: expected at least {2 * n_dimensions}"


def _acceptance(posterior: Posterior, walkers: np.ndarray, rng: np.random.Generator) -> float:
    """Mean acceptance of one independent proposal from each start."""
    move = moves(1.0)[0][0]
    proposed, log_ratio = move.get_proposal(walkers, np.random.RandomState(rng.integers(2**31)))
    gain = posterior.log_probability(proposed) - posterior.log_probability(walkers) + log_ratio
    return float(np.exp(np.minimum(gain, 0)).mean())


def _lengthen(
    posterior: Posterior, backends: list[BlockBackend], starts: list[np.ndarray], seeds: list[int], independent: float,
    length: ChainLength, advance: Advance,
) -> tuple[int, float]:  # fmt: skip
    """Lengthen all ensembles block by block until they are long enough; return the steps and the autocorrelation time.

    Only as many steps count as a fresh run would have made, however long the chain is already.
    """
    steps = 0
    while True:
        steps = min(steps + length.block, length.max_steps)
        for backend, start, seed in zip(backends, starts, seeds, strict=True):
            if backend.iteration < steps:
                _extend(backend, posterior, start, seed, independent, steps - backend.iteration)
        tau, ess = _mixing(backends, steps)
        progress = min(1.0, steps / (ENOUGH_TAU * tau), ess / length.ess)
        advance(progress)
        if progress >= 1 or steps >= length.max_steps:
            return steps, tau


def _extend(
    backend: BlockBackend, posterior: Posterior, start: np.ndarray, seed: int, independent: float, steps: int
) -> None:
    def densities(u: np.ndarray) -> list[tuple[float, float, float]]:
        return list(zip(*posterior.densities(u), strict=True))

    block = emcee.backends.Backend()
    sampler = emcee.EnsembleSampler(
        *start.shape,
        densities,
        vectorize=True,
        backend=block,
        blobs_dtype=KEPT,
        moves=moves(independent),
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
