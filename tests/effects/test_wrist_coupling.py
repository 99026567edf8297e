"""A SCARA's quill slides as it turns: hidden in positions of plain trigonometry, to be found as the coupling that it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

import calflow as cf
from calflow.effects import catalogue

UPPER, FORE, ASIDE = 0.35, 0.3, 0.06  # m
LEAD, NOISE = 8e-5, 3e-5  # m/rad, m


def scara(tilted: float = 0.0) -> cf.Robot:
    """Two turning joints, a slide downwards and a turning tool, which may be tilted against the slide."""
    joints = [
        cf.Joint(cf.modified_dh(d=0.4), limits=(-2.3, 2.3)),
        cf.Joint(cf.modified_dh(a=UPPER), limits=(-2.4, 2.4)),
        cf.Joint(cf.modified_dh(alpha=np.pi, a=FORE), kind="prismatic", limits=(0, 0.2)),
        cf.Joint(cf.modified_dh(alpha=tilted), limits=(-3.1, 3.1)),
    ]
    return cf.Robot(joints=joints, markers={"tool": cf.Marker((ASIDE, 0, 0.03))})


def test_a_quill_that_slides_as_it_turns_is_named(tmp_path: Path) -> None:
    """Fails if the coupling is left unexplained, taken for an error of the turning joint's own, or has another sign or size."""
    robot, rng = scara(), np.random.default_rng(1)
    q = rng.uniform(*robot.limits.T, (80, 4))
    arm = q[:, 0] + q[:, 1]
    tool = arm - q[:, 3]  # the shaft points down, so its turn counts the other way
    place = np.stack([
        UPPER * np.cos(q[:, 0]) + FORE * np.cos(arm) + ASIDE * np.cos(tool),
        UPPER * np.sin(q[:, 0]) + FORE * np.sin(arm) + ASIDE * np.sin(tool),
        0.4 - 0.03 - q[:, 2] - LEAD * q[:, 3],
    ], axis=1)  # fmt: skip
    columns = ["q1_rad", "q2_rad", "q3_m", "q4_rad", "x_m", "y_m", "z_m"]
    table = pd.DataFrame(np.hstack([q, place + rng.normal(0, NOISE, place.shape)]), columns=columns)
    table.assign(sigma_m=NOISE).to_csv(tmp_path / "points.csv", index=False)
    data = cf.Measurements.from_csv(tmp_path / "points.csv", robot).split(holdout=0.3, seed=1)
    found = cf.identify(robot, data, ["geometry"], starts=1).diagnose().findings
    assert [(finding.cause, finding.joint) for finding in found] == [("wrist-coupling", 3)]
    assert abs(found[0].estimate - LEAD) < 4 * found[0].sd


def test_only_a_joint_along_the_slide_moves_it() -> None:
    """Fails if a slide is coupled to a joint with another shaft, or a turning joint to its slide."""
    coupled = lambda robot: [p.name for p in catalogue()["wrist-coupling"](robot).declared]  # noqa: E731
    assert coupled(scara()) == ["joint3.wrist-coupling.k34"]
    assert coupled(scara(tilted=0.5)) == []
