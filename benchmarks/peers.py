"""Identify a simulated UR10 with calflow and with pybotics: same data, same split, one run, the processor's seconds.

    python benchmarks/peers.py --pybotics PYTHON

PYTHON is an interpreter that has pybotics, which needs numpy 1 and lives in an environment of its own.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.estimation.accuracy import errors
from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.robot.frames import modified_dh
from calflow.robot.parts import Joint, Marker
from calflow.robot.robot import Robot

# modified DH of a UR10 [m, rad]: alpha, a, theta, d of each joint, as pybotics states it
TABLE = np.array(
    [
        [0, 0, 0, 0.118],
        [np.pi / 2, 0, np.pi, 0],
        [0, 0.6127, 0, 0],
        [0, 0.5716, 0, 0.1639],
        [-np.pi / 2, 0, 0, 0.1157],
        [np.pi / 2, 0, np.pi, 0.0922],
    ]
)
SIGMA = 5e-5  # m
TRAIN, HELDOUT = 700, 300

PEER = """
import sys, time
import numpy as np
from scipy.optimize import least_squares
from pybotics.optimization import OptimizationHandler, compute_absolute_errors, optimize_accuracy
from pybotics.robot import Robot
data = np.load(sys.argv[1])
table = data["table"].copy()
table[:, [1, 3]] *= 1e3
robot = Robot.from_parameters(table)
handler = OptimizationHandler(robot, kinematic_chain_mask=[True] * robot.kinematic_chain.num_parameters)
n = int(data["train"])
started = time.process_time()
least_squares(optimize_accuracy, handler.generate_optimization_vector(),
              args=(handler, data["q"][:n], 1e3 * data["xyz"][:n]))
seconds = time.process_time() - started
heldout = compute_absolute_errors(data["q"][n:], 1e3 * data["xyz"][n:], handler.robot)
print(seconds, heldout.mean())
"""


def forward(table: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Positions (n, 3) of the last frame, in plain numpy."""
    frame = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for (alpha, a, theta, d), angle in zip(table, q.T, strict=True):
        c, s, ca, sa = np.cos(angle + theta), np.sin(angle + theta), np.cos(alpha), np.sin(alpha)
        zero, one = np.zeros_like(c), np.ones_like(c)
        link = np.array(
            [[c, -s, zero, a * one], [s * ca, c * ca, -sa * one, -d * sa * one],
             [s * sa, c * sa, ca * one, d * ca * one], [zero, zero, zero, one]]
        ).transpose(2, 0, 1)  # fmt: skip
        frame = frame @ link
    return frame[:, :3, 3]


def main() -> None:
    """Print one line a program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pybotics", required=True, help="a Python interpreter that has pybotics")
    parser.add_argument("--repeats", type=int, default=3)
    asked = parser.parse_args()

    rng = np.random.default_rng(0)
    true = TABLE + rng.normal(scale=1e-3, size=TABLE.shape)
    q = rng.uniform(-np.pi, np.pi, (TRAIN + HELDOUT, 6))
    xyz = forward(true, q) + SIGMA * rng.standard_normal((len(q), 3))

    print(f"{'':10} {'seconds':>8} {'held-out mean mm':>17}")
    runs = [calflow(q, xyz, f"UR10 {k}") for k in range(4 * asked.repeats)]
    own, least = min(runs), min(work for *_, work in runs)
    print(f"{'calflow':10} {own[0]:8.4f} {own[1]:17.4f}")
    print(f"{'':10} {runs[0][0]:8.4f} the first, which loads the effects, the kinds of observation and IPOPT")
    print(f"{'':10} {least:8.4f} of its own Jacobians and QR factorisations: {own[0] / least:.1f} times as much")
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data.npz"
        np.savez(data, table=TABLE, q=q, xyz=xyz, train=TRAIN)
        command = [asked.pybotics, "-c", PEER, str(data)]
        peer = min(
            tuple(map(float, subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()))
            for _ in range(asked.repeats)
        )
    print(f"{'pybotics':10} {peer[0]:8.3f} {peer[1]:17.4f}")
    print(f"calflow is {peer[0] / own[0]:.0f} times as fast")


def calflow(q: np.ndarray, xyz: np.ndarray, name: str) -> tuple[float, float, float]:
    """Seconds from table to estimate, with the graph's construction; held-out mean error [mm]; seconds of the linear algebra.

    The last is what a Jacobian and its QR factorisation take at each point that the fit looks at. What was made of a robot is
    kept: one of a new name is a robot that nothing is kept of.
    """
    joints = [Joint(modified_dh(alpha=r[0], a=r[1], theta=r[2], d=r[3])) for r in TABLE.tolist()]
    robot = Robot(joints, name=name, markers={"flange": Marker((0.0, 0.0, 0.0))})
    table = pd.DataFrame(q, columns=[f"q{i + 1}" for i in range(6)])
    table[["x", "y", "z"]] = xyz
    table = table.assign(pose=np.arange(len(q)), repeat=1, marker="flange", payload="", split="train")
    data = Measurements(robot, table)
    train, heldout = data.only(np.arange(len(q)) < TRAIN), data.only(np.arange(len(q)) >= TRAIN)
    started = time.process_time()
    model = build(robot, ("geometry",))
    result, _ = fit(LeastSquares.of(model, train, Noise(np.full(TRAIN, SIGMA), ("file",))))
    seconds = time.process_time() - started
    started = time.process_time()
    for _ in range(result.iterations + 1):
        result.problem.r_factor(result.estimate)
    least = time.process_time() - started
    return seconds, 1e3 * float(np.linalg.norm(errors(model, result.estimate, heldout), axis=1).mean()), least


if __name__ == "__main__":
    main()
