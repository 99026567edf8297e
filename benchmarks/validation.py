"""Validation: how often further poses are within a tolerance that they were stated to be within with a probability of 0.9.

python benchmarks/validation.py [SIMULATIONS]     (500)

Robots of the 210 kg class are drawn by the hidden simulator, and calibrated by 120 poses. Poses are measured anywhere before them,
the tolerance is the one for which `validate` states 0.9, and as many further poses as that is about are measured after, by the
same device in the same place: where its frame was fitted, in the frame of the first poses. Errors are those of the calibrated
robot, which are mostly noise; of a robot that was calibrated without its springs, which hang together where poses are near; and
of the robot as its maker says.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import product

import numpy as np
from heavy_robot import EFFECTS, HeavyRobot, seen

from calflow.deployment.attained import Alignment, errors_left_out
from calflow.deployment.tolerance import Errors

STATED = 0.9
CASES = ((5, 1), (5, 5), (12, 1), (12, 12), (40, 1), (40, 40))  # poses measured, further poses asked for
ROBOTS, CALIBRATED_BY, POSES = 10, 120, 4000


@dataclass(frozen=True)
class Known:
    """Where a robot is at many poses, and where each model says that it is, shape (POSES, 3) [m]."""

    true: np.ndarray
    expected: dict[str, np.ndarray]

    @staticmethod
    def drawn(rng: np.random.Generator) -> Known:
        """Draw a robot and calibrate it."""
        robot = HeavyRobot.drawn(rng)
        q = robot.poses(POSES, rng)
        conditions = robot.measured(q, robot.points(q)).stating(()).conditions
        whole, _ = robot.calibrated(CALIBRATED_BY, rng)
        stiff, _ = robot.calibrated(CALIBRATED_BY, rng, EFFECTS[:1])
        estimates = {
            "calibrated": (whole.model, whole.estimate), "without springs": (stiff.model, stiff.estimate),
            "nominal": (whole.model, whole.model.nominal),
        }  # fmt: skip
        return Known(
            robot.points(q)[:, 0], {name: model.point(p, conditions) for name, (model, p) in estimates.items()}
        )


def is_right(known: Known, model: str, poses: int, further: int, fitted: bool, rng: np.random.Generator) -> bool:
    """Whether further poses are within what the first ones state."""
    own = rng.choice(len(known.true), poses + further, replace=False)
    measured, expected = seen(known.true[own], rng), known.expected[model][own]
    error = measured - expected
    if fitted:
        error = Alignment.best(measured[:poses], expected[:poses]).of(measured) - expected
        error[:poses] = errors_left_out(measured[:poses], expected[:poses], np.arange(poses))
    size = np.linalg.norm(error, axis=1)
    limit = Errors.of(size[:poses], 1.0 if fitted else 0.0).reached_by(STATED, further)
    return bool((size[poses:] <= limit).all())


def main(simulations: int) -> None:
    """Print the share that was right, which is to be 0.87 to 0.93."""
    rng = np.random.default_rng(11)
    robots = [Known.drawn(np.random.default_rng(seed)) for seed in range(ROBOTS)]
    print(
        f"stated {STATED}; {simulations} simulations a figure, {ROBOTS} robots\nerrors           frame   poses  further  right"
    )
    for model, fitted, (poses, further) in product(robots[0].expected, (False, True), CASES):
        right = np.mean([is_right(robots[k % ROBOTS], model, poses, further, fitted, rng) for k in range(simulations)])
        print(f"{model:15s}  {'fitted' if fitted else 'known':6s}  {poses:5d}  {further:7d}  {right:5.3f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
