"""Effective samples per second of the processor, calflow's moves against emcee's default: the HH800, and with bounds active.

    python benchmarks/sampling.py --seed 0

Two posteriors: as measured, and with joints that do not give way, whose stiffness is at its bound. emcee's default moves are
tried in the parameters and in calflow's coordinates.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import emcee
import numpy as np
import pandas as pd

from calflow.estimation.fit import Fit, fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import measured_noise
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.sampling.log_posterior import Laplace, LogPosterior, move_mixture
from calflow.study import load_study

STUDY = Path(__file__).parents[1] / "studies" / "hh800" / "study.toml"
NOISE = 3e-5  # m, per axis, of the robot whose joints do not give way
LONG, SHORT = 4000, 800  # steps


def main() -> None:
    """Print one line a mixture, for each of two posteriors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="of the noise, the starts and the moves")
    parser.add_argument("--out", type=Path, help="CSV to write the table to")
    options = parser.parse_args()
    measured = _fitted(None)
    rows = _compared("as measured", measured, options.seed)
    rows += _compared("joints that do not give way", _fitted(_stiff(measured, options.seed)), options.seed)
    if options.out:
        pd.DataFrame(rows).to_csv(options.out, index=False)


def _fitted(positions: np.ndarray | None) -> Fit:
    """Fit the study's training rows, or other positions (n, 3) [m] at the same poses."""
    study = load_study(STUDY)
    data = study.measurements()
    train = data.only(data.train)
    if positions is not None:
        train = Measurements(train.robot, train.table.assign(**dict(zip("xyz", positions.T, strict=True)), sigma=NOISE))
    model = build(study.robot, study.file.effects, data.given)
    return fit(LeastSquares.of(model, train, measured_noise(train)))[0]


def _stiff(found: Fit, seed: int) -> np.ndarray:
    """Where a tracker would see the robot if none of its joints gave way: compliances are at their bound, or near it by noise."""
    springs = np.array([parameter.symbol == "s" for parameter in found.model.parameters])
    (block,) = found.problem.blocks
    exact = found.model.position(np.where(springs, 0.0, found.estimate), block.conditions)
    return np.asarray(exact + NOISE * np.random.default_rng(seed).standard_normal(exact.shape))


def _compared(name: str, found: Fit, seed: int) -> list[dict[str, object]]:
    posterior = LogPosterior.about(found.problem, Laplace.of(found.problem, found.estimate))
    n, active = posterior.n_dimensions, int(found.at_bound.sum())
    start = np.random.default_rng(seed).standard_normal((2 * n, n))
    print(
        f"{name}: {n} dimensions, {active} estimates at a bound, {posterior.coordinates.n_cut} parameters transformed"
    )
    print(f"{'':40} {'steps':>6} {'tau':>7} {'effective samples/s':>20}")

    def plain(x: np.ndarray) -> np.ndarray:
        return np.sum(posterior.densities_at(x), axis=0)

    def same(x: np.ndarray) -> np.ndarray:
        return x

    def own(u: np.ndarray) -> np.ndarray:
        return posterior.densities(u)[0]

    mapped = posterior.parameters
    mixtures: dict[str, tuple[list | None, int, Callable, Callable]] = {
        "stretch (emcee's default), parameters": (None, LONG, plain, same),
        "stretch (emcee's default), coordinates": (None, LONG, own, mapped),
        "differential evolution, coordinates": (move_mixture(0.0), LONG, own, mapped),
        "independent t + DE (calflow)": (move_mixture(0.9), SHORT, own, mapped),
    }
    rows = []
    for mixture, (chosen, steps, density, parameters) in mixtures.items():
        first = mapped(start) if parameters is same else start
        density(first)  # compile before the clock runs
        sampler = emcee.EnsembleSampler(len(start), n, density, vectorize=True, moves=chosen)
        state = emcee.State(first, random_state=np.random.RandomState(seed).get_state())
        started = time.process_time()
        sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        seconds = time.process_time() - started
        chain = parameters(sampler.get_chain(discard=steps // 4))
        tau = float(np.max(emcee.autocorr.integrated_time(chain, tol=0)))
        rate = len(start) * steps / tau / seconds
        print(f"{mixture:40} {steps:6} {tau:7.1f} {rate:20.0f}", flush=True)
        rows.append(
            {"posterior": name, "at_bound": active, "moves": mixture, "steps": steps, "tau": tau, "per_second": rate}
        )
    first, other, *_, best = (row["per_second"] for row in rows)
    print(f"calflow's mixture gives {best / first:.0f} times the effective samples per second of emcee's default in the "
          f"parameters, {best / other:.0f} times in the coordinates\n")  # fmt: skip
    return rows


if __name__ == "__main__":
    main()
