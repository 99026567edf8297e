"""Identification of 100 poses, and of 100,000 rows with its peak memory: the stage as a user runs it."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

STUDY = Path(__file__).parents[1] / "studies" / "hh800"
RUN = """
import resource, sys
from calflow.runs.manifest import read_manifest
from calflow.runs.run import run
from calflow.study import load_study
study = load_study(sys.argv[1])
for _ in range(int(sys.argv[3])):  # the first time compiles and imports
    folder = run(study, sys.argv[2], "identify", True).folder
print(read_manifest(folder).stages["identify"].seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6)
"""


def main() -> None:
    """Print one line a size."""
    print(
        f"{'rows':>8} {'seconds':>8} {'peak GB':>8}   (identify: geometry, then geometry + compliance; held out 30 %)"
    )
    for poses in (100, 100_000):
        with tempfile.TemporaryDirectory() as folder:
            seconds, peak = identify(Path(folder), poses)
        print(f"{poses:8} {seconds:8.2f} {peak:8.2f}", flush=True)


def identify(folder: Path, poses: int) -> tuple[float, float]:
    """Seconds of the stage, and its process's peak memory [GB], on simulated measurements of so many training poses."""
    for name in ("robot.toml", "study.toml"):
        (folder / name).write_text((STUDY / name).read_text())
    truth = (STUDY / "truth.toml").read_text()
    truth = truth.replace('split = "train"\nposes = "poses.csv"', f'split = "train"\nrandom = {poses}')
    truth = truth.replace("random = 60", f"random = {int(0.4 * poses)}")
    (folder / "truth.toml").write_text(truth)
    subprocess.run(
        [sys.executable, "-m", "calflow", "simulate", str(folder / "truth.toml")], check=True, capture_output=True
    )
    command = [sys.executable, "-c", RUN, str(folder), str(folder / "run"), "2" if poses < 1000 else "1"]
    seconds, peak = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return float(seconds), float(peak)


if __name__ == "__main__":
    main()
