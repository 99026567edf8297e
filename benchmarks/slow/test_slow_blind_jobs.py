"""The blind benchmarks' cases run by the fleet's engine: what a kill leaves is kept, and no number of jobs changes a table."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from calflow.files.tables import read_csv

BENCHMARKS = Path(__file__).parents[1]
SCRIPT = """\
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {benchmarks!r})
from blind_run import Kind, run_kind

HERE = Path(__file__).parent

def work(job):
    if job[0] == 2 and (HERE / "fatal").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    with (HERE / "worked").open("a") as told:
        told.write(f"{{job[0]}} ")
    return {{"case": job[0], "drawn": job[1], "failed": None}}

def tell(rows):
    return f"{{len(rows)}} cases, {{rows['drawn'].sum():.17g}}"

run_kind(None, {{"toy": Kind(lambda n, rng: [(k, rng.random()) for k in range(n)], work, tell)}})
"""


def test_jobs_that_were_killed_are_done_anew_and_no_others(tmp_path):
    """Fails if a kill costs the cases of other jobs, a case is lost or done twice, or the table tells of jobs."""
    script, fatal = tmp_path / "toy.py", tmp_path / "fatal"
    script.write_text(SCRIPT.format(benchmarks=str(BENCHMARKS)), encoding="utf-8")

    def called() -> subprocess.CompletedProcess[str]:
        asked = ["toy", "5", "--out", tmp_path / "cases.csv", "--batch", "3", "--processes", "2"]
        return subprocess.run([sys.executable, script, *asked], capture_output=True, text=True)

    fatal.touch()
    done = called()
    assert done.returncode == 1
    assert done.stderr.startswith("1 of 2 jobs were not done")
    assert not (tmp_path / "cases.csv").exists()
    before = (tmp_path / "worked").read_text()
    fatal.unlink()
    done = called()
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "worked").read_text() == f"{before}0 1 2 "
    rows = read_csv(tmp_path / "cases.csv")
    rng = np.random.default_rng([1, *b"toy"])  # whatever the jobs, the cases are those of one generator
    assert rows["case"].to_list() == list(range(5))
    assert rows["drawn"].to_list() == [rng.random() for _ in range(5)]
