"""Look-alikes of one and of two parameters: whether a stated probability comes true, whichever of the two is hidden.

    python benchmarks/rival_pairs.py linear --cases 600    100 to 10,000 rows, the two alone, without a robot
    python benchmarks/rival_pairs.py robot --cases 60      100 to 1,000 rows, identify and diagnose with the whole catalogue

Both truths equally often. Sizes are a 170 kg arm's (log-uniform, from a fifth of the least usual one to the largest), those of
several parameters in a direction drawn at random; joints travel a part of their range, and come from the side to which gravity
turns them more often than not. What a cause does is a lever of foreign_physics' arms times an input; all geometry and springs are
fitted beside it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import kept_cases
import numpy as np
import pandas as pd
from foreign_forms import rated
from foreign_physics import ARMS, Arm, Array, Frame, Rows, Yielding, measured_rows, points, slopes, state, worn
from foreign_study import identified, joint_of, names_of, write_study
from kept_cases import Place, Row, calibration_table

from calflow.linear import Block, diagnose_linear

ROWS = {"linear": (100, 10_000), "robot": (100, 1_000)}
BINS = [0, 0.5, 0.8, 0.9, 0.95, 1]
CERTAIN = 0.95
SMALLEST = 0.2  # of the least usual size
SHOWN = 1e-8  # of the largest, from which a direction of the fitted parameters counts
USUAL = {  # rad, of device causes m, of what gives way rad/Nm
    "joint-eccentricity": (20e-6, 300e-6), "periodic-joint-error": (50e-6, 400e-6), "gear-ratio-error": (20e-6, 400e-6),
    "joint-backlash": (20e-6, 300e-6), "torque-backlash": (20e-6, 300e-6), "friction-wind-up": (20e-6, 300e-6),
    "nonlinear-joint-stiffness": (50e-6, 1000e-6), "gravity-compensator": (50e-6, 1000e-6), "frame-drift": (5e-5, 3e-4),
    "frame-step": (5e-5, 3e-4), "bearing-compliance": (2e-8, 3e-7), "link-torsion": (3e-8, 3e-7),
}  # fmt: skip
PAIRS = (
    ("gear-ratio-error", "joint-eccentricity"), ("joint-eccentricity", "periodic-joint-error"),
    ("joint-backlash", "torque-backlash"),
    ("joint-backlash", "friction-wind-up"), ("nonlinear-joint-stiffness", "torque-backlash"), ("frame-drift", "frame-step"),
    ("gravity-compensator", "joint-eccentricity"), ("link-torsion", "bearing-compliance"),
)  # fmt: skip


@dataclass(frozen=True)
class World:
    """An arm at rows, the joint in question (index), its share of the rated torque, and how points move with it."""

    arm: Arm
    rows: Rows
    i: int
    share: Array
    lever: Array  # (rows, 3) a turn of the joint
    tilts: Array  # (rows, 3, 2) turns about x and y of the joint's frame, times the moments about them
    twist: Array  # (rows, 3) a turn about the link's line, times the moment about it

    @staticmethod
    def drawn(rows: int, rng: np.random.Generator) -> World:
        """Draw it."""
        arm = ARMS["large-6"]
        middle = measured_rows(arm, 1, rng).q[0]
        reach = rng.uniform(0.25, 1.0, arm.n) * np.ptp(arm.limits, axis=1) / 2
        box = np.clip(np.stack([middle - reach, middle + reach], axis=1), *arm.limits.T[:, :, None])
        done = measured_rows(arm, rows, rng, box=box)
        i = int(rng.choice([1, 2]))
        now = state(arm, done, Yielding.none(rows, arm.n))
        share, joint, at = now.torque(i) / rated(arm, i), now.joints[i], now.tips[-1].at(arm.markers[done.marker])
        follows = rng.random(rows) < rng.uniform(0, 0.7)
        side = done.side.copy()
        side[follows, i] = np.sign(share - np.median(share))[follows]
        moment = now.moment(i, joint.place)
        line = now.tips[i].place - joint.place
        line = line / np.linalg.norm(line, axis=1, keepdims=True)

        def turned(axis: Array, frame: Frame) -> Array:
            return np.cross(axis, at - frame.place) @ arm.base.as_matrix().T

        tilts = [
            turned(joint.turn[:, :, k], joint) * (moment * joint.turn[:, :, k]).sum(axis=1)[:, None] for k in (0, 1)
        ]
        twist = turned(line, joint) * (moment * line).sum(axis=1)[:, None]
        return World(
            arm, replace(done, side=side), i, share, turned(joint.turn[:, :, 2], joint), np.stack(tilts, axis=2), twist
        )

    @property
    def q(self) -> Array:
        """The joint's readings (rows,)."""
        return self.rows.q[:, self.i]

    def by_angle(self, *inputs: Array) -> Array:
        """What errors of the joint do (rows, 3, inputs)."""
        return self.lever[:, :, None] * np.stack(inputs, axis=1)[:, None]

    def by_device(self, course: Array) -> Array:
        """What a shift along each axis does that follows a course in time (rows, 3, 3)."""
        return course[:, None, None] * np.eye(3)


