"""Curves: what is drawn of a finding is its function over its variable, before and after it was put into the model."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.design.candidates import packed_conditions
from calflow.diagnosis.cause_tables import CurvePoint, curves
from calflow.diagnosis.fitted import Fitted
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.estimation.fit import Fit
from calflow.estimation.lack_of_fit import LackOfFit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise
from calflow.files.tables import columns
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import numbered
from calflow.model import Model, build

ROBOT = robots.industrial()
NOISE = 1e-5  # m
PLAY = 3e-4
COS, SIN = 2e-4, -1e-4
HELD = [1.2, 0.3, -0.4, 0.5, 0.9, -0.7]  # rad, of the joints that do not move in a sweep
FUNCTIONS = {  # rad, of the joint's angle [rad] and approach
    "joint-backlash": (2, "", (PLAY,), lambda angle, approach: PLAY / 2 * approach),
    "joint-eccentricity": (3, "deg", (COS, SIN), lambda angle, approach: COS * np.cos(angle) + SIN * np.sin(angle)),
}


def drawn(*names, q, approach):
    """The curves of some causes in a model whose values are true, at joint angles and approaches (n_rows, 6)."""
    causes = [Cause(ROBOT, catalogue()[name](ROBOT), f"joint{FUNCTIONS[name][0]}") for name in names]
    model = Model(ROBOT, (*build(ROBOT, ("geometry",)).effects, *causes), ("approach",))
    values = np.concatenate([FUNCTIONS[name][2] for name in names])
    estimate = np.concatenate([np.zeros(len(model.parameters) - len(values)), values])
    table = pd.DataFrame(q, columns=numbered("q", 6))
    table[numbered("approach", 6)] = approach
    split = np.where(np.arange(len(q)) % 3, "train", "holdout")
    table = table.assign(pose=np.arange(len(q)), marker="E", payload="load", split=split)
    noise = NOISE * np.random.default_rng(1).standard_normal((len(q), 3))
    table[["x", "y", "z"]] = model.position(estimate, Measurements(ROBOT, table).conditions) + noise
    data = Measurements(ROBOT, table)
    level = Noise(np.full(len(q), NOISE), ("file",))
    problem = LeastSquares.of(model, data, level)
    fit = Fit(problem, estimate, "linear", 0.0, (noise / NOISE).ravel(), 0 * estimate, np.eye(len(estimate)))
    fitted = Fitted(fit, data, level, LackOfFit(1.0, 0.5, 0.0), level)
    return curves(fitted, causes, data), noise


def lever(joint, q):
    """How far [m/rad] the tool moves with a joint."""
    model, step = build(ROBOT, ()), np.eye(6)[joint - 1] * 1e-6
    ahead, back = (
        model.position(model.nominal, packed_conditions(model, q + way * step, "load", "E")) for way in (1, -1)
    )
    return np.linalg.norm(ahead - back, axis=1) / 2e-6


@pytest.fixture(scope="module")
def rows():
    """Poses far apart, each reached from both sides."""
    q = robots.poses(ROBOT, 8)
    return {"q": np.repeat(q, 2, axis=0), "approach": np.tile([[-1.0], [1.0]], (8, 6))}


@pytest.mark.parametrize(
    "names", [("joint-backlash",), ("joint-eccentricity",), ("joint-backlash", "joint-eccentricity")]
)
def test_before_is_after_with_the_causes_own_part(rows, names):
    """Fails if what is drawn before is not what the model without this cause, but with the others, would leave."""
    found, noise = drawn(*names, **rows)
    assert list(found.columns) == [column.name for column in columns(CurvePoint)]
    assert_allclose(found["before"] - found["fitted"], found["after"], atol=1e-12)
    for k, name in enumerate(names):
        own = found[found["finding"] == k + 1]
        assert set(own["cause"]) == {name}
        assert set(own["joint"]) == {FUNCTIONS[name][0]}
        assert list(own["pose"]) == list(range(len(noise)))
        assert set(own["split"]) == {"train", "holdout"}
        assert (own["after"].abs() <= 1e3 * np.linalg.norm(noise, axis=1) + 1e-9).all()
        assert own["after"].std() == pytest.approx(1e3 * NOISE, rel=0.6)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_fitted_is_the_function_on_its_lever(rows, name):
    """Fails if a curve's abscissa is another joint's, or its ordinate is not the joint's error times the tool's lever."""
    joint, unit, _, function = FUNCTIONS[name]
    found, _ = drawn(name, **rows)
    angle, approach = rows["q"][:, joint - 1], rows["approach"][:, joint - 1]
    assert_allclose(found["x"], np.rad2deg(angle) if unit else approach, atol=1e-9)
    assert set(found["variable_unit"]) == {unit}
    assert f"joint {joint}" in found["variable"].iloc[0]
    expected = 1e3 * lever(joint, rows["q"]) * function(angle, approach)
    assert_allclose(np.abs(found["fitted"]), np.abs(expected), rtol=2e-3, atol=1e-4)


def test_a_curve_changes_sign_with_its_function():
    """Fails if the direction in which a row's error is taken turns with the error, so that all of it looks positive."""
    joint, _, _, function = FUNCTIONS["joint-eccentricity"]
    q = np.tile(HELD, (15, 1))
    q[:, joint - 1] = np.linspace(0.5, 1.7, 15)  # through zero at atan(2)
    found, _ = drawn("joint-eccentricity", q=q, approach=np.ones((15, 6)))
    expected = 1e3 * lever(joint, q) * function(q[:, joint - 1], 1.0)
    assert expected.min() < -0.05 < 0.05 < expected.max()
    side = np.sign(found["fitted"].iloc[0] * expected[0])
    assert_allclose(side * found["fitted"], expected, atol=2e-3)


def test_backlash_is_drawn_to_both_sides(rows):
    """Fails if a pose's errors from its two sides are drawn to the same side."""
    found, _ = drawn("joint-backlash", **rows)
    fitted = found["fitted"].to_numpy().reshape(-1, 2)
    assert_allclose(fitted[:, 0], -fitted[:, 1], rtol=1e-2)


def test_no_finding_draws_nothing(rows):
    """Fails if a table without findings has no columns, or holds the model's other effects."""
    found, _ = drawn("joint-backlash", **rows)
    assert len(found) == len(rows["q"])
    data = Measurements(
        ROBOT,
        pd.DataFrame(rows["q"], columns=numbered("q", 6)).assign(
            pose=range(len(rows["q"])), x=0.0, y=0.0, z=0.0, marker="E", payload=""
        ),
    )
    model = build(ROBOT, ("geometry",))
    level = Noise(np.ones(len(data)), ("file",))
    problem = LeastSquares.of(model, data, level)
    fit = Fit(
        problem, model.nominal, "linear", 0.0, np.zeros(3 * len(data)), 0 * model.nominal, np.eye(len(model.nominal))
    )
    none = curves(Fitted(fit, data, level, LackOfFit(1.0, 0.5, 0.0), level), [], data)
    assert list(none.columns) == [column.name for column in columns(CurvePoint)]
    assert none.empty
