"""What calibrations without a tracker's positions are worth: simulated wires, sockets and stations, and real Panda arms.

    python benchmarks/observations.py [--robots 10] [--stations 200]

The Pandas need CALFLOW_DATA, the folder that holds mukca-panda.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from multiprocessing import Pool
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: a core a worker
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from calflow.robot.robot import Robot
from calflow.study import load_study
from hidden import trials

ROOT = Path(__file__).parents[1]
UR10 = ROOT / "studies" / "ur10-tmac" / "robot.toml"
PANDAS = {"panda_2": 1.00, "panda_4": 0.278}  # published mean consistency error [mm]
CORES = 2
Row = tuple[str, str, str]


def simulated(robots: int) -> Iterator[Row]:
    """The tool's error against what the information matrix promises, root mean square over robots drawn at random."""
    for what, observe in (
        ("wire alone, 60 lengths", trials.by_wire),
        ("two sockets, 60 touches each", trials.by_sockets),
    ):
        with Pool(CORES) as pool:
            errors = pool.starmap(trials.tool_error, [(_ur10(), observe, seed) for seed in range(robots)])
        true, promised = (
            float(np.sqrt(np.mean(np.square(values)))) for values in zip(*map(_pair, errors), strict=True)
        )
        yield (
            what,
            f"{1e3 * true:.3f} mm, promised {1e3 * promised:.3f} mm: {true / promised:.2f} times",
            "at most 1.3 times",
        )


def _pair(error: trials.Error) -> tuple[float, float]:
    return error.true, error.promised


def _ur10() -> Robot:
    return Robot.from_toml(UR10)


def _z(seeds: tuple[int, ...]) -> np.ndarray:
    stations = trials.Stations.of(_ur10())
    return np.array([stations.z(seed) for seed in seeds])


def stations(calibrations: int) -> Iterator[Row]:
    """How often intervals cover the truth."""
    every = np.arange(calibrations)
    with Pool(CORES) as pool:
        z = np.concatenate(pool.map(_z, [tuple(map(int, every[k::CORES])) for k in range(CORES)]))
    covered, within = (np.abs(z) < 1.96).mean(), (np.abs(z) < 3).mean()
    said = f"95 % intervals cover {100 * covered:.1f} %; {100 * within:.2f} % within 3 sd, the largest {np.abs(z).max():.1f} sd"
    yield (
        f"tracker in two stations, {calibrations} times {z.shape[1]} parameters",
        said,
        "93 to 97 %; 99.7 % within 3 sd",
    )


def pandas() -> Iterator[Row]:
    """Real arms, each placement left out in turn."""
    for name, published in PANDAS.items():
        study = load_study(ROOT / "studies" / "mukca-panda" / f"{name}.toml")
        for effects in (("geometry",), ("geometry", "gravity-deflection"), ()):
            found = trials.left_out_in_turn(study.measurements(), effects)
            what = " + ".join(effects) or "whichever has the better BIC on the fitted placements"
            took = f"; {np.median(found.seconds):.2f} s a fit (at most {max(found.seconds):.2f})" if effects else ""
            yield f"{name}, {what}", f"{1e3 * found.mean:.3f} mm{took}", f"{published} mm published; 2 s"


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--stations", type=int, default=200)
    asked = parser.parse_args()
    begin = time.perf_counter()
    rows = [*simulated(asked.robots), *stations(asked.stations)]
    if "CALFLOW_DATA" in os.environ:
        rows += pandas()
    print("| what | found | asked |\n| --- | --- | --- |")
    for row in rows:
        print(f"| {' | '.join(row)} |")
    print(f"\n{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
