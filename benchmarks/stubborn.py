"""What a misfit costs that no catalogue has: the processor's seconds of a diagnosis, refits, and models that were fitted twice.

    python benchmarks/stubborn.py --poses 200 --seed 1    (2600)

A seven-axis arm of foreign_physics.py, three markers and three loads. Three of its joints err by a smooth function of three angles
each, together by 5 noises at the tool, which no catalogue has. Counted are the models with causes that are fitted, and those of
causes that were fitted together before, with the same noise. Linear algebra has one thread, as in the program: waiting ones count
as work.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from foreign_physics import ARMS, Yielding, measured_rows, points, worn
from foreign_study import identified, write_study

from calflow.diagnosis import fitted
from calflow.effects.cause import Cause
from calflow.estimation.noise import Noise
from calflow.measurements.measurements import Measurements
from calflow.model import Model

ARM, SIGMA, NOISES, ERRING = "arm-7", 2e-5, 5.0, (1, 3, 4)
TINY = 1e-6  # rad, by which a displacement is told


def main() -> None:
    """Write a case, diagnose it, and print what it took."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--poses", type=int, default=200)
    asked.add_argument("--seed", type=int, default=1)
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        study = Path(folder) / "case"
        write(study, given.poses, np.random.default_rng(given.seed))
        fits = counted()
        begun = time.process_time()
        first = identified(study)
        between = time.process_time()
        last = first.diagnose()
        ended = time.process_time()
    table = last.findings.table
    print(f"{between - begun:.1f} s to identify, {ended - between:.1f} s to diagnose, {given.poses} x 3 points")
    print(f"{sum(fits.values())} refits, {sum(n - 1 for n in fits.values())} of a model that was fitted before")
    print(table[["status", "cause", "joint"]].to_string() if len(table) else "nothing found")


def write(folder: Path, poses: int, rng: np.random.Generator) -> None:
    """Write the study: markers seen at random poses under three loads."""
    arm = ARMS[ARM]
    rows = measured_rows(arm, poses, rng, markers=3)
    waves = [(rng.choice(arm.n, 3, replace=False), rng.uniform(0.7, 1.5, 3), rng.uniform(0, 6, 3)) for _ in ERRING]
    error = np.zeros_like(rows.q)
    for joint, (of, rate, phase) in zip(ERRING, waves, strict=True):
        error[:, joint] = np.prod(np.sin(rate * rows.q[:, of] + phase), axis=1)
    real, still = worn(arm, rng), Yielding.none(len(rows), arm.n)
    moved, exact = (points(real, rows, [lambda *_, k=k: replace(still, joint=k * error)]) for k in (TINY, 0.0))
    moved -= exact
    size = NOISES * SIGMA / np.sqrt(np.mean(moved**2))
    seen = exact + size * moved + SIGMA * rng.standard_normal(exact.shape)
    write_study(folder, arm, rows, seen, sigma=SIGMA, columns={"approach", "travel", "time", "temperature"})


def counted() -> Counter[object]:
    """Count the models that are fitted with causes from now on."""
    fits: Counter[object] = Counter()
    settled = fitted._settled

    def counting(model: Model, data: Measurements, device: Noise, *further):  # type: ignore[no-untyped-def]
        if causes := frozenset(effect for effect in model.effects if isinstance(effect, Cause)):
            fits[causes, device.sigma.tobytes()] += 1
        return settled(model, data, device, *further)

    fitted._settled = counting
    return fits


if __name__ == "__main__":
    main()
