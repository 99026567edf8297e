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


def test_rows_that_were_held_out_do_not_tell_when_it_was(full):
    """Fails if a jump is dated to the row where nobody looks, of several that the fit does not distinguish."""
    n = full.robot.n_joints
    table = pd.DataFrame(np.random.default_rng(1).uniform(-0.5, 0.5, (12, n)), columns=numbered("q", n))
    held = np.isin(np.arange(12), (5, 6))
    table = table.assign(
        pose=np.arange(12).astype(str), order=np.arange(1.0, 13.0), split=np.where(held, "holdout", "train")
    )
    data = Measurements(full.robot, table)
    step = JointStep(full.robot)
    assert step.at(6.5, data).detail == "after row 5 and before row 8 in measuring order"
    assert step.at(4.5, data).detail == "after row 4 in measuring order"
