"""Poses: how sure the tool is over a task by random poses, by those best for all parameters, and by those best for the task.

python benchmarks/poses.py [scale] [robots] [constraints] [figaroh PYTHON]

PYTHON is one that has figaroh (PyPI), in an environment of its own.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calflow.design.candidates import candidates
from calflow.design.optimality import ParameterCriterion, ToolError, indices, information
from calflow.design.planned import Planned, SelectionRequest, Task
from calflow.design.search import search_poses, search_worst
from calflow.design.selection import select
from calflow.estimation.progress import draws
from calflow.measurements.series import Series
from calflow.model import Model, build
from calflow.observations.position import Position
from calflow.robot.mechanism import reading_columns, shown_readings
from calflow.robot.robot import Robot
from calflow.templates import library_file

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from collisions import CASES, Outside

HERE = Path(__file__).parent
STUDY = HERE.parent / "studies" / "hh800"
ROBOTS = ("hh800", "ur10", "kuka-kr210-r2700", "abb-irb6640", "fanuc-r2000ic-165f")
SIGMA = 5e-5  # m
POSES = (20, 40, 60)
CANDIDATES = 10_000
RANDOM = 20  # random sets of poses
SEEN = np.array([[0.2, -0.6, 0.05], [1.0, 0.6, 0.9]])  # where the tracker sees the marker, in reaches
WORK = np.array([[0.5, -0.3, 0.1], [0.85, 0.3, 0.5]])  # where the robot works
CELLS = ("industrial", "ur10")  # of tests/collisions.py
PLANS = 50  # of 100 poses, a cell
ROUNDED = 1e-5  # m or rad: the tables have 0.0001 degrees
CHECK = 1000  # points of the task that no choice has seen
SCALE = """
import resource, sys, time
from calflow.runs.run import run
from calflow.study import load_study
run(load_study(sys.argv[1]), sys.argv[1] + "/run", "select", True)
print(time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6)
"""


@dataclass(frozen=True, eq=False)
class Case:
    """A robot's candidates with their whitened, scaled Jacobians, and its task: points to choose by, and points to check by."""

    model: Model
    whitened: np.ndarray
    task: Task
    check: Task

    @property
    def prior(self) -> np.ndarray:
        """Information before any pose."""
        return np.eye(len(self.model.parameters))

    def covariance(self, chosen: list[int]) -> np.ndarray:
        """What so many poses leave of the parameters."""
        return np.linalg.inv(information(self.whitened[chosen], self.prior))


def robot(name: str) -> Robot:
    """A robot of the library, or the HH800."""
    if name == "hh800":
        return Robot.from_toml(STUDY / "robot.toml")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "robot.toml")
        path.write_text(library_file(name), encoding="utf-8")
        return Robot.from_toml(path)


def case(name: str, number: int = CANDIDATES) -> Case:
    """The candidates and the task of a robot: boxes in front of it, in shares of its reach."""
    arm = robot(name)
    planned = Planned(Position.planned(Series()), SIGMA)
    effects = ("geometry", "joint-compliance") if arm.has_masses else ("geometry",)
    model = build(arm, effects, (), (planned.observation,))
    load, marker = next(iter(arm.payloads), ""), next(iter(arm.markers))
    rng = np.random.default_rng(1)
    _, conditions = candidates(model, 2000, load, marker, None, rng)
    point = model.point(model.nominal, conditions)
    reach = float(np.quantile(np.hypot(point[:, 0], point[:, 1]), 0.99))
    _, conditions = candidates(model, number, load, marker, SEEN * reach, rng)
    task, check = (Task.within(model, [load], marker, WORK * reach, n, rng) for n in (400, CHECK))
    return Case(model, planned.whitened(model, model.nominal, conditions) * model.prior_sd, task, check)


def robots() -> None:
    """Print one line a robot and number of poses: the tool's error by each way to choose, its ratios, and the certificates."""
    print(
        f"of {CANDIDATES} candidates; tool [mm]: root mean square, and largest, of 1 sd at {CHECK} task points not chosen by"
    )
    print(f"{'robot':20} {'par.':>4} {'poses':>5} {'random':>8} {'O1':>8} {'tool':>8} {'/tool: random':>13} {'O1':>5}"
          f" | {'random':>8} {'O1':>8} {'worst':>8} {'/worst: random':>14} {'O1':>5} | could gain [%]")  # fmt: skip
    for name in ROBOTS:
        one = case(name)
        for poses in POSES:
            print(f"{name:20} {len(one.prior):4} {poses:5} {_compared(one, poses)}", flush=True)


def _compared(one: Case, poses: int) -> str:
    """The ways to choose beside each other, at points of the task that none has seen."""
    rng = np.random.default_rng(2)
    tool, checked = one.task.criterion(one.model), one.check.criterion(one.model)
    found = [
        search_poses(one.whitened, one.prior, poses, ParameterCriterion(len(one.prior)), rng),
        search_poses(one.whitened, one.prior, poses, tool, rng),
        search_worst(one.whitened, one.prior, poses, tool, rng),
    ]
    drawn = [list(rng.choice(CANDIDATES, poses, replace=False)) for _ in range(RANDOM)]
    errors = np.array([_errors(one, checked, each) for each in [each.chosen for each in found] + drawn])
    chance = np.median(errors[3:], axis=0)
    columns = []
    for k, own in ((0, errors[1, 0]), (1, errors[2, 1])):
        figures = 1e3 * chance[k], 1e3 * errors[0, k], 1e3 * own, chance[k] / own, errors[0, k] / own
        columns.append("{:8.4f} {:8.4f} {:8.4f} {:13.2f} {:5.2f}".format(*figures))
    return " | ".join([*columns, " ".join(f"{100 * each.could_gain:5.2f}" for each in found)])


