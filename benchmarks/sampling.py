"""Effective samples per second on the HH800's posterior: calflow's moves against emcee's default."""

from __future__ import annotations

import time
from pathlib import Path

import emcee
import numpy as np

from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.repeats import measured_noise
from calflow.model import build
from calflow.sampling.posterior import Laplace, Posterior, moves
from calflow.study import load_study

STUDY = Path(__file__).parents[1] / "studies" / "hh800" / "study.toml"


def main() -> None:
    """Print one line a mixture."""
    study = load_study(STUDY)
    data = study.measurements()
    train = data.only(data.train)
    problem = LeastSquares.of(build(study.robot, study.file.effects, data.given), train, measured_noise(train))
    result, _ = fit(problem)
    posterior = Posterior.about(problem, Laplace.of(problem, result.estimate, result.at_bound))
    n = posterior.n_dimensions
    start = posterior.start(2 * n, np.random.default_rng(0))
    posterior.log_probability(start)  # compile before the clock runs

    print(f"{'':28} {'steps':>6} {'tau':>7} {'effective samples/s':>20}")
    mixtures = {
        "stretch (emcee's default)": (None, 4000),
        "differential evolution": (moves(posterior.folded, 0.0), 4000),
        "independent t + DE (calflow)": (moves(posterior.folded, 0.8), 800),
    }
    rates = {}
    for name, (mixture, steps) in mixtures.items():
        sampler = emcee.EnsembleSampler(len(start), n, posterior.log_probability, vectorize=True, moves=mixture)
        state = emcee.State(start, random_state=np.random.RandomState(0).get_state())
        started = time.perf_counter()
        sampler.run_mcmc(state, steps)
        seconds = time.perf_counter() - started
        tau = float(np.max(emcee.autocorr.integrated_time(sampler.get_chain(discard=steps // 4), tol=0)))
        rates[name] = len(start) * steps / tau / seconds
        print(f"{name:28} {steps:6} {tau:7.1f} {rates[name]:20.0f}")
    first, *_, own = rates.values()
    print(f"calflow's mixture gives {own / first:.0f} times the effective samples per second of emcee's default")


if __name__ == "__main__":
    main()
