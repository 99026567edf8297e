"""Compensated commands on the independent simulator: HH800 at 800 kg, with compliance and a hidden backlash that diagnose finds.

python benchmarks/compensation.py          some robots: true tool error before and after, and what was promised
python benchmarks/compensation.py time     seconds for 10,000 targets, of the processor
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

import calflow

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from hidden.case import Case, draw, write_case
from hidden.causes import Hidden
from hidden.landings import missed, targets

SOFT = Hidden("joint-compliance", 0, 1.0)  # twice the usual compliance, in all joints
CASE = Case(robot="hh800", hidden=(SOFT, Hidden("joint-backlash", 3, 3e-4)), columns=("approach", "sigma"))
ASKED = 300
ROBOTS = 5


def main() -> None:
    """Print one line a robot, or the seconds."""
    if sys.argv[1:] == ["time"]:
        print(f"10,000 targets: {seconds(10_000):.1f} s of the processor")
        return
    print(
        "robot  found                 nominal  compensated  promised  ratio   (true tool error, rms over targets, mm)"
    )
    every = []
    for seed in range(1, ROBOTS + 1):
        with tempfile.TemporaryDirectory() as folder:
            causes, errors = landed(Path(folder), seed)
        every.append(errors)
        print(f"{seed:5}  {shown(causes, errors)}", flush=True)
    print(f"  all  {shown('', np.sqrt(np.mean(np.square(every), axis=0)))}")


def shown(causes: str, errors: np.ndarray) -> str:
    """One line of the table."""
    before, after, promised = errors
    return f"{causes:20}  {before:7.2f}  {after:11.4f}  {promised:8.4f}  {after / promised:5.2f}"


def landed(folder: Path, seed: int) -> tuple[str, np.ndarray]:
    """What diagnose found of one robot; rms true errors [mm] of nominal and of compensated commands, and what was promised."""
    world, asked, commands = compensated(folder, seed, ASKED)
    found = pd.read_csv(folder / "run" / "diagnose" / "findings.csv")
    causes = ", ".join(f"{row.cause} {row.joint}" for row in found.itertuples() if row.status in ("named", "one_of"))
    readings = [f"q{i}_deg" for i in range(1, 7)]
    q = commands[readings].where(commands["reached"], commands[[f"nominal_{name}" for name in readings]].to_numpy())
    after, before = missed(world, q, asked), missed(world, asked[readings], asked)
    own = (commands["reached"] & commands["reached"].shift(fill_value=False)).to_numpy()[1:]
    promised = commands["expected_mm"][1:][own]
    return causes, np.array([np.sqrt(np.mean(np.square(v))) for v in (before[own], after[own], promised)])


def seconds(number: int) -> float:
    """Seconds of the processor for so many targets, from the CSV to the CSV."""
    with tempfile.TemporaryDirectory() as folder:
        compensated(Path(folder), 1, 10)
        world, case = draw(CASE, np.random.default_rng(1)), replace(CASE, poses=number)
        targets(world, case, np.random.default_rng(2)).to_csv(Path(folder, "many.csv"), index=False)
        begun = time.process_time()
        calflow.compensate(Path(folder, "run"), Path(folder, "many.csv"), in_order=True)
        return time.process_time() - begun


def compensated(folder: Path, seed: int, number: int):
    """A hidden robot that was measured, identified and diagnosed; its targets, and the commands for them."""
    write_case(folder / "case", CASE, np.random.default_rng(seed))
    world = draw(CASE, np.random.default_rng(seed))
    calflow.run(calflow.load_study(folder / "case" / "study.toml"), folder / "run")
    asked = targets(world, replace(CASE, poses=number), np.random.default_rng(1000 + seed))
    asked.to_csv(folder / "targets.csv", index=False)
    return world, asked, calflow.compensate(folder / "run", folder / "targets.csv", in_order=True)


if __name__ == "__main__":
    main()
