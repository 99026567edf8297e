"""Promises in another place by devices that see no position: sockets, a wire, planes; measured in one place, judged in another.

    python benchmarks/one_place.py --cases 72 --seed 1 --out one_place.csv

A UR10 or an arm of the 210 kg class errs in all figures (0.5 mm, 1 mrad), and in three joints by nothing, by three waves of each
one's own angle, or by a product of waves of three joints' angles, which no catalogue has: at the tool by 3 times the noise. It is
measured by two sockets 50 mm apart, by two in opposite corners, by a wire's lengths in a ball a tenth of its reach in radius, or by
three planes; judged by a third socket, the wire all over the joints' ranges, or a fourth plane, which their own rows place. promise
is the pooled standard deviation over the pooled error. Only waves of a joint's own angle may be named.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import kept_cases
import numpy as np
import pandas as pd
from kept_cases import Place, Row

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import calflow as cf
from calflow.files.units import METRE
from calflow.measurements.series import Series
from hidden.devices import Arm, Array, measured, sockets, surface, wire
from robots import industrial, marker_position, ur10

NOISE, NOISES = 1e-4, 3.0  # m
ERRING, PRODUCT, WAVES = (1, 2, 3), 3, 3
TOUCHES, LENGTHS, FURTHER = 50, 100, 40
NEAR, TINY = 0.1, 1e-6  # of the reach; rad
WITHIN = 1.959964

Wrong = Callable[[Array], Array]  # joint angles (n, n_joints) to what they are off by


@dataclass(frozen=True)
class Bent(Arm):
    """An arm whose joints are off by wrong(q) [rad]."""

    wrong: Wrong

    def tool(self, q: Array, marker: int = 0) -> Array:
        """The marker's points (n, 3)."""
        return marker_position(self.robot, q + self.wrong(q), self.figures, marker)


def nothing(n: int, rng: np.random.Generator) -> Wrong:
    """No error."""
    return np.zeros_like


def waves(n: int, rng: np.random.Generator) -> Wrong:
    """Waves of each joint's own angle, the shorter the smaller."""
    size = rng.standard_normal((2, WAVES, n)) / np.arange(1, WAVES + 1)[:, None] * np.isin(np.arange(n), ERRING)
    order = np.arange(1, WAVES + 1)[:, None, None]
    return lambda q: (size[0][:, None] * np.cos(order * q) + size[1][:, None] * np.sin(order * q)).sum(axis=0)


def product(n: int, rng: np.random.Generator) -> Wrong:
    """Products of waves of three joints' angles."""
    of = [(rng.choice(n, PRODUCT, replace=False), rng.uniform(0.7, 1.5, 3), rng.uniform(0, 6, 3)) for _ in ERRING]

    def wrong(q: Array) -> Array:
        off = np.zeros_like(q)
        for joint, (others, rate, phase) in zip(ERRING, of, strict=True):
            off[:, joint] = np.prod(np.sin(rate * q[:, others] + phase), axis=1)
        return off

    return wrong


def drawn(misfit: Callable[[int, np.random.Generator], Wrong], arm: Arm, rng: np.random.Generator) -> Bent:
    """An arm that errs so, by NOISES at the tool over all its poses."""
    wrong, q = misfit(arm.robot.n_joints, rng), arm.random(2000, rng)
    moved = marker_position(arm.robot, q + TINY * wrong(q), arm.figures) - arm.tool(q)
    size = NOISES * NOISE / max(float(np.sqrt(np.mean(moved**2))), 1e-12) * TINY
    return Bent(arm.robot, arm.figures, lambda q: size * wrong(q))


Tables = tuple[pd.DataFrame, pd.DataFrame, Series]  # here, elsewhere, and what they are


def by_sockets(apart: bool) -> Callable[[Bent, np.random.Generator], Tables]:
    """Touches of two sockets, and of a third one."""

    def tables(arm: Bent, rng: np.random.Generator) -> Tables:
        here, there, third = arm.tool(arm.random(3, rng, reach=1.0))
        pair = {"a": here, "b": there if apart else here + np.array([0.03, 0.04, 0.0])}
        both = (sockets(arm, points, n, NOISE, rng) for points, n in ((pair, TOUCHES), ({"c": third}, FURTHER)))
        return (*both, Series.of("", "same-point", labels=("socket",)))

    return tables


