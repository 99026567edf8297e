"""Arms that photograph boards, in plain numpy apart from calflow's graph: chain, pinhole and distortion of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

SIZE = np.array([1280.0, 960.0])  # px


def frame(turn: Rotation | None = None, origin: tuple[float, ...] | np.ndarray = (0, 0, 0)) -> np.ndarray:
    """A transform (4, 4)."""
    made = np.eye(4)
    made[:3, :3] = np.eye(3) if turn is None else turn.as_matrix()
    made[:3, 3] = origin
    return made


def screws(axis: str, angle: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Turns about an axis and shifts along it, (…, 4, 4)."""
    i, j, k = {"x": (0, 1, 2), "z": (2, 0, 1)}[axis]
    made = np.zeros((*np.shape(angle), 4, 4))
    made[..., j, j] = made[..., k, k] = np.cos(angle)
    made[..., k, j] = np.sin(angle)
    made[..., j, k] = -made[..., k, j]
    made[..., i, i] = made[..., 3, 3] = 1.0
    made[..., i, 3] = along
    return made


@dataclass(frozen=True)
class Arm:
    """DH figures (n, 4) alpha, a, theta, d [rad, m], standard or modified, and the joints' limits (n, 2) [rad]."""

    figures: np.ndarray
    modified: bool
    limits: np.ndarray

    def worn(self, rng: np.random.Generator, turn: float = 1e-3, shift: float = 5e-4) -> Arm:
        """The arm with errors of all its figures."""
        by = rng.normal(size=self.figures.shape) * [turn, shift, turn, shift]
        return replace(self, figures=self.figures + by)

    def links(self, q: np.ndarray) -> list[np.ndarray]:
        """The frames of the base and of each link's far end, (n_poses, 4, 4) each."""
        alpha, a, theta, d = self.figures.T
        before = screws("x", alpha, a)
        about = screws("z", q + theta, d)
        found = [np.tile(np.eye(4), (len(q), 1, 1))]
        for joint in np.moveaxis(before @ about if self.modified else about @ before, 1, 0):
            found.append(found[-1] @ joint)
        return found


HALF = np.pi / 2
UR5E = Arm(
    np.array([
        [HALF, 0, 0, 0.1625], [0, -0.425, 0, 0], [0, -0.3922, 0, 0], [HALF, 0, 0, 0.1333], [-HALF, 0, 0, 0.0997],
        [0, 0, 0, 0.0996],
    ]),
    False,
    np.array([[-np.pi, np.pi]] * 6),
)  # fmt: skip
PANDA = Arm(
    np.array([
        [0, 0, 0, 0.333], [-HALF, 0, 0, 0], [HALF, 0, 0, 0.316], [HALF, 0.0825, 0, 0], [-HALF, -0.0825, 0, 0.384],
        [HALF, 0, 0, 0], [HALF, 0.088, 0, 0.107],
    ]),
    True,
    np.array([[-2.8, 2.8], [-1.7, 1.7], [-2.8, 2.8], [-3.0, -0.1], [-2.8, 2.8], [0.0, 3.7], [-2.8, 2.8]]),
)  # fmt: skip


@dataclass(frozen=True)
class Optics:
    """A lens: focal lengths and principal point [px], and k1, k2, p1, p2, k3."""

    focal: tuple[float, float] = (1150.0, 1146.0)
    centre: tuple[float, float] = (652.0, 471.0)
    bend: tuple[float, ...] = (-0.11, 0.08, 4e-4, -3e-4, 0.0)

    def image(self, points: np.ndarray) -> np.ndarray:
        """Where points (n, 3) of the camera's frame are shown (n, 2) [px]."""
        x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        k1, k2, p1, p2, k3 = self.bend
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        bent = (radial * x + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), radial * y + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y)
        return np.column_stack(bent) * self.focal + self.centre


def board(columns: int = 8, rows: int = 6, pitch: float = 0.03) -> np.ndarray:
    """A board's points (n, 3) [m], from a corner, row by row."""
    return np.array([(pitch * i, pitch * j, 0.0) for j, i in product(range(rows), range(columns))])


@dataclass(frozen=True)
class Photographs:
    """What was photographed: the rows, and the arm, the camera on its link, the target on its own, and the lens as they are."""

    rows: pd.DataFrame
    arm: Arm
    camera: np.ndarray
    target: np.ndarray
    lens: Optics


