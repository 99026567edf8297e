"""Contact: candidates for what touches are brought to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.design.candidates import candidates
from calflow.design.planned import Planned
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations.same_point import SamePoint
from calflow.robot.parts import Base
from robots import ur10


def test_candidates_go_to_both_sockets_within_the_limits():
    """Fails if poses miss the sockets, all go to one of them, or a joint leaves its range."""
    sockets = SamePoint.planned(Series.of("", "same-point", {"distance": 0.05, "place": (0.6, 0.2, 0.3)}))
    robot = replace(ur10(), base=Base(fixed=True))
    model = build(robot, ("geometry",), (), (sockets,))
    readings, conditions = candidates(model, 40, "", "E", None, np.random.default_rng(1), sockets)
    points = model.point(model.nominal, conditions)
    apart = np.linalg.norm(points[:, None] - np.array([[0.6, 0.2, 0.3], [0.65, 0.2, 0.3]]), axis=2)
    assert (apart.min(axis=1) < 2e-6).all()
    assert set(apart.argmin(axis=1)) == {0, 1}
    low, high = robot.limits.T
    angles = readings @ robot.reading_matrix.T
    assert ((angles > low) & (angles < high)).all()
    slope = Planned(sockets, 1e-4).whitened(model, model.nominal, conditions)
    assert slope.shape == (40, 3, len(model.parameters))
    assert np.isfinite(slope).all()
