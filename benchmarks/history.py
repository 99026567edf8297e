"""What `calflow history` promises: false alarms over all parameters and runs, and steps found, by size.

python benchmarks/history.py --cases 500 --seed 1 [--out FILE.csv]
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd

from calflow.deployment.history import changes
from calflow.estimation.difference import LikelihoodEstimate

N, RUNS, READINGS, SIGMA = 20, 6, 120, 0.5
STEP_AFTER, MOVED = 2, 4  # the run after which a parameter moves, and which one
SIZES = (0.0, 2.0, 4.0, 6.0, 8.0, 12.0)  # of the step, in standard deviations of one run's estimate
ALARMS = (0.01, 0.05, 0.1)


def calibrated(truth: np.ndarray, prior: np.ndarray, rng: np.random.Generator) -> LikelihoodEstimate:
    """Least squares with a prior; each parameter is correlated with the next one, and poses differ from run to run."""
    common = rng.standard_normal((READINGS, N + 1))
    design = (common[:, :-1] + 2.0 * common[:, 1:]) / prior
    design[:, MOVED + 1] = (design[:, MOVED] * prior[MOVED] + 0.5 * rng.standard_normal(READINGS)) / prior[MOVED + 1]
    read = design @ truth + SIGMA * rng.standard_normal(READINGS)
    covariance = np.linalg.inv(design.T @ design / SIGMA**2 + np.diag(prior**-2.0))
    return LikelihoodEstimate.of(covariance @ (design.T @ read) / SIGMA**2, covariance, np.zeros(N), prior)


def case(size: float, alarm: float, rng: np.random.Generator) -> dict[str, float]:
    """One history: whether anything that stayed was said to have moved, and whether what moved was found, and at its run."""
    prior = 1e-3 * np.exp(rng.standard_normal(N))
    robot = prior * rng.standard_normal(N)
    sd = calibrated(robot, prior, rng).sd[MOVED]
    truths = np.tile(robot, (RUNS, 1))
    truths[STEP_AFTER + 1 :, MOVED] += size * sd
    found = changes([calibrated(truth, prior, rng) for truth in truths], alarm, rng)
    own = [one for one in found if one.parameter == MOVED]
    wrong = [one for one in found if one.parameter != MOVED or size == 0]
    return {"size_sd": size, "false_alarm": alarm, "wrong": bool(wrong), "found": bool(own),
            "at_its_run": any(one.after == STEP_AFTER for one in own)}  # fmt: skip


def main() -> None:
    """Print shares of histories by size and false alarm."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out")
    asked = parser.parse_args()
    rows = [
        case(size, alarm, np.random.default_rng([asked.seed, k, i, j]))
        for k in range(asked.cases) for i, size in enumerate(SIZES) for j, alarm in enumerate(ALARMS)
        if alarm == ALARMS[0] or size in (SIZES[0], SIZES[-1])
    ]  # fmt: skip
    table = pd.DataFrame(rows).groupby(["false_alarm", "size_sd"]).mean().reset_index()
    print(table.to_string(index=False))
    if asked.out:
        table.to_csv(asked.out, index=False)


if __name__ == "__main__":
    main()
