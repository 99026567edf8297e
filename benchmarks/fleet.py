"""A fleet: time against the sum of its parts, failures that harm no other robot, and kills that leave no trace in the tables.

python benchmarks/fleet.py --cases 200 --failing 10 --kills 20 [--workflow diagnose] [--seed 1] [--processes 2] [--out FOLDER]

HH800 robots are drawn by the hidden simulator, each about the mean of its type as worn as that is about what the maker states, and
measured in 60 poses. The sum of the parts is each robot's study run one after the other in one process, before the fleet and after
it, the mean of both. The fleet is run sound; with some robots whose files are spoilt or gone; and that once more, killed at
random, with all its processes or only the one that was called, and called again until it is done.

The processor's seconds are those of all processes of a fleet: Python and Snakemake starting, reading, and reporting included.
They do not depend on what else the machine does, as the time by the clock does.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from hidden.case import COMPLIANCE, Case, World, draw, measure, robot_file, stated_tables, toml
from hidden.causes import measured_points
from hidden.simulator import read, worn

POSES = 60
KINDS = ("a column misspelt", "no file", "a robot that stands elsewhere")
SUBREAPER = 36  # of prctl: processes whose parent is gone become ours, and their seconds are counted
STUDY = """\
name = "hh800"
robot = "robot.toml"
workflow = "workflow.toml"
seed = 1
effects = ["geometry", "joint-compliance"]

[split]
holdout = 0.25
"""
FLEET = """\
[fleet]
name = "fleet"

[types.hh800]
study = "study.toml"
data = "data/{robot}/measurements.csv"
"""
WORKFLOWS = {
    "identify": 'name = "identify"\nstages = ["identify"]\n',
    "diagnose": 'name = "diagnose"\nstages = ["identify", "diagnose"]\n',
    "report": 'name = "report"\nstages = ["identify", "diagnose", "report"]\n',
}
PARTS = """
import sys, time
from pathlib import Path
from calflow.runs.run import run
from calflow.study import load_study
for name in sys.argv[3:]:
    began, clock = time.process_time(), time.monotonic()
    run(load_study(Path(sys.argv[1], "parts", "studies", f"{name}.toml")), Path(sys.argv[1], sys.argv[2], name))
    print(time.process_time() - began, time.monotonic() - clock, flush=True)
"""


@dataclass(frozen=True)
class Took:
    """What a call took [s]: of the processor, and by the clock; and its exit code."""

    processor: float
    clock: float
    code: int


def main() -> None:
    """Build a plant, run it in every way, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--failing", type=int, default=2)
    parser.add_argument("--kills", type=int, default=4)
    parser.add_argument("--workflow", choices=WORKFLOWS, default="diagnose")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    ctypes.CDLL(None).prctl(SUBREAPER, 1, 0, 0, 0)
    plant = (asked.out or Path(tempfile.mkdtemp())).resolve()
    rng = np.random.default_rng(asked.seed)
    robots = built(plant, asked.cases, asked.workflow, rng)

    before = parts(plant, robots, "before")
    whole = fleet(plant, "sound", asked.processes)
    processor, clock = np.mean([before, parts(plant, robots, "after")], axis=0)
    found = pd.read_csv(plant / "sound" / "fleet.csv")
    print(f"{asked.cases} robots, {asked.workflow}, seed {asked.seed}; load of the machine {os.getloadavg()[0]:.1f}")
    print(f"calibrated: {(found['status'] == 'calibrated').sum()}; after, mean [mm]: {found['after_mean_mm'].median():.4f} "
          f"(to {found['after_mean_mm'].max():.4f}); before: {found['before_mean_mm'].median():.2f}")  # fmt: skip
    print(f"sum of the parts: {processor:.1f} s of the processor, {clock:.1f} s by the clock")
    times, over = whole.processor / processor, whole.clock / (clock / asked.processes)
    print(f"fleet: {whole.processor:.1f} s of the processor, {times:.3f} times the parts; {whole.clock:.1f} s by the clock, "
          f"{over:.3f} times the parts over {asked.processes} cores", flush=True)  # fmt: skip

    spoilt = spoil(plant, [str(name) for name in rng.choice(robots, asked.failing, replace=False)])
    failing = fleet(plant, "failing", asked.processes)
    rows = pd.read_csv(plant / "failing" / "fleet.csv").set_index("robot")
    named = set(rows.index[rows["status"] == "failed"])
    same = lines(plant / "failing", spoilt) == lines(plant / "sound", spoilt)
    print(f"made to fail: {len(spoilt)}; named: {len(named & set(spoilt))}; others named: {len(named - set(spoilt))}; "
          f"the others as before: {same}; exit code {failing.code}")  # fmt: skip
    for name, kind in spoilt.items():
        print(f"  {name} ({kind}): {rows.loc[name, 'failed_stage']} {str(rows.loc[name, 'reason'])[:160]}")

    for kill in range(asked.kills):
        after, alone = rng.uniform(0.2, 1.8) * failing.clock / (asked.kills + 1), bool(kill % 2)
        left = killed(plant, "killed", asked.processes, after, alone)
        done = len(list((plant / "killed" / "outcomes").glob("*.json")))
        print(
            f"  killed after {after:.0f} s ({'the command alone' if alone else 'all processes'}): {done} outcomes{left}",
            flush=True,
        )
    last = fleet(plant, "killed", asked.processes)
    tables = [(plant / name / "fleet.csv").read_bytes() for name in ("failing", "killed")]
    print(f"killed {asked.kills} times: ended with {last.code}, same bytes: {tables[0] == tables[1]}")
    if asked.out is None:
        shutil.rmtree(plant)


