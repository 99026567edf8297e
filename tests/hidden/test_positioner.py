"""A two-axis positioner beside an arm that touches the piece on it: one robot, by kinematics of its own in numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.measurements.series import Series
from hidden.devices import measured, rows
from hidden.test_arms import NOISE, frame, point_of_link
from hidden.trials import calibrated

Array = np.ndarray
LINKS = ((0.4, 0.0, 90.0), (0.1, 0.0, 0.0), (0.5, 0.1, 90.0), (0.0, 0.6, 0.0), (0.0, 0.1, 90.0), (0.6, 0.0, -90.0),
         (0.0, 0.0, 90.0))  # fmt: skip
PARENTS = (0, 1, 0, 3, 4, 5, 6)  # links, 0 the base: tilt and plate, then the arm
PLATE, FLANGE = 2, 7
STANDS = (-0.9, 0.1, 0.0), (0.0, 0.0, 0.3)  # of the arm on the floor
TIP = (0.0, 0.03, 0.2)
CUPS = {
    "a": (0.1, 0.0, 0.1),
    "b": (-0.08, 0.12, 0.14),
    "c": (0.0, -0.15, 0.05),
}  # in the plate's frame, which nobody knows
LIMITS = np.array([(-1.0, 1.0), (-2.5, 2.5), *((-2.2, 2.2),) * 5])


def robot() -> cf.Robot:
    """The cell as its maker says."""
    joints = []
    for i, (d, a, alpha) in enumerate(LINKS, start=1):
        stated = cf.dh(d=d, a=a, alpha=np.deg2rad(alpha))
        stated = cf.at_origin(stated, *STANDS) if i == 3 else stated
        joints.append(cf.Joint(stated, link={PLATE: "plate", FLANGE: "flange"}.get(i, ""),
                               parent="base" if i == 3 else "", limits=tuple(LIMITS[i - 1])))  # fmt: skip
    return cf.Robot(joints=joints, markers={"tip": cf.Marker(TIP, on="flange")}, base=cf.Base())


@dataclass(frozen=True)
class Positioner:
    """The cell as it is: what stands before and after each joint's turn, each off by some 0.3 mm and mrad."""

    before: list[Array]
    after: list[Array]

    @staticmethod
    def made(rng: np.random.Generator) -> Positioner:
        """Make one."""

        def off() -> Array:
            return frame(Rotation.from_rotvec(3e-4 * rng.normal(size=3)), 3e-4 * rng.normal(size=3))

        stands = frame(Rotation.from_euler("XYZ", STANDS[1]), STANDS[0])
        return Positioner(
            [(stands if i == 2 else np.eye(4)) @ off() for i in range(len(LINKS))],
            [frame(Rotation.from_euler("x", alpha, degrees=True), (a, 0, d)) @ off() for d, a, alpha in LINKS],
        )

    def placed(self, q: Array, link: int, point: object) -> Array:
        """Where a point of a link is on the floor, (n, 3), by joint angles (n, 7)."""
        return point_of_link(self.before, self.after, PARENTS, q, link, point)

    def touching(self, cup: object, starts: int, rng: np.random.Generator) -> Array:
        """Joint angles (n, 7) by which the arm's tip is in a cup of the plate, wherever that is turned."""
        seat = NOISE * rng.normal(size=(starts, 3))
        q, arm = rng.uniform(*LIMITS.T, (starts, len(LIMITS))), np.eye(len(LIMITS))[2:]

        def apart(q: Array) -> Array:
            return self.placed(q, FLANGE, TIP) - self.placed(q, PLATE, cup) + seat

        for _ in range(30):
            slope = np.stack([(apart(q + 1e-6 * way) - apart(q)) / 1e-6 for way in arm], axis=2)
            q = q - np.clip(np.einsum("nji,ni->nj", np.linalg.pinv(slope, rcond=1e-2), apart(q)), -0.3, 0.3) @ arm
        met = np.linalg.norm(apart(q), axis=1) < 1e-9
        return np.asarray(q[met & ((q > LIMITS[:, 0]) & (q < LIMITS[:, 1])).all(axis=1)])


def test_an_arm_that_touches_the_piece_calibrates_the_positioner_too():
    """Fails if a cup on the plate is taken to stand still on the floor, or an error of the positioner is not found."""
    rng = np.random.default_rng(2)
    real = Positioner.made(rng)
    touches = [rows(real.touching(cup, 150, rng)[:40]).assign(socket=name) for name, cup in CUPS.items()]
    table = pd.concat(touches, ignore_index=True)
    assert len(table) > 90
    data = measured(robot(), table, Series.of("piece", "same-point", {"on": "plate"}, labels=("socket",)), NOISE)
    assert calibrated(data, ("geometry",)).left < 1.3 * NOISE
    assert calibrated(data, ()).left > 5 * NOISE  # of the maker's cell
