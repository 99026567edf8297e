"""Drift: shifts of a joint's zero found by eight check poses, the joint that is named, and false alarms where nothing moved.

python benchmarks/drift.py [CALIBRATIONS] [CHECKS]     (10 calibrations, 100 checks of each with a shift, 100 without)

The robot is a simulated one of the 210 kg class with a load; each calibration has 100 poses of its own. A check is eight poses that
tell the zeros of all joints as surely as eight can, measured once each; noise is 0.05 mm per axis throughout.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import calflow as cf
from calflow.deployment.check import Check
from calflow.deployment.drift import searched
from calflow.deployment.drift_verdict import MOVEMENTS_SHARE, drift, rivals
from calflow.deployment.movements import movements
from calflow.design.candidates import candidates
from calflow.design.optimality import greedy
from calflow.estimation.calibrated import Identified
from calflow.model import Model, build
from robots import industrial

NOISE, SHIFT, POSES, ALARM = 5e-5, 1e-4, 8, 0.01
EFFECTS = ("geometry", "joint-compliance")


def truth(model: Model, rng: np.random.Generator) -> np.ndarray:
    """A robot as built: half a millimetre and half a milliradian off everywhere, with springs in its joints."""
    values = model.nominal.copy()
    for k, parameter in enumerate(model.parameters):
        compliant = parameter.effect == "joint-compliance"
        values[k] += abs(rng.normal(0, 4e-7)) if compliant else rng.normal(0, 5e-4)
    return values


def measured(model: Model, p: np.ndarray, q: np.ndarray, rng: np.random.Generator, **more: object) -> cf.Measurements:
    """Poses as the tracker sees them."""
    robot = model.robot
    rows = cf.Measurements.from_arrays(
        robot, q, np.zeros((len(q), 3)), payload="load", sigma=np.full(len(q), NOISE), **more
    )
    seen = model.point(p, rows.stating(model.given).rows) + NOISE * rng.standard_normal((len(q), 3))
    return cf.Measurements.from_arrays(robot, q, seen, payload="load", sigma=np.full(len(q), NOISE), **more)


def check_poses(known: Identified, rng: np.random.Generator) -> np.ndarray:
    """Eight poses that tell the zeros of all joints best."""
    readings, _ = candidates(known.model, 400, "load", "E", None, rng)
    rows = cf.Measurements.from_arrays(known.model.robot, readings, None, payload="load")
    zeros = np.concatenate([one.slope for one in movements(known, rows, True) if one.kind == "zero"], axis=2)
    return readings[greedy(zeros * 1e-4 / NOISE, np.eye(zeros.shape[2]), POSES)]


def main(calibrations: int, checks: int) -> None:
    """Print what was found."""
    robot = industrial()
    model = build(robot, EFFECTS)
    alarms, found, right, named, settled = 0, np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    tried, limits = np.zeros(6), []
    for seed in range(calibrations):
        rng = np.random.default_rng(seed)
        p = truth(model, rng)
        q = candidates(model, 100, "load", "E", None, rng)[0]
        fit = cf.identify(robot, measured(model, p, q, rng).split(0.0, 1), EFFECTS, starts=1)
        found_model = fit.identification.known
        known = replace(found_model, model=replace(found_model.model, given=()))
        own = check_poses(known, rng)
        for k in range(checks):
            data = measured(model, p, own, rng, split="train")
            verdict = drift(known, [], data, false_alarm=ALARM, station="known", seed=k)
            alarms += verdict.summary.status != "in place"
        limits.append(
            [one.limits[0] for one in sorted(verdict.candidates, key=lambda one: one.movement) if one.kind == "zero"]
        )
        for k in range(checks):
            joint = k % 6
            moved = own.copy()
            moved[:, joint] += SHIFT * (-1) ** k
            data = measured(model, p, moved, rng, split="train")
            data = cf.Measurements.from_arrays(
                robot, own, data.position, payload="load", sigma=data.sigma, split="train"
            )
            check = Check.of(known, [], data, False)
            steps = searched(check, movements(known, data, True), MOVEMENTS_SHARE * ALARM, np.random.default_rng(k))
            tried[joint] += 1
            hit = steps[0].family_p < MOVEMENTS_SHARE * ALARM
            found[joint] += hit
            right[joint] += hit and steps[0].best.movement.joint == joint + 1
            named[joint] += hit and f"joint{joint + 1}.zero" == steps[0].best.movement.name
            settled[joint] += hit and not rivals(steps[0])
        print(f"calibration {seed}: {alarms} false alarms of {checks * (seed + 1)}", flush=True)
    print(f"false alarms {alarms} of {calibrations * checks}, allowed {ALARM}")
    print("joint  found  joint right (of those found)  zero named  nothing else left  found in 95 of 100 from [mrad]")
    for joint in range(6):
        hits = max(found[joint], 1)
        print(f"{joint + 1:5d}  {found[joint] / tried[joint]:5.3f}  {right[joint] / hits:28.3f}  {named[joint] / hits:10.3f}  "
              f"{settled[joint] / hits:17.3f}  {1e3 * np.mean(limits, axis=0)[joint]:10.3f}")  # fmt: skip


if __name__ == "__main__":
    main(*(int(one) for one in sys.argv[1:])) if len(sys.argv) > 2 else main(10, 100)