def built(plant: Path, cases: int, workflow: str, rng: np.random.Generator) -> list[str]:
    """Write a plant's files; return its robots' names."""
    case = Case(robot="hh800", poses=POSES)
    tables = stated_tables(case)
    stated = read(tables, np.array(COMPLIANCE["hh800"]))
    usual = worn(stated, rng)  # what robots of this type have in common
    plant.mkdir(parents=True, exist_ok=True)
    for name, text in (("study.toml", STUDY), ("fleet.toml", FLEET), ("workflow.toml", WORKFLOWS[workflow])):
        (plant / name).write_text(text, encoding="utf-8")
    (plant / "robot.toml").write_text(toml(robot_file(tables, True)), encoding="utf-8")
    names = [f"R{k + 1:03}" for k in range(cases)]
    for name in names:
        drawn = draw(case, rng)
        world: World = replace(drawn, real=worn(usual, rng))
        table, _ = measure(case, world, measured_points(world.real, world.rows, world.hidden), rng)
        (plant / "data" / name).mkdir(parents=True, exist_ok=True)
        table.to_csv(plant / "data" / name / "measurements.csv", index=False)
    return names


def spoil(plant: Path, robots: list[str]) -> dict[str, str]:
    """Spoil the files of some robots; how, by robot."""
    for k, name in enumerate(robots):
        path = plant / "data" / name / "measurements.csv"
        table = pd.read_csv(path)
        match KINDS[k % len(KINDS)]:
            case "a column misspelt":
                table.rename(columns={"y_mm": "y_mmm"}).to_csv(path, index=False)
            case "no file":
                path.unlink()
                (plant / "fleet.toml").open("a").write(f'\n[robots.{name}]\ntype = "hh800"\n')
            case _:
                table.assign(x_mm=table["x_mm"] + 5000.0).to_csv(path, index=False)
    return {name: KINDS[k % len(KINDS)] for k, name in enumerate(robots)}


def lines(folder: Path, without: dict[str, str]) -> list[str]:
    """The lines of a fleet's table, without those of some robots."""
    text = (folder / "fleet.csv").read_text(encoding="utf-8").splitlines()
    return [line for line in text if line.partition(",")[0] not in without]


def called(plant: Path, out: str, processes: int) -> list[str]:
    """The command that runs the fleet."""
    return [
        sys.executable,
        "-m",
        "calflow",
        "fleet",
        "run",
        str(plant / "fleet.toml"),
        "--out",
        str(plant / out),
        "--cores",
        str(processes),
    ]


def fleet(plant: Path, out: str, processes: int) -> Took:
    """Run the fleet to its end, with all that it starts."""
    before, began = seconds(), time.monotonic()
    done = subprocess.run(called(plant, out, processes), stdout=subprocess.DEVNULL)
    clock = time.monotonic() - began
    reap()
    return Took(seconds() - before, clock, done.returncode)


def killed(plant: Path, out: str, processes: int, after: float, alone: bool) -> str:
    """Run the fleet and kill it after some seconds; what it leaves at work."""
    process = subprocess.Popen(
        called(plant, out, processes), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        process.wait(after)
        return ", it was done before"
    except subprocess.TimeoutExpired:
        (os.kill if alone else os.killpg)(process.pid, signal.SIGKILL)
        process.wait()
    return ", its jobs go on" if alone else ""


def reap() -> None:
    """Wait for what outlived its parent."""
    with suppress(ChildProcessError):
        while True:
            os.wait()


def seconds() -> float:
    """The processor's seconds of all processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def parts(plant: Path, robots: list[str], out: str) -> tuple[float, float]:
    """What the robots take one after the other in one process [s]: of the processor, and by the clock."""
    plan = [sys.executable, "-m", "calflow", "fleet", "plan", str(plant / "fleet.toml"), "--out", str(plant / "parts")]
    subprocess.run(plan, stdout=subprocess.DEVNULL, check=True)  # writes their studies
    done = subprocess.run(
        [sys.executable, "-c", PARTS, str(plant), out, *robots], capture_output=True, text=True, check=True
    )
    took = np.array([line.split()[-2:] for line in done.stdout.splitlines()], dtype=float)
    processor, clock = took.sum(axis=0)
    return float(processor), float(clock)


if __name__ == "__main__":
    main()
