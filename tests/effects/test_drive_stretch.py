"""The stretch of a linear axis's drive, hidden in a lift whose equations are written out here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from calflow import Measurements, identify
from calflow.diagnosis.findings import Finding
from calflow.robot.frames import modified_dh
from calflow.robot.mechanism import rated_torques
from calflow.robot.parts import Joint, Marker, Payload
from calflow.robot.robot import Robot
from hidden.simulator import moved, shifted, turned

LIFT = Robot(
    [
        Joint(modified_dh(), kind="prismatic", limits=(0, 1.5), mass=40.0, com=(0, 0, 0.1)),
        Joint(modified_dh(a=0.2, d=0.1), limits=(-2.5, 2.5), mass=15.0, com=(0.3, 0, 0)),
        Joint(modified_dh(a=0.6), limits=(-2.5, 2.5), mass=8.0, com=(0.2, 0, 0)),
        Joint(modified_dh(alpha=np.pi / 2, a=0.5), limits=(-1.5, 1.5), mass=3.0, com=(0, 0, 0)),
    ],
    gravity=(0, 0, -9.80665),
    payloads={"empty": Payload(1.0, (0, 0, 0)), "box": Payload(45.0, (0, 0, 0))},
    markers={"a": Marker((0.2, 0.1, 0)), "b": Marker((-0.05, 0.15, 0.1))},
)  # fmt: skip


def lifted(stretch: float, rng: np.random.Generator) -> Measurements:
    """What a tracker sees of a lift on a belt of which 0.4 m are free at the bottom, longer by stretch per newton and metre."""
    q = rng.uniform(*LIFT.limits.T, (80, 4))
    names = np.where(np.arange(80) % 4 < 2, "empty", "box")
    force = 9.80665 * (66.0 + np.where(names == "box", 45.0, 1.0))
    sunk = stretch * force * (0.4 + q[:, 0])
    arm = shifted(z=q[:, 0] - sunk) @ shifted(0.2, z=0.1003) @ turned(2, q[:, 1]) @ shifted(0.6004)
    hand = arm @ turned(2, q[:, 2]) @ shifted(0.5) @ turned(0, np.pi / 2) @ turned(2, q[:, 3])
    seen = np.concatenate([moved(hand, np.array(marker.point)) for marker in LIFT.markers.values()])
    return Measurements.from_arrays(
        LIFT, np.tile(q, (2, 1)), seen + 3e-5 * rng.standard_normal(seen.shape), sigma=3e-5,
        pose=np.tile(np.arange(80), 2), marker=np.repeat([*LIFT.markers], 80), payload=np.tile(names, 2),
    ).split(seed=3)  # fmt: skip


def told(data: Measurements) -> Sequence[Finding]:
    """What is named in it."""
    names = ["drive-stretch", "gear-ratio-error", "joint-error-map", "nonlinear-joint-stiffness", "link-mass"]
    return identify(LIFT, data, ("geometry", "joint-compliance"), starts=1).diagnose(catalogue=names).findings


def test_a_belt_that_its_load_stretches_is_told_from_a_wrong_ratio():
    """Fails if what a lift's belt gives way, the more the longer it is, passes for a wrong ratio."""
    (found,) = told(lifted(4e-7, np.random.default_rng(8)))  # benchmarks/slow has a stiff belt
    assert (found.cause, found.joint, found.unit) == ("drive-stretch", 1, "m/m")
    assert found.estimate == pytest.approx(4e-7 * rated_torques(LIFT)[0], rel=0.2)