def by_wire(arm: Bent, rng: np.random.Generator) -> Tables:
    """Lengths of a wire near one point, and everywhere."""
    every, centre = arm.random(100_000, rng), arm.tool(arm.random(1, rng, reach=1.0))[0]
    points = arm.tool(every)
    reach = np.linalg.norm(points, axis=1).max()
    near = every[np.linalg.norm(points - centre, axis=1) < NEAR * reach][:LENGTHS]
    anchor = reach * np.array([1.2, 0.3, 0.1])
    here, there = (wire(arm, q, anchor, NOISE, rng) for q in (near, every[:LENGTHS]))
    return here, there, Series.of("", "distance", {"offset": 0.0, "scale": 0.0})


def by_planes(arm: Bent, rng: np.random.Generator) -> Tables:
    """Touches of three planes, and of a fourth one."""
    normals = np.vstack([np.eye(3), rng.standard_normal((1, 3))])
    touched = [
        surface(arm, point, normal / np.linalg.norm(normal), TOUCHES, NOISE, rng).assign(plane=str(k))
        for k, (point, normal) in enumerate(zip(arm.tool(arm.random(4, rng, reach=1.0)), normals, strict=True))
    ]
    return pd.concat(touched[:3], ignore_index=True), touched[3], Series.of("", "plane", labels=("plane",))


ARMS = (ur10, industrial)
DEVICES = {"sockets beside": by_sockets(False), "sockets apart": by_sockets(True), "wire": by_wire, "planes": by_planes}
MISFITS = {"none": nothing, "waves": waves, "product": product}


def work(place: Place) -> list[Row]:
    """Calibrate an arm here, and hold what is found elsewhere against what is promised."""
    rng, k = place.rng, place.number
    device, misfit = list(DEVICES)[k % len(DEVICES)], list(MISFITS)[k // len(DEVICES) % len(MISFITS)]
    nominal = ARMS[k // len(DEVICES) // len(MISFITS) % len(ARMS)]()
    arm = drawn(MISFITS[misfit], Arm.drawn(nominal, rng), rng)
    here, there, series = DEVICES[device](arm, rng)
    data = measured(arm.robot, here, series, NOISE).split(holdout=0.2, seed=place.seed)
    first = cf.identify(arm.robot, data, ("geometry",), starts=1, seed=place.seed)
    found = []
    for stage, known in (("identify", first), ("diagnose", first.diagnose())):
        names = known.findings.table
        named = names["cause"][names["status"].isin(["named", "one_of"])].nunique() if len(names) else 0
        further = measured(known.model.robot, there, series, NOISE).stating(known.model.given)
        judged = known.errors_in_unit(further, METRE)
        seen = np.isfinite(judged.error)
        error, sd = judged.error[seen], np.sqrt(judged.variance[seen] + NOISE**2)
        found.append({
            "device": device, "misfit": misfit, "arm": nominal.name, "stage": stage, "coordinates": len(error),
            "covered": (np.abs(error) < WITHIN * sd).mean(), "found_mm": 1e3 * np.sqrt(np.mean(error**2)),
            "promised_mm": 1e3 * np.sqrt(np.mean(sd**2)), "named": named,
        })  # fmt: skip
    return found


def tell(rows: pd.DataFrame) -> str:
    """Coverage, promise over found, and names of what has none."""

    def of(group: pd.DataFrame) -> pd.Series:
        sizes = group["coordinates"]
        promised, error = (
            np.sqrt(np.average(group[f"{name}_mm"] ** 2, weights=sizes)) for name in ("promised", "found")
        )
        return pd.Series({"covered": np.average(group["covered"], weights=sizes), "promise": promised / error,
                          "found_mm": error, "named": (group["named"] > 0).mean(), "cases": len(group)})  # fmt: skip

    tables = (
        rows.groupby(keys).apply(of, include_groups=False).round(3)
        for keys in (["stage", "misfit", "device"], ["stage", "misfit"])
    )
    return "\n\n".join(table.to_string() for table in tables)


if __name__ == "__main__":
    kept_cases.run_cases(__doc__, {"one_place": (work, tell)})
