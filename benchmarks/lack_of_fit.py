"""Lack of fit on clean data: how often its p-value is below 1 and 10 % where nothing is missing.

python benchmarks/lack_of_fit.py 2000      simulated linear fits, stated noise and repeats, normal and heavy tails
python benchmarks/lack_of_fit.py 40 robot  whole identifications of the hidden simulator's robot
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calflow.estimation.lack_of_fit import Evidence, lack_of_fit

PARAMETERS = 30
REPEATS = {
    "stated sigma, 120 poses": (120, 0, 1),
    "stated sigma, 400 poses": (400, 0, 1),
    "three repeats of 120 poses": (120, 120, 3),
    "two repeats of 60 poses": (60, 60, 2),
    "three repeats of 40 of 120 poses": (120, 40, 3),
    "four repeats of 10 of 120 poses": (120, 10, 4),
}
TAILS = {"normal": 0, "t, 5 degrees of freedom": 5, "t, 3 degrees of freedom": 3}


@dataclass(frozen=True)
class Design:
    """So many poses, of which the first are repeated so many times."""

    poses: int
    repeated: int
    times: int


def simulated(design: Design, degrees: int, rng: np.random.Generator) -> float:
    """Return the p-value of one linear fit to noise of unit variance; degrees 0 is a normal one."""
    count = np.where(np.arange(design.poses) < design.repeated, design.times, 1)
    mean, squared = np.empty((design.poses, 3)), np.zeros(design.poses)
    for times in np.unique(count):
        own, shape = count == times, (np.count_nonzero(count == times), times, 3)
        noise = (
            rng.standard_t(degrees, shape) / np.sqrt(degrees / (degrees - 2)) if degrees else rng.standard_normal(shape)
        )
        mean[own] = noise.mean(axis=1)
        squared[own] = ((noise - mean[own][:, None]) ** 2).sum(axis=(1, 2))
    freedom = 3.0 * (count - 1)
    sigma = np.sqrt(squared.sum() / freedom.sum()) if design.repeated else 1.0
    of_means = np.repeat(sigma / np.sqrt(count), 3)
    regressors = rng.standard_normal((3 * design.poses, PARAMETERS)) * (
        1 + rng.exponential(size=(design.poses, 1))
    ).repeat(3, 0)
    basis = np.linalg.qr(regressors / of_means[:, None])[0]
    whitened = mean.ravel() / of_means
    left = whitened - basis @ (basis.T @ whitened)
    poses = np.arange(design.poses)
    told = Evidence(squared / sigma**2, freedom, poses, count, 0 * poses)
    return lack_of_fit(left * of_means, of_means, PARAMETERS, poses.repeat(3), told).p


def identified(kind: str, repeats: int, seed: int) -> float:
    """Return the p-value of one identification of the hidden simulator's robot, without any hidden cause."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from calflow.estimation.identification import fit_effects
    from calflow.faults import examined
    from calflow.study import load_study
    from hidden.case import Case, write_case

    with tempfile.TemporaryDirectory() as folder:
        columns = ("approach",) if repeats > 1 else ("approach", "sigma")
        write_case(Path(folder), Case(noise=kind, repeats=repeats, columns=columns), np.random.default_rng(seed))
        study = load_study(Path(folder))
        data, _ = examined(study.measurements())
        return fit_effects(data, study.file.effects, starts=1).lack.p


def told(label: str, p: list[float]) -> None:
    """Print how often p-values are small, or large."""
    found = np.array(p)
    below = "  ".join(f"{100 * (found < at).mean():5.2f}" for at in (0.01, 0.1, 0.5, 0.9))
    print(f"{label:60s} {below}", flush=True)


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    print(f"{'share of p-values below [%]':60s}  0.01   0.10   0.50   0.90")
    if sys.argv[2:] == ["robot"]:
        for kind in ("gauss", "heavy", "range"):
            for repeats in (1, 3):
                told(
                    f"robot, {kind} noise, {repeats} repeats",
                    [identified(kind, repeats, seed) for seed in range(number)],
                )
    else:
        for name, sizes in REPEATS.items():
            for tail, degrees in TAILS.items():
                rng = np.random.default_rng(degrees)
                told(f"{name}, {tail}", [simulated(Design(*sizes), degrees, rng) for _ in range(number)])
