"""Isolability: what a plan of poses states beforehand that diagnose will see and tell apart, against what it then does.

    python benchmarks/isolability.py --cases 300 --seed 3 --out cases.csv

Each plan is of 40 or 60 poses that calflow chooses for a robot drawn at random, each of its cases a cause of the simulator that
is apart from calflow (tests/hidden) at a size at which a chance between 0.3 and 1 is stated, for half of them between 0.8 and 1.
"Seen": diagnose has a finding whose set holds the cause; "told": and the set does not hold the rival. --out FILE.csv keeps a row a
chance stated.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # a process a core
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import argparse
import multiprocessing
import tempfile
import time
from functools import cached_property
from itertools import pairwise

import numpy as np
import pandas as pd
from blind_cases import UNITS, Unit

import calflow as cf
from calflow.design.isolability import (
    DRAWS_PER_CAUSE,
    RECORDS,
    ROOM_TEMPERATURE,
    MeasuringPlan,
    Place,
    chances,
    screened,
)
from calflow.design.planned import Planned, SelectionRequest
from calflow.design.selection import select
from calflow.diagnosis import FALSE_ALARM
from calflow.diagnosis.diagnosis import search_causes
from calflow.diagnosis.screening import Family, Screening
from calflow.diagnosis.stepwise import SHARES
from calflow.effects.cause import Cause
from calflow.estimation.progress import draws
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations.position import Position
from hidden.case import COMPLIANCE, Case, draw_poses, robot_file, stated_tables, toml
from hidden.causes import PAYLOADS, WIND_UP, Hidden, measured_points
from hidden.simulator import Robot, Rows, read, worn

EFFECTS = ("geometry", "joint-compliance")
SIGMA = 4e-5  # m, per axis, of the device
COLD = 20.0  # degC: the room, where the simulator's robot has grown by nothing
CASES = 10  # of a plan
ROUGH = 100  # measurements drawn of a cause whose size is looked for
SIZES = (0.02, 30.0)  # usual sizes: least and largest
HALVINGS = 8  # of the sizes' range, in search of the one with a chance
LARGEST = 2e-3  # m, rms per axis: what moves the tool further is no cause that one has to look for
LEAST = 0.3  # chance that is asked for
SURE = (0.8, 1.0)  # chances that half the cases ask for: those that a reader takes for a yes
ALARM = SHARES["causes"] * FALSE_ALARM


@dataclass(frozen=True, eq=False)
class Plan:
    """What will be measured of a robot, as stated and as built, and the tests of it."""

    seed: int
    plan: MeasuringPlan
    real: Robot

    @staticmethod
    def drawn(seed: int) -> Plan:
        """Draw a robot, its payloads and what is recorded, and choose its poses."""
        rng = np.random.default_rng([seed, 1])
        case = Case(robot=str(rng.choice(["serial", "hh800"])), poses=2000)
        number, loads = int(rng.choice([40, 60])), [("full",), ("full", "none")][int(rng.integers(2))]
        records = list(RECORDS)[: int(rng.choice([1, 2, 4]))]
        tables = stated_tables(case)
        nominal = read(tables, np.array(COMPLIANCE[case.robot]))
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "robot.toml")
            file.write_text(toml(robot_file(tables, True)), encoding="utf-8")
            robot = cf.Robot.from_toml(file)
        stated = draw_poses(nominal, case, rng)
        asked = SelectionRequest(number=number, payload="full", planned=PLANNED, stated=stated)
        chosen = select(build(robot, EFFECTS, (), (PLANNED.observation,)), asked, rng=draws(seed))
        payloads = tuple(np.resize(np.array(loads), number).tolist())
        plan = MeasuringPlan(robot, chosen.readings, payloads, (next(iter(robot.markers)),), frozenset(records))
        return Plan(seed, plan, worn(nominal, rng))

    @cached_property
    def screening(self) -> Screening[Cause]:
        """The tests of all causes, as the plan states them."""
        return screened(EFFECTS, PLANNED, self.plan.measurements().split(0.0), self.rng("plan"))[0]

    @cached_property
    def family(self) -> Family:
        """What their number costs."""
        return self.screening.family(self.rng("family"))

    @cached_property
    def rows(self) -> Rows:
        """What the robot does, for the simulator: joints from pose to pose without a halt, all else as the plan takes it."""
        plan = replace(self.plan, records=frozenset(RECORDS))
        table, q = plan.measurements().table, self.plan.readings
        came, far, time_, warm = (
            table[[name for name in table if name.startswith(kind)]].to_numpy(float)
            for kind in ("approach", "travel", "time", "temperature")
        )
        wound = np.zeros_like(q)
        for k in range(1, len(q)):
            way = np.sign(q[k] - q[k - 1])
            wound[k] = way + (wound[k - 1] - way) * np.exp(-np.abs(q[k] - q[k - 1]) / WIND_UP)
        payload = np.array([PAYLOADS.index(name) for name in self.plan.payloads])
        return Rows(
            q, payload, np.zeros(len(q), int), came, far, wound, time_[:, 0], warm[:, 0] - ROOM_TEMPERATURE + COLD
        )

    def rng(self, purpose: str) -> np.random.Generator:
        """A generator of a purpose's own."""
        return draws(self.seed)(purpose)

    def stated(
        self, place: Place, size: float, purpose: str, drawn: int = DRAWS_PER_CAUSE
    ) -> dict[Place | None, float]:
        """The chance that a cause is seen (None), and that it is told from each rival."""
        told = chances(self.screening, self.family, ALARM, self.rng(purpose), size=size, draws=drawn, places=[place])
        return {rival: chance for (_, rival), chance in told.items()}

    def measurements(self, points: np.ndarray) -> Measurements:
        """The rows of the plan with what the device saw (n, 3) [m]."""
        planned = self.plan.measurements().table
        return Measurements.from_arrays(
            self.plan.robot, self.plan.readings, points, split="train", **_conditions(planned)
        )


