"""What a tracker, two sockets and a draw-wire report of an arm that is not quite what `arm.urdf` says: python measured.py

The arm is simulated by NumPy and SciPy alone, so that the three studies show whether calflow finds what is hidden here.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

HERE = Path(__file__).parent
AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]])
ORIGINS = np.array([[0, 0, 0.40], [0.15, 0, 0], [0, 0, 0.60], [0.10, 0, 0.12], [0.52, 0, 0], [0.10, 0, 0]])  # m
BALL = np.array([0.090, 0.040, 0.060])  # m, in the flange's frame
LONGER = np.array([[0, 0, 0], [5e-4, 0, 0], [0, 0, -6e-4], [0, 4e-4, 0], [-3e-4, 0, 0], [0, 0, 0]])  # m: hidden errors
ZEROS = np.array([0, 0.8e-3, -1.1e-3, 0.6e-3, -0.7e-3, 0])  # rad
ECCENTRIC = 0.4e-3  # rad: the gear of joint 3 does not run true
TRACKER, BESIDE = np.array(
    [[2.5, -0.8, 0.1], [0.03, 0.04, 0.0]]
)  # m: the arm's foot as the tracker sees it; socket to socket
LOW, HIGH = np.array(
    [[-2.4, -1.2, -1.6, -2.2, -1.6, -2.2], [2.4, 1.2, 1.6, 2.2, 1.6, 2.2]]
)  # rad: where it is measured


def ball(q: np.ndarray) -> np.ndarray:
    """Where the real arm has its ball, at readings (n, 6) [rad]: (n, 3) [m]."""
    angles = q + ZEROS
    angles[:, 2] += ECCENTRIC * np.sin(q[:, 2])
    place, turn = np.zeros((len(q), 3)), Rotation.identity(len(q))
    for origin, axis, angle in zip(ORIGINS + LONGER, AXES, angles.T, strict=True):
        place = place + turn.apply(origin)
        turn = turn * Rotation.from_rotvec(angle[:, None] * axis)
    return place + turn.apply(BALL)


def touching(socket: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Readings (6,) [rad] with which the ball is in a socket (3,) [m], from whatever side the hand comes."""
    while True:
        found = least_squares(lambda q: ball(q[None])[0] - socket, rng.uniform(LOW, HIGH), bounds=(LOW, HIGH))
        if found.cost < 1e-16:
            return found.x


def write(name: str, header: list[str], rows: list[list[str]], separator: str = ",") -> None:
    """Write a table beside this file."""
    with (HERE / name).open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, delimiter=separator, lineterminator="\n").writerows([header, *rows])


def degrees(q: np.ndarray) -> list[str]:
    """Readings as a controller shows them."""
    return [f"{angle:.4f}" for angle in np.degrees(q)]


def main() -> None:
    """Write tracker.csv, sockets.csv and wire.csv."""
    rng = np.random.default_rng(25)

    q = rng.uniform(LOW, HIGH, (90, 6))
    seen = Rotation.from_euler("z", 35, degrees=True).apply(ball(q)) + TRACKER + rng.normal(0, 2e-5, (90, 3))
    rows = [
        [f"P{k:02}", *degrees(row), *(f"{1e3 * x:.3f}" for x in at)]
        for k, (row, at) in enumerate(zip(q, seen, strict=True), 1)
    ]
    german = [[cell.replace(".", ",") for cell in row] for row in rows]
    write("tracker.csv", ["Punkt", *(f"A{k}" for k in range(1, 7)), "X", "Y", "Z"], german, ";")

    rows = []
    for placement, place in enumerate(
        ([0.75, -0.20, 0.30], [0.65, 0.35, 0.55], [-0.10, 0.80, 0.45], [0.35, -0.70, 0.85]), 1
    ):
        for socket, at in (("left", np.array(place)), ("right", np.array(place) + BESIDE)):
            for _ in range(15):
                q = touching(at + rng.normal(0, 3e-5, 3), rng)
                rows.append([str(placement), socket, *degrees(q)])
    write("sockets.csv", ["placement", "socket", *(f"q{k}_deg" for k in range(1, 7))], rows)

    q = rng.uniform(LOW, HIGH, (100, 6))
    lengths = np.linalg.norm(ball(q) - [1.9, 0.3, -0.2], axis=1) + rng.normal(0, 5e-5, 100)
    rows = [[*degrees(row), f"{1e3 * length:.3f}"] for row, length in zip(q, lengths, strict=True)]
    write("wire.csv", [*(f"q{k}_deg" for k in range(1, 7)), "length_mm"], rows)


if __name__ == "__main__":
    main()