def _sprung(world: World, hinge: float) -> Array:
    """The torque of a spring over a joint, from a hinge four times as far off as its lug."""
    return np.sin(world.q - hinge) / np.sqrt(1 + 0.25**2 - 0.5 * np.cos(world.q - hinge))


def _course(world: World) -> Array:
    return (world.rows.time - world.rows.time.min()) / np.ptp(world.rows.time)


FORMS: Mapping[
    str, tuple[tuple[float, ...], Callable[[World, float], Array]]
] = {  # forms that are scanned, and what each does
    "joint-eccentricity": ((1.0,), lambda w, k: w.by_angle(np.cos(w.q), np.sin(w.q))),
    "periodic-joint-error": (
        (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0),
        lambda w, k: w.by_angle(np.cos(k * w.q), np.sin(k * w.q)),
    ),
    "gear-ratio-error": ((0.0,), lambda w, _: w.by_angle(w.q)),
    "joint-backlash": ((0.0,), lambda w, _: w.by_angle(w.rows.side[:, w.i])),
    "torque-backlash": ((0.01,), lambda w, near: w.by_angle(np.tanh(w.share / near))),
    "friction-wind-up": ((0.0,), lambda w, _: w.by_angle(w.rows.side[:, w.i], w.rows.side[:, w.i] * np.abs(w.share))),
    "nonlinear-joint-stiffness": ((3.0,), lambda w, power: w.by_angle(w.share**power)),
    "gravity-compensator": (tuple(np.arange(-1.5, 1.6, 0.5)), lambda w, hinge: w.by_angle(_sprung(w, hinge))),
    "frame-drift": ((0.0,), lambda w, _: w.by_device(_course(w))),
    "frame-step": (
        tuple(np.arange(0.1, 0.95, 0.1)),
        lambda w, moment: w.by_device((_course(w) > moment).astype(float)),
    ),
    "bearing-compliance": ((0.0,), lambda w, _: w.tilts),
    "link-torsion": ((0.0,), lambda w, _: w.twist[:, :, None]),
}


