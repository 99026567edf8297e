"""When a joint's zero may have jumped."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calflow.effects.joint_step import JointStep
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import numbered


def test_one_or_two_poses_at_an_end_are_no_step_however_many_markers_they_have(full):
    """Fails if rows of one pose count as several: a step would be fitted to the last pose, and be in all predictions."""
    pose, n = np.repeat(np.arange(12), 3), full.robot.n_joints
    table = pd.DataFrame(np.random.default_rng(1).uniform(-0.5, 0.5, (12, n))[pose], columns=numbered("q", n))
    table = table.assign(
        pose=pose.astype(str), order=np.arange(1.0, 37.0), split=np.where(pose == 10, "holdout", "train")
    )
    data = Measurements(full.robot, table)
    moments = [step.moment for step in JointStep.variants(full.robot, data)]
    assert min(moments) == 7.5  # within the third pose: a tracker may be bumped between two markers
    assert max(moments) == 26.5  # likewise: of the last four poses one is held out