PLANNED = Planned(Position.planned(Series()), SIGMA)


def _conditions(table: pd.DataFrame) -> dict[str, np.ndarray]:
    """What was recorded, as arrays."""
    found: dict[str, np.ndarray] = {name: table[name].to_numpy() for name in ("pose", "payload", "marker")}
    for kind in RECORDS:
        own = [name for name in table if name.rstrip("0123456789") == kind]
        if own:
            values = table[own].to_numpy(float)
            found[kind] = values if kind in ("approach", "travel") else values[:, 0]
    return found


@dataclass(frozen=True)
class Hiding:
    """A cause of the simulator at one usual size of the place in the catalogue that it is; off is the share of it that is not."""

    hidden: Hidden
    place: Place
    off: float


def hiding(plan: Plan, rng: np.random.Generator) -> Hiding:
    """Draw a cause that the plan's tests show at its usual size or a few of them."""
    units = [unit for unit in UNITS if plan.plan.records.issuperset(unit.columns)]
    candidates = plan.screening.whole.regressors.candidates
    matrix, sd = plan.screening.whole.regressors.matrix, plan.screening.whole.regressors.prior_sd
    while True:
        unit: Unit = units[int(rng.integers(len(units)))]
        joint, extra = int(rng.choice(unit.joints)), unit.extras[int(rng.integers(len(unit.extras)))]
        joint = int(str(extra)[0]) if unit.cause == "wrist-coupling" else joint
        small = Hidden(unit.cause, joint, 0.05 * unit.largest, extra, int(rng.integers(2**31)))
        forms = [one for one in candidates if (one.cause.id, one.cause.joint) == (unit.cause, joint)]
        moved = measured_points(plan.real, plan.rows, (small,)) - measured_points(plan.real, plan.rows, ())
        shift = (moved / SIGMA).ravel()
        fits = []
        for form in forms:
            x = matrix[:, form.columns] * sd[form.columns]
            found = np.linalg.lstsq(x, shift, rcond=1e-3)[0]
            fits.append((float(np.linalg.norm(shift - x @ found) / np.linalg.norm(shift)), found, form))
        if not fits:
            continue
        off, found, form = min(fits, key=lambda one: one[0])
        usual = float(np.sqrt(np.mean(found**2)))
        return Hiding(replace(small, size=small.size / usual), form.cause.place, off)


