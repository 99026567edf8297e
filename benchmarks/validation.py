"""Validation: how often further poses are within a tolerance that they were stated to be within with a probability of 0.9.

python benchmarks/validation.py [SIMULATIONS]     (500)

A simulated robot of the 210 kg class is calibrated on 100 poses, or left as its maker says; poses anywhere in its joints' range are
measured, the tolerance is the one for which `validate` states 0.9, and as many further poses as that is about are measured after.
Calibrated errors are mostly noise, nominal ones differ widely from pose to pose and hang together where poses are near.
"""

from __future__ import annotations

import sys
from itertools import product

import numpy as np
from drift import EFFECTS, NOISE, industrial, measured, truth
from scipy.optimize import brentq

import calflow as cf
from calflow.deployment.alignment import Alignment, restored
from calflow.deployment.tolerance import Errors
from calflow.design.candidates import candidates
from calflow.model import build

STATED = 0.9
CASES = ((5, 1), (5, 5), (12, 1), (12, 12), (40, 1), (40, 40))  # poses measured, further poses asked for


def stated_limit(known: Errors, further: int) -> float:
    """The tolerance within which so many further poses are stated to be with STATED."""
    one = known.reached_by(STATED)
    if further == 1:
        return one
    return float(brentq(lambda tolerance: known.within(tolerance, further) - STATED, one, 1e3 * one, xtol=1e-3 * one))


def is_right(true: np.ndarray, expected: np.ndarray, poses: int, fitted: bool, rng: np.random.Generator) -> bool:
    """Whether the poses after the first ones (n, 3) [m] are within what these state."""
    seen = true + NOISE * rng.standard_normal(true.shape)
    error = seen - expected
    if fitted:
        frame = Alignment.best(seen[:poses], expected[:poses], np.ones(poses))
        error = frame.of(seen) - expected
        error[:poses] = restored(error[:poses], seen[:poses])
    size = np.linalg.norm(error, axis=1)
    known = Errors.of(size[:poses], 2.0 if fitted else 0.0)
    return bool((size[poses:] <= stated_limit(known, len(true) - poses)).all())


def main(simulations: int) -> None:
    """Print the share that was right, which is to be 0.87 to 0.93."""
    robot = industrial()
    model, rng = build(robot, EFFECTS), np.random.default_rng(11)
    p = truth(model, rng)
    q = candidates(model, 100, "load", "E", None, rng)[0]
    fit = cf.identify(robot, measured(model, p, q, rng).split(0.0, 1), EFFECTS, starts=1)
    _, rows = candidates(model, 20000, "load", "E", None, rng)
    true = model.point(p, rows)
    estimates = {"calibrated": fit.identification.known.estimate, "nominal": model.nominal}
    print(f"stated {STATED}; {simulations} simulations a figure\nerrors      frame   poses  further  right")
    for (name, estimate), fitted, (poses, further) in product(estimates.items(), (False, True), CASES):
        expected = model.point(estimate, rows)
        drawn = [rng.choice(len(true), poses + further, replace=False) for _ in range(simulations)]
        right = np.mean([is_right(true[own], expected[own], poses, fitted, rng) for own in drawn])
        print(f"{name:10s}  {'fitted' if fitted else 'known':6s}  {poses:5d}  {further:7d}  {right:5.3f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
