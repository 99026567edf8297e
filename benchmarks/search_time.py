"""How long it takes to identify and diagnose: 120 poses with the whole catalogue, and a real robot's 2,773 rows."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np

from hidden.case import Case, write_case
from hidden.causes import Hidden

REAL = Path(__file__).parents[1] / "studies" / "ur10-tmac"
BACKLASH, RATIO = Hidden("joint-backlash", 2, 2e-4), Hidden("gear-ratio-error", 3, 5e-4)
COLUMNS = ("approach", "travel", "time", "temperature")


def main() -> None:
    """Print one line a case."""
    print(f"{'rows':>6} {'seconds':>8}  case")
    for robot in ("serial", "hh800"):
        for hidden in ((), (BACKLASH,), (BACKLASH, RATIO)):
            with tempfile.TemporaryDirectory() as folder:
                case = Case(robot=robot, hidden=hidden, poses=160, columns=COLUMNS)
                write_case(Path(folder) / "case", case, np.random.default_rng(1))
                told = f"{robot}, 120 poses to fit, {len(hidden)} hidden"
                print(f"{120:6} {seconds(Path(folder) / 'case', Path(folder) / 'run'):8.1f}  {told}", flush=True)
    if "CALFLOW_DATA" in os.environ:
        with tempfile.TemporaryDirectory() as folder:
            print(
                f"{2773:6} {seconds(REAL, Path(folder) / 'run'):8.1f}  UR10, series C, confirmed by series B",
                flush=True,
            )


def seconds(study: Path, folder: Path) -> float:
    """Seconds of both stages, each as the run's manifest states it, in a process of their own."""
    command = [sys.executable, "-m", "calflow", "run", str(study), "--out", str(folder), "--stage", "diagnose"]
    subprocess.run(command, check=True, capture_output=True)
    stages = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["stages"]
    return float(sum(stages[stage]["seconds"] for stage in ("identify", "diagnose")))


if __name__ == "__main__":
    main()