@dataclass(frozen=True)
class Truth:
    """Which of a pair is hidden, what it does (rows, 3) [m], and what is said of the case."""

    world: World
    pair: tuple[str, str]
    hidden: str
    moved: Array
    sigma: float

    @staticmethod
    def drawn(place: Place) -> Truth:
        """Draw it: the pairs and both of each in turn."""
        rng = place.rng
        pair, which = list(product(PAIRS, (0, 1)))[place.number % (2 * len(PAIRS))]
        world = World.drawn(int(np.exp(rng.uniform(*np.log(ROWS[place.kind])))), rng)
        hidden = pair[which]
        variants, act = FORMS[hidden]
        columns = act(world, float(rng.choice(variants)))
        direction = rng.normal(size=columns.shape[2])
        least, most = USUAL[hidden]
        size = np.exp(rng.uniform(np.log(SMALLEST * least), np.log(most)))
        return Truth(
            world,
            pair,
            hidden,
            columns @ (size * direction / np.linalg.norm(direction)),
            float(rng.uniform(3e-5, 5e-5)),
        )

    def rows(self, found: list[tuple[str, float]]) -> list[Row]:
        """A row a name, with its probability and whether it is right; one without where there is none."""
        known: Row = {
            "pair": " / ".join(self.pair),
            "hidden": self.hidden,
            "rows": len(self.moved),
            "names": len(found),
        }
        given = [{"name": name, "probability": stated, "right": name == self.hidden} for name, stated in found]
        return [known | row for row in given] or [known | {"name": "", "probability": np.nan, "right": np.nan}]


def work_linear(place: Place) -> list[Row]:
    """Hide one of a pair, and have the method without a robot choose."""
    truth, rng = Truth.drawn(place), np.random.default_rng([place.seed, place.number, 1])
    blocks = []
    for cause in truth.pair:
        variants, act = FORMS[cause]
        blocks += [
            Block(cause, _flat(act(truth.world, variant)), USUAL[cause][1] / 2, f"{variant:g}") for variant in variants
        ]
    seen = truth.moved + truth.sigma * rng.standard_normal(truth.moved.shape)
    slope = slopes(truth.world.arm, truth.world.rows)
    span, shown, _ = np.linalg.svd(slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-12), full_matrices=False)
    told = diagnose_linear(-seen.ravel(), span[:, shown > SHOWN], blocks, rng=rng, noise=truth.sigma)
    return truth.rows([(finding.name, finding.probability) for finding in told.findings])


def _flat(columns: Array) -> Array:
    return columns.reshape(-1, columns.shape[2])


def work_robot(place: Place) -> list[Row]:
    """Hide one of a pair in an arm as built, and have it identified and diagnosed."""
    truth, rng = Truth.drawn(place), np.random.default_rng([place.seed, place.number, 1])
    world = truth.world
    seen = points(worn(world.arm, rng), world.rows) + truth.moved + truth.sigma * rng.standard_normal(truth.moved.shape)
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, world.arm, world.rows, seen, sigma=truth.sigma, columns=("approach", "time"))
        names = names_of(identified(folder).diagnose())
    here = [
        f"{row['cause']}" + (f":{joint_of(row)}" if joint_of(row) not in (0, world.i + 1) else "")
        for _, row in names.iterrows()
    ]
    return truth.rows(list(zip(here, names["probability"], strict=True)))


def tell(rows: pd.DataFrame) -> str:
    """Stated against right in bins, and names stated at 0.95 and more that are wrong; by pair, and by number of rows."""
    named = rows[rows["probability"].notna()]
    if named.empty:
        return "nothing was named"
    right = named["right"].astype(str).str.startswith(("True", "1"))
    named = named.assign(right=right, wrong=~right & (named["probability"] >= CERTAIN),
                         size=pd.cut(named["rows"], [0, 300, 1000, 3000, 10_001]))  # fmt: skip
    cases = rows.drop_duplicates(["seed", "case"])
    wrong = named[named["wrong"]].drop_duplicates(["seed", "case"])
    tables = [
        named.groupby(key, observed=True).agg(n=("right", "size"), stated=("probability", "mean"), right=("right", "mean"),
                                              certain_and_wrong=("wrong", "mean")).round(3).to_string()
        for key in ("pair", "hidden", "size")
    ]  # fmt: skip
    return "\n\n".join([
        calibration_table(named["probability"], right, BINS), *tables,
        f"wrong at {CERTAIN} or more: {len(wrong)} of {len(cases)} cases; nothing named in {(cases['names'] == 0).sum()}",
    ])  # fmt: skip


if __name__ == "__main__":
    kept_cases.run_cases(__doc__, {"linear": (work_linear, tell), "robot": (work_robot, tell)})
