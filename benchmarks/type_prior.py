"""What a fleet knows that a robot does not: a robot of ten poses with its type's prior, and robots unlike their type.

Robots of the HH800's type are built by code apart from calflow's graph: all share the type's own deviations from the maker's
figures, and each has some of its own, as machining (0.1 mm, 0.1 mrad), mastering (0.3 mrad of each joint's zero) and springs
(5 %) leave them. Base and tool stand elsewhere each time. Errors are from what the device reports at held-out poses, its noise
included. Ten poses are drawn like the others, or chosen by `select` for the tool's error, refined, all under full load.

    python benchmarks/type_prior.py --seed 1 --robots 50 --further 20 --fleets 4
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import calflow as cf
from calflow.design.planned import SelectionRequest, Task
from calflow.design.selection import select
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.model import build
from calflow.population.likelihood import ParameterEstimates, ParameterLikelihood, shared_parameters
from calflow.population.unlike import unlike
from calflow.robot.parts import Parameter
from hidden.case import COMPLIANCE, Case, draw_poses, robot_file, stated_tables, toml
from hidden.causes import PAYLOADS, measured_points
from hidden.simulator import Robot, Rows, placed, read, worn

EFFECTS = ("geometry", "joint-compliance")
NOISE = 5e-5  # m, per axis
POSES, FEW, MANY, HELD_OUT = 60, 10, 100, 100
MACHINED, MASTERED, SPRINGS = 1e-4, 3e-4, 0.05  # m and rad, rad, share
UNLIKE = {"theta": 3e-3, "alpha": 1e-3, "a": 1e-3, "d": 1e-3, "compliance": 0.5}  # ten spreads of what is of its kind
HIDDEN = 5


@dataclass(frozen=True)
class Plant:
    """A type of robots: as its maker states it, for calflow and for the simulator, and the mean of those that are built."""

    stated: cf.Robot
    nominal: Robot
    mean: Robot
    spread: float = 1.0

    @staticmethod
    def drawn(rng: np.random.Generator, spread: float = 1.0) -> Plant:
        """A type whose robots are tenths of a millimetre off the maker's figures alike."""
        tables = stated_tables(Case(robot="hh800"))
        nominal = read(tables, np.array(COMPLIANCE["hh800"]))
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "robot.toml")
            file.write_text(toml(robot_file(tables, True)), encoding="utf-8")
            stated = cf.Robot.from_toml(file)
        mean = worn(nominal, rng)
        return Plant(stated, nominal, replace(mean, base=nominal.base, markers=nominal.markers), spread)

    def built(self, rng: np.random.Generator, kind: str = "", joint: int = 0) -> Robot:
        """One robot; kind and joint (from 0) name the figure that is unlike the type's."""
        mean, n, share = self.mean, self.mean.n, self.spread
        figures = {
            name: getattr(mean, name) + share * MACHINED * rng.standard_normal(n) for name in ("alpha", "a", "d")
        }
        figures["theta"] = mean.theta + share * MASTERED * rng.standard_normal(n)
        figures["compliance"] = mean.compliance * (1 + share * SPRINGS * rng.standard_normal(n))
        if kind:
            off = share * rng.choice([-1, 1]) * UNLIKE[kind]
            figures[kind] = figures[kind] + (np.arange(n) == joint) * (
                off * mean.compliance if kind == "compliance" else off
            )
        return replace(
            mean, **figures, base=mean.base @ placed(rng.normal(0, 2e-3, 6)),
            markers=mean.markers + rng.normal(0, 1e-3, mean.markers.shape),
        )  # fmt: skip

    def drawn_poses(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Readings (number, 6) [rad] anywhere with the tool before the robot."""
        return draw_poses(self.nominal, Case(robot="hh800", poses=number), rng)

    def measured(
        self, real: Robot, q: np.ndarray, load: np.ndarray, rng: np.random.Generator, held_out: int = 0
    ) -> cf.Measurements:
        """A robot's rows at readings (n, 6) under loads (n,), by their numbers; so many, the last ones, are held out."""
        number, none = len(q), np.zeros_like(q)
        rows = Rows(q, load, np.zeros(number, int), none, none, none, np.zeros(number), np.full(number, 20.0))
        seen = measured_points(real, rows, ()) + NOISE * rng.standard_normal((number, 3))
        return cf.Measurements.from_arrays(
            self.stated, q, seen, payload=np.array(PAYLOADS)[load], sigma=np.full(number, NOISE),
            split=np.where(np.arange(number) < number - held_out, "train", "holdout"),
        )  # fmt: skip

    def anywhere(self, real: Robot, poses: int, rng: np.random.Generator, held_out: int = 0) -> cf.Measurements:
        """A robot's rows at poses anywhere, a third of them under each load."""
        q = self.drawn_poses(poses + held_out, rng)
        return self.measured(real, q, np.arange(len(q)) % len(PAYLOADS), rng, held_out)

    def chosen(self, expecting: cf.Robot, rng: np.random.Generator) -> np.ndarray:
        """Few readings (FEW, 6) [rad] that tell most of the tool of a robot that something is expected of."""
        model = build(expecting, EFFECTS)
        task = Task.of(self.drawn_poses(100, rng), PAYLOADS, next(iter(expecting.markers)))
        asked = SelectionRequest(number=FEW, aim="tool", task=task, payload=PAYLOADS[-1], candidates=5000, refine=True)
        return select(model, asked).readings


def known(robot: cf.Robot, data: cf.Measurements) -> tuple[CalibratedModel, float]:
    """What calflow identifies, and its mean error at the held-out poses [m]."""
    fit = cf.identify(robot, data, EFFECTS, starts=1)
    held = data.only(~data.train)
    if not len(held):
        return fit, float("nan")
    conditions = held.on(fit.model.robot).conditions
    left = fit.model.position(fit.estimate, conditions) - held.position
    return fit, float(np.linalg.norm(left, axis=1).mean())


def told_by(
    plant: Plant, robots: list[Robot], rng: np.random.Generator
) -> tuple[tuple[Parameter, ...], list[ParameterLikelihood]]:
    """What each robot's own calibration tells."""
    fits = [ParameterEstimates.of(known(plant.stated, plant.anywhere(robot, POSES, rng))[0]) for robot in robots]
    parameters = shared_parameters(fits)
    return parameters, [ParameterLikelihood.of(str(k), one, parameters) for k, one in enumerate(fits)]


def further(args: argparse.Namespace) -> pd.DataFrame:
    """Held-out errors of further robots: few poses with and without the type's prior, and many poses alone."""
    rng = np.random.default_rng(args.seed)
    plant = Plant.drawn(rng, args.spread)
    parameters, told = told_by(plant, [plant.built(rng) for _ in range(args.robots)], rng)
    prior, found = unlike(parameters, told)
    print(f"{len(found)} of {args.robots} robots wrongly named unlike their type", flush=True)
    expecting = replace(plant.stated, expected=prior.expected())
    usual = replace(
        plant.stated,
        expected=tuple(
            cf.Expected(one.effect, one.part, one.symbol, one.unit, 0.0, one.prior_sd) for one in parameters
        ),
    )  # what calflow takes where nobody knows better: ten poses are refused else
    best, full = plant.chosen(expecting, rng), np.full(FEW, len(PAYLOADS) - 1)
    rows = []
    for _ in range(args.further):
        real = plant.built(rng)
        data = plant.anywhere(real, MANY, rng, HELD_OUT)
        few = data.only(~data.train | (np.arange(len(data)) < FEW))
        held = few.table.iloc[FEW:]
        telling = plant.measured(real, best, full, rng)
        telling = replace(
            few, table=pd.concat([telling.table, held], ignore_index=True).assign(pose=np.arange(len(few)))
        )
        ways = {
            "10": (usual, few), "10, prior": (expecting, few), "10 chosen": (usual, telling),
            "10 chosen, prior": (expecting, telling), "100": (plant.stated, data),
        }  # fmt: skip
        rows.append({name: 1e3 * known(robot, own)[1] for name, (robot, own) in ways.items()})
    table = pd.DataFrame(rows)
    print(table.describe().loc[["mean", "50%", "max"]].round(4).to_string())
    print((table.mean() / table["100"].mean()).round(2).to_string())
    print(f"noise alone {1e3 * NOISE * np.sqrt(8 / np.pi):.4f} mm", flush=True)
    return table


def odd_ones(args: argparse.Namespace) -> pd.DataFrame:
    """Robots that are unlike their type, hidden among those that are not."""
    rows = []
    for fleet in range(args.fleets):
        rng = np.random.default_rng([args.seed, fleet])
        plant = Plant.drawn(rng, args.spread)
        hidden = dict(zip(rng.choice(args.robots, HIDDEN, replace=False).tolist(), UNLIKE, strict=True))
        joints = {k: int(rng.integers(1, 5)) for k in hidden}
        robots = [plant.built(rng, hidden.get(k, ""), joints.get(k, 0)) for k in range(args.robots)]
        _, found = unlike(*told_by(plant, robots, rng))
        named = {int(one.robot): one for one in found}
        for k, kind in hidden.items():
            one = named.get(k)
            said = f"{one.parameter} by {one.spreads:.1f} spreads" if one else "not named"
            more = ", ".join(one.instead) if one else ""
            rows.append(
                {"fleet": fleet, "robot": k, "hidden": f"joint{joints[k] + 1}.{kind}", "said": said, "or": more}
            )
        rows += [
            {"fleet": fleet, "robot": k, "hidden": "", "said": one.parameter}
            for k, one in named.items()
            if k not in hidden
        ]
    table = pd.DataFrame(rows)
    of = table[table["hidden"] != ""]
    print(table.to_string())
    print(
        f"named {(of['said'] != 'not named').sum()} of {len(of)}, wrongly {(table['hidden'] == '').sum()} in {args.fleets} fleets"
    )
    return table


def main() -> None:
    """Run both parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--robots", type=int, default=50, help="of the fleet")
    parser.add_argument("--further", type=int, default=20, help="robots measured after it")
    parser.add_argument("--fleets", type=int, default=4, help="in which robots unlike their type are hidden")
    parser.add_argument("--spread", type=float, default=1.0, help="times as much that robots of the type differ")
    parser.add_argument("--out", type=Path, help="folder for the tables")
    args = parser.parse_args()
    start = time.process_time()
    tables = {"further": further(args), "unlike": odd_ones(args)}
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        for name, table in tables.items():
            table.to_csv(args.out / f"{name}.csv", index=False)
    print(f"{time.process_time() - start:.0f} s of processor")


if __name__ == "__main__":
    main()
