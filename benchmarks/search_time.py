"""What it costs to identify and diagnose with the whole catalogue: the processor's seconds and peak memory of the whole command.

    python benchmarks/search_time.py                  120 simulated poses, and the real UR5 and UR10 where there is CALFLOW_DATA
    python benchmarks/search_time.py ur5 ur10-c       some: 120, ur5, ur10-c

The UR5 needs `python studies/ur5/convert.py` once. To compare two versions, run them in turns on the same machine: the older one
with PYTHONPATH=OTHER/src.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from real_data import DATA

from hidden.case import Case, write_case
from hidden.causes import Hidden

BACKLASH, RATIO = Hidden("joint-backlash", 2, 2e-4), Hidden("gear-ratio-error", 3, 5e-4)
COLUMNS = ("approach", "travel", "time", "temperature")
REAL = {"ur5": "UR5, 1,000 rows", "ur10-c": "UR10, series C, 1,941 rows, confirmed by series B"}


def main() -> None:
    """Print one line a case."""
    wanted = sys.argv[1:] or ["120", *(REAL if "CALFLOW_DATA" in os.environ else ())]
    print(f"{'processor [s]':>13} {'peak [GB]':>9}  case", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        if "120" in wanted:
            for told, study in simulated(Path(folder)):
                report(told, study, study.with_name(f"{study.name}-run"))
        for name in (name for name in REAL if name in wanted):
            report(REAL[name], DATA[name], Path(folder) / name)


def simulated(folder: Path) -> Iterator[tuple[str, Path]]:
    """Write 120 poses to fit of two robots, with nothing, one and two causes hidden; yield what they are, and where."""
    for robot in ("serial", "hh800"):
        for hidden in ((), (BACKLASH,), (BACKLASH, RATIO)):
            study = folder / f"{robot}{len(hidden)}"
            case = Case(robot=robot, hidden=hidden, poses=160, columns=COLUMNS)
            write_case(study, case, np.random.default_rng(1))
            yield f"{robot}, 120 poses to fit, {len(hidden)} hidden", study


def report(told: str, study: Path, out: Path) -> None:
    """Run both stages in a process of their own, and print what it took."""
    command = [sys.executable, "-m", "calflow", "run", study, "--out", out, "--stage", "diagnose", "--force"]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{told}: the run failed")
    print(f"{used.ru_utime + used.ru_stime:13.1f} {used.ru_maxrss / 1e6:9.2f}  {told}", flush=True)


if __name__ == "__main__":
    main()
