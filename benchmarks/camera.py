"""Cameras: the processor's seconds of identifying an arm of seven joints by so many images, lens free.

python benchmarks/camera.py --images 500 1000 2000 [--seed 3]

A Panda holds a board of 48 points before a camera that stands beside it, by a chain and a pinhole with distortion apart from
calflow's graph; 0.2 px of noise, three images in ten held out. Reading the file is not in it, finding lens, camera and board is.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from calflow.estimation.identification import fit_effects
from observations.photographed import BESIDE, IN_GRIPPER, PANDA, SIZE, Optics, Photographs, board, looking
from observations.test_camera import study

BEGUN, JITTER, NOISE = 20, 0.06, 0.2  # poses that the others are near to; rad; px


def many(images: int, rng: np.random.Generator) -> Photographs:
    """So many photographs, at poses near to a few."""
    points, lens, worn = board(), Optics(), PANDA.worn(rng)
    begun = looking(PANDA, points, False, BEGUN, rng)
    near = begun[rng.integers(BEGUN, size=4 * images)] + JITTER * rng.standard_normal((4 * images, 7))
    q = np.clip(near, *PANDA.limits.T)
    seen = np.linalg.inv(BESIDE) @ worn.links(q)[-1] @ IN_GRIPPER
    there = np.einsum("nij,kj->nki", seen[:, :3, :3], points) + seen[:, None, :3, 3]
    image = lens.image(there.reshape(-1, 3)).reshape(len(q), -1, 2)
    kept = np.flatnonzero(((image > 0) & (image < SIZE)).all(axis=(1, 2)))[:images]
    shown = image[kept].reshape(-1, 2) + NOISE * rng.standard_normal((len(kept) * len(points), 2))
    rows = {"pose": np.repeat(np.arange(1, len(kept) + 1), len(points)), "u_px": shown[:, 0], "v_px": shown[:, 1]}
    rows |= {f"q{i + 1}_rad": np.repeat(q[kept, i], len(points)) for i in range(7)}
    rows |= {f"px_{axis}_mm": np.tile(1e3 * points[:, i], len(kept)) for i, axis in enumerate("xyz")}
    return Photographs(pd.DataFrame(rows), worn, BESIDE, IN_GRIPPER, lens)


def main() -> None:
    """Print seconds and what is left, for each number of images."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--images", type=int, nargs="+", default=[500, 1000, 2000])
    asked.add_argument("--seed", type=int, default=3)
    given = asked.parse_args()
    print("images   rows  seconds  held out [px]")
    for images in given.images:
        made = many(images, np.random.default_rng(given.seed))
        with tempfile.TemporaryDirectory() as folder:
            data = study(Path(folder), made, "franka-panda", False).measurements()
            begun = time.process_time()
            found = fit_effects(data, ["geometry"], starts=1)
            seconds = time.process_time() - begun
        left = next(row.rms for row in reversed(found.steps) if row.split == "holdout")
        print(f"{images:6} {len(made.rows):6} {seconds:8.1f} {left:14.3f}", flush=True)


if __name__ == "__main__":
    main()