IN_HAND = frame(Rotation.from_euler("XYZ", (4, -7, 93), degrees=True), (0.03, -0.07, 0.06))
ON_TABLE = frame(Rotation.from_euler("XYZ", (1.5, -2, 30), degrees=True), (-0.45, 0.12, 0.02))
BESIDE = frame(
    Rotation.from_matrix([[0, 0, -1], [1, 0, 0], [0, -1, 0]]) * Rotation.from_rotvec((0.03, 0.07, -0.05)),
    (1.35, 0.05, 0.5),
)
IN_GRIPPER = frame(Rotation.from_euler("XYZ", (5, 80, -40), degrees=True), (0.02, 0.03, 0.11))


def looking(
    arm: Arm, points: np.ndarray, in_hand: bool, n: int, rng: np.random.Generator, most: float = 40.0
) -> np.ndarray:
    """Joint readings (n, n_joints) at which the camera sees the board from 0.3 to 0.6 m (in the hand) or further."""
    found: list[np.ndarray] = []
    camera, target = (IN_HAND, ON_TABLE) if in_hand else (BESIDE, IN_GRIPPER)
    middle, step = points.mean(axis=0), 1e-7 * np.eye(len(arm.figures))
    while len(found) < n:
        tilt = Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)
        tilt *= Rotation.from_euler("x", 180 + rng.uniform(-most, most), degrees=True)
        tilt *= Rotation.from_euler("y", rng.uniform(-most, most), degrees=True)
        far = rng.uniform(0.3, 0.6) if in_hand else rng.uniform(0.6, 1.0)
        aside = rng.uniform(-0.12, 0.12, 2) * far
        seen = frame(tilt, (0, 0, 0))
        seen[:3, 3] = np.array([*aside, far]) - seen[:3, :3] @ middle
        wanted = (
            target @ np.linalg.inv(seen) @ np.linalg.inv(camera) if in_hand else camera @ seen @ np.linalg.inv(target)
        )

        def off(q: np.ndarray, wanted: np.ndarray = wanted) -> np.ndarray:
            reached = arm.links(np.atleast_2d(q))[-1]
            turn = Rotation.from_matrix(reached[:, :3, :3].transpose(0, 2, 1) @ wanted[:3, :3]).as_rotvec()
            return np.hstack([reached[:, :3, 3] - wanted[:3, 3], 0.3 * turn]).reshape(*q.shape[:-1], 6)

        def slopes(q: np.ndarray, off: Callable[[np.ndarray], np.ndarray] = off) -> np.ndarray:
            more, less = np.split(off(np.vstack([q + step, q - step])), 2)
            return (more - less).T / 2e-7

        begin = rng.uniform(*(arm.limits * 0.7).T)
        end = least_squares(off, np.clip(begin, *arm.limits.T), slopes, (*arm.limits.T,), max_nfev=60)
        if np.abs(end.fun).max() < 1e-4:
            found.append(end.x)
    return np.array(found)


def photographed(
    arm: Arm,
    in_hand: bool,
    n: int,
    rng: np.random.Generator,
    noise: float = 0.2,
    lens: Optics = Optics(),
    points: np.ndarray | None = None,
    worn: Arm | None = None,
) -> Photographs:
    """Photographs by a worn arm: camera in its hand and board on the table, or camera beside it and board in its gripper."""
    points = board() if points is None else points
    q = looking(arm, points, in_hand, n, rng)
    worn = arm.worn(rng) if worn is None else worn
    hand = worn.links(q)[-1]
    camera, target = (IN_HAND, ON_TABLE) if in_hand else (BESIDE, IN_GRIPPER)
    seen = np.linalg.inv(hand @ camera) @ target if in_hand else np.linalg.inv(camera) @ hand @ target
    rows = []
    for k in range(n):
        image = lens.image(points @ seen[k, :3, :3].T + seen[k, :3, 3]) + noise * rng.standard_normal((len(points), 2))
        inside = ((image > 0) & (image < SIZE)).all(axis=1)
        rows.append(
            pd.DataFrame({"pose": k + 1, **{f"q{i + 1}_rad": q[k, i] for i in range(q.shape[1])}, "u_px": image[:, 0],
                          "v_px": image[:, 1], **{f"px_{axis}_mm": 1e3 * points[:, i] for i, axis in enumerate("xyz")}})[inside]
        )  # fmt: skip
    return Photographs(pd.concat(rows, ignore_index=True), worn, camera, target, lens)