def _errors(one: Case, checked: ToolError, chosen: list[int]) -> tuple[float, float]:
    """Root mean square and largest standard deviation [m] of the tool."""
    variances = checked.variances(one.covariance(chosen))
    return float(np.sqrt(variances.mean())), float(np.sqrt(variances.max()))


def scale() -> None:
    """Print the time and memory of the stage, imports included, for 60 poses of 100,000 candidates of the HH800."""
    for aim in ("parameters", "tool", "worst"):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "robot.toml").write_text((STUDY / "robot.toml").read_text())
            text = (STUDY / "study.toml").read_text().replace("[measurements]\nfile", "# file")
            settings = f'poses = 60\ncandidates = 100000\ncriterion = "{aim}"\n'
            text = text.replace("[stages.select]\n", f"[stages.select]\n{settings}")
            Path(folder, "study.toml").write_text(text)
            answer = subprocess.run([sys.executable, "-c", SCALE, folder], check=True, capture_output=True, text=True)
            certificate = json.loads(Path(folder, "run", "select", "certificate.json").read_text())
        seconds, peak = map(float, answer.stdout.split()[-2:])
        print(
            f"{aim:12} {seconds:6.1f} s of processor time, {peak:.2f} GB, could gain {certificate['could_gain_percent']:.2f} %",
            flush=True,
        )


def constraints() -> None:
    """Print how many of 10,000 poses chosen in a cell, and moved, pinocchio and coal find in a collision or out of sight.

    The tests' two robots in their cells, 50 plans each of 100 poses; and how long 100,000 allowed candidates take.
    """
    for name in CELLS:
        make, cell = CASES[name]
        arm, load, said = make(), "load", list[str]()
        model, outside = build(arm, ("geometry",)), Outside(arm, cell)
        rooms = []
        for plan in range(PLANS):
            asked = SelectionRequest(payload=load, marker="E", cell=cell, candidates=500, refine=True)
            poses = select(model, asked, rng=draws(plan), say=said.append).poses
            readings = poses[reading_columns(arm)].to_numpy() / shown_readings(arm, np.ones((1, arm.n_joints)))
            rooms += [outside.room(q) for q in readings]
        least = {rule: min(room[rule] for room in rooms) for rule in rooms[0]}
        wrong = sum(min(room.values()) < -ROUNDED for room in rooms)
        print(f"{name}: {wrong} of {len(rooms)} poses refused; least room [m or rad] "
              + ", ".join(f"{rule} {room:.6f}" for rule, room in least.items()), flush=True)  # fmt: skip
        print(f"  the first plan: {said[0]}; {said[3]}")
        began = time.process_time()
        candidates(model, 100_000, load, "E", None, np.random.default_rng(1), None, cell, print)
        print(f"  100,000 allowed ones: {time.process_time() - began:.1f} s of processor time", flush=True)


def figaroh(python: str, number: int, poses: int) -> None:
    """Print O1 and time of figaroh's search by exchange and of calflow's: same UR10, candidates and identifiable parameters."""
    one = case("ur10", number)
    flat = one.whitened.reshape(-1, len(one.prior))
    _, singular, turned = np.linalg.svd(flat, full_matrices=False)
    known = turned[singular > 1e-6 * singular[0]]
    base = one.whitened @ known.T
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "candidates.npz")
        np.savez(path, jacobians=base, poses=poses)
        began = time.process_time()
        found = search_poses(
            base, 1e-9 * np.eye(len(known)), poses, ParameterCriterion(len(known)), np.random.default_rng(1)
        )
        print(f"{number} candidates of the UR10, {len(known)} identifiable parameters, {poses} poses")
        seconds = time.process_time() - began
        o1 = indices(base[found.chosen].reshape(-1, len(known)), len(known))[0]
        print(f"calflow          O1 {o1:9.4f}, {seconds:8.2f} s of processor time", flush=True)
        script = HERE / "prior_methods" / "figaroh_poses.py"
        subprocess.run([python, str(script), str(path), folder], check=True)
        held = np.load(Path(folder, "detmax.npz"))
        print(f"figaroh, DetMax  O1 {held['o1']:9.4f}, {held['seconds']:8.2f} s of processor time", flush=True)


def main(arguments: list[str]) -> None:
    """Print what is asked for; scale and robots where nothing is."""
    if not arguments or "scale" in arguments:
        scale()
    if not arguments or "robots" in arguments:
        robots()
    if "constraints" in arguments:
        constraints()
    if "figaroh" in arguments:
        for number, poses in ((300, 30), (3000, 60)):
            figaroh(arguments[arguments.index("figaroh") + 1], number, poses)


if __name__ == "__main__":
    main(sys.argv[1:])
