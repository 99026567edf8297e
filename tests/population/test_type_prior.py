"""The type's prior covers further robots, and robots unlike their type are named as seldom by chance as is promised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.model import build
from calflow.population.likelihood import ParameterEstimates, ParameterLikelihood, shared_parameters
from calflow.population.type_prior import FEWEST_ROBOTS, type_prior
from calflow.population.unlike import unlike
from calflow.robot.parts import Marker, Parameter
from robots import hh800

N, ROWS, NOISE = 12, 20, 0.05
UNSEEN = N - 1  # the last parameter, of which nobody is told


def parameters() -> tuple[Parameter, ...]:
    return tuple(Parameter("e", f"joint{k}", "a", "rad", 2.0, -50, 50) for k in range(N))


def plant(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A type's mean and spread, in the priors' standard deviations."""
    return 0.5 * rng.standard_normal(N), 10 ** rng.uniform(-1.5, -0.5, N)


def told(rng: np.random.Generator, robot: str, value: np.ndarray) -> ParameterLikelihood:
    """What measurements tell in which two parameters look much alike, and one is not seen."""
    slope = rng.standard_normal((ROWS, N))
    slope[:, 1] = 0.9 * slope[:, 0] + 0.45 * slope[:, 1]
    slope[:, UNSEEN] = 0
    seen = slope @ value + NOISE * rng.standard_normal(ROWS)
    return ParameterLikelihood(robot, slope.T @ slope / NOISE**2, slope.T @ seen / NOISE**2)


def fleet(rng: np.random.Generator, robots: int, shifted: dict[int, tuple[int, float]] | None = None):
    mean, spread = plant(rng)
    value = mean + spread * rng.standard_normal((robots, N))
    for robot, (k, by) in (shifted or {}).items():
        value[robot, k] += by * spread[k]
    return mean, spread, [told(rng, str(robot), one) for robot, one in enumerate(value)]


@pytest.mark.parametrize("robots", [8, 40])
def test_what_is_expected_covers_further_robots(robots):
    """Fails if the spread comes out too small (as where the mean counts as known), or too wide."""
    rng, inside = np.random.default_rng(1), []
    for _ in range(60):
        mean, spread, found = fleet(rng, robots)
        prior = type_prior(parameters(), found)
        further = mean + spread * rng.standard_normal((20, N))
        inside.append(np.abs(further - prior.mean)[:, :UNSEEN] < 1.96 * prior.sd[:UNSEEN])
    assert 0.92 < np.mean(inside) < 0.98


def test_what_nobody_is_told_of_stays_as_wide_as_it_was():
    """Fails if a parameter that no robot determines becomes certain because all robots say the same: nothing."""
    prior = type_prior(parameters(), fleet(np.random.default_rng(2), 30)[2])
    assert prior.mean[UNSEEN] == pytest.approx(0.0)
    assert prior.sd[UNSEEN] > 0.9
    assert prior.determined[UNSEEN] == 0
    own = prior.expected()[UNSEEN]
    assert own.sd == float(f"{2.0 * prior.sd[UNSEEN]:.6g}")  # in digits that a file may state


def test_no_robot_is_named_by_chance():
    """Fails if the family of all robots' parameters is not counted, or a spread of few robots counts as known."""
    rng, named = np.random.default_rng(3), 0
    for k in range(60):
        named += bool(unlike(parameters(), fleet(rng, 10 if k % 2 else 30)[2])[1])
    assert named <= 8  # three are promised; nine come by chance in fewer than 1 of 200


def test_robots_unlike_their_type_are_named_with_what_is_unlike():
    """Fails if several such robots hide each other, or a robot that is like its type is named."""
    rng = np.random.default_rng(4)
    hidden = {3: (5, 10.0), 11: (2, -10.0), 12: (8, 12.0), 30: (5, 9.0)}
    mean, spread, found = fleet(rng, 40, hidden)
    prior, odd = unlike(parameters(), found)
    assert {one.robot: one.parameter.partition(".")[0] for one in odd} == {
        str(k): f"joint{j}" for k, (j, _) in hidden.items()
    }
    for one in odd:
        j, by = hidden[int(one.robot)]
        assert abs(one.shift - 2.0 * by * spread[j]) < 3 * one.sd
    assert np.abs((prior.mean - mean) / prior.sd)[:UNSEEN].max() < 1.5


def test_parameters_that_look_alike_are_said_together():
    """Fails if one of two parameters is named with certainty that the measurements do not tell apart."""
    rng = np.random.default_rng(5)
    value = 0.1 * rng.standard_normal((20, N))
    value[7, 0] += 1.0
    slope = rng.standard_normal((ROWS, N))
    slope[:, 1] = slope[:, 0] + 1e-3 * slope[:, 1]
    robots = [
        ParameterLikelihood(
            str(k), slope.T @ slope / NOISE**2, slope.T @ (slope @ one + NOISE * rng.standard_normal(ROWS)) / NOISE**2
        )
        for k, one in enumerate(value)
    ]
    (odd, *_) = unlike(parameters(), robots)[1]
    assert odd.robot == "7"
    assert {name.partition(".")[0] for name in (odd.parameter, *odd.instead)} >= {"joint0", "joint1"}


def test_too_few_robots_are_refused():
    """Fails if a spread is stated that nobody can know."""
    with pytest.raises(ValueError, match=f"at least {FEWEST_ROBOTS} robots"):
        unlike(parameters(), fleet(np.random.default_rng(6), FEWEST_ROBOTS - 1)[2])


def test_a_fits_own_prior_is_taken_out_of_what_it_tells(calibration: CalibratedModel):
    """Fails if what the study took for granted counts once a robot: a fit with another prior tells the same."""
    fitted = ParameterEstimates.of(calibration)
    shared = shared_parameters([fitted])
    one = ParameterLikelihood.of("r", fitted, shared)
    known = np.linalg.inv(one.information + np.eye(len(shared))) @ one.pull
    where = {p.identity: k for k, p in enumerate(calibration.model.parameters)}
    own = [where[p.identity] for p in shared]
    assert np.allclose(known * [p.prior_sd for p in shared], calibration.estimate[own], atol=1e-7, rtol=1e-3)


def test_what_was_set_up_with_a_robot_is_not_its_types():
    """Fails if the turn of an adapter with reflectors, or what a robot stands on, makes it unlike the others."""
    beside = {"E": Marker((0.1, 0, 0.1)), "F": Marker((-0.1, 0, 0.1), relative_sd=2e-5)}
    robot = hh800(markers=beside, tool_rotation=(0.0, 0.0, 0.0))
    model = build(robot, ("geometry", "joint-compliance", "base-compliance"))
    none = np.zeros(len(model.parameters))
    shared = shared_parameters([ParameterEstimates(model.parameters, none, np.diag(none), none > 0)] * 2)
    assert {p.part for p in model.parameters} > {"base", "E", "F", "markers"}
    assert {p.part for p in shared} == {"loop", *(f"joint{k}" for k in range(1, 7))}


@pytest.fixture(scope="module")
def calibration() -> CalibratedModel:
    import calflow as cf
    from estimation.data import drawn_truth, measured

    model = build(hh800(), ("geometry", "joint-compliance"))
    rng = np.random.default_rng(7)
    data = measured(model, drawn_truth(model, rng), 50, rng)
    data = replace(data, table=data.table.assign(sigma=3e-5))
    return cf.identify(data.robot, data, ["geometry", "joint-compliance"], starts=1)
