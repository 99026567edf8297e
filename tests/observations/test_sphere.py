"""Sphere: touches of a ball of unknown centre, its radius known or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.design.candidates import candidates
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations.sphere import Sphere
from calflow.robot.parts import Base
from hidden.devices import Arm, measured, rows
from hidden.trials import calibrated, error_of_tool
from observations.graph import error, no_links, through_json
from robots import ur10

CENTRE, RADIUS = np.array([0.5, 0.2, -0.1]), 0.04
STATED = Series.of("ball", "sphere", {"radius": RADIUS, "centre": tuple(CENTRE)})


def on_sphere(rng: np.random.Generator, n: int, height: float = 0.0) -> np.ndarray:
    """Points at a height over the sphere."""
    way = rng.normal(size=(n, 3))
    return CENTRE + (RADIUS + height) * way / np.linalg.norm(way, axis=1, keepdims=True)


def test_the_error_is_the_distance_from_the_sphere_less_the_reading():
    """Fails if a row is held against another sphere, or the radius' error has another sign."""
    rng = np.random.default_rng(1)
    points, reading = rng.normal(size=(6, 3)), rng.normal(size=6)
    table = pd.DataFrame({"reading": reading, "sphere": ["near", "far"] * 3})
    ball = Sphere.of(Series.of("", "sphere", {"radius": 0.05, "radius_sd": 0.001}), table)
    p = 0.1 * rng.normal(size=7)
    found = error(ball, p, points, table)[:, 0]
    for i in range(6):
        centre = p[3 * (i % 2) : 3 * (i % 2) + 3]
        assert abs(found[i] - (np.linalg.norm(points[i] - centre) - 0.05 - p[6] - reading[i])) < 1e-12
    names = [f"sphere-{n}.{axis}" for n in ("near", "far") for axis in "xyz"]
    assert [q.name for q in ball.declared] == [*names, "sphere.radius"]


@pytest.mark.parametrize("radius", [RADIUS, None])
def test_a_sphere_is_laid_through_its_points(radius):
    """Fails if exact points with readings leave an error, a known radius is moved, or an unknown one is not found."""
    rng = np.random.default_rng(2)
    points = np.vstack([on_sphere(rng, 8), on_sphere(rng, 8, 0.003)])
    table = pd.DataFrame({"reading": np.repeat([0.0, 0.003], 8)})
    settings = {} if radius is None else {"radius": radius}
    ball = Sphere.of(Series.of("", "sphere", settings), table).registered(points, no_links, table)
    np.testing.assert_allclose(error(ball, np.zeros(len(ball.declared)), points, table), 0, atol=1e-8)
    assert ball.radius == pytest.approx(RADIUS, abs=1e-8)
    assert len(ball.declared) == (3 if radius else 4)
    assert through_json(ball) == ball


def test_a_new_sphere_leaves_the_known_ones_and_their_radius():
    """Fails if an unknown sphere goes unseen, or adding it moves what was found before."""
    rng = np.random.default_rng(3)
    points, (known, new) = on_sphere(rng, 8), (pd.DataFrame({"sphere": [name] * 8}) for name in "ab")
    ball = Sphere.of(Series("", "sphere"), known).registered(points, no_links, known)
    assert ball.lacks(new)
    wider = ball.extended(new).registered(points + 0.3 * (points - CENTRE), no_links, new)
    assert wider.radius == ball.radius
    assert wider.placements | ball.placements == wider.placements
    assert not wider.lacks(new)


def test_planned_poses_touch_the_sphere_that_is_stated():
    """Fails if candidates miss the sphere, or one of unknown place is planned for."""
    ball = Sphere.planned(STATED)
    model = build(replace(ur10(), base=Base(fixed=True)), ("geometry",), (), (ball,))
    readings, conditions = candidates(model, 30, "", "E", None, np.random.default_rng(1), ball)
    assert len(readings) == 30
    apart = np.linalg.norm(model.point(model.nominal, conditions) - CENTRE, axis=1)
    np.testing.assert_allclose(apart, RADIUS, atol=2e-6)
    with pytest.raises(ValueError, match="centre_mm"):
        Sphere.planned(Series("ball", "sphere"))


def touched(arm: Arm, centre: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Joint angles at which the marker is on a sphere, but for noise."""
    start = arm.random(4 * n, rng)
    height = 5e-5 * rng.standard_normal(len(start))
    return arm.brought(lambda at: (np.linalg.norm(at - centre, axis=1) - RADIUS - height)[:, None], start)[:n]


def test_touches_of_three_balls_calibrate_a_robot():
    """Fails if balls of a known radius and unknown places bias the fit, or it promises too much."""
    rng = np.random.default_rng(4)
    arm = Arm.drawn(ur10(), rng)
    centres = {"a": CENTRE, "b": np.array([-0.4, 0.6, 0.1]), "c": np.array([0.1, -0.7, 0.5])}
    table = pd.concat(
        [rows(touched(arm, centre, 50, rng)).assign(sphere=name) for name, centre in centres.items()], ignore_index=True
    )
    found = calibrated(measured(arm.robot, table, STATED, 5e-5), ("geometry",)).fit
    squared = float((found.residual**2).sum()) / (found.residual.size - found.effective_parameters)
    assert 0.6 < squared < 1.5
    tool = error_of_tool(found, arm, 300, rng)
    assert tool.true < 1.5 * tool.promised
