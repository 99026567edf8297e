"""Slopes by levers are those of the graph itself, for every effect that there is."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow.effects import Effect, catalogue
from calflow.effects.cause import Cause
from calflow.estimation.error_model import normal_equations, usual_sizes
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise
from calflow.estimation.probing import probed
from calflow.estimation.registration import registered
from calflow.estimation.smooth_functions import smooth_functions
from calflow.files.units import PIXEL
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.observations import observations
from calflow.observations.position import Position
from calflow.robot.robot import Robot
from estimation.data import drawn_truth, stated
from hidden.case import Case, write_case
from observations.photographed import UR5E, photographed
from observations.test_camera import study

COLUMNS = ("approach", "travel", "time", "temperature")
MODELS = {
    "serial": ("geometry", "joint-compliance", "gear-ratio-error"),
    "hh800": ("geometry", "gravity-deflection", "link-bending"),
}


def forms(robot, data) -> tuple[Effect, ...]:
    """Two forms of every effect at the most, and single causes, which own only a part of an effect."""
    every = [form for kind in catalogue().values() if not kind.is_noise() for form in kind.variants(robot, data)[:2]]
    whole = [effect for effect in every if effect.declared]
    single = [Cause(robot, effect, list(effect.parts)[-1]) for effect in whole[::3]]
    return (*whole, *single)


def direct(problem, p, effects):
    """Residuals and Jacobian of one graph with all effects in it."""
    large = replace(problem.model, probes=tuple(effects))
    return probed(problem.on(large), np.concatenate([p, large.nominal[len(p) :]]), ())


@pytest.fixture(scope="module", params=MODELS)
def problem(request, tmp_path_factory):
    """A model away from its nominal values, of data in which hardly a condition is missing."""
    folder = tmp_path_factory.mktemp(request.param)
    case = Case(robot=request.param, poses=40, columns=COLUMNS, markers=3)
    write_case(folder, case, np.random.default_rng(1))
    robot = Robot.from_toml(folder / "robot.toml")
    data = Measurements.from_csv(folder / "measurements.csv", robot)
    return LeastSquares.of(build(robot, MODELS[request.param], data.given), data, stated(data)), data


def test_levers_give_the_slopes_of_the_whole_graph(problem):
    """Fails if an effect acts on the graph through something that no lever reaches, or columns are another parameter's."""
    problem, data = problem
    effects = forms(data.robot, data)
    p = drawn_truth(problem.model, np.random.default_rng(3), 0.3)
    left, matrix = probed(problem, p, effects)
    wanted_left, wanted = direct(problem, p, effects)
    assert_allclose(left, wanted_left, rtol=1e-12)
    assert matrix.shape == wanted.shape
    assert_allclose(
        matrix / np.abs(wanted).max(axis=0).clip(1e-9), wanted / np.abs(wanted).max(axis=0).clip(1e-9), atol=1e-9
    )
    assert (np.abs(matrix).max(axis=0) > 0).mean() > 0.8
    alone = probed(problem, p, ())[1]
    assert_allclose(alone, matrix[:, : len(p)], rtol=1e-9, atol=1e-9 * np.abs(alone).max())


@dataclass(frozen=True)
class Twice(Position):
    """An observation that asks the device for two points: the second's place is mixed into the first's error."""

    def error(self, p, seen, reported) -> ca.SX:
        """Compare the mean of two reports."""
        both = seen.device(seen.point) + seen.device(2 * seen.point)
        return both - 3 * reported[:3]


def test_a_device_that_is_asked_twice_is_one_graph(problem):
    """Fails if what a device reports of two points counts as one, as a lever would have it."""
    problem, _ = problem
    model = problem.model
    observation = Twice(**{one.name: getattr(model.observations[0], one.name) for one in fields(Twice)})
    model = replace(model, observations=(observation,))
    problem = LeastSquares(model, tuple(replace(b, model=model, observation=observation) for b in problem.blocks))
    turned = catalogue()["frame-step"](model.robot, 50.5, True)
    p = model.nominal
    assert_allclose(probed(problem, p, [turned])[1], direct(problem, p, [turned])[1], rtol=1e-12)


@pytest.mark.parametrize("correlation", [0.0, 0.4])
def test_an_images_points_have_their_slopes_in_common(tmp_path, correlation):
    """Fails if the sums by images are not those row by row, be it that columns or images are mixed up, or errors shared."""
    made = photographed(UR5E, True, 8, np.random.default_rng(5))
    data = study(tmp_path, made, "ur5e", True).measurements()
    robot, observed = registered(data.robot, observations(data), data)
    data = data.on(robot)
    model = build(robot, ("geometry",), data.given, observed)
    noise = Noise(np.full(len(data), 0.2), ("file",), units=(PIXEL,), intraclass=correlation)
    problem = LeastSquares.of(model, data, noise)
    functions = [one for _, some in smooth_functions(problem, model.nominal, data) for one in some]
    assert len(data) > 8
    alone = replace(problem.blocks[0], intraclass=0.0)
    left, slopes = probed(replace(problem, blocks=(alone,)), model.nominal, functions)
    slopes[:, len(model.nominal) :] *= usual_sizes(model, functions)
    rows = np.column_stack([slopes, left]).reshape(len(data), 2, -1)
    assert problem.blocks[0].intraclass == correlation
    rows = problem.blocks[0].decorrelated(rows)
    rows = rows.reshape(2 * len(data), -1)
    found = normal_equations(problem, model.nominal, functions)
    size = np.linalg.norm(rows, axis=0).clip(1e-9)
    assert_allclose(found.products / np.outer(size, size), rows.T @ rows / np.outer(size, size), atol=1e-11)