def sized(plan: Plan, place: Place, rng: np.random.Generator) -> float | None:
    """Find the size at which seeing the cause, or telling it from one rival, has a chance between LEAST and 1; None: no size."""
    wanted = rng.uniform(*((LEAST, 1.0) if rng.random() < 0.5 else SURE))
    low, high = np.log(SIZES)
    last = plan.stated(place, SIZES[1], "sizes", ROUGH)
    tellable = [rival for rival, chance in last.items() if rival is not None and chance > LEAST]
    of = tellable[int(rng.integers(len(tellable)))] if tellable and rng.random() < 0.5 else None
    if last[of] < LEAST:
        return None
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (
            (low, middle) if plan.stated(place, float(np.exp(middle)), "sizes", ROUGH)[of] > wanted else (middle, high)
        )
    return float(np.exp(high))


def cases(seed: int) -> list[dict[str, object]]:
    """A plan's cases: what was stated of each, and what diagnose said."""
    plan, rng = Plan.drawn(seed), np.random.default_rng([seed, 2])
    return [row for k in range(CASES) for row in case(plan, k, rng)]


def case(plan: Plan, k: int, rng: np.random.Generator) -> Iterator[dict[str, object]]:
    """Hide a cause, diagnose, and yield every chance that was stated with what came."""
    while True:
        one = hiding(plan, rng)
        if not (size := sized(plan, one.place, rng)):
            continue
        h = replace(one.hidden, size=one.hidden.size * size)
        points, without = (measured_points(plan.real, plan.rows, hidden) for hidden in ((h,), ()))
        moved = float(np.sqrt(np.mean((points - without) ** 2)))
        if moved < LARGEST:
            break
    started = time.process_time()
    data = plan.measurements(points + SIGMA * rng.standard_normal(points.shape))
    known = cf.identify(plan.plan.robot, data, EFFECTS, starts=1)
    found = search_causes(known, data, rng=draws(int(rng.integers(2**31))))
    sets = [
        {verdict.cause.place, *(rival.cause.place for rival in verdict.rivals if rival.cause)}
        for verdict in found.verdicts
    ]
    own = next((each for each in sets if one.place in each), None)
    seconds = time.process_time() - started
    names = "; ".join(f"{verdict.cause.id} {verdict.cause.part}" for verdict in found.verdicts)
    for rival, chance in plan.stated(one.place, size, "isolability").items():
        right = own is not None and rival not in own
        yield {
            "plan": plan.seed, "case": k, "robot": plan.plan.robot.name, "poses": len(plan.plan.readings),
            "loads": len(set(plan.plan.payloads)), "records": len(plan.plan.records),
            "cause": one.place[0], "part": one.place[1], "size": size, "moved_mm": 1e3 * moved, "off": one.off,
            "rival": rival[0] if rival else "", "rival_part": rival[1] if rival else "",
            "stated": chance, "right": right, "found": names, "seconds": seconds,
        }  # fmt: skip


def table(rows: pd.DataFrame) -> str:
    """How often what was stated came true, by the chance that was stated."""
    bands = [0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.85, 0.95, 0.995, 1.01]
    said = []
    for what, own in (("seen", rows[rows["rival"] == ""]), ("told", rows[rows["rival"] != ""])):
        for low, high in pairwise(bands):
            part = own[(own["stated"] >= low) & (own["stated"] < high)]
            if len(part):
                groups = part.groupby(["plan", "case"])["right"].agg(["sum", "size"])
                error = np.sqrt(((groups["sum"] - groups["size"] * part["right"].mean()) ** 2).sum()) / len(part)
                said.append(f"{what} {low:5.3f} to {high:5.3f}: {len(part):6} of {len(groups):4} cases, stated "
                            f"{part['stated'].mean():.3f}, came {part['right'].mean():.3f} +- {error:.3f}")  # fmt: skip
    return "\n".join(said)


def main() -> None:
    """Run as many cases as asked for, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    seeds = [asked.seed * 100_000 + k for k in range(-(-asked.cases // CASES))]
    rows = list[dict[str, object]]()
    with multiprocessing.get_context("spawn").Pool(asked.processes) as pool:
        for own in pool.imap(cases, seeds):
            rows += own
            if asked.out:
                pd.DataFrame(rows).to_csv(asked.out, index=False)
    print(table(pd.DataFrame(rows)))


if __name__ == "__main__":
    main()
