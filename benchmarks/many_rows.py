"""Many rows diagnosed: processor's seconds, peak memory, and what is found of two causes hidden in them.

python benchmarks/many_rows.py --rows 10000 30000 100000 [--markers 1] [--seed 5]

An HH800 that physics apart from calflow's graph measures, a quarter of its poses held out: play of joint 2 (100 µrad) and joint 3
running out of true (150 µrad), three payloads, 0.04 mm of noise an axis.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from hidden.case import Case, write_case
from hidden.causes import Hidden

HIDDEN = (Hidden("joint-eccentricity", 3, 150e-6), Hidden("joint-backlash", 2, 100e-6))
RUN = """
import resource, sys, time
from calflow.runs.run import run
from calflow.study import load_study
study = load_study(sys.argv[1])
for stage in ("identify", "diagnose"):
    begun, clock = time.process_time(), time.monotonic()
    run(study, sys.argv[2], stage, True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{stage}: {time.process_time() - begun:.1f} s of the processor, {time.monotonic() - clock:.1f} s by the clock, "
          f"{peak:.2f} GB", file=sys.stderr, flush=True)
"""


def main() -> None:
    """Print some lines a size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, nargs="+", default=[10_000, 30_000, 100_000])
    parser.add_argument("--markers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=5)
    asked = parser.parse_args()
    for rows in asked.rows:
        with tempfile.TemporaryDirectory() as folder:
            study, out = Path(folder, "study"), Path(folder, "run")
            case = Case(
                name="many", robot="hh800", hidden=HIDDEN, poses=rows // asked.markers, markers=asked.markers,
                columns=("approach", "time"), seed=asked.seed,
            )  # fmt: skip
            write_case(study, case, np.random.default_rng(asked.seed))
            print(f"{rows} rows", flush=True)
            subprocess.run([sys.executable, "-c", RUN, str(study), str(out)], check=True, stdout=subprocess.DEVNULL)
            found = pd.read_csv(out / "diagnose" / "findings.csv")
            print(found[["status", "cause", "joint", "estimate", "sd", "heldout_mean_mm"]].to_string(index=False))


if __name__ == "__main__":
    main()
