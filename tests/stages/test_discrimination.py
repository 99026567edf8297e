"""The poses that are proposed separate rivals better than others do."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.effects import catalogue
from calflow.model import Model, build
from calflow.stages.causes import Cause
from calflow.stages.discrimination import POSES, propose
from calflow.stages.fitted import Fitted
from calflow.stages.settle import fit_settled
from robots import industrial
from stages.data import SIGMA, measured, stated


def test_proposed_poses_separate_more_than_random_ones():
    """Breaks if poses are chosen for anything but what the rival cannot imitate, or their worth is misstated."""
    robot = industrial()
    ratio = Cause(robot, catalogue()["gear-ratio-error"](robot), "joint2")
    eccentric = Cause(robot, catalogue()["joint-eccentricity"](robot), "joint2")
    model = Model(robot, (*build(robot, ("geometry",)).effects, ratio))
    truth = model.nominal.copy()
    truth[-1] = 5e-4
    rng = np.random.default_rng(9)
    near = measured(model, truth, 60, rng)
    near = near.only(np.abs(near.joints[:, 1]) < 0.8)  # on short travel the two are alike
    fit, noise, lack, _ = fit_settled(model, near, stated(near), model.nominal[None], "linear")
    fitted = Fitted(fit, near, noise, lack, "linear", noise)
    proposal = propose(fitted, ratio, eccentric, SIGMA, np.random.default_rng(1))
    assert proposal.readings.shape == (POSES, 6)
    assert proposal.after > 1.5 * proposal.before

    def separation(readings):
        """What a rival's best fit leaves of the effect, by plain least squares."""
        more = measured(model, truth, len(readings), np.random.default_rng(2))
        more.table[[f"q{i + 1}" for i in range(6)]] = readings
        rows = np.hstack([near.rows, more.rows])
        both = Model(robot, (*model.effects, eccentric))
        jacobian = (
            both.position_jacobian(np.append(fit.estimate, [0.0, 0.0]), rows).reshape(3 * rows.shape[1], -1) / SIGMA
        )
        own = len(fit.estimate) - 1
        others = np.delete(np.arange(jacobian.shape[1]), own)
        whole = np.vstack([jacobian[:, others], np.diag(1 / both.prior_sd[others])])
        effect = np.append(jacobian[:, own] * fit.estimate[own], np.zeros(len(others)))
        return np.linalg.norm(effect - whole @ np.linalg.lstsq(whole, effect)[0])

    assert separation(proposal.readings) == pytest.approx(proposal.after, rel=0.02)
    random = measured(model, truth, POSES, np.random.default_rng(3)).joints
    assert separation(proposal.readings) > 1.1 * separation(random)
